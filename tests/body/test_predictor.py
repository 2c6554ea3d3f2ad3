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
from thermofit.body.solve.march import Loading, MarchSettings, march
from thermofit.body.solve.newton import Equilibrator, NewtonSettings, virgin_state
from thermofit.body.solve.predictor import Passed, onwards, predicted
from thermofit.law.page import law_of

SHAPE = np.random.default_rng(4).normal(size=(dogbone()[0].mesh.n_nodes, 3))
SHAPE[dogbone()[0].equation == LOADED] = 1.0
FLAT = NOMINAL.replace(E=230000.0, M_y0=210.0, M_yinf=300.0, H_exp=9.0)
"""Steel that hardly hardens: its tangent of flow is a hundredth of its elastic one."""
TIME = np.cumsum([0, 3, 2.3, 1.0, 2.6, 1.1, 2.4, 0.9, 2.6, 2.0, 1.0, 2.5, 0.5, 2.3, 1.0, 2.6])
END = 0.3 * np.maximum(TIME - 3.0, 0.0) + 0.003 * np.random.default_rng(1).normal(size=TIME.size) * (TIME > 3.0)
"""mm: as stages see it, of unlike length, and noise."""


def at(load: float, time: float) -> Any:
    return SimpleNamespace(time=time, load=load, u=load * SHAPE + load**2, theta=np.full(len(SHAPE), 290.0 + time))


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
    """Beyond its knee every step begins close to where it ends; each of them was bisected where its last layer had to take a jump."""
    body = tension_body(dogbone_mesh(SPECIMEN, 2, 12, 1), control="displacement")
    if sections:
        loading = GaugeLoading(TIME, 0.5 * END, "displacement", True, gauge=dogbone()[1])
        counts = march_between(body, FLAT, loading, TIME, MarchSettings()).counts
    else:
        counts = march(body, FLAT, Loading(TIME, END, "displacement", from_rest=True), TIME, MarchSettings()).counts
    assert counts["bisections"] <= 2, counts
    assert counts["factorisations"] <= 4 * len(TIME), counts
