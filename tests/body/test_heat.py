"""Heat equation: closed forms of bars and fins, order in mesh and time, balance, films that follow the deformation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from small_bodies import ADIABATIC, NOMINAL, bar_mesh

from thermofit.body.body import Body, tension_body, thermal_geometry
from thermofit.body.heat.conduction import HeatConditions, heat_conditions, heat_step, steady_temperature, stored_heat
from thermofit.body.heat.equation import PointStates, heat_of_increment, smallest_dissipation
from thermofit.body.solve.linear import multiply_symmetric
from thermofit.body.solve.march import History, Loading, MarchSettings, march
from thermofit.body.solve.newton import NewtonSettings
from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.law.page import dissipated_energy, law_of, thermoelastic_heat

SIDES = ("x0", "x1", "z0", "z1")
A, LENGTH, B = 2.0, 60.0, 1.0


def fin(n: int) -> Body:
    """Bar held at the jaw temperature at both ends, films on all four sides: the discrete problem is exactly one-dimensional."""
    return tension_body(bar_mesh((1, n, 1), (A, LENGTH, B), air=SIDES, clamp=("y0", "y1")), symmetry=1.0)


FIN = NOMINAL.replace(alpha_air=50.0, theta_air=280.0, alpha_clamp=1e8, theta_clamp=320.0)


def at_rest(body: Body) -> np.ndarray:
    return np.zeros((body.mesh.n_nodes, 3))


def fin_profile(y: np.ndarray) -> np.ndarray:
    """theta_air + (theta_clamp - theta_air) cosh m (y - l/2) / (cosh m l/2 + kappa m / alpha_clamp sinh m l/2).

    m^2 = alpha P / (kappa A), with the perimeter P and section A.
    """
    m = np.sqrt(1e-3 * FIN["alpha_air"] * 2.0 * (A + B) / (FIN["kappa"] * A * B))
    end = np.cosh(0.5 * m * LENGTH) + FIN["kappa"] * m / (1e-3 * FIN["alpha_clamp"]) * np.sinh(0.5 * m * LENGTH)
    return FIN["theta_air"] + (FIN["theta_clamp"] - FIN["theta_air"]) * np.cosh(m * (y - 0.5 * LENGTH)) / end


def test_fin_in_steady_state_with_order_2() -> None:
    errors = []
    for n in (8, 16, 32):
        body = fin(n)
        theta = steady_temperature(body, thermal_geometry(body, at_rest(body)), heat_conditions(FIN))
        errors.append(np.abs(theta - fin_profile(body.mesh.nodes[:, 1])).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 2.0) < 0.1), (errors, orders)
    assert errors[-1] < 0.01


def test_a_very_good_contact_is_isothermal() -> None:
    """1e8 W/(m^2 K) (5.2.2): the ends take the jaw temperature although the bar is 14 K away from it."""
    body = fin(16)
    theta = steady_temperature(body, thermal_geometry(body, at_rest(body)), heat_conditions(FIN))
    ends = np.concatenate([body.mesh.node_sets["bottom"], body.mesh.node_sets["top"]])
    assert theta[ends] == pytest.approx(np.full(len(ends), 320.0), abs=2e-3)
    assert theta.min() < 306.0


def dense(body: Body, data: np.ndarray) -> np.ndarray:
    p = body.thermal
    out = np.zeros((p.n, p.n))
    out[p.row, p.column] = data
    out[p.column, p.row] = data
    return out


@pytest.mark.parametrize(("scheme", "order"), [("sdirk2", 2.0), ("backward-euler", 1.0)])
def test_cooling_has_the_order_of_its_scheme(scheme: str, order: float) -> None:
    """Against the matrix exponential of the same discrete body, constant heating included."""
    body = fin(6)
    conditions = heat_conditions(FIN.replace(alpha_clamp=300.0))
    geometry = thermal_geometry(body, at_rest(body))
    heating = np.random.default_rng(1).uniform(0.0, 20.0, body.mesh.n_nodes)
    capacity = conditions.c0 * dense(body, body.capacity)
    exchange = conditions.kappa * dense(body, geometry.conduction)
    inflow = np.zeros(body.mesh.n_nodes)
    for name, (alpha, medium) in conditions.films.items():
        exchange += 1e-3 * alpha * dense(body, geometry.film[name])
        inflow += 1e-3 * alpha * medium * geometry.film_area[name]
    end = np.linalg.solve(exchange, inflow + heating)
    start = 310.0 + 5.0 * np.sin(body.mesh.nodes[:, 1])
    exact = end + expm(-20.0 * np.linalg.solve(capacity, exchange)) @ (start - end)
    errors = []
    for steps in (20, 40, 80):
        theta, dt = start, 20.0 / steps
        for _ in range(steps):
            theta = heat_step(body, geometry, conditions, theta, dt * heating, (dt, scheme)).theta
        errors.append(np.abs(theta - exact).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - order) < 0.15), (errors, orders)


@pytest.mark.parametrize("scheme", ["sdirk2", "backward-euler"])
def test_discrete_heat_balance(scheme: str) -> None:
    """Stored = released - left through the films, to 1e-8 of the heat involved, on a distorted and deformed body."""
    mesh = bar_mesh((2, 8, 2), (A, LENGTH, B), air=("x1", "z1"), clamp=("y0", "y1"), distortion=0.2)
    body = tension_body(mesh)
    random = np.random.default_rng(0)
    u = at_rest(body) + mesh.nodes @ np.array([[-0.05, 0, 0], [0.02, 0.12, 0], [0, 0, -0.06]]).T
    geometry, conditions = thermal_geometry(body, u), heat_conditions(NOMINAL)
    theta = random.uniform(290.0, 310.0, mesh.n_nodes)
    heat = random.uniform(0.0, 3.0, mesh.n_nodes)
    step = heat_step(body, geometry, conditions, theta, heat, (2.5, scheme))
    stored = stored_heat(body, conditions, theta, step.theta)
    assert stored == pytest.approx(heat.sum() - sum(step.outflow.values()), abs=1e-8 * heat.sum())
    assert all(abs(value) > 1e-3 * heat.sum() for value in step.outflow.values())
    assert stored_heat(body, conditions, theta, theta + 1.0) == pytest.approx(NOMINAL["c0"] * A * LENGTH * B, rel=1e-12)


def test_no_exchange_leaves_the_jaw_temperature_and_a_negative_film_is_told() -> None:
    body = fin(4)
    geometry = thermal_geometry(body, at_rest(body))
    assert np.all(steady_temperature(body, geometry, heat_conditions(ADIABATIC)) == 296.7)
    with pytest.raises(StudyError, match="alpha_air"):
        steady_temperature(body, geometry, HeatConditions(100.0, 2.0, {"air": (-1.0, 290.0), "clamp": (1.0, 290.0)}))


def test_air_alone_gives_the_air_temperature() -> None:
    body = fin(4)
    theta = steady_temperature(body, thermal_geometry(body, at_rest(body)), heat_conditions(FIN.replace(alpha_clamp=0.0)))
    assert theta == pytest.approx(np.full(body.mesh.n_nodes, 280.0), rel=1e-12)


def test_films_and_conduction_follow_the_deformation() -> None:
    """Stretches lx, ly, lz: film area of the current body; conduction along y of kappa (lx lz) A / (ly l) (Fourier in space)."""
    mesh = bar_mesh((2, 5, 3), (A, LENGTH, B), air=("x1",), clamp=("y0", "y1"), distortion=0.2)
    body = tension_body(mesh)
    lx, ly, lz = 0.93, 1.2, 0.9
    geometry = thermal_geometry(body, mesh.nodes * (np.array([lx, ly, lz]) - 1.0))
    assert geometry.film_area["air"].sum() == pytest.approx(LENGTH * B * ly * lz, rel=1e-12)
    assert geometry.film_area["clamp"].sum() == pytest.approx(2 * A * B * lx * lz, rel=1e-12)
    p, ones = body.thermal, np.ones(mesh.n_nodes)
    for name in ("air", "clamp"):
        assert multiply_symmetric(p.row, p.column, geometry.film[name], ones) == pytest.approx(geometry.film_area[name], abs=1e-12)
    drop = mesh.nodes[:, 1] / LENGTH
    flow = multiply_symmetric(p.row, p.column, geometry.conduction, drop)
    assert flow[mesh.node_sets["top"]].sum() == pytest.approx(A * B * lx * lz / (LENGTH * ly), rel=1e-12)
    assert multiply_symmetric(p.row, p.column, geometry.conduction, ones) == pytest.approx(np.zeros(mesh.n_nodes), abs=1e-12)
    mean = geometry.mean_with(thermal_geometry(body, at_rest(body)))
    assert mean.film_area["air"].sum() == pytest.approx(0.5 * LENGTH * B * (1.0 + ly * lz), rel=1e-12)


def test_heat_of_an_increment_is_the_law_times_the_volume() -> None:
    """One state everywhere: the nodal heats sum to volume times the scalar formulas; points that do not flow dissipate nothing."""
    body, law = fin(3), law_of(NOMINAL)
    n = body.mesh.n_elements

    def history(j: float, alpha: float, accumulated: float) -> PointStates:
        return PointStates(np.full((n, 8), j), np.full((n, 8), alpha), np.full((n, 8), accumulated))

    start, end = history(1.0005, 0.01, 0.011), history(1.0011, 0.0125, 0.014)
    theta, out = np.full(body.mesh.n_nodes, 301.0), np.zeros(body.mesh.n_nodes)
    dissipated, elastic = heat_of_increment(body.data, start, end, theta, law, out)
    volume = A * LENGTH * B
    assert dissipated == pytest.approx(volume * dissipated_energy(0.01, 0.0125, 0.003, law), rel=1e-12)
    expected = volume * thermoelastic_heat(301.0, np.log(1.0005) / 1.0005, np.log(1.0011) / 1.0011, law)
    assert elastic == pytest.approx(expected, rel=1e-12)
    assert out.sum() == pytest.approx(dissipated + elastic, rel=1e-12)
    assert heat_of_increment(body.data, start, start, theta, law, np.zeros_like(out)) == (0.0, 0.0)
    none = np.zeros((n, 8))
    assert smallest_dissipation(start, end, 300.0, law, none) == 0.0
    broken = end._replace(accumulated=end.accumulated.copy(), alpha=end.alpha.copy())
    broken.accumulated[1, 2] = 0.010
    assert smallest_dissipation(start, broken, 300.0, law, none) < 0.0


def adiabatic_run(stresses: list[float], parameters: Parameters = ADIABATIC, **settings: Any) -> tuple[Body, History]:
    """A homogeneous bar without any exchange under nominal stresses (MPa), 40 steps from one to the next."""
    body = tension_body(bar_mesh((1, 2, 1), (A, LENGTH, B), air=SIDES, clamp=("y0", "y1")), symmetry=1.0)
    marks = np.arange(len(stresses), dtype=float)
    times = np.linspace(0.0, marks[-1], 40 * (len(stresses) - 1) + 1)
    loading = Loading(marks, np.array(stresses) * A * B)
    return body, march(
        body, parameters, loading, times, MarchSettings(newton=NewtonSettings(tolerance=1e-9), coupling_tolerance=1e-6, **settings)
    )


def test_gough_joule_cooling() -> None:
    """Elastic loading to 139.5492 MPa cools by 0.36382 K (reference solution); -alpha theta_0 P / c0 would be 0.37693 K."""
    _, history = adiabatic_run([0.0, 139.5492])
    assert history.theta[-1] - 296.7 == pytest.approx(np.full(12, -0.36382), abs=1.5e-5)
    assert history.largest_multiplier[-1] == 0.0
    p = NOMINAL
    bulk = p["E"] / (3.0 * (1.0 - 2.0 * p["nu"]))
    constant_pressure = p["c0"] + 9.0 * bulk * p["alpha_exp"] ** 2 * 296.7
    assert history.theta[-1, 0] - 296.7 == pytest.approx(-p["alpha_exp"] * 296.7 * 139.5492 / constant_pressure, rel=1.5e-3)


@pytest.mark.parametrize("model", [1, 2])
def test_plastic_heating_at_zero_stress_needs_the_heat_capacity_at_constant_pressure(model: int) -> None:
    """Loaded and unloaded (errata 6): rise = dissipation / (c0 + 9 K alpha^2 theta), 3.5 % less than dissipation / c0. What remains
    (0.2 %) is work of the thermoelastic cycle; the entropy balance c0 ln(theta / theta_0) + 3 alpha K ln J / J = int D / theta is exact.
    """
    body, history = adiabatic_run([0.0, 200.0, 0.0], model=model)
    p = NOMINAL
    bulk = p["E"] / (3.0 * (1.0 - 2.0 * p["nu"]))
    rise = history.theta[-1, 0] - 296.7
    constant_pressure = p["c0"] + 9.0 * bulk * p["alpha_exp"] ** 2 * (296.7 + 0.5 * rise)
    density = history.total("dissipated") / body.data.volume.sum()
    assert rise > 2.0
    assert rise == pytest.approx(density / constant_pressure, rel=2.5e-3)
    middle = 0.5 * (history.theta[1:, 0] + history.theta[:-1, 0])
    produced = sum(step.dissipated / at for step, at in zip(history.balance, middle, strict=True)) / body.data.volume.sum()
    stretch = 1.0 + (history.u[-1][body.mesh.nearest_node((A, LENGTH, B))]) / np.array([A, LENGTH, B])
    j = float(np.prod(stretch))
    entropy = p["c0"] * np.log(history.theta[-1, 0] / 296.7) + 3.0 * p["alpha_exp"] * bulk * np.log(j) / j
    assert entropy == pytest.approx(produced, rel=1e-6)
    accumulated = history.largest_multiplier[-1]
    law = law_of(NOMINAL, model)
    alpha = accumulated if model == 1 else (1.0 - np.exp(-p["H_exp"] * accumulated)) / p["H_exp"]
    assert density == pytest.approx(dissipated_energy(0.0, alpha, accumulated, law), rel=1e-9)


def test_nothing_heats_without_expansion_in_the_elastic_range() -> None:
    _, history = adiabatic_run([0.0, 100.0], ADIABATIC.replace(alpha_exp=0.0))
    assert np.all(np.abs(history.theta - 296.7) < 1e-10)
