"""What every hardening law answers, found by itself: derivatives, energy, lanes, both drivers, first guess, recovery of what was planted.

A law has its closed form, worked out by hand, in tests/law/hardening/test_<law>.py.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from coupons import CYCLES, LOSSY, bar_and_point, corners, cycles
from hardening_law import parameters_of, values_of
from scipy.integrate import quad
from scipy.optimize import least_squares

from thermofit.core.errors import StudyError
from thermofit.core.jit import kernel
from thermofit.core.lanes import spread
from thermofit.core.parameters import LAW, Param, Parameters, param
from thermofit.effects.catalogue import MATERIAL, effects
from thermofit.effects.curve import hardening as curve_for_effects
from thermofit.law.composition import EFFECT_NUMBERS, hardening_along, hardening_stress
from thermofit.law.hardening.catalogue import Hardening, hardening, hardening_laws, law_of_file
from thermofit.law.hardening.curves import first_guess, taken_over
from thermofit.law.page import Law, dissipated_energy, hardening_variable, law_in_step, law_of, plastic_energy, yield_stress
from thermofit.law.page_rates import N_NUMBERS, NUMBERS, STEP, moved_law, number_rates, yield_gradients
from thermofit.point.driver import PointSettings, Programme, simulate, simulate_rates
from thermofit.point.lanes_memory import lane_sum
from thermofit.virtual.machine import uniaxial_law

LAWS = hardening_laws()
by_law = pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)


def test_every_law_has_its_closed_form() -> None:
    here = {path.stem for path in Path(__file__).parent.glob("test_*.py")}
    assert [law.name for law in LAWS if f"test_{law.name}" not in here] == []


def test_the_models_of_the_thesis_keep_their_numbers() -> None:
    assert (hardening(1).name, hardening(2).name, hardening("voce").number) == ("voce", "model2", 1)
    assert len({law.number for law in LAWS}) == len(LAWS)
    with pytest.raises(StudyError, match="'vocee' is not known; known are voce, model2, "):
        hardening("vocee")


@by_law
def test_params_and_texts(law: Hardening) -> None:
    own, known = {p.name for p in law.own}, {p.name for p in LAW}
    assert law.names[0] == "M_y0" and set(law.names) <= own | known and set(law.fitted) <= own | known
    assert all(p.lower <= p.neutral <= p.upper and p.scale > 0.0 and p.meaning for p in law.own)
    assert set(law.file.METALS) == set(law.file.MEANING) == set(law.fitted)
    assert law.file.FORMULA and law.file.SOURCE and set(law.raises) <= set(law.fitted)
    for ranges in (law.file.METALS, law.file.search(350.0, 0.15), law.file.search(1200.0, 0.01)):
        assert set(ranges) == set(law.fitted)
        for name, (start, low, high) in ranges.items():
            assert param(name).lower <= low < high <= param(name).upper and low <= start <= high, name
    assert law.error(values_of(law)) is None


def test_a_file_that_lacks_something_is_told() -> None:
    file = ModuleType("own")
    file.__file__ = "own.py"
    with pytest.raises(StudyError, match=r"own\.py: PARAMS is missing; a file of a hardening law gives PARAMS, "):
        law_of_file(file, "own", 9)
    for key in ("FORMULA", "SOURCE", "METALS", "MEANING", "yield_stress", "stored_energy", "search", "first_guess"):
        setattr(file, key, None)
    file.PARAMS = ("H_exp",)  # type: ignore[attr-defined]
    with pytest.raises(StudyError, match=r"PARAMS begins with \('H_exp',\); expected 'M_y0'"):
        law_of_file(file, "own", 9)
    file.PARAMS = ("M_y0", LAW[0])  # type: ignore[attr-defined]
    with pytest.raises(StudyError, match=r"PARAMS holds .*; expected Param\('own.<param>'"):
        law_of_file(file, "own", 9)
    file.PARAMS = ("M_y0", Param("own.n", "1", 0.2, 0.0, 1.0, 0.1, "exponent"))  # type: ignore[attr-defined]
    file.SMALL = True  # type: ignore[attr-defined]
    with pytest.raises(StudyError, match=r"SMALL is given beside Params of its own"):
        law_of_file(file, "own", 9)
    del file.SMALL
    file.NUMBERS = tuple("abcdefghijklmnopq")  # type: ignore[attr-defined]
    with pytest.raises(StudyError, match=r"17 NUMBERS found; expected at most 16"):
        law_of_file(file, "own", 9)


@by_law
def test_begins_at_the_initial_yield_limit(law: Hardening) -> None:
    numbers = law_of(parameters_of(law), law.name)
    assert yield_stress(0.0, 0.0, numbers)[0] == pytest.approx(values_of(law)["M_y0"], rel=1e-15)
    assert plastic_energy(0.0, 0.0, numbers) == pytest.approx(0.0, abs=1e-13)


@by_law
def test_slope_is_the_derivative_by_complex_step(law: Hardening) -> None:
    numbers = law.number_values(values_of(law))
    for alpha in (1e-6, 1e-3, 0.0123, 0.087, 0.31, 0.9):
        moved = law.file.yield_stress(complex(alpha, STEP), *numbers)[0].imag / STEP
        stress, slope = law.file.yield_stress(alpha, *numbers)
        assert slope == pytest.approx(moved, rel=1e-9, abs=1e-9 * stress), alpha


@by_law
@pytest.mark.parametrize("beta", [0.3, 1.0])
def test_work_is_what_is_stored_and_what_is_dissipated(law: Hardening, beta: float) -> None:
    """Over Lambda: int sigma_y dLambda = psi_pl + (1 - beta) M_y0 alpha + linear part + dissipation."""
    numbers = law_of(parameters_of(law).replace(beta=beta, H_lin=300.0), law.name)

    def stress(accumulated: float) -> float:
        return yield_stress(hardening_variable(0.0, accumulated, numbers)[0], accumulated, numbers)[0]

    for end in (0.004, 0.07, 0.5):
        work = quad(lambda u: 2.0 * u * stress(u * u), 0.0, np.sqrt(end), epsrel=1e-11, limit=300)[0]
        alpha = hardening_variable(0.0, end, numbers)[0]
        released = dissipated_energy(0.0, alpha, end, numbers)
        assert plastic_energy(alpha, end, numbers) + released == pytest.approx(work, rel=1e-8)


@by_law
def test_curve_is_the_yield_stress_of_monotonic_flow(law: Hardening) -> None:
    """In studies (`curve`), for effects in kernels and outside them, and as the point follows it."""
    parameters = parameters_of(law).replace(H_lin=150.0)
    numbers, grown = law_of(parameters, law.name), np.array([0.0, 1e-3, 0.03, 0.4])
    expected = [yield_stress(hardening_variable(0.0, x, numbers)[0], x, numbers)[0] for x in grown]
    assert law.curve(parameters, grown) == pytest.approx(expected, rel=1e-13)
    assert curve_for_effects(grown, numbers) + 150.0 * grown == pytest.approx(expected, rel=1e-13)
    assert [_along(x, numbers) + 150.0 * x for x in grown] == pytest.approx(expected, rel=1e-13)


@kernel
def _along(accumulated: float, law: Law) -> float:
    found: float = hardening_along(accumulated, law)[0]
    return found


@kernel
def _in_lanes(alpha: float, law: Law) -> tuple[float, float]:
    stress, slope = hardening_stress(spread(alpha), law)
    return lane_sum(stress), lane_sum(spread(0.0) + slope)


@by_law
def test_lanes_are_numbers(law: Hardening) -> None:
    numbers = law_of(parameters_of(law), law.name)
    for alpha in (0.0, 0.003, 0.2, 0.7):
        one = hardening_stress(alpha, numbers)
        assert _in_lanes(alpha, numbers) == pytest.approx((8.0 * one[0], 8.0 * one[1]), rel=1e-13)


@by_law
def test_only_its_own_numbers_are_felt(law: Hardening) -> None:
    """Of all numbers of the law, the yield stress after an increment feels those that the law names, and H_lin."""
    numbers = law_in_step(law_of(parameters_of(law), law.name), 1.0)
    points = tuple(np.array([x]) for x in (0.03, 0.03, 0.02, 297.0))
    found = yield_gradients(points, numbers, np.arange(N_NUMBERS))[0, 4:, 0]
    felt = {name for name, slope in zip(NUMBERS, found, strict=True) if slope != 0.0 and name not in EFFECT_NUMBERS}
    assert felt <= {*law.fields, "H_lin"} and "H_lin" in felt
    assert "M_y0" in felt or law.name == "table"


@by_law
def test_gradients_by_parameters(law: Hardening) -> None:
    """d sigma_y / d parameter after an increment from a given state, by complex step, against central differences."""
    parameters, names = parameters_of(law), tuple(dict.fromkeys((*law.names, *law.fitted)))
    alpha, before, increment = 0.019, 0.021, 0.017
    numbers, points = law_of(parameters, law.name), tuple(np.array([x]) for x in (alpha, before, increment, 297.0))
    found = yield_gradients(points, numbers, np.arange(N_NUMBERS))[0, 4:, 0] @ number_rates(parameters, names, numbers)
    for name, slope in zip(names, found, strict=True):
        h = 1e-6 * max(abs(parameters[name]), 1e-3)
        moved = [law_of(parameters.replace(**{name: parameters[name] + s * h}), law.name) for s in (1.0, -1.0)]
        upper, lower = (yield_stress(hardening_variable(alpha, increment, one)[0], before + increment, one)[0] for one in moved)
        assert slope == pytest.approx((upper - lower) / (2.0 * h), rel=1e-6, abs=1e-6 / param(name).scale), name
    assert np.any(found != 0.0)


def test_a_moved_law_is_the_law_with_one_number_moved() -> None:
    numbers = law_of(parameters_of(LAWS[0]), 1)
    for which in (-1, 0, NUMBERS.index("M_y0"), NUMBERS.index("hardening_1"), N_NUMBERS - 1):
        moved = moved_law(numbers, which)
        here = [name for name in NUMBERS if name in numbers._fields]
        asked = NUMBERS[which] if which >= 0 else ""
        assert [np.imag(getattr(moved, name)) / STEP for name in here] == [float(name == asked) for name in here]
        assert [np.real(getattr(moved, name)) for name in here] == [getattr(numbers, name) for name in here]
        assert moved.effective == (which == N_NUMBERS - 1) and moved.model == 1


@by_law
def test_taylor_order_two_of_a_coupon(law: Hardening) -> None:
    """f(p + h) - f(p) - h f' falls as h^2 for the stresses and temperatures of a cycled coupon, by everything the law frees."""
    base, programme = parameters_of(law).replace(tau=70.0), cycles(8)
    settings = PointSettings(model=law.name, max_strain=0.004)
    names = tuple(dict.fromkeys((*law.names, *law.fitted)))
    start, rates = simulate_rates(base, names, programme, settings)
    weight = np.cos(np.arange(len(start.time)))

    def seen(history: object) -> float:
        return float(weight @ (history.stress / np.ptp(start.stress) + history.theta / np.ptp(start.theta)))  # type: ignore[attr-defined]

    for k, name in enumerate(names):
        slope = float(weight @ (rates["stress"][:, k] / np.ptp(start.stress) + rates["theta"][:, k] / np.ptp(start.theta)))
        assert slope != 0.0 or name.startswith("table."), name
        size, remainder = 2e-3 * base[name], []
        for h in (size, 0.5 * size):
            change = seen(simulate(base.replace(**{name: base[name] + h}), programme, settings)) - seen(start)
            remainder.append(abs(change - h * slope))
        round_off = 1e-9
        assert remainder[1] < 0.3 * remainder[0] + round_off or remainder[1] < 1e-6 * abs(size * slope), (name, remainder)


@by_law
def test_the_body_is_the_point(law: Hardening) -> None:
    """Stress, lateral strain, temperature and Lambda of an adiabatic bar of elements through cycles, to 1e-6."""
    time, strain = corners(*CYCLES, steps=5)
    bar_and_point(LOSSY.replace(**values_of(law)), time, strain, law.name)


@by_law
def test_first_guess_of_its_own_curve(law: Hardening) -> None:
    accumulated = np.concatenate([[0.0], np.geomspace(1e-4, 0.3, 80)])
    stress = law.curve(parameters_of(law), accumulated)
    found = Parameters.of({"theta_ref": 297.0, **first_guess(law, accumulated, stress)})
    # A table has other knots than the one that it is asked to follow.
    assert law.curve(found, accumulated) == pytest.approx(stress, rel=0.02 if law.name == "table" else 1e-4)


@by_law
def test_takes_over_the_curve_of_voce(law: Hardening) -> None:
    voce = parameters_of(hardening("voce"))
    accumulated, linear = np.linspace(0.0, 0.2, 50), 400.0
    for given in (voce, voce.replace(H_lin=linear)):
        found = taken_over(law, hardening("voce"), given)
        assert set(law.fitted) <= set(found)
        # Linear hardening that the law does not free stays beside it.
        allowed = {"linear": 0.25}.get(law.name, 0.06)
        assert law.curve(given.replace(**found), accumulated) == pytest.approx(hardening("voce").curve(given, accumulated), rel=allowed)


@by_law
def test_recovers_what_was_planted(law: Hardening) -> None:
    """From the first guess of the measured flow curve, with exact derivatives: noise of 0.2 MPa leaves the curve to 0.15 MPa, and every
    parameter within four of its standard errors."""
    truth, settings = parameters_of(law), PointSettings(model=law.name)
    programme = Programme.by_strain(np.linspace(0.0, 200.0, 251), 0.2 * np.linspace(0.0, 1.0, 251) ** 1.5)
    clean = simulate(truth, programme, settings)
    measured = clean.stress + 0.2 * np.random.default_rng(5).normal(size=len(clean.stress))
    root = np.sqrt(truth["F"] + truth["H"])
    stretch = 1.0 + programme.value
    grown = (np.log(stretch) - measured * stretch / truth["E"]) / root
    flows = grown > 1e-3
    guess = first_guess(law, grown[flows], root * (measured * stretch)[flows])
    given = {name: truth[name] for name in law.names if name not in law.fitted}
    names, scale = law.fitted, np.array([param(name).scale for name in law.fitted])
    low, high = np.array([(param(name).lower, param(name).upper) for name in names]).T
    start = truth.replace(**{**guess, **given})

    def at(x: np.ndarray) -> Parameters:
        return start.replace(**dict(zip(names, x * scale, strict=True)))

    found = least_squares(
        lambda x: (simulate(at(x), programme, settings).stress - measured) / 0.2,
        np.clip([start[name] for name in names], low, high) / scale,
        jac=lambda x: simulate_rates(at(x), names, programme, settings)[1]["stress"] * scale / 0.2,
        bounds=(low / scale, high / scale),
    )
    assert simulate(at(found.x), programme, settings).stress == pytest.approx(clean.stress, abs=0.15)
    sigma = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    off = (found.x - np.array([truth[name] for name in names]) / scale) / sigma
    assert np.abs(off).max() < 4.0, dict(zip(names, off, strict=True))


def _probes(slots: tuple[str, ...]) -> dict[str, float]:
    """The first effect of each slot at its probe."""
    first = [next(e for e in effects((slot,))) for slot in slots]
    return {p.name: p.probe if p.probe is not None else p.neutral for e in first for p in e.params}


CASES = [(law, MATERIAL) for law in LAWS] + [(law, ()) for law in LAWS] + [(LAWS[0], (slot,)) for slot in MATERIAL]


@pytest.mark.parametrize(("law", "slots"), CASES, ids=lambda x: getattr(x, "name", "+".join(x) if isinstance(x, tuple) else str(x)))
def test_capacity_of_the_machine_is_the_largest_stress_of_the_point(law: Hardening, slots: tuple[str, ...]) -> None:
    """Plain, with the first effect of every material slot at once, and with each of them alone."""
    parameters = parameters_of(law).replace(**_probes(slots))
    table = uniaxial_law(parameters, law.name)
    top = float(np.expm1(table.plastic[-1] + table.elastic[0]))
    strain = np.concatenate([np.linspace(0.0, 0.8 * top, 401), np.linspace(0.8 * top, 1.25 * top + 1e-3, 2001)[1:]])
    still = parameters.replace(c0=1e12, theta_air=parameters["theta_ref"])
    found = simulate(still, Programme.by_strain(np.arange(len(strain)) * 1e9, strain), PointSettings(law.name, max_strain=6.0))
    peak = int(np.argmax(found.stress))
    assert 0 < peak < len(strain) - 1
    a, b, c = found.stress[peak - 1 : peak + 2]
    largest = b + (a - c) ** 2 / (8.0 * (2.0 * b - a - c))
    assert table.nominal[-1] == pytest.approx(largest, rel=1e-6)
