"""Effects in whole runs of a body: exactly off at neutral, and their influence by direct differentiation, both on and dormant."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from published_surfaces import TWISTED
from small_bodies import NOMINAL, SPECIMEN

from thermofit.body.body import Body, tension_body
from thermofit.body.heat.one_way import heat_problem, heat_run, heat_run_rates
from thermofit.body.heat.structure import felt_by_heat, structure_slopes
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.sensitivity.march import Sensitivities, StepRates
from thermofit.body.solve.march import History, Loading, MarchSettings, Watch, march
from thermofit.body.solve.newton import NewtonSettings
from thermofit.core.parameters import param
from thermofit.core.slots import Slots
from thermofit.law.composition import STRUCTURAL, law_effects
from thermofit.law.hardening.catalogue import Hardening, hardening_laws
from thermofit.law.page import law_of
from thermofit.law.page_rates import directions, moved_law

BASE = NOMINAL.replace(H_lin=20.0, theta_ref=295.2)
PROBES = {p.name: 0.3 * p.probe if p.probe is not None else p.neutral for e in law_effects() for p in e.params}
AMPLITUDES = tuple(p.name for e in law_effects() for p in e.amplitudes)
STRUCTURAL_AMPLITUDES = tuple(name for name in AMPLITUDES if name in STRUCTURAL)
EFFECT_PARAMS = tuple(name for e in law_effects() for name in e.names)
FORCE = Loading(np.array([0.0, 1.0, 25.0, 35.0, 37.0, 60.0]), np.array([0.0, 0.0, 5200.0, 5200.0, 0.0, 0.0]))
TIMES = np.array([0.0, 1.0, 5.0, 9.0, 13.0, 17.0, 21.0, 25.0, 30.0, 35.0, 36.0, 37.0, 45.0, 60.0])
SETTINGS = MarchSettings(newton=NewtonSettings(tolerance=2e-9, max_iterations=80), coupling_tolerance=1e-8, keep_energy=True)


def body(control: str = "force") -> Body:
    return tension_body(dogbone_mesh(SPECIMEN, 1, 8, 1), control=control)


def run(
    names: tuple[str, ...] = (),
    loading: Loading = FORCE,
    times: np.ndarray = TIMES,
    yields: str = "hill",
    hardening: int | str = 2,
    **changes: float,
) -> tuple[History, dict[str, np.ndarray]]:
    """A run and the derivatives of its fields (n_t, ..., n_p)."""
    kept: dict[str, list[np.ndarray]] = {"u": [], "theta": [], "force": []}

    def collect(n: int, at: StepRates) -> None:
        for field, values in kept.items():
            values.append(np.array(getattr(at, field)))

    watch = Watch(sensitivities=Sensitivities(names, collect, tolerance=1e-9)) if names else Watch()
    settings = replace(SETTINGS, model=Slots(hardening, yields))
    history = march(body(loading.control), BASE.replace(**changes), loading, times, settings, watch)
    return history, {field: np.stack(values) for field, values in kept.items() if values}


def test_every_effect_of_the_law_acts_and_is_differentiated_in_a_coupled_run() -> None:
    """All effects on at once; derivatives by every amplitude, of displacement and temperature, are those of differences."""
    history, rates = run(AMPLITUDES, **PROBES)
    plain, _ = run()
    assert np.abs(history.u - plain.u).max() > 1e-3
    for k, name in enumerate(AMPLITUDES):
        h = 2e-3 * PROBES[name]
        there, back = (run(**{**PROBES, name: PROBES[name] + x})[0] for x in (h, -h))
        for field in ("u", "theta"):
            expected = (getattr(there, field) - getattr(back, field)) / (2.0 * h)
            noise = 2e-8 * np.abs(getattr(there, field)).max() / h
            assert np.abs(rates[field][..., k] - expected).max() < 1e-4 * np.abs(expected).max() + noise, (name, field)


END = Loading(np.array([0.0, 20.0, 30.0, 50.0]), np.array([0.0, 1.6, 0.6, 2.4]), "displacement", from_rest=True)
"""The end is pulled, pushed back until flow reverses, and pulled on."""
TURNED = Loading(np.array([0.0, 25.0, 50.0, 75.0]), np.array([0.0, 5200.0, -4900.0, 5600.0]))
LAW = ("E", "nu", "M_y0", "M_yinf", "H_exp", "H_lin", "F", "alpha_exp", "beta")


OF_SURFACE = ("yld2004.a", *(f"yld2004.c{at}" for at in ("1_12", "1_31", "1_66", "2_23", "2_55")))
LAW_OF = {"hill": LAW, "yld2004": (*(name for name in LAW if name != "F"), *OF_SURFACE)}
SEEDS = {"hill": 4, "yld2004": 3}
"""Points about which the same points flow in every step."""


@pytest.mark.parametrize("control", ["force", "displacement"])
@pytest.mark.parametrize("yields", SEEDS)
def test_remainders_are_of_second_order_with_everything_on(yields: str, control: str) -> None:
    """At a random point away from neutral, along random directions of all parameters of the law and its effects at once: |f(p + h d) - f(p)
    - h f'(p) d| falls fourfold as h is halved, of displacements, temperatures and force, through load, unloading and reversed flow."""
    random, law = np.random.default_rng(SEEDS[yields]), LAW_OF[yields]
    names, surface = (*law, *EFFECT_PARAMS), TWISTED if yields == "yld2004" else {}
    point = {name: value * random.uniform(0.7, 1.3) for name, value in PROBES.items()}
    point |= {**surface, **{name: (surface.get(name) or BASE[name]) * random.uniform(0.95, 1.05) for name in law}}
    driven = (TURNED, np.linspace(0.0, 75.0, 26)) if control == "force" else (END, np.linspace(0.0, 50.0, 21))
    start, rates = run(names, *driven, yields, **point)
    assert start.force.min() < -0.3 * start.force.max(), "flow reverses"
    if control == "force":
        assert not np.any(rates.pop("force")), "it is given"
    for _ in range(2):
        along = {name: random.choice([-1.0, 1.0]) * (abs(point[name]) or 1e-3) for name in names}
        direction = np.array([along[name] for name in names])
        left: dict[str, list[float]] = {field: [] for field in rates}
        for h in (4e-3, 2e-3, 1e-3):
            there, _ = run((), *driven, yields, **{**point, **{name: point[name] + h * along[name] for name in names}})
            for field, values in left.items():
                linear = h * (rates[field] @ direction)
                values.append(float(np.abs(getattr(there, field) - getattr(start, field) - linear).max() / np.abs(linear).max()))
        for field, values in left.items():
            # relative to the linear part, which falls with h itself
            assert values[1] < 0.62 * values[0] and values[2] < 0.62 * values[1] and values[2] < 0.05, (field, values)


def test_by_parameters_of_a_surface_as_differences_of_the_run() -> None:
    """Every field of a run under displacement with all effects on, by exponent and coefficients of a transformed surface."""
    driven, values = (END, np.linspace(0.0, 50.0, 21), "yld2004"), {**TWISTED, **PROBES}
    _, rates = run(OF_SURFACE, *driven, **values)
    for k, name in enumerate(OF_SURFACE):
        h = 1e-4 * values[name]
        there, back = (run((), *driven, **{**values, name: values[name] + x})[0] for x in (h, -h))
        for field in ("u", "theta", "force"):
            expected = (getattr(there, field) - getattr(back, field)) / (2.0 * h)
            noise = 2e-8 * np.abs(getattr(there, field)).max() / h
            assert np.abs(rates[field][..., k] - expected).max() < 1e-4 * np.abs(expected).max() + noise, (name, field)


STRAINS_OF_TABLE = {f"table.strain{k}": 0.0035 * k for k in range(1, 6)}
STRESSES_OF_TABLE = {"table.stress1": 140.0, "table.stress2": 147.0, "table.stress3": 153.0, "table.stress4": 158.0, "table.stress5": 162.0}


@pytest.mark.parametrize("law", hardening_laws(), ids=lambda law: law.name)
def test_by_every_number_of_a_hardening_law_as_differences_of_the_run(law: Hardening) -> None:
    """Pulled to a strain beyond the last knot of the table: a knot acts between its neighbours alone, and each has a part in the motion."""
    values = {**{n: param(n).neutral for n in law.names}, **{n: BASE[n] for n in LAW if n in law.fitted}}
    if "H_lin" in law.fitted:
        values["H_lin"] = 200.0
    if law.name == "table":
        values |= {**STRAINS_OF_TABLE, **STRESSES_OF_TABLE, "M_y0": 130.0}
    driven = (END, np.linspace(0.0, 20.0, 21))
    _, rates = run(law.fitted, *driven, hardening=law.name, **values)
    for k, name in enumerate(law.fitted):
        h = 1e-3 * values[name]
        there, back = (run((), *driven, hardening=law.name, **{**values, name: values[name] + x})[0] for x in (h, -h))
        for field in ("u", "theta", "force"):
            expected = (getattr(there, field) - getattr(back, field)) / (2.0 * h)
            noise = 4e-8 * np.abs(getattr(there, field)).max() / h
            size = float(np.abs(expected).max())
            assert size > 3.0 * noise, (name, field)
            assert np.abs(rates[field][..., k] - expected).max() < 3e-3 * size + noise, (name, field)


@pytest.mark.parametrize("yields", SEEDS)
def test_energy_is_balanced_where_the_update_is_changed(yields: str) -> None:
    """The first law of the whole specimen with what backstresses store and lost moduli release, and no point that takes heat to flow."""
    structure = {name: value for name, value in PROBES.items() if name in STRUCTURAL}
    structure |= TWISTED if yields == "yld2004" else {}
    defects = []
    for n in (81, 161):
        history, _ = run((), END, np.linspace(0.0, 50.0, n), yields, **structure)
        assert min(step.smallest_dissipation for step in history.balance) >= 0.0
        work = max(abs(w) for w in np.cumsum([step.work for step in history.balance]))
        defects.append(max(abs(d) for d in np.cumsum([step.first_law_defect for step in history.balance])) / work)
    assert defects[1] < 0.6 * defects[0] and defects[1] < 2e-3, defects


@pytest.mark.parametrize("name", [name for name in AMPLITUDES if name in STRUCTURAL])
def test_the_influence_at_neutral_itself(name: str) -> None:
    """Of effects that change the local update, asked for while all are off, through reversed flow: by differences from neutral on one side.
    The run itself stays what it is without the question."""
    others = {p: PROBES[p] for p in EFFECT_PARAMS if p not in AMPLITUDES}
    times, h = np.linspace(0.0, 50.0, 21), 1.25e-3 * PROBES[name]  # small: with less of it the same points flow in every step
    neutral, rates = run((name,), END, times, **others)
    plain, one, two = (run((), END, times, **others, **{name: x})[0] for x in (0.0, h, 2.0 * h))
    for field in ("u", "theta", "force"):
        assert getattr(neutral, field) == pytest.approx(getattr(plain, field), abs=1e-7 * np.abs(getattr(plain, field)).max())
        slope = (4.0 * getattr(one, field) - 3.0 * getattr(plain, field) - getattr(two, field)) / (2.0 * h)
        assert np.abs(slope).max() > 0.0
        noise = 2e-7 * np.abs(getattr(plain, field)).max() / h
        assert np.abs(rates[field][..., 0] - slope).max() < 3e-3 * np.abs(slope).max() + noise, field


@pytest.mark.parametrize("name", AMPLITUDES)
def test_a_dormant_effect_is_exactly_off_and_its_influence_is_known(name: str) -> None:
    """The influence is asked for at a tiny amplitude: at neutral itself a point that rests on the yield surface during a hold
    does not flow, with the least overstress it does."""
    # Over the strains of this run, all steps of a curve act.
    others = {p: PROBES[p] for p in EFFECT_PARAMS if p not in AMPLITUDES} | {"hardening_curve.range": 0.01}
    (off, _), (plain, _) = run(**others), run()
    assert np.array_equal(off.u, plain.u) and np.array_equal(off.theta, plain.theta)
    h = 0.01 * PROBES[name]
    _, rates = run((name,), **others, **{name: h})
    more, less = run(**others, **{name: 1.2 * h})[0], run(**others, **{name: 0.8 * h})[0]
    for field in ("u", "theta"):
        expected = (getattr(more, field) - getattr(less, field)) / (0.4 * h)
        size = np.abs(expected).max()
        assert size > 0.0
        noise = 4e-8 * np.abs(getattr(plain, field)).max() / (0.4 * h)
        assert np.abs(rates[field][..., 0] - expected).max() < 3e-3 * size + noise, field


SOURCES = ("stored_energy.slope", "rate_power.K", "thermal_softening.slope")


def test_one_way_heat_run_with_effects_and_their_derivatives() -> None:
    settings = MarchSettings(newton=SETTINGS.newton, coupling_tolerance=1e-8, keep_points=True)
    parameters = BASE.replace(**PROBES)
    history = march(body(), parameters, FORCE, TIMES, settings)
    problem = heat_problem(body(), history, settings)
    names, collected = (*SOURCES, "backstress_first.C", "elastic_degradation.amount", "F", "E"), []
    assert np.abs(heat_run(problem, parameters) - history.theta).max() < 0.01
    heat_run_rates(problem, parameters, names, lambda n, theta, rates: collected.append(np.array(rates[:, : len(names)])))
    for k, name in enumerate(names):
        h = 1e-2 * parameters[name]
        there, back = (heat_run(problem, parameters.replace(**{name: parameters[name] + x})) for x in (h, -h))
        expected = (there - back) / (2.0 * h)
        assert np.abs(np.stack(collected)[..., k] - expected).max() < 1e-5 * np.abs(expected).max() + 1e-9 / h, name


@pytest.mark.parametrize("which", [STRUCTURAL_AMPLITUDES, *((name,) for name in STRUCTURAL_AMPLITUDES)], ids=lambda names: "+".join(names))
@pytest.mark.parametrize("yields", ["hill", "yld2004"])
def test_heat_of_a_changed_update_has_all_slopes_that_are_not_zero(which: tuple[str, ...], yields: str) -> None:
    """What its arguments and numbers are asked for by several general points leaves out is zero at every point of a run."""
    parameters, slots = BASE.replace(**{name: PROBES[name] for name in which}), Slots(2, yields)
    history = march(body(), parameters, FORCE, TIMES, replace(SETTINGS, model=slots, keep_points=True))
    names = ("E", "nu", "M_y0", "M_yinf", "H_exp", "beta", "alpha_exp", "F", *STRUCTURAL_AMPLITUDES)
    law = law_of(parameters, slots)
    asked = directions(parameters, names, law)
    numbers = np.flatnonzero(np.any(asked.numbers != 0.0, axis=1))
    moved = tuple(moved_law(law, int(k)) for k in (-1, *numbers))
    felt = felt_by_heat(moved)
    assert 0 < len(felt.arguments) and 0 < felt.numbers.sum() < len(numbers)
    theta = np.full(history.points[0].alpha.shape, 301.0)
    for start, end in pairwise(history.points):
        every = structure_slopes(start, end, theta + 0.1, theta, law, moved, (), tuple(range(10)), True)
        told = structure_slopes(start, end, theta + 0.1, theta, law, moved, (), felt.arguments, True)
        assert not np.any(every.by_numbers[~felt.numbers])
        assert np.array_equal(told.start, every.start) and np.array_equal(told.end, every.end)
        assert np.array_equal(told.by_j, every.by_j) and np.array_equal(told.by_theta, every.by_theta)
