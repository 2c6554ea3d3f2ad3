"""Equilibrium of one load level: rate of convergence, failures in words, control, unloading, holds."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from necked_bar import AREA, bar, necked, run
from small_bodies import ADIABATIC, MISES, NOMINAL, bar_mesh, dense_equilibrium, run_pass

from thermofit.body.body import Body, tension_body
from thermofit.body.solve import newton
from thermofit.body.solve.march import Loading, march
from thermofit.body.solve.newton import Equilibrator, NewtonSettings, virgin_state
from thermofit.core.errors import NumericsError, StudyError
from thermofit.law.page import law_of


def rest(body: Body) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    mesh = body.mesh
    return np.zeros((mesh.n_nodes, 3)), np.full(mesh.n_nodes, 296.7), virgin_state(mesh.n_elements)


def test_residual_falls_quadratically_with_a_fresh_tangent(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plastic step of a necked bar from an extrapolated start, tangent formed in every iteration: r_k+1 < C r_k^2."""
    monkeypatch.setattr(newton, "PATIENCE", 0.0)
    body = necked()
    solver = Equilibrator(body, law_of(MISES), NewtonSettings(tolerance=1e-12))
    u, theta, state = rest(body)
    first = solver.solve(u, theta, state, 150.0 * AREA, fresh=True)
    second = solver.solve(first.u, theta, first.state, 152.0 * AREA, fresh=True)
    guess = second.u + 2.0 * (second.u - first.u)
    third = solver.solve(guess, theta, second.state, 158.0 * AREA, fresh=True)
    assert np.all(third.state[:, :, 10] > second.state[:, :, 10])
    relative = np.array(third.residuals) / (158.0 * AREA)
    steps = [(a, b) for a, b in pairwise(relative) if b > 1e-12]
    assert len(steps) >= 3
    assert all(b < 10.0 * a**2 for a, b in steps), relative
    assert relative[-1] < 1e-11


def test_solution_is_that_of_a_dense_newton() -> None:
    """The same displacement as an independent assembly of all dofs, under displacement control."""
    body = necked("displacement")
    law = law_of(NOMINAL)
    _, theta, state = rest(body)
    start = body.mesh.nodes * np.array([-0.005, 0.01, -0.005])
    found = Equilibrator(body, law, NewtonSettings(tolerance=1e-10)).solve(start, theta, state, 0.3)
    held = body.equation < 0
    expected, nodal, _ = dense_equilibrium(body.data, start, held, law)
    assert found.u == pytest.approx(expected, abs=1e-9)
    assert found.top_force == pytest.approx(nodal[body.loaded, 1].sum(), rel=1e-8)
    assert found.state[:, :, 10].max() > 0.005


def test_force_control_ends_at_the_force_with_one_common_end_displacement() -> None:
    body = necked()
    u, theta, state = rest(body)
    found = Equilibrator(body, law_of(NOMINAL), NewtonSettings()).solve(u, theta, state, 150.0 * AREA)
    assert found.top_force == pytest.approx(150.0 * AREA, rel=1e-6)
    assert np.ptp(found.u[body.loaded, 1]) == 0.0 and found.u[body.loaded[0], 1] > 0.0
    assert np.ptp(found.u[body.loaded, 0]) > 0.0
    for name, direction in (("x0", 0), ("bottom", 1), ("z0", 2)):
        assert np.all(found.u[body.mesh.node_sets[name], direction] == 0.0)


def test_reactions_equal_the_load_and_free_nodes_carry_none() -> None:
    """Forces of all elements, assembled without the solver's numbering: balance to 1e-8 of the load in an inhomogeneous plastic state."""
    body, law = necked(), law_of(NOMINAL)
    u, theta, state = rest(body)
    found = Equilibrator(body, law, NewtonSettings(tolerance=1e-11)).solve(u, theta, state, 165.0 * AREA)
    assert 0.01 < 1.5 * found.state[:, :, 10].min() < found.state[:, :, 10].max()
    force = run_pass(body.data, found.u, theta, state, law)[0]
    nodal = np.zeros((body.mesh.n_nodes, 3))
    np.add.at(nodal, body.mesh.hexes.ravel(), force.reshape(-1, 3))
    top, bottom = (nodal[body.mesh.node_sets[name], 1].sum() for name in ("top", "bottom"))
    assert top == pytest.approx(165.0 * AREA, rel=1e-8) and bottom == pytest.approx(-165.0 * AREA, rel=1e-8)
    free = body.equation >= 0
    free[body.loaded, 1] = False
    assert np.abs(nodal[free]).max() < 1e-8 * top


def test_old_state_stays_as_it_was() -> None:
    body = bar()
    u, theta, state = rest(body)
    before = (u.copy(), state.copy())
    solver = Equilibrator(body, law_of(NOMINAL), NewtonSettings())
    found = solver.solve(u, theta, state, 160.0 * AREA)
    assert np.array_equal(u, before[0]) and np.array_equal(state, before[1])
    kept = found.state.copy()
    solver.solve(found.u, theta, found.state, 165.0 * AREA)
    assert np.array_equal(found.state, kept)


def test_a_load_beyond_the_material_is_told_in_one_sentence() -> None:
    body = bar()
    u, theta, state = rest(body)
    solver = Equilibrator(body, law_of(NOMINAL), NewtonSettings(max_iterations=15))
    with pytest.raises(NumericsError, match=r"^equilibrium: "):
        solver.solve(u, theta, state, 400.0 * AREA)
    assert solver.solve(u, theta, state, 100.0 * AREA, fresh=True).iterations <= 5


def test_fields_that_never_agree_are_told_by_the_temperature() -> None:
    """The residual is small: it would not say what failed."""
    body = bar()
    u, theta, state = rest(body)

    def restless(_u: np.ndarray, _state: np.ndarray, _dilatation: np.ndarray, before: np.ndarray) -> tuple[np.ndarray, float]:
        return before, 0.25

    with pytest.raises(NumericsError, match=r"temperature still changes by 2\.5e-01 K from sweep to sweep, expected 1e-04 K"):
        Equilibrator(body, law_of(NOMINAL), NewtonSettings()).solve(u, theta, state, 50.0 * AREA, thermal=(restless, 1e-4))


def test_an_inverted_start_is_told() -> None:
    body = bar()
    u, theta, state = rest(body)
    u[:, 1] = -2.0 * body.mesh.nodes[:, 1]
    with pytest.raises(NumericsError, match="not admissible"):
        Equilibrator(body, law_of(NOMINAL), NewtonSettings()).solve(u, theta, state, 0.0)


def test_missing_sets_and_unknown_control_are_told() -> None:
    mesh = bar_mesh((1, 2, 1), (1.0, 2.0, 1.0))
    with pytest.raises(StudyError, match="'sideways'"):
        tension_body(mesh, control="sideways")
    del mesh.node_sets["z0"]  # type: ignore[attr-defined]
    with pytest.raises(StudyError, match="'z0' is missing"):
        tension_body(mesh)


PROGRAMME = ([0.0, 1.0, 1.5, 2.0, 3.0, 3.5, 4.5], [0.0, 170.0, 170.0, 40.0, -175.0, -175.0, 60.0])
"""Loading, hold, unloading, reverse yield, hold, reloading; nominal stress in MPa."""


def test_force_never_drifts_over_holds_unloading_and_reversal() -> None:
    body = necked()
    history = run(body, PROGRAMME[0], [4.0 * AREA * value for value in PROGRAMME[1]])
    prescribed = np.interp(history.time, PROGRAMME[0], 4.0 * AREA * np.array(PROGRAMME[1]))
    assert history.force == pytest.approx(prescribed, abs=1e-5 * 4.0 * AREA * 175.0)
    multiplier = history.largest_multiplier
    for start, end in ((1.0, 1.5), (1.5, 2.0), (3.0, 3.5)):
        during = (history.time >= start) & (history.time <= end)
        assert np.ptp(multiplier[during]) < 1e-6, (start, end)
    assert multiplier[-1] > multiplier[history.time <= 1.5][-1] + 1e-3
    hold = (history.time >= 1.0) & (history.time <= 1.5)
    assert np.ptp(history.u_top[hold]) < 5e-5 * history.u_top[hold][0]  # heat flows out of the neck


def test_displacement_control_follows_the_curve_of_force_control() -> None:
    force_run = run(necked(), PROGRAMME[0], [4.0 * AREA * value for value in PROGRAMME[1]])
    loading = Loading(force_run.time, force_run.u_top, "displacement")
    moved = march(necked("displacement"), ADIABATIC, loading, force_run.time)
    assert moved.u_top == pytest.approx(force_run.u_top, abs=1e-12)
    assert moved.force == pytest.approx(force_run.force, abs=2e-5 * 4.0 * AREA * 175.0)
    assert np.abs(moved.u - force_run.u).max() < 1e-5 * np.abs(force_run.u).max()
    assert moved.theta == pytest.approx(force_run.theta, abs=2e-3)


def test_bisection_recovers_a_step_that_is_too_large() -> None:
    """From rest to 265 MPa in one step fails without bisection and arrives with it at the answer of many small steps."""
    body, load = necked(), [0.0, 4.0 * AREA * 215.0]
    with pytest.raises(NumericsError, match=r"time step to t = 1 s failed after 0 bisections"):
        run(body, [0.0, 1.0], load, steps=1, max_cuts=0, newton=NewtonSettings(max_iterations=9))
    cut = run(body, [0.0, 1.0], load, steps=1, newton=NewtonSettings(max_iterations=9))
    assert cut.counts["bisections"] >= 1 and len(cut.time) == 2
    with pytest.raises(NumericsError, match=r"1 bisections in 1 steps to t = 1 s, expected one for every step and -1 besides at most"):
        run(body, [0.0, 1.0], load, steps=1, all_cuts=-1, newton=NewtonSettings(max_iterations=9))
    fine = run(body, [0.0, 1.0], load, steps=80)
    assert cut.u_top[-1] == pytest.approx(fine.u_top[-1], rel=2e-3)
    assert cut.balance[0].dissipated == pytest.approx(fine.total("dissipated"), rel=5e-3)
    assert abs(cut.balance[0].heat_defect) < 1e-8 * cut.balance[0].dissipated
