"""Moduli that fall with temperature in a hot body: forces of a change of temperature, energy, and derivatives of march and heat run."""

from __future__ import annotations

import numpy as np
import pytest
from small_bodies import NOMINAL, SPECIMEN, bar_mesh

from thermofit.body.body import Body, tension_body
from thermofit.body.element.hex8 import element_pass
from thermofit.body.element.thermal_load import thermal_forces
from thermofit.body.heat.one_way import heat_problem, heat_run, heat_run_rates
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.sensitivity.march import Sensitivities, StepRates
from thermofit.body.solve.march import History, Loading, MarchSettings, Watch, march
from thermofit.body.solve.newton import NewtonSettings, virgin_state
from thermofit.law.composition import STRUCTURAL
from thermofit.law.page import law_of
from thermofit.point.state import LAMBDA, TRACE

SLOPE = "modulus_by_temperature.slope"
HOT = NOMINAL.replace(theta_ref=560.0, theta_air=570.0, theta_clamp=575.0, H_lin=20.0, **{SLOPE: 1.2e-3})
"""m = 0.67, and theta dm/dtheta = -1.03 of that."""
SETTINGS = MarchSettings(newton=NewtonSettings(tolerance=2e-9, max_iterations=80), coupling_tolerance=1e-8, keep_energy=True)
PULLED = Loading(np.array([0.0, 20.0, 30.0, 50.0]), np.array([0.0, 1.6, 0.6, 2.4]), "displacement", from_rest=True)
LOADED = Loading(np.array([0.0, 25.0, 50.0, 75.0]), np.array([0.0, 5200.0, -4900.0, 5600.0]))
NAMES = (SLOPE, "E", "nu", "alpha_exp", "M_y0", "beta", "c0", "kappa", "theta_clamp", "theta_ref")


def run(loading: Loading, times: np.ndarray, names: tuple[str, ...] = (), **changes: float) -> tuple[History, dict[str, np.ndarray]]:
    """A run of a hot dogbone and the derivatives of its fields (n_t, ..., n_p)."""
    kept: dict[str, list[np.ndarray]] = {"u": [], "theta": [], "force": []}

    def collect(n: int, at: StepRates) -> None:
        for field, values in kept.items():
            values.append(np.array(getattr(at, field)))

    body = tension_body(dogbone_mesh(SPECIMEN, 1, 8, 1), control=loading.control)
    watch = Watch(sensitivities=Sensitivities(names, collect, tolerance=1e-9)) if names else Watch()
    history = march(body, HOT.replace(**changes), loading, times, SETTINGS, watch)
    return history, {field: np.stack(values) for field, values in kept.items() if values}


@pytest.mark.parametrize("loading", [PULLED, LOADED], ids=["displacement", "force"])
def test_remainders_are_of_second_order(loading: Loading) -> None:
    """|f(p + h d) - f(p) - h f'(p) d|, relative to the linear part, is halved with h, of displacements, temperatures and force, through
    load, unloading and reversed flow, along random directions of all parameters at once."""
    random, times = np.random.default_rng(5), np.linspace(0.0, loading.time[-1], 21)
    start, rates = run(loading, times, NAMES)
    if loading.control == "force":
        assert not np.any(rates.pop("force")), "it is given"
    for _ in range(2):
        along = {name: random.choice([-1.0, 1.0]) * HOT[name] * (0.01 if name.startswith("theta") else 1.0) for name in NAMES}
        direction, left = np.array([along[name] for name in NAMES]), {field: [] for field in rates}
        for h in (8e-3, 4e-3, 2e-3):
            there, _ = run(loading, times, (), **{name: HOT[name] + h * along[name] for name in NAMES})
            for field, values in left.items():
                linear = h * (rates[field] @ direction)
                values.append(float(np.abs(getattr(there, field) - getattr(start, field) - linear).max() / np.abs(linear).max()))
        for field, values in left.items():
            assert values[1] < 0.62 * values[0] and values[2] < 0.62 * values[1] and values[2] < 0.02, (field, values)


def test_energy_is_balanced_with_order_2() -> None:
    """The first law of the whole specimen; half the steps leave less than a third, and no point takes heat to flow."""
    defects = []
    for n in (41, 81, 161):
        history, _ = run(PULLED, np.linspace(0.0, 50.0, n))
        assert min(step.smallest_dissipation for step in history.balance) >= 0.0
        work = max(abs(w) for w in np.cumsum([step.work for step in history.balance]))
        defects.append(max(abs(d) for d in np.cumsum([step.first_law_defect for step in history.balance])) / work)
    assert defects[2] < 0.6 * defects[1] and defects[2] < 1e-3, defects


def test_elastic_cycle_of_a_hot_body_keeps_its_energy() -> None:
    """Without flow nothing is dissipated, and the first law holds to order two: what m_theta takes up on loading comes back."""
    defects = []
    for n in (9, 17):
        loading = Loading(np.array([0.0, 20.0, 40.0]), np.array([0.0, 2000.0, 0.0]))
        history, _ = run(loading, np.linspace(0.0, 40.0, n))
        assert history.largest_multiplier[-1] == 0.0
        work = np.cumsum([step.work for step in history.balance])
        defects.append(float(np.abs(np.cumsum([step.first_law_defect for step in history.balance])).max() / np.abs(work).max()))
    assert defects[1] < 0.3 * defects[0] and defects[1] < 1e-4, defects


@pytest.mark.parametrize("f_bar", [True, False])
def test_forces_of_a_change_of_temperature_are_those_of_the_elements(f_bar: bool) -> None:
    """At a fixed deformation and state of points that do not flow, to round-off."""
    random = np.random.default_rng(2)
    body = tension_body(bar_mesh((1, 2, 1), (4.0, 10.0, 1.5), air=("x1",)), f_bar=f_bar)
    law, n_el = law_of(HOT, plastic=False), body.mesh.n_elements
    u = 1e-3 * random.normal(size=(body.mesh.n_nodes, 3))
    states, forces, other = [], [], np.empty((n_el, 24))
    theta, warmer = (570.0 + random.uniform(0.0, size, body.mesh.n_nodes) for size in (5.0, 30.0))
    for at in (theta, warmer):
        state, force = np.empty((n_el, 8, virgin_state(1, structure=True).shape[2])), np.empty((n_el, 24))
        assert not element_pass(
            body.data, u, at, virgin_state(n_el, structure=True), law, False, force, np.empty((n_el, 24, 24)), state, np.empty((n_el, 8))
        )
        states.append(state)
        forces.append(force)
    thermal_forces(body.data, u, states[0], theta, warmer, law, other)
    assert np.abs(forces[1] - forces[0] - other).max() < 1e-11 * np.abs(forces[0]).max()
    assert np.all(states[0][:, :, TRACE] > 0.0) and not np.any(states[0][:, :, LAMBDA])


def test_one_way_heat_run_and_its_derivatives() -> None:
    settings = MarchSettings(newton=SETTINGS.newton, coupling_tolerance=1e-8, keep_points=True)
    body: Body = tension_body(dogbone_mesh(SPECIMEN, 1, 8, 1))
    history = march(body, HOT, LOADED, np.linspace(0.0, 75.0, 26), settings)
    problem, names, collected = heat_problem(body, history, settings), (SLOPE, "E", "c0", "theta_clamp"), []
    assert set(names) & set(STRUCTURAL)
    assert np.abs(heat_run(problem, HOT) - history.theta).max() < 0.05
    heat_run_rates(problem, HOT, names, lambda n, theta, rates: collected.append(np.array(rates[:, : len(names)])))
    for k, name in enumerate(names):
        h = 1e-3 * HOT[name]
        there, back = (heat_run(problem, HOT.replace(**{name: HOT[name] + x})) for x in (h, -h))
        expected = (there - back) / (2.0 * h)
        assert np.abs(np.stack(collected)[..., k] - expected).max() < 1e-5 * np.abs(expected).max() + 1e-9 / h, name
