"""Sensitivities of a whole run: Taylor tests of second order for every parameter, central differences, both couplings and controls."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from small_bodies import NOMINAL, SPECIMEN, bar_mesh

from thermofit.body.body import Body, tension_body
from thermofit.body.heat.one_way import heat_problem, heat_run, heat_run_rates
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.sensitivity.heat_rates import WARM, SourceSlopes, source_slopes
from thermofit.body.sensitivity.march import Differentiator, LinearisedStep, PointStateRates, Rates, Sensitivities, StepEnds, StepRates
from thermofit.body.solve.march import History, Loading, MarchSettings, Watch, march
from thermofit.body.solve.newton import Equilibrator, NewtonSettings
from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import NAMES

BASE = NOMINAL.replace(H_lin=20.0, theta_ref=295.2)
TIME = np.array([0.0, 1.0, 25.0, 35.0, 37.0, 60.0])
FORCE = Loading(TIME, np.array([0.0, 0.0, 5700.0, 5700.0, 0.0, 0.0]))
"""Rest, loading far into plastic flow, hold, unloading, cooling."""
DISPLACEMENT = Loading(TIME, np.array([0.0, 0.0, 3.0, 3.0, 2.6, 2.6]), "displacement", from_rest=True)
TIMES = np.array([0.0, 1.0, 5.0, 9.0, 13.0, 17.0, 21.0, 25.0, 30.0, 35.0, 36.0, 37.0, 45.0, 60.0])
EXACT = MarchSettings(newton=NewtonSettings(tolerance=2e-9, max_iterations=80), coupling_tolerance=1e-8)
BODY = tuple(name for name in NAMES if name not in ("tau", "lag"))
"""Parameters of a body; those of coupons come after them."""
FIELDS = ("u", "theta", "force")


@dataclass(frozen=True)
class Case:
    """A control and a coupling."""

    control: str
    coupling: str

    @property
    def body(self) -> Body:
        return _body(self.control)

    def run(self, sensitivities: Sensitivities | None = None, **changes: float) -> History:
        settings = MarchSettings(newton=EXACT.newton, coupling_tolerance=EXACT.coupling_tolerance, coupling=self.coupling)
        loading = FORCE if self.control == "force" else DISPLACEMENT
        return march(self.body, BASE.replace(**changes), loading, TIMES, settings, watch=Watch(sensitivities=sensitivities))


@lru_cache(maxsize=2)
def _body(control: str) -> Body:
    return tension_body(dogbone_mesh(SPECIMEN, 1, 8, 1), control=control)


CASES = [Case("force", "full"), Case("displacement", "full"), Case("force", "one-way")]


class Collected:
    """Every derivative of a run: per field (n_t, ..., n_parameters)."""

    def __init__(self) -> None:
        self.at: list[tuple[np.ndarray, ...]] = []

    def collect(self, n: int, s: StepRates) -> None:
        assert n == len(self.at)
        self.at.append(tuple(np.array(getattr(s, name)) for name in FIELDS))

    def field(self, name: str) -> np.ndarray:
        return np.stack([values[FIELDS.index(name)] for values in self.at])


@lru_cache(maxsize=3)
def differentiated(case: Case) -> tuple[History, Collected]:
    collected = Collected()
    return case.run(Sensitivities(NAMES, collected.collect, tolerance=1e-9)), collected


def functional(history: History) -> float:
    """A number that every displacement, temperature and force of the run takes part in."""
    random = np.random.default_rng(4)
    return float(sum((random.normal(size=value.shape) * value).sum() / scale for value, scale in _scaled(history)))


def slope(collected: Collected) -> np.ndarray:
    """Derivative (n_parameters,) of `functional`."""
    random = np.random.default_rng(4)
    out = np.zeros(len(NAMES))
    for name, scale in zip(FIELDS, (1.0, 10.0, 1e4), strict=True):
        value = collected.field(name)
        out += np.tensordot(random.normal(size=value.shape[:-1]), value, value.ndim - 1) / scale
    return out


def _scaled(history: History) -> list[tuple[np.ndarray, float]]:
    return [(getattr(history, name), scale) for name, scale in zip(FIELDS, (1.0, 10.0, 1e4), strict=True)]


def step(name: str) -> float:
    return 0.05 if name.startswith("theta") else 2e-4 * BASE[name]


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c.control}-{c.coupling}")
@pytest.mark.parametrize("name", BODY)
def test_taylor_remainder_is_of_second_order(case: Case, name: str) -> None:
    """|J(p + h) - J(p) - h J'| falls by four when h is halved, or is nothing beside h J' (J linear) or beside the noise of equilibrium.

    Through-thickness shear (M, N) hardly matters in a sheet: tests/body/test_mechanical_rates.py has it in three dimensions.
    """
    history, collected = differentiated(case)
    start, derivative, h = functional(history), float(slope(collected)[NAMES.index(name)]), step(name)
    remainders = [abs(functional(case.run(**{name: BASE[name] + x})) - start - x * derivative) for x in (h, h / 2.0)]
    if remainders[0] < 2e-5 * abs(h * derivative) + 2e-7:
        return
    assert np.log2(remainders[0] / remainders[1]) == pytest.approx(2.0, abs=0.25), (remainders, h * derivative)
    assert remainders[0] < 0.05 * abs(h * derivative)


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c.control}-{c.coupling}")
@pytest.mark.parametrize("name", ["E", "M_yinf", "F", "alpha_exp", "kappa", "beta", "alpha_clamp"])
def test_every_field_agrees_with_central_differences_of_the_run(case: Case, name: str) -> None:
    _, collected = differentiated(case)
    h = 0.1 * step(name)
    there, back = case.run(**{name: BASE[name] + h}), case.run(**{name: BASE[name] - h})
    for field in FIELDS:
        expected = (getattr(there, field) - getattr(back, field)) / (2.0 * h)
        found = collected.field(field)[..., NAMES.index(name)]
        if field == "force" and case.control == "force":
            assert not found.any()
            continue
        noise = 1e-8 * np.abs(getattr(there, field)).max() / h
        assert np.abs(found - expected).max() < 1e-5 * np.abs(expected).max() + noise, (field, np.abs(expected).max())


def test_default_tolerance_is_enough_for_a_fit() -> None:
    """At the default tolerance of the staggered scheme and steps of up to 15 s: temperatures within 0.2 % of the exact ones,
    displacements within 1 % (those along thermal parameters, which are small), at a third of the sweeps."""
    case = CASES[0]
    exact, collected = differentiated(case)
    quick = Collected()
    history = case.run(Sensitivities(NAMES, quick.collect))
    assert history.counts["sensitivity_sweeps"] < 0.5 * exact.counts["sensitivity_sweeps"]
    for field, tolerance in (("u", 1e-2), ("theta", 2e-3)):
        a, b = quick.field(field), collected.field(field)
        axes = tuple(range(a.ndim - 1))
        a, b = a[..., : len(BODY)], b[..., : len(BODY)]
        error = np.abs(a - b).max(axis=axes) / np.abs(b).max(axis=axes)
        assert np.all(error < tolerance), (field, dict(zip(BODY, error, strict=True)))


def test_a_dissipation_that_feels_the_temperature_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of where it does not, the guess of theta' is left, since expansion alone moves no history."""

    def sweeps() -> int:
        return CASES[0].run(Sensitivities(("M_y0", "c0"), lambda n, at: None)).counts["sensitivity_sweeps"]

    def warm(*given: Any) -> SourceSlopes:
        slopes = source_slopes(*given)
        slopes.dissipation[WARM] = 1e-9
        return slopes

    usual = sweeps()
    monkeypatch.setattr("thermofit.body.sensitivity.march.source_slopes", warm)
    assert sweeps() > 1.2 * usual


def test_default_tolerance_is_enough_where_moduli_change_with_temperature() -> None:
    """Then every point follows the temperature, of an elastic step too; with its guess left, c0 was 7 % off."""
    names, warms = ("M_y0", "beta", "c0"), {"modulus_by_temperature.slope": -2e-3}
    found = []
    for tolerance in (1e-8, Sensitivities.tolerance):
        found.append(Collected())
        CASES[0].run(Sensitivities(names, found[-1].collect, tolerance=tolerance), **warms)
    for field in ("u", "theta"):
        exact, quick = (one.field(field) for one in found)
        axes = tuple(range(exact.ndim - 1))
        assert np.all(np.abs(quick - exact).max(axis=axes) < 2e-3 * np.abs(exact).max(axis=axes)), field


STRONG_COUPLING = {
    "a twelfth": {"alpha_exp": 6e-5, "kappa": 500.0, "c0": 7.8, "beta": 3.0},
    "half": {"alpha_exp": 2.5e-4, "kappa": 1460.0, "c0": 11.5, "beta": 4.0},
    "most": {"alpha_exp": 3.57e-4, "kappa": 2240.0, "c0": 3.8, "beta": 16.0},
    "nearly all": {"alpha_exp": 4.2e-4, "kappa": 2650.0, "c0": 0.05, "beta": 18.9},
}
"""Parts of the heat that expansion takes along the valley of model 1, in aluminium 4 %; the last is Table 5.14, with its c0 << 1."""


@pytest.mark.parametrize("part", STRONG_COUPLING)
def test_default_tolerance_is_enough_where_expansion_takes_much_of_the_heat(part: str) -> None:
    """Against central differences, with steps of 2 s."""
    strong = STRONG_COUPLING[part]
    times = np.array([0.0, 1.0, *np.arange(3.0, 26.0, 2.0), 30.0, 35.0, 36.0, *np.arange(37.0, 61.0, 2.0)])

    def run(sensitivities: Sensitivities | None = None, **changes: float) -> History:
        parameters = BASE.replace(**{**strong, **changes})
        return march(CASES[0].body, parameters, FORCE, times, EXACT, watch=Watch(sensitivities=sensitivities))

    quick = Collected()
    run(Sensitivities(tuple(strong), quick.collect))
    for k, (name, value) in enumerate(strong.items()):
        h = 5e-4 * value
        there, back = (run(**{name: value + x}) for x in (h, -h))
        for field in ("u", "theta"):
            expected = (getattr(there, field) - getattr(back, field)) / (2.0 * h)
            error = np.linalg.norm(quick.field(field)[..., k] - expected)
            assert error < 3e-3 * np.linalg.norm(expected), (name, field)


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c.control}-{c.coupling}")
def test_a_body_does_not_feel_the_parameters_of_coupons(case: Case) -> None:
    _, collected = differentiated(case)
    for field in FIELDS:
        assert not collected.field(field)[..., len(BODY) :].any()


def test_run_itself_is_not_changed() -> None:
    """Within the tolerance of equilibrium: a differentiated run keeps other factors."""
    history, _ = differentiated(CASES[0])
    plain = CASES[0].run()
    assert np.abs(history.u - plain.u).max() < 1e-8 * np.abs(plain.u).max()
    assert np.abs(history.theta - plain.theta).max() < 1e-6


def test_one_way_heat_run_has_the_derivatives_of_its_differences() -> None:
    """On frozen mechanics, all thermal parameters."""
    case = CASES[0]
    kept = MarchSettings(newton=EXACT.newton, coupling_tolerance=EXACT.coupling_tolerance, keep_points=True)
    problem = heat_problem(case.body, march(case.body, BASE, FORCE, TIMES, kept), kept)
    names = ("alpha_exp", "kappa", "c0", "beta", "alpha_air", "alpha_clamp", "theta_air", "theta_clamp")
    theta, rates = [], []

    def collect(n: int, at: np.ndarray, slopes: np.ndarray) -> None:
        assert n == len(theta)
        theta.append(np.array(at))
        rates.append(np.array(slopes[:, : len(names)]))

    heat_run_rates(problem, BASE, names, collect)
    assert np.abs(np.stack(theta) - heat_run(problem, BASE)).max() < 1e-9
    for k, name in enumerate(names):
        h = 10.0 * step(name)
        there = [heat_run(problem, BASE.replace(**{name: BASE[name] + n * h})) for n in (1, -1, 2, -2)]
        expected = (8.0 * (there[0] - there[1]) - (there[2] - there[3])) / (12.0 * h)
        assert np.abs(np.stack(rates)[..., k] - expected).max() < 1e-6 * np.abs(expected).max(), name


def test_bisected_steps_are_differentiated_too() -> None:
    """One step that has to be cut: the derivative of its end is that of its differences."""
    mesh = bar_mesh((2, 4, 1), (4.0, 20.0, 1.0), air=("x1",), clamp=("y0",))
    mesh.nodes[:, 0] *= 1.0 - 0.1 * np.exp(-(((mesh.nodes[:, 1] - 10.0) / 4.0) ** 2))
    body, loading = tension_body(mesh), Loading(np.array([0.0, 1.0]), np.array([0.0, 4.0 * 4.0 * 215.0]))
    settings = MarchSettings(newton=NewtonSettings(tolerance=1e-9, max_iterations=12), coupling_tolerance=1e-8)
    times, collected = np.array([0.0, 1.0]), Collected()
    history = march(
        body, BASE, loading, times, settings, Watch(sensitivities=Sensitivities(("M_yinf",), collected.collect, tolerance=1e-9))
    )
    assert history.counts["bisections"] > 0
    h = 2e-5 * BASE["M_yinf"]
    there, back = (march(body, BASE.replace(M_yinf=BASE["M_yinf"] + x), loading, times, settings) for x in (h, -h))
    expected = (there.u - back.u) / (2.0 * h)
    assert np.abs(collected.field("u")[..., 0] - expected).max() < 1e-4 * np.abs(expected).max()


def test_a_step_whose_differentiation_fails_is_cut_and_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same derivatives as of a run that takes the halves of those steps by itself, whether a point yielded or not."""
    names = ("E", "M_y0", "beta")
    settings = MarchSettings(newton=EXACT.newton, coupling_tolerance=EXACT.coupling_tolerance)

    def run(times: np.ndarray) -> tuple[History, Collected]:
        collected = Collected()
        watch = Watch(sensitivities=Sensitivities(names, collected.collect, tolerance=1e-9))
        return march(_body("force"), BASE, FORCE, times, settings, watch), collected

    cut_at = (9.0, 37.0)
    _, halves = run(np.sort(np.append(TIMES, [0.5 * (t + TIMES[list(TIMES).index(t) - 1]) for t in cut_at])))
    kept = [n for n, t in enumerate(np.sort(np.append(TIMES, [7.0, 36.5]))) if t in TIMES]
    heat, step, calls = Differentiator.heat_rates, Differentiator.step, [0]

    def counted(self: Differentiator, start: Rates, mechanics: LinearisedStep, ends: StepEnds, load: np.ndarray) -> Rates:
        calls[0] += 1
        return step(self, start, mechanics, ends, load)

    def failing(self: Differentiator, start: Rates, u: np.ndarray, end: PointStateRates, theta: np.ndarray, ends: StepEnds) -> np.ndarray:
        if calls[0] in (3, 13, 14):  # the steps to 9 s and, two halves later, to 37 s, there with a factor of its own as well
            raise NumericsError("made to fail")
        return heat(self, start, u, end, theta, ends)

    monkeypatch.setattr(Differentiator, "step", counted)
    monkeypatch.setattr(Differentiator, "heat_rates", failing)
    history, cut = run(TIMES)
    assert history.counts["bisections"] == len(cut_at)
    for field in FIELDS:
        expected = halves.field(field)[kept]
        assert np.abs(cut.field(field) - expected).max() <= 1e-7 * np.abs(expected).max(), field


def test_arc_control_is_refused_in_words() -> None:
    with pytest.raises(StudyError, match="arc control"):
        loading = Loading(np.array([0.0, 1.0]), np.array([0.0, 0.1]), "arc")
        march(_body("force"), BASE, loading, np.array([0.0, 1.0]), watch=Watch(sensitivities=Sensitivities(("E",), lambda n, s: None)))


def test_a_factor_of_another_state_costs_answers_and_no_digits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps of a hold may flow here and there with the factor of an elastic step: its answers leave most of what they are to balance."""
    names = ("M_y0", "E", "kappa")
    case = Case("force", "full")

    def columns(tolerance: float = 1e-4) -> Collected:
        found = Collected()
        case.run(Sensitivities(names, found.collect, tolerance=tolerance))
        return found

    exact, usual, solve = columns(), columns(0.02), LinearisedStep.solve
    monkeypatch.setattr(LinearisedStep, "solve", lambda self, right: (0.35 if self.largest_increment > 0.0 else 1.0) * solve(self, right))
    mended, quick = columns(), columns(0.02)
    for field, coarsely in (("u", 1e-2), ("theta", 8e-4)):
        for found, wanted, share in ((mended, exact, 1e-3), (quick, usual, coarsely)):
            a, b = found.field(field), wanted.field(field)
            assert np.all(np.abs(a - b) <= share * np.abs(b).max(axis=tuple(range(b.ndim - 1))))


def test_a_factor_at_hand_that_is_far_off_is_formed_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that answers threefold sends every mending twice as far off, and is given up before long. The step is differentiated with its own
    factor then, and is not made smaller: a smaller one would be as far from it. What is wrong with its own is an error."""
    case, last, asked, answers = CASES[0], list[Any](), list[bool](), [0]

    class Threefold:
        def __init__(self, factor: Any) -> None:
            self.factor = factor

        def solve(self, right: np.ndarray) -> np.ndarray:
            answers[0] += 1
            return 3.0 * np.asarray(self.factor.solve(right))

    fresh = Equilibrator.linearise

    def own(self: Equilibrator, *args: Any) -> Any:
        factor, stiffness = fresh(self, *args)
        last[:] = [factor]
        return factor, stiffness

    def at_hand(self: Equilibrator) -> Any:
        asked.append(bool(last))
        return Threefold(last[0]) if last else None

    def off(self: Equilibrator, *args: Any) -> Any:
        factor, stiffness = fresh(self, *args)
        return Threefold(factor), stiffness

    names, (right, wrong) = ("E", "M_y0", "c0"), (Collected(), Collected())
    known = case.run(Sensitivities(names, right.collect, tolerance=1e-6))
    monkeypatch.setattr(Equilibrator, "linearise", own)
    monkeypatch.setattr(Equilibrator, "good_factor", at_hand)
    found = case.run(Sensitivities(names, wrong.collect, tolerance=1e-6))
    assert sum(asked) > 2 and found.counts["bisections"] == known.counts["bisections"]
    assert answers[0] < 40 * sum(asked), "of a hundred"
    for name in FIELDS:
        size = np.abs(right.field(name)).max(axis=tuple(range(right.field(name).ndim - 1)))
        assert np.all(np.abs(wrong.field(name) - right.field(name)) <= 1e-4 * size), name
    monkeypatch.setattr(Equilibrator, "linearise", off)
    with pytest.raises(NumericsError, match="too far from the exact one"):
        case.run(Sensitivities(names, Collected().collect, tolerance=1e-6))
