"""Where a step begins whose end is displaced: the end where it has to be, no jump left to the last layer of elements."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_bodies import NOMINAL, SPECIMEN
from test_gauge import dogbone

from thermofit.body.body import LOADED, tension_body
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.solve.gauge import GaugeLoading, march_between
from thermofit.body.solve.march import Balance, Loading, MarchSettings, Run, march
from thermofit.body.solve.newton import Equilibrator, NewtonSettings, virgin_state
from thermofit.body.solve.predictor import Passed, onwards, predicted
from thermofit.core.errors import NumericsError
from thermofit.law.page import law_of

SHAPE = np.random.default_rng(4).normal(size=(dogbone()[0].mesh.n_nodes, 3))
SHAPE[dogbone()[0].equation == LOADED] = 1.0
FLAT = NOMINAL.replace(E=230000.0, M_y0=210.0, M_yinf=300.0, H_exp=9.0)
"""Steel that hardly hardens: its tangent of flow is a hundredth of its elastic one."""
TIME = np.cumsum([0, 3, 2.3, 1.0, 2.6, 1.1, 2.4, 0.9, 2.6, 2.0, 1.0, 2.5, 0.5, 2.3, 1.0, 2.6])
END = 0.3 * np.maximum(TIME - 3.0, 0.0) + 0.003 * np.random.default_rng(1).normal(size=TIME.size) * (TIME > 3.0)
"""mm: as stages see it, of unlike length, and noise."""


def at(load: float, time: float) -> Any:
    return SimpleNamespace(time=time, load=load, u=load * SHAPE + load**2, theta=np.full(len(SHAPE), 290.0 + time), points=None)


@pytest.mark.parametrize("number", [2, 3])
def test_a_displaced_end_is_where_it_has_to_be(number: int) -> None:
    """Over displacements of the end that do not follow the time, u is extrapolated over these, theta over the time."""
    start, *past = [at(load, time) for load, time in ((1.0, 4.0), (0.7, 3.0), (0.3, 1.2))[:number]]
    passed = tuple(Passed(p.time, p.load, p.u, p.theta) for p in past)
    u, theta, fresh = predicted(dogbone()[0], start, passed, 5.5, 1.31)
    assert u == pytest.approx(1.31 * SHAPE + (1.31**2 if number == 3 else 1.0 + 1.7 * 0.31), abs=1e-12)
    assert theta == pytest.approx(295.5) and not fresh


def test_under_a_force_the_time_leads() -> None:
    body: Any = SimpleNamespace(top=0)
    start, before = at(1.0, 4.0), at(0.7, 3.0)
    passed = (Passed(before.time, before.load, before.u, before.theta),)
    assert predicted(body, start, passed, 5.5, 1.31)[0] == pytest.approx(start.u + 1.5 * (start.u - before.u))
    assert predicted(dogbone()[0], start, (), 5.5, 1.0)[0] == pytest.approx(start.u), "an end that stays where it is stretches nothing"


def test_the_body_goes_on_as_in_the_step_before() -> None:
    start, before = at(1.0, 4.0), at(0.7, 3.0)
    found = onwards(start, Passed(before.time, before.load, before.u, before.theta), 0.9)
    assert found == pytest.approx(start.u - (start.u - before.u) / 3.0)


def test_the_answer_of_the_tangent_is_that_of_equilibrium_to_second_order() -> None:
    """Of a displacement of the end from an elastic equilibrium."""
    body = dogbone()[0]
    law = law_of(NOMINAL, plastic=False)
    solver, state = Equilibrator(body, law, NewtonSettings(tolerance=1e-11)), virgin_state(body.mesh.n_elements)
    theta = np.full(body.mesh.n_nodes, NOMINAL["theta_ref"])
    rest = solver.solve(np.zeros((body.mesh.n_nodes, 3)), theta, state, 0.5).u
    missed = []
    for step in (0.4, 0.2):
        missed.append(np.abs(solver.answer(rest, theta, state, step) - solver.solve(rest, theta, state, 0.5 + step).u).max())
    assert np.log2(missed[0] / missed[1]) > 1.9
    assert missed[1] < 1e-3 * 0.2


@pytest.mark.parametrize("sections", [False, True])
def test_a_body_that_hardly_hardens_goes_on_without_bisections(sections: bool) -> None:
    """Of 15 steps two at most are bisected. Where the last layer had to take a jump, 12 were under the end's motion and 5 under that of
    sections, with 342 and 158 factorisations."""
    body = tension_body(dogbone_mesh(SPECIMEN, 2, 12, 1), control="displacement")
    if sections:
        loading = GaugeLoading(TIME, 0.5 * END, "displacement", True, gauge=dogbone()[1])
        counts = march_between(body, FLAT, loading, TIME, MarchSettings()).counts
    else:
        counts = march(body, FLAT, Loading(TIME, END, "displacement", from_rest=True), TIME, MarchSettings()).counts
    assert counts["bisections"] <= 2, counts
    assert counts["factorisations"] <= 4 * len(TIME), counts


def test_halves_of_a_step_remember_what_was_before() -> None:
    """A step of 1 s that fails is halved: its first half knows the states before it, its second half the first one's start and one more."""
    asked: list[tuple[float, float, list[float]]] = []

    def step(start: Any, past: tuple[Passed, ...], t: float) -> tuple[Any, Balance]:
        asked.append((start.time, t, [p.time for p in past]))
        if t - start.time > 0.6:
            raise NumericsError("too long")
        return at(t, t), Balance(0.0, 0.0, 0.0, {}, 0.0, 0.0)

    run: Any = Run.__new__(Run)
    run._step, run.settings, run.cuts, run.steps = step, MarchSettings(), 0, 1
    run.solver = SimpleNamespace(forget=lambda: None)
    before = tuple(Passed(s.time, s.load, s.u, s.theta) for s in (at(0.9, 3.0), at(0.7, 2.0)))
    state, _ = run.advance(at(1.0, 4.0), before, 5.0, 0)
    assert state.time == 5.0 and run.cuts == 1
    assert asked == [(4.0, 5.0, [3.0, 2.0]), (4.0, 4.5, [3.0, 2.0]), (4.5, 5.0, [4.0, 3.0])]


def guesses(top: int, before: tuple[Any, ...], load: float, effective: int = 0) -> list[np.ndarray]:
    """Where equilibrium under a load is sought in turn from a state of load 1; the answer of the tangent is 7 everywhere, and the solver
    finds twice its guess."""
    run: Any = Run.__new__(Run)
    law = SimpleNamespace(effective=effective, _replace=lambda **_: "elastic")
    run.body, run.law = SimpleNamespace(top=top), law
    run.solver = SimpleNamespace(
        law=law, answer=lambda u, *_: 7.0 + 0.0 * u, solve=lambda u, *_, **__: SimpleNamespace(u=2.0 * u), forget=lambda: None
    )
    past = tuple(Passed(s.time, s.load, s.u, s.theta) for s in before)
    found = [make() for make in run._guesses(at(1.0, 4.0), past, np.zeros(1), load)]
    assert run.solver.law is law
    return found


def test_a_displaced_end_is_followed_then_answered_and_a_force_begins_at_rest() -> None:
    start, before = at(1.0, 4.0), at(0.7, 3.0)
    answer = np.full_like(start.u, 7.0)
    along, second = guesses(-1, (before,), 1.3)
    assert along == pytest.approx(start.u + (start.u - before.u)) and np.array_equal(second, answer)
    for alone in (guesses(-1, (before,), 0.8), guesses(-1, (), 1.3)):
        assert len(alone) == 1 and np.array_equal(alone[0], answer), "the end has turned, or nothing was before"
    assert np.array_equal(guesses(-1, (), 1.3, effective=1)[1], 2.0 * answer), "the elastic answer begins at that of the tangent"
    for number, found in enumerate(guesses(0, (before,), 1.3, effective=1), start=1):
        assert np.array_equal(found, number * start.u), "under a force at the start, then from the elastic answer"
