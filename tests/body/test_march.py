"""The march in time: coupling, one-way runs, energies, convergence in steps and mesh, sentences for wrong input."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_bodies import ADIABATIC, LOADING, NOMINAL, SPECIMEN, bar_mesh

from thermofit.body.body import Body, ThermalGeometry, tension_body, thermal_geometry
from thermofit.body.heat.conduction import HeatStep, heat_step
from thermofit.body.heat.one_way import heat_problem, heat_run
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.solve.march import History, Loading, MarchSettings, Watch, march
from thermofit.body.solve.newton import NewtonSettings
from thermofit.core.errors import StudyError

HALF_SECTION = 25.0 * 1.2
"""Rest, loading to 190 MPa, hold, unloading, cooling."""


def times(step: float = 1.0) -> np.ndarray:
    return np.arange(0.0, 60.0 + 1e-9, step)


@pytest.fixture(scope="module")
def dogbone() -> Body:
    return tension_body(dogbone_mesh(SPECIMEN, 2, 12, 1))


@pytest.fixture(scope="module")
def full(dogbone: Body) -> History:
    return march(dogbone, NOMINAL, LOADING, times(), MarchSettings(keep_points=True))


@pytest.fixture(scope="module")
def one_way(dogbone: Body) -> History:
    return march(dogbone, NOMINAL, LOADING, times(), MarchSettings(coupling="one-way", keep_points=True))


def test_default_accuracy_is_a_hundredth_of_the_noise(dogbone: Body, full: History) -> None:
    """Against a run of tight tolerances: 1e-5 mm beside 1e-3 mm of image correlation, 1e-4 K beside 1e-2 K of an infrared camera."""
    tight = MarchSettings(newton=NewtonSettings(tolerance=1e-9), coupling_tolerance=1e-8)
    exact = march(dogbone, NOMINAL, LOADING, times(), tight)
    assert np.abs(full.u - exact.u).max() < 1e-5
    assert np.abs(full.theta - exact.theta).max() < 1e-4


def test_tolerances_below_round_off_are_met_by_it(dogbone: Body) -> None:
    """A residual of round-off is equilibrium, at rest (where forces vanish) as under load."""
    settings = MarchSettings(newton=NewtonSettings(tolerance=1e-15))
    history = march(dogbone, NOMINAL, LOADING, times(2.0), settings)
    assert history.counts["bisections"] == 0
    assert history.force == pytest.approx(np.interp(history.time, LOADING.time, LOADING.value), abs=1e-7)


def test_factors_are_kept_over_steps(full: History) -> None:
    """A tangent is formed less than every other step, and an iteration needs no more than one pass beside those."""
    assert full.counts["factorisations"] < 0.5 * full.counts["steps"]
    assert full.counts["element_passes"] <= full.counts["newton_iterations"] + full.counts["steps"] + 2 * full.counts["factorisations"]


def test_internal_energy_is_kept_where_it_is_asked_for(dogbone: Body, full: History) -> None:
    assert np.isnan(full.total("internal")) and np.isnan(full.balance[3].first_law_defect)
    kept = march(dogbone, NOMINAL, LOADING, times()[:9], MarchSettings(keep_energy=True))
    assert np.isfinite([step.internal for step in kept.balance]).all()


def test_balance_of_heat_and_second_law(full: History) -> None:
    """Stored = dissipated + thermoelastic - left, step by step and in all; dissipation never negative; work exceeds it."""
    for step in full.balance:
        assert abs(step.heat_defect) < 1e-8 * max(full.total("dissipated") / len(full.balance), 1.0)
        assert step.smallest_dissipation >= 0.0
        assert step.dissipated >= 0.0
    assert 0.5 * full.total("work") < full.total("dissipated") < full.total("work")
    assert full.total("thermoelastic") < 0.0
    outflow = {name: sum(step.outflow[name] for step in full.balance) for name in ("air", "clamp")}
    assert full.total("stored") == pytest.approx(
        full.total("dissipated") + full.total("thermoelastic") - sum(outflow.values()), abs=1e-6 * full.total("dissipated")
    )
    assert all(value > 0.01 * full.total("dissipated") for value in outflow.values())


def test_work_of_a_closed_elastic_cycle_is_small_and_of_a_plastic_one_is_the_area_of_its_curve(full: History) -> None:
    area = np.trapezoid(full.force, full.u_top)
    assert full.total("work") == pytest.approx(area, rel=1e-12)
    elastic = Loading(np.array([0.0, 10.0, 20.0]), np.array([0.0, 2400.0, 0.0]))
    body = tension_body(dogbone_mesh(SPECIMEN, 1, 8, 1))
    cycle = march(body, NOMINAL, elastic, np.linspace(0.0, 20.0, 41))
    assert cycle.largest_multiplier[-1] == 0.0 and cycle.total("dissipated") == 0.0
    largest = 0.5 * 2400.0 * cycle.u_top.max()
    assert abs(cycle.total("work")) < 5e-3 * largest


def test_history_has_the_states_at_the_asked_times(dogbone: Body, full: History) -> None:
    n = len(times())
    assert np.array_equal(full.time, times())
    assert full.u.shape == (n, dogbone.mesh.n_nodes, 3) and full.theta.shape == (n, dogbone.mesh.n_nodes)
    assert full.force == pytest.approx([LOADING.at(t) for t in times()], abs=0.05)
    assert len(full.balance) == n - 1 and len(full.points) == n
    assert full.counts["steps"] == n - 1 and full.counts["bisections"] == 0
    assert np.all(np.diff(full.largest_multiplier) >= 0.0) and full.plastic_points[0] == 0 < full.plastic_points[-1]
    assert full.largest_multiplier[-1] == max(points.accumulated.max() for points in full.points)


def test_first_state_is_the_steady_state_of_the_films(dogbone: Body, full: History) -> None:
    """At rest between air at 297.4 K and jaws at 296.7 K; the free specimen expands by alpha (theta - theta_0)."""
    assert 296.7 < full.theta[0].min() < full.theta[0].max() < 297.4
    assert np.abs(full.theta[1] - full.theta[0]).max() < 1e-4
    axis = np.flatnonzero((dogbone.mesh.nodes[:, 0] == 0.0) & (dogbone.mesh.nodes[:, 2] == 0.0))
    expansion = 20.21e-6 * np.trapezoid(full.theta[0][axis] - 296.7, dogbone.mesh.nodes[axis, 1])
    assert full.u_top[0] == pytest.approx(expansion, rel=5e-3)


def test_heat_run_agrees_with_the_march(dogbone: Body, full: History, one_way: History) -> None:
    """The heat equation on the known mechanics: against the one-way march and against the full one."""
    rise = np.ptp(full.theta)
    assert rise > 1.5
    for history, coupling in ((one_way, "one-way"), (full, "full")):
        theta = heat_run(heat_problem(dogbone, history, MarchSettings(coupling=coupling)), NOMINAL)
        assert np.abs(theta - history.theta).max() < 1e-3 * rise


def test_heat_run_with_other_thermal_parameters_is_another_march(dogbone: Body, one_way: History) -> None:
    """Mechanics frozen, thermal parameters changed: the same as a one-way march that had them from the start (alpha_exp kept)."""
    other = NOMINAL.replace(kappa=160.0, c0=2.5, beta=0.6, alpha_air=30.0, alpha_clamp=1000.0)
    theta = heat_run(heat_problem(dogbone, one_way, MarchSettings(coupling="one-way")), other)
    expected = march(dogbone, other, LOADING, times(), MarchSettings(coupling="one-way"))
    assert np.abs(theta - expected.theta).max() < 2e-3 * np.ptp(expected.theta)
    assert np.abs(expected.theta - one_way.theta).max() > 0.1 * np.ptp(expected.theta)


def test_coupling_matters_a_little(full: History, one_way: History) -> None:
    """One-way mechanics misses the thermal strain alpha (theta - resting) of 2 K, some 4e-5, and nothing else of that size."""
    strain = (full.u_top - one_way.u_top) / 150.0
    warmer = (full.theta - full.theta[0]).mean(axis=1)
    assert strain == pytest.approx(20.21e-6 * warmer, abs=1.5e-5)
    assert np.abs(strain).max() > 1e-5
    difference = np.abs(full.theta - one_way.theta).max()
    assert 1e-6 < difference < 2e-3 * np.ptp(full.theta)


def test_heat_run_needs_the_point_histories(dogbone: Body, full: History) -> None:
    with pytest.raises(StudyError, match="keep_points"):
        heat_problem(dogbone, replace(full, points=()), MarchSettings())


def test_nothing_moves_without_load_and_temperature_difference() -> None:
    body = tension_body(bar_mesh((1, 2, 1), (1.0, 4.0, 1.0), air=("x1",), clamp=("y0",)))
    still = NOMINAL.replace(theta_air=296.7, theta_clamp=296.7)
    history = march(body, still, Loading(np.array([0.0, 1.0]), np.zeros(2)), np.linspace(0.0, 1.0, 4))
    assert np.all(np.abs(history.u) < 1e-12) and history.theta == pytest.approx(np.full(history.theta.shape, 296.7), abs=1e-8)


def test_thermal_expansion_of_a_free_bar() -> None:
    """Without load J makes the stress vanish: lambda ln J + mu (J^(2/3) - 1) = 3 alpha K (theta - theta_0) (1 - ln J) / J."""
    body = tension_body(bar_mesh((2, 3, 1), (2.0, 6.0, 1.0), air=("x1", "z1", "y1"), clamp=("y0",), distortion=0.2))
    warm = NOMINAL.replace(theta_air=340.0, theta_clamp=340.0, alpha_exp=1e-4)
    history = march(body, warm, Loading(np.array([0.0, 1.0]), np.zeros(2)), np.array([0.0, 1.0]))
    law_mu = NOMINAL["E"] / (2.0 * (1.0 + NOMINAL["nu"]))
    bulk = NOMINAL["E"] / (3.0 * (1.0 - 2.0 * NOMINAL["nu"]))
    stretch = 1.0 + history.u_top[-1] / 6.0
    j = stretch**3
    thermal = 3.0 * 1e-4 * bulk * (340.0 - 296.7) * (1.0 - np.log(j)) / j
    assert (bulk - 2.0 / 3.0 * law_mu) * np.log(j) + law_mu * (stretch**2 - 1.0) == pytest.approx(thermal, rel=1e-5)
    assert stretch > 1.004


def test_heat_of_a_step_passes_the_mean_of_the_geometries_at_its_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the films of a growing specimen lag or lead by half a step."""
    used: list[float] = []

    def recorded(body: Body, geometry: ThermalGeometry, *rest: Any) -> HeatStep:
        used.append(float(geometry.film_area["air"].sum()))
        return heat_step(body, geometry, *rest)

    monkeypatch.setattr("thermofit.body.heat.coupling.heat_step", recorded)
    body = tension_body(bar_mesh((1, 2, 1), (1.0, 4.0, 1.0), air=("x1",), clamp=("y0",)), control="displacement")
    pull = Loading(np.array([0.0, 1.0]), np.array([0.0, 0.4]), "displacement")
    history = march(body, NOMINAL, pull, np.linspace(0.0, 1.0, 6), MarchSettings(coupling="one-way"))
    area = np.array([thermal_geometry(body, u).film_area["air"].sum() for u in history.u])
    assert area[-1] > 1.03 * area[0]
    assert used == pytest.approx(0.5 * (area[1:] + area[:-1]), rel=1e-12)


def test_callback_counts_the_steps() -> None:
    body = tension_body(bar_mesh((1, 2, 1), (1.0, 4.0, 1.0), air=("x1",), clamp=("y0",)))
    seen: list[int] = []
    march(body, ADIABATIC, Loading(np.array([0.0, 1.0]), np.array([0.0, 100.0])), np.linspace(0.0, 1.0, 6), watch=Watch(step=seen.append))
    assert seen == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("wrong", [[0.0], [0.0, 1.0, 1.0], [1.0, 0.0]])
def test_times_must_increase(wrong: list[float]) -> None:
    body = tension_body(bar_mesh((1, 1, 1), (1.0, 1.0, 1.0), air=("x1",)))
    with pytest.raises(StudyError, match="increasing times"):
        march(body, NOMINAL, Loading(np.array([0.0, 1.0]), np.zeros(2)), np.array(wrong))


def test_loading_and_body_must_have_the_same_control() -> None:
    body = tension_body(bar_mesh((1, 1, 1), (1.0, 1.0, 1.0), air=("x1",)), control="displacement")
    with pytest.raises(StudyError, match="control"):
        march(body, NOMINAL, Loading(np.array([0.0, 1.0]), np.zeros(2), "force"), np.array([0.0, 1.0]))


def final(mesh: tuple[int, int, int]) -> np.ndarray:
    """End displacement (mm) and hottest temperature (K) at the end of loading, and the temperature at the end."""
    body = tension_body(dogbone_mesh(SPECIMEN, *mesh))
    history = march(body, NOMINAL, LOADING, times())
    loaded = int(np.searchsorted(history.time, 25.0))
    return np.array([history.u_top[loaded], history.theta[loaded].max(), history.theta[-1].max()])


@pytest.mark.slow
@pytest.mark.parametrize(("settings", "order"), [({}, 2.0), ({"closed_form": False, "heat_scheme": "backward-euler"}, 1.0)])
def test_convergence_in_the_step(settings: dict[str, Any], order: float) -> None:
    """Centre temperature in plastic flow: order 2 of closed form and sdirk2 (steps of 4 s to 0.5 s), order 1 of backward Euler."""
    body = tension_body(dogbone_mesh(SPECIMEN, 2, 12, 1))
    ramp = Loading(np.array([0.0, 32.0]), np.array([3600.0, 5800.0]))
    centre = body.mesh.nearest_node((0.0, 0.0, 0.6))
    values = []
    for steps in (8, 16, 32, 64):
        history = march(body, NOMINAL, ramp, np.linspace(0.0, 32.0, steps + 1), MarchSettings(coupling_tolerance=1e-7, **settings))
        values.append(history.theta[-1, centre])
    changes = np.abs(np.diff(values))
    orders = np.log2(changes[:-1] / changes[1:])
    assert abs(orders[-1] - order) < 0.3 and np.all(orders > order - 0.6), (values, orders)


@pytest.mark.slow
def test_convergence_in_the_mesh() -> None:
    values = np.array([final((n, 8 * n, max(1, n // 2))) for n in (2, 4, 8)])
    changes = np.abs(np.diff(values, axis=0))
    assert np.all(changes[1] < 0.4 * changes[0]), changes
