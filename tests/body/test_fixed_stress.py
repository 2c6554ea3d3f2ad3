"""What is left of a change of temperature where the body swells with it, and coupled runs in which swelling takes nearly all heat."""

from __future__ import annotations

import numpy as np
import pytest
from reference import reference_table
from small_bodies import ADIABATIC, NOMINAL, SPECIMEN, bar_mesh

from thermofit.body.body import Body, tension_body, thermal_geometry
from thermofit.body.heat.conduction import HeatStep, expansion_capacity, heat_conditions, heat_step, same_step
from thermofit.body.heat.fixed_stress import left_of
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.sensitivity.conduction_rates import heat_answer
from thermofit.body.solve.linear import multiply_symmetric
from thermofit.body.solve.march import Loading, MarchSettings, march
from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.law.page import law_of

DT = 3.0
MORE = 20.0
"""mJ/(mm^3 K), nine times the heat capacity."""


def solved(parameters: Parameters, scheme: str) -> tuple[Body, HeatStep]:
    body = tension_body(bar_mesh((2, 8, 2), (2.0, 60.0, 1.0), air=("x1", "z1"), clamp=("y0", "y1"), distortion=0.2))
    geometry = thermal_geometry(body, np.zeros((body.mesh.n_nodes, 3)))
    rest = np.full(body.mesh.n_nodes, 297.0)
    return body, heat_step(body, geometry, heat_conditions(parameters), rest, np.zeros(body.mesh.n_nodes), (DT, scheme))


@pytest.mark.parametrize("scheme", ["sdirk2", "backward-euler"])
def test_answer_to_heat_is_the_difference_of_two_steps(scheme: str) -> None:
    body, step = solved(NOMINAL, scheme)
    heat = np.random.default_rng(0).uniform(0.0, 3.0, body.mesh.n_nodes)
    np.testing.assert_allclose(heat_answer(body, step, heat), same_step(body, step, heat).theta - step.theta, atol=1e-10)


@pytest.mark.parametrize("scheme", ["sdirk2", "backward-euler"])
def test_without_conduction_the_capacities_share_the_heat(scheme: str) -> None:
    body, step = solved(ADIABATIC.replace(kappa=0.0), scheme)
    change = np.ones((body.mesh.n_nodes, 1)) * np.array([0.3, 0.0, -2.0])
    left = left_of(body, step, MORE, change)
    np.testing.assert_allclose(left, NOMINAL["c0"] / (NOMINAL["c0"] + MORE) * change, atol=1e-4)
    assert not left[:, 1].any()


@pytest.mark.parametrize("scheme", ["sdirk2", "backward-euler"])
def test_with_conduction_swelling_takes_its_heat(scheme: str) -> None:
    """x + R (9 K alpha^2 theta_0 S x) = dtheta; conduction leaves more of it than the capacities alone."""
    body, step = solved(NOMINAL, scheme)
    p, change = body.thermal, np.random.default_rng(2).normal(size=body.mesh.n_nodes)
    x = left_of(body, step, MORE, change)
    back = x + heat_answer(body, step, MORE * multiply_symmetric(p.row, p.column, body.swelling, x))
    assert np.linalg.norm(back - change) < 2e-3 * np.linalg.norm(change)
    assert np.linalg.norm(x) > 2.0 * NOMINAL["c0"] / (NOMINAL["c0"] + MORE) * np.linalg.norm(change)


def test_what_is_not_solved_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    body, step = solved(NOMINAL, "sdirk2")
    monkeypatch.setattr("thermofit.body.heat.fixed_stress.RESTART", 1)
    monkeypatch.setattr("thermofit.body.heat.fixed_stress.CYCLES", 1)
    with pytest.raises(NumericsError, match="check alpha_exp and c0"):
        left_of(body, step, MORE, np.random.default_rng(3).normal(size=body.mesh.n_nodes))


def law_values(ratio: float) -> Parameters:
    """A material whose expansion takes `ratio` times the heat that warms it at constant strain."""
    alpha = 4.2e-4
    law = law_of(ADIABATIC.replace(alpha_exp=alpha))
    return ADIABATIC.replace(alpha_exp=alpha, c0=expansion_capacity(law) / ratio)


@pytest.mark.parametrize("ratio", [0.5, 5.0, 500.0])
def test_elastic_tension_cools_by_the_heat_capacity_of_constant_stress(ratio: float) -> None:
    """Kelvin: dtheta = -alpha theta_0 sigma / (c0 + 9 K alpha^2 theta_0) of an adiabatic bar, to first order in sigma."""
    parameters, stress = law_values(ratio), 20.0
    body = tension_body(bar_mesh((1, 6, 1), (2.0, 30.0, 1.0)))
    times = np.linspace(0.0, 5.0, 6)
    history = march(body, parameters, Loading(times, stress * 8.0 * times / 5.0), times, MarchSettings())
    theta_0 = float(history.theta[0].mean())
    both = parameters["c0"] * (1.0 + ratio)
    expected = -parameters["alpha_exp"] * theta_0 * stress / both
    assert history.theta[-1] - theta_0 == pytest.approx(np.full(body.mesh.n_nodes, expected), rel=0.02)


@pytest.mark.parametrize("ratio", [5.0, 500.0])
def test_first_law_where_swelling_takes_nearly_all_heat(ratio: float) -> None:
    """Over the measured force history, flow, unloading and cooling included."""
    table = reference_table("force_history.csv")
    body = tension_body(dogbone_mesh(SPECIMEN, 2, 12, 1))
    parameters = law_values(ratio).replace(kappa=2650.0, beta=18.9, alpha_clamp=1e8)
    history = march(body, parameters, Loading(table["time_s"], table["force_N"]), table["time_s"], MarchSettings(model=1, keep_energy=True))
    assert history.total("work") > 1e4
    assert sum(abs(step.first_law_defect) for step in history.balance) < 1e-3 * history.total("work")
