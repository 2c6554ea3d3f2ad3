"""Slice model and crosshead programme against closed forms and an independent root search."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq

from thermofit.core.errors import StudyError
from thermofit.core.experiment import Specimen
from thermofit.core.parameters import Parameters
from thermofit.point.driver import PointSettings, Programme, simulate
from thermofit.study.virtual import Machine, Simulate
from thermofit.virtual.machine import (
    CrossheadStep,
    bar_of,
    describe_programme,
    elongation,
    load_history,
    programme_of,
    uniaxial_law,
)

LAW = Parameters.of({"E": 68396.66, "nu": 0.34, "M_y0": 128.92, "M_yinf": 292.73, "H_exp": 10.87, "F": 0.35})
DOGBONE = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
STRAIGHT = Specimen(25.0, 1.2, 100.0, 25.0, 25.0, 150.0, 10.0)
RATIO = np.sqrt(0.35 + 0.5)
PROGRAMME = (
    {"hold": 3.0},
    {"crosshead_to": 9.5, "rate": 0.14},
    {"force_to": 1500.0, "rate": -0.14},
    {"crosshead_to": 19.5, "rate": 0.14},
    {"force_to": 0.0, "rate": -0.14},
    {"hold_force_until": 400.0},
)
MACHINE = Machine()


def steps_of(*actions: dict[str, float]) -> tuple[CrossheadStep, ...]:
    return programme_of(Simulate.model_validate({"truth": {}, "programme": actions}).programme)


LAME, MU = 68396.66 * 0.34 / (1.34 * 0.32), 68396.66 / 2.68


def hencky(mandel: float) -> float:
    """Logarithmic elastic stretch b along the load: mu (exp 2b - exp 2a) = M_22, lateral faces free mu exp 2a + lambda (2a + b) = mu."""
    return brentq(
        lambda b: MU * (np.exp(2.0 * b) - 1.0) - mandel + LAME * (np.log(np.exp(2.0 * b) - mandel / MU) + b), -0.01, 0.02, xtol=1e-16
    )


def closed_form_force(lam: float) -> tuple[float, float]:
    """Force and elongation of the straight bar at the plastic multiplier Lambda."""
    mandel = (128.92 + (292.73 - 128.92) * (1.0 - np.exp(-10.87 * lam))) / RATIO
    stretch = np.exp(RATIO * lam + hencky(mandel))
    return mandel / stretch * 25.0 * 1.2, 150.0 * (stretch - 1.0)


@pytest.mark.parametrize("lam", [0.0, 1e-4, 0.01, 0.05, 0.1, 0.15, 0.179])
def test_straight_bar_reproduces_the_closed_form(lam: float) -> None:
    force, length = closed_form_force(lam)
    bar = bar_of(STRAIGHT, uniaxial_law(LAW))
    assert elongation(bar, np.array([force]), np.array([force]))[0] == pytest.approx(length, rel=2e-7)


def test_unloaded_bar_keeps_the_plastic_stretch() -> None:
    force, _ = closed_form_force(0.1)
    bar = bar_of(STRAIGHT, uniaxial_law(LAW))
    assert elongation(bar, np.array([0.0]), np.array([force]))[0] == pytest.approx(150.0 * np.expm1(RATIO * 0.1), rel=2e-7)


def test_capacity_is_the_largest_force_of_the_closed_form() -> None:
    lam = np.linspace(0.0, 0.4, 40001)
    forces = np.array([closed_form_force(value)[0] for value in lam])
    assert bar_of(STRAIGHT, uniaxial_law(LAW)).capacity == pytest.approx(forces.max(), rel=1e-8)


@pytest.mark.parametrize("model", [1, 2])
@pytest.mark.parametrize("own", [{}, {"H_lin": 200.0}, {"second_hardening.Q": 60.0, "second_hardening.b": 20.0}, {"G": 0.7, "F": 0.42}])
def test_the_machine_pulls_by_the_law_of_the_point(model: int, own: dict[str, float]) -> None:
    """Capacity is the largest nominal stress of the point driver, slowly pulled at one temperature; elongation its strain."""
    law = LAW.replace(**own)
    bar = bar_of(STRAIGHT, uniaxial_law(law, model))
    programme = Programme.by_strain(np.linspace(0.0, 1e9, 8001), np.linspace(0.0, 0.4, 8001))
    history = simulate(law.replace(tau=1.0), programme, PointSettings(model))
    peak = int(np.argmax(history.stress))
    assert 0 < peak < len(history.stress) - 1
    assert bar.capacity / 30.0 == pytest.approx(history.stress[peak], rel=1e-6)
    assert uniaxial_law(law, model, 2001).nominal[-1] == pytest.approx(history.stress[peak], rel=1e-5)
    some = np.arange(5, int(0.9 * peak), 97)
    force = 30.0 * history.stress[some]
    assert elongation(bar, force, force) == pytest.approx(150.0 * history.strain[some], rel=1e-6)


def test_linear_hardening_raises_what_the_specimen_carries_in_both_models() -> None:
    for model in (1, 2):
        without, with_it = (uniaxial_law(LAW.replace(H_lin=h), model).nominal[-1] for h in (0.0, 200.0))
        assert with_it > 1.1 * without


def test_a_yield_plateau_is_passed_and_not_taken_for_the_largest_force() -> None:
    law = uniaxial_law(LAW.replace(**{"yield_plateau.share": 1.0, "yield_plateau.length": 0.02, "yield_plateau.upper": 10.0}))
    assert (np.diff(law.nominal) > 0.0).all() and (np.diff(law.plastic) > 0.0).all()
    assert law.nominal[-1] > 1.2 * law.nominal[0] and np.diff(law.plastic).max() > 0.01


def test_elastic_dogbone_against_quadrature_over_its_width() -> None:
    def width(y: float) -> float:
        s = min(max(y - 50.0, 0.0), 15.0)
        return 25.0 + 2.0 * (25.0 - np.sqrt(625.0 - s**2))

    force = 1000.0

    def strain(y: float) -> float:
        nominal = force / (width(y) * 1.2)
        return np.expm1(brentq(lambda e: e - hencky(nominal * np.exp(e)), 0.0, 0.01, xtol=1e-15))

    expected = 2.0 * quad(strain, 0.0, 75.0, points=[50.0, 65.0], epsabs=1e-13)[0]
    bar = bar_of(DOGBONE, uniaxial_law(LAW))
    assert bar.length.sum() == pytest.approx(150.0)
    assert elongation(bar, np.array([force]), np.array([force]))[0] == pytest.approx(expected, rel=1e-9)


def test_programme_is_executed_exactly() -> None:
    bar = bar_of(DOGBONE, uniaxial_law(LAW))
    history = load_history(steps_of(*PROGRAMME), bar, MACHINE)
    time, crosshead = history.time, history.crosshead
    assert (np.diff(time) > 0.0).all() and np.diff(time).max() <= 0.1 + 1e-9
    assert time[0] == 0.0 and time[-1] == 400.0
    assert np.isin(history.kinks, time).all() and len(history.kinks) == 5
    assert history.kinks[:2] == pytest.approx([3.0, 3.0 + 9.5 / 0.14])
    at = np.searchsorted(time, history.kinks)
    assert crosshead[at[[1, 3]]] == pytest.approx([9.5, 19.5])
    assert history.force[at[[2, 4]]] == pytest.approx([1500.0, 0.0])
    rate = np.diff(crosshead) / np.diff(time)
    phase = np.searchsorted(history.kinks, time[:-1], side="right")
    assert rate == pytest.approx(np.array([0.0, 0.14, -0.14, 0.14, -0.14, 0.0])[phase], abs=1e-9)
    largest = np.maximum.accumulate(history.force)
    give = elongation(bar, history.force, largest) + MACHINE.compliance * history.force + history.slip
    assert give == pytest.approx(crosshead, abs=1e-9)


def test_slip_only_grows_and_stays_after_unloading() -> None:
    history = load_history(steps_of(*PROGRAMME), bar_of(DOGBONE, uniaxial_law(LAW)), MACHINE)
    assert (np.diff(history.slip) >= 0.0).all()
    assert 0.9 * MACHINE.slip < history.slip[-1] < MACHINE.slip
    assert history.force[-1] == 0.0


@settings(max_examples=15, deadline=None)
@given(st.floats(0.5, 8.0), st.floats(0.0, 1000.0), st.floats(8.5, 15.0), st.floats(0.05, 0.5))
def test_any_loading_unloading_reloading_is_consistent(first: float, down: float, second: float, rate: float) -> None:
    bar = bar_of(DOGBONE, uniaxial_law(LAW))
    steps = [
        CrossheadStep("crosshead_to", first, rate),
        CrossheadStep("force_to", down, -rate),
        CrossheadStep("crosshead_to", second, rate),
    ]
    history = load_history(steps, bar, MACHINE, rate=2.0)
    largest = np.maximum.accumulate(history.force)
    give = elongation(bar, history.force, largest) + MACHINE.compliance * history.force + history.slip
    assert give == pytest.approx(history.crosshead, abs=1e-8)


@pytest.mark.parametrize(
    ("items", "text"),
    [
        ([{"crosshead_to": 40.0, "rate": 0.1}], "largest force"),
        ([{"force_to": 9000.0, "rate": 0.1}], "more than the specimen can carry"),
        ([{"crosshead_to": 5.0, "rate": -0.1}], "change its sign"),
        ([{"crosshead_to": 5.0, "rate": 0.1}, {"crosshead_to": 0.0, "rate": -0.1}], "compress"),
        ([{"hold": 5.0}, {"hold_force_until": 4.0}], "lies before"),
    ],
)
def test_impossible_programmes_are_refused(items: list[dict[str, float]], text: str) -> None:
    with pytest.raises(StudyError, match=text):
        load_history(steps_of(*items), bar_of(DOGBONE, uniaxial_law(LAW)), MACHINE)


def test_a_programme_without_time_is_refused() -> None:
    with pytest.raises(StudyError, match="takes no time"):
        load_history((), bar_of(DOGBONE, uniaxial_law(LAW)), MACHINE)


def test_impossible_specimens_are_refused() -> None:
    with pytest.raises(StudyError, match="grip_width"):
        bar_of(Specimen(25.0, 1.2, 100.0, 2.0, 35.0, 150.0, 10.0), uniaxial_law(LAW))
    with pytest.raises(StudyError, match="total_length"):
        bar_of(Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 120.0, 10.0), uniaxial_law(LAW))


def test_programme_in_words() -> None:
    words = describe_programme(steps_of(*PROGRAMME))
    assert words[1] == "crosshead at 0.14 mm/s to 9.5 mm" and words[-1] == "constant force until 400 s"
