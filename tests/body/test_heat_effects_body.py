"""Effects of the heat problem in a body: closed forms, order in time, balance of heat, and their rates in the march and the heat run."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp, trapezoid
from small_bodies import ADIABATIC, NOMINAL, SPECIMEN, bar_mesh

from thermofit.body.body import Body, tension_body, thermal_geometry
from thermofit.body.heat import sources
from thermofit.body.heat.conduction import heat_conditions, heat_step, steady_temperature
from thermofit.body.heat.effects import HeatEffects, heat_effects
from thermofit.body.heat.one_way import heat_problem, heat_run, heat_run_rates
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.sensitivity import heat_effect_rates
from thermofit.body.sensitivity.march import Sensitivities
from thermofit.body.solve.march import History, Loading, MarchSettings, Watch, march
from thermofit.body.solve.newton import NewtonSettings
from thermofit.core import parameters as declared
from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.effects import catalogue
from thermofit.effects.catalogue import HEAT, effect, effects, load_effect
from thermofit.effects.radiation import SIGMA

SIDES = ("x0", "x1", "z0", "z1")
A, LENGTH, B = 2.0, 60.0, 1.0
VOLUME, SKIN = A * LENGTH * B, 2.0 * (A + B) * LENGTH
STIFF = ADIABATIC.replace(alpha_exp=0.0, theta_clamp=400.0, theta_air=290.0)
"""No films and no expansion: a body at 400 K that only effects cool or heat."""


def bar(clamp: tuple[str, ...] = ("y0", "y1"), n_y: int = 6) -> Body:
    return tension_body(bar_mesh((1, n_y, 1), (A, LENGTH, B), air=SIDES, clamp=clamp), symmetry=1.0)


def resting(parameters: Parameters, times: np.ndarray, clamp: tuple[str, ...] = ("y0", "y1")) -> tuple[History, np.ndarray]:
    """A body without load: the march, and the temperatures (n_t, n_np) of the heat run on it."""
    settings = MarchSettings(coupling_tolerance=1e-10, keep_points=True)
    idle = Loading(np.array([times[0], times[-1]]), np.zeros(2))
    history = march(bar(clamp), parameters, idle, times, settings)
    return history, heat_run(heat_problem(bar(clamp), history, settings), parameters)


def exact(rate: Callable[[float, float], float], start: float, times: np.ndarray) -> np.ndarray:
    """Temperature (n_t,) of a lumped body with the given rate(t, theta) in K/s."""
    found = solve_ivp(lambda t, y: [rate(t, y[0])], (times[0], times[-1]), [start], t_eval=times, rtol=1e-11, atol=1e-11, max_step=1.0)
    return np.asarray(found.y[0])


def check_order_2(parameters: Parameters, rate: Callable[[float, float], float], end: float, tolerance: float) -> None:
    """March and heat run against the lumped body, and their order in the step."""
    errors = []
    for steps in (10, 20, 40):
        times = np.linspace(0.0, end, steps + 1)
        history, one_way = resting(parameters, times)
        assert np.ptp(history.theta, axis=1).max() < 1e-8
        expected = exact(rate, history.theta[0, 0], times)[:, None]
        errors.append((np.abs(history.theta - expected).max(), np.abs(one_way - expected).max()))
    assert max(errors[-1]) < tolerance
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(orders > 1.7), (errors, orders)


def test_radiating_body_with_order_2() -> None:
    """c0 V dtheta/dt = -sigma emissivity A (theta^4 - theta_air^4)."""
    p = STIFF.replace(**{"radiation.emissivity": 0.8})
    check_order_2(p, lambda t, x: -0.8 * SIGMA * SKIN / (p["c0"] * VOLUME) * (x**4 - 290.0**4), 600.0, 0.04)


def test_body_in_still_air_with_order_2() -> None:
    """c0 V dtheta/dt = -film |theta - theta_air|^n (theta - theta_air) A, far from the temperature of the air."""
    p = STIFF.replace(**{"free_convection.film": 3.0, "free_convection.exponent": 0.25})
    check_order_2(p, lambda t, x: -3e-3 * SKIN / (p["c0"] * VOLUME) * (x - 290.0) ** 1.25, 120.0, 0.02)


def test_a_film_that_grows_along_the_load_cools_the_upper_half_and_warms_the_lower_one() -> None:
    """Without conduction c0 V dtheta/dt = -slope y (theta - theta_air) A: no heat is lost in all, and for a short time

    d/dt int y theta dy = -slope A / (c0 V) (theta_0 - theta_air) int y^2 dy, with an error of order 2 in the mesh."""
    p, end, off = STIFF.replace(**{"kappa": 1e-9, "film_by_height.slope": 0.5}), 0.001, []
    wanted = -0.5e-3 * SKIN / (p["c0"] * VOLUME) * 110.0 * LENGTH**3 / 12.0 * end
    for n_y in (6, 12, 24):
        body = bar(n_y=n_y)
        history = march(body, p, Loading(np.array([0.0, end]), np.zeros(2)), np.array([0.0, end]), MarchSettings(coupling_tolerance=1e-10))
        knots = np.linspace(0.0, LENGTH, n_y + 1)
        theta = np.array([history.theta[-1][np.isclose(body.mesh.nodes[:, 1], y)].mean() - 400.0 for y in knots])
        fine = np.linspace(0.0, LENGTH, 50 * n_y + 1)
        assert theta[-1] < -1e-4 < 1e-4 < theta[0]
        assert abs(trapezoid(np.interp(fine, knots, theta), fine)) < 1e-6, "of second order in time"
        moment = trapezoid(np.interp(fine, knots, theta) * (fine - 0.5 * LENGTH), fine)
        off.append(moment / wanted - 1.0)
    assert abs(off[-1]) < 5e-3 and np.log2(np.array(off[:-1]) / off[1:]) == pytest.approx(2.0, abs=0.1)


def test_radiating_body_whose_heat_capacity_changes_with_order_2() -> None:
    """c0 (1 + slope (theta - theta_0)) V dtheta/dt = -sigma emissivity A (theta^4 - theta_air^4)."""
    p, slope = STIFF.replace(**{"radiation.emissivity": 0.8, "capacity_by_temperature.slope": 5e-3}), 5e-3

    def rate(t: float, x: float) -> float:
        return -0.8 * SIGMA * SKIN / (p["c0"] * (1.0 + slope * (x - p["theta_ref"])) * VOLUME) * (x**4 - 290.0**4)

    check_order_2(p, rate, 600.0, 0.2)


def test_drift_of_the_air_with_order_2() -> None:
    """c0 V dtheta/dt = -alpha A (theta - theta_air - rate time (1 - exp(-t / time)))."""
    p = STIFF.replace(**{"alpha_air": 40.0, "air_drift.rate": 0.05, "air_drift.time": 80.0})

    def rate(t: float, x: float) -> float:
        return -1e-3 * 40.0 * SKIN / (p["c0"] * VOLUME) * (x - 290.0 - 0.05 * 80.0 * (1.0 - np.exp(-t / 80.0)))

    check_order_2(p, rate, 300.0, 3e-3)


def test_ends_follow_jaws_that_drift_without_delay() -> None:
    """Ideal contact: the ends have the temperature of the jaws at that very time; below the upper half, the difference apart."""
    p = STIFF.replace(**{"alpha_clamp": 1e8, "clamp_drift.rate": 0.02, "clamp_drift.time": 1e7, "clamp_difference.difference": 3.0})
    mesh = bar().mesh
    for coupling in (0, 1):
        theta = (lambda r: (r[0].theta, r[1]))(resting(p, np.linspace(10.0, 110.0, 11)))[coupling]
        for name, half in (("bottom", -1.5), ("top", 1.5)):
            wanted = 400.0 + half + 0.02 * np.linspace(0.0, 100.0, 11)
            assert theta[:, mesh.node_sets[name]] == pytest.approx(np.tile(wanted, (len(mesh.node_sets[name]), 1)).T, abs=2e-3)


@pytest.mark.parametrize("rate", [0.0, 0.02])
def test_jaws_that_drift_apart_need_no_drift_of_both(rate: float) -> None:
    """The upper jaw warms by rate + apart / 2, the lower one by rate - apart / 2."""
    p = STIFF.replace(**{"alpha_clamp": 1e8, "clamp_drift.rate": rate, "clamp_drift.apart": 0.03, "clamp_drift.time": 1e7})
    mesh = bar().mesh
    history, one_way = resting(p, np.linspace(10.0, 110.0, 11))
    for theta in (history.theta, one_way):
        for name, own in (("bottom", rate - 0.015), ("top", rate + 0.015)):
            wanted = 400.0 + own * np.linspace(0.0, 100.0, 11)
            assert theta[:, mesh.node_sets[name]] == pytest.approx(np.tile(wanted, (len(mesh.node_sets[name]), 1)).T, abs=2e-3)


def test_every_amplitude_of_an_effect_acts_alone() -> None:
    """An effect is off where all of its amplitudes are neutral, not where the first one is."""
    for e in effects(HEAT):
        assert heat_effects(BASE) is None
        for p in e.amplitudes:
            assert heat_effects(BASE.replace(**{p.name: p.neutral + 0.1 * e.amplitude.probe})) is not None, p.name


def test_lamp_heats_at_its_rate_from_its_start_on() -> None:
    """theta = theta_0 + absorbed A / (c0 V) (t - start), however long the steps are in which it starts."""
    p = STIFF.replace(**{"lamp.absorbed": 0.1, "lamp.start": 40.0})
    history, one_way = resting(p, np.array([0.0, 30.0, 37.0, 45.0, 60.0, 100.0]))
    for theta in (history.theta, one_way):
        rise = theta[-1] - 400.0
        assert rise == pytest.approx(np.full(len(rise), 0.1 * SKIN / (p["c0"] * VOLUME) * 60.0), rel=1e-2)
        assert np.abs(theta[1] - 400.0).max() < 1e-6
    assert sum(b.outflow["air"] for b in history.balance) == pytest.approx(-0.1 * SKIN * 60.0, rel=1e-2)


def test_heat_capacity_that_rises_takes_the_heat_of_the_lamp() -> None:
    """c0 (theta - theta_1) (1 + slope ((theta + theta_1)/2 - theta_0)) V = Q, exactly, with the balance."""
    p = STIFF.replace(**{"lamp.absorbed": 0.5, "lamp.start": 10.0, "capacity_by_temperature.slope": 5e-3})
    history, _ = resting(p, np.linspace(0.0, 60.0, 13))
    heat, x = -sum(b.outflow["air"] for b in history.balance), history.theta[-1, 0]
    enthalpy = p["c0"] * VOLUME * (x - 400.0) * (1.0 + 5e-3 * (0.5 * (x + 400.0) - p["theta_ref"]))
    assert x > 410.0 and enthalpy == pytest.approx(heat, rel=1e-7)
    assert sum(b.stored for b in history.balance) == pytest.approx(heat, rel=1e-9)
    assert sum(b.stored_by_effects for b in history.balance) == pytest.approx(enthalpy - p["c0"] * VOLUME * (x - 400.0), rel=1e-7)


def test_latent_heat_of_a_bar_that_passes_its_window() -> None:
    """Homogeneous flow to Lambda beyond the window: heat x width x V in total, and the rise that belongs to it."""
    p = STIFF.replace(**{"latent_heat.heat": 50.0, "latent_heat.centre": 0.01, "latent_heat.width": 0.01, "theta_clamp": 296.7})
    loading = Loading(np.array([0.0, 20.0]), np.array([0.0, 180.0 * A * B]))
    times = np.linspace(0.0, 20.0, 81)
    settings = MarchSettings(keep_points=True)
    history = march(bar(), p, loading, times, settings)
    assert history.largest_multiplier[-1] > 0.02
    assert history.total("source") == pytest.approx(50.0 * 0.01 * VOLUME, rel=2e-3)
    plain = march(bar(), p.replace(**{"latent_heat.heat": 0.0}), loading, times, settings)
    rise = history.theta[-1] - plain.theta[-1]
    assert rise == pytest.approx(np.full(len(rise), 0.5 / p["c0"]), rel=2e-3)
    assert heat_run(heat_problem(bar(), history, settings), p)[-1] == pytest.approx(history.theta[-1], abs=1e-6)


def test_conductivity_that_changes_bends_the_profile_between_two_jaws() -> None:
    """Kirchhoff: theta + slope/2 (theta - theta_0)^2 is linear between the ends; exact at the nodes, in steady state and after long."""
    p = STIFF.replace(alpha_clamp=1e8, theta_clamp=300.0, theta_ref=296.0)
    p = p.replace(**{"conductivity_by_temperature.slope": 8e-3, "clamp_difference.difference": 60.0})
    history, one_way = resting(p, np.linspace(0.0, 100.0, 6))
    y = bar().mesh.nodes[:, 1] / LENGTH
    for theta in (history.theta[0], history.theta[-1], one_way[-1]):
        potential = theta + 4e-3 * (theta - 296.0) ** 2
        low, high = (x + 4e-3 * (x - 296.0) ** 2 for x in (270.0, 330.0))
        assert potential == pytest.approx(low + (high - low) * y, abs=5e-3)
    assert np.abs(history.theta[0] - (270.0 + 60.0 * y)).max() > 2.0


def test_steady_state_with_radiation_is_in_balance() -> None:
    """Film and radiation against each other: alpha (theta_air - theta) = sigma emissivity (theta^4 - theta_air^4) needs theta_air."""
    p = STIFF.replace(**{"alpha_clamp": 200.0, "radiation.emissivity": 0.9})
    body = bar()
    rest = thermal_geometry(body, np.zeros((body.mesh.n_nodes, 3)))
    theta = steady_temperature(body, rest, heat_conditions(p))
    in_at_jaws = 1e-3 * 200.0 * float(rest.film_area["clamp"] @ (400.0 - theta))
    out = 0.9 * SIGMA * float(rest.film_area["air"] @ (theta**4 - 290.0**4))
    assert in_at_jaws == pytest.approx(out, rel=1e-10) and out > 50.0


def test_initial_excess_is_that_of_the_file() -> None:
    p = STIFF.replace(**{"initial_gradient.amplitude": 2.0, "initial_gradient.tilt": 0.5})
    history, one_way = resting(p, np.array([0.0, 1.0]))
    y = bar().mesh.nodes[:, 1] - 0.5 * LENGTH
    for theta in (history.theta, one_way):
        assert theta[0] == pytest.approx(400.0 + 2.0 * (np.cos(np.pi * y / LENGTH) + y / LENGTH), abs=1e-9)


def test_a_factor_that_is_not_positive_is_told() -> None:
    with pytest.raises(NumericsError, match="capacity_by_temperature"):
        resting(STIFF.replace(**{"capacity_by_temperature.slope": -0.02}), np.array([0.0, 1.0]))


def test_effects_without_a_time_are_told() -> None:
    body = bar()
    rest = thermal_geometry(body, np.zeros((body.mesh.n_nodes, 3)))
    conditions = heat_conditions(STIFF.replace(**{"radiation.emissivity": 0.5}))
    theta = np.full(body.mesh.n_nodes, 300.0)
    with pytest.raises(NumericsError, match="time"):
        heat_step(body, rest, conditions, theta, 0.0 * theta, (1.0, "sdirk2"))


# Whole runs of a dogbone: loading into plastic flow, hold, unloading, cooling.

BASE = NOMINAL.replace(H_lin=20.0, theta_ref=295.2)
ON = {
    **{"radiation.emissivity": 0.8, "lamp.absorbed": 0.3, "lamp.start": 20.0, "clamp_difference.difference": 1.5},
    **{"clamp_drift.rate": 0.02, "clamp_drift.apart": -0.03, "clamp_drift.time": 40.0, "air_drift.rate": -0.03, "air_drift.time": 100.0},
    **{"clamp_step.step": 1.2, "clamp_step.apart": -0.9, "clamp_step.start": 18.0, "clamp_step.onset": 6.0},
    **{"latent_heat.heat": 40.0, "latent_heat.centre": 0.01, "latent_heat.width": 0.008},
    **{"local_source.power": 3.0, "local_source.place": 4.0, "local_source.width": 6.0, "local_source.start": 20.0},
    **{"local_source.concentration": 4.0},
    **{"capacity_by_temperature.slope": 4e-3, "conductivity_by_temperature.slope": -6e-3},
    **{"initial_gradient.amplitude": 1.3, "initial_gradient.tilt": 0.6},
    **{"free_convection.film": 6.0, "free_convection.exponent": 0.3},
    **{"film_by_height.slope": 0.2},
}
NAMES = tuple(name for name in ON)
AMPLITUDES = tuple(p.name for e in effects(HEAT) for p in e.amplitudes)
BESIDES = ("theta_air", "theta_clamp", "theta_ref", "kappa", "c0", "alpha_air", "alpha_clamp")
FORCE = Loading(np.array([0.0, 1.0, 25.0, 35.0, 37.0, 60.0]), np.array([0.0, 0.0, 5200.0, 5200.0, 0.0, 0.0]))
TIMES = np.array([0.0, 1.0, 5.0, 9.0, 13.0, 17.0, 21.0, 25.0, 30.0, 35.0, 36.0, 37.0, 45.0, 60.0])
SETTINGS = MarchSettings(newton=NewtonSettings(tolerance=2e-9, max_iterations=80), coupling_tolerance=1e-8, keep_points=True)


@lru_cache(maxsize=1)
def dogbone() -> Body:
    return tension_body(dogbone_mesh(SPECIMEN, 1, 8, 1))


def run(
    names: tuple[str, ...] = (), settings: MarchSettings = SETTINGS, tolerance: float = 1e-9, **values: float
) -> tuple[History, np.ndarray]:
    """A run, and the derivatives (n_t, n_np, n_p) of its temperatures."""
    kept: list[np.ndarray] = []
    asked = Sensitivities(names, lambda n, at: kept.append(np.array(at.theta)), tolerance)
    history = march(dogbone(), BASE.replace(**values), FORCE, TIMES, settings, Watch(sensitivities=asked) if names else Watch())
    return history, np.array(kept)


def step_of(name: str) -> float:
    return 0.02 if name.startswith("theta") else 2e-3 * {**BASE.values, **ON}[name]


def check_rates(theta: Callable[..., np.ndarray], rates: np.ndarray, names: tuple[str, ...], tolerance: float) -> None:
    """Central differences for every Param, and the Taylor remainder of order 2 for those that do not act linearly."""
    here = theta()
    for k, name in enumerate(names):
        h, value = abs(step_of(name)), {**BASE.values, **ON}[name]
        ahead, back = (theta(**{name: value + s * h}) for s in (1.0, -1.0))
        slope = (ahead - back) / (2.0 * h)
        size, curvature = np.abs(slope).max(), np.abs(ahead + back - 2.0 * here).max()
        noise = 1e-8 / (h * size) if size > 0.0 else 0.0
        assert size > 0.0, name
        assert np.abs(rates[..., k] - slope).max() < (tolerance + noise) * size + 0.05 * curvature / h, name
        far, near = (np.abs(theta(**{name: value + s * h}) - here - s * h * rates[..., k]).max() for s in (20.0, 10.0))
        assert far < 4.6 * near + 2e-6, (name, far, near)


def test_rates_in_the_coupled_march_are_those_of_differences() -> None:
    """All effects on at once, by all their Params and by those of the base that meet them; heat in balance to 1e-8."""
    names = NAMES + BESIDES
    history, rates = run(names, **ON)
    involved = sum(abs(b.stored) + abs(b.source) + b.dissipated for b in history.balance)
    assert max(abs(b.heat_defect) for b in history.balance) < 1e-8 * involved
    assert history.total("source") > 100.0 and history.total("stored_by_effects") > 100.0
    check_rates(lambda **moved: run(**{**ON, **moved})[0].theta, rates, names, 1e-3)


def test_rates_of_the_one_way_march_are_those_of_differences() -> None:
    settings = replace(SETTINGS, coupling="one-way")
    names = NAMES + BESIDES
    _, rates = run(names, settings, **ON)
    check_rates(lambda **moved: run((), settings, **{**ON, **moved})[0].theta, rates, names, 1e-4)


@pytest.mark.parametrize("scheme", ["sdirk2", "backward-euler"])
def test_rates_of_the_heat_run_are_those_of_differences(scheme: str) -> None:
    settings = replace(SETTINGS, heat_scheme=scheme)
    history, _ = run((), settings, **ON)
    problem, names, rates = heat_problem(dogbone(), history, settings), NAMES + BESIDES, []
    heat_run_rates(problem, BASE.replace(**ON), names, lambda n, theta, at: rates.append(np.array(at[:, : len(names)])))
    check_rates(lambda **moved: heat_run(problem, BASE.replace(**{**ON, **moved})), np.array(rates), names, 1e-5)


def test_heat_run_follows_the_coupled_march() -> None:
    history, _ = run(**ON)
    plain, _ = run()
    there = heat_run(heat_problem(dogbone(), history, SETTINGS), BASE.replace(**ON))
    assert np.abs(there - history.theta).max() < 0.02 * np.abs(history.theta - plain.theta).max()


@pytest.mark.parametrize("name", AMPLITUDES)
def test_dormant_is_exactly_off_and_its_influence_is_known(name: str) -> None:
    """At neutral itself: the derivative by the amplitude against differences from one side, coupled and in the heat run."""
    others = {p: value for p, value in ON.items() if p not in AMPLITUDES}
    (off, rates), (plain, _) = run((name,), **others), run()
    assert np.array_equal(run(**others)[0].theta, plain.theta) and np.array_equal(run(**others)[0].u, plain.u)
    problem, kept = heat_problem(dogbone(), plain, SETTINGS), []
    heat_run_rates(problem, BASE.replace(**others), (name,), lambda n, theta, at: kept.append(np.array(at[:, 0])))
    h = 0.05 * ON[name]
    for which, theta in ((rates[..., 0], lambda x: run(**others, **{name: x})[0].theta), (np.array(kept), None)):
        at = theta or (lambda x: heat_run(problem, BASE.replace(**others, **{name: x})))
        expected = (4.0 * at(h) - 3.0 * at(0.0) - at(2.0 * h)) / (2.0 * h)
        assert np.abs(expected).max() > 0.0
        assert np.abs(which - expected).max() < 2e-4 * np.abs(expected).max() + 4e-8 / abs(h)
    assert np.abs(off.theta - plain.theta).max() < 1e-6


def test_influence_of_what_is_off_stands_in_its_own_direction() -> None:
    """All at once and among others each is what it is alone, where the jaws' temperature moves too."""
    names = ("kappa", *AMPLITUDES, "theta_clamp", "c0")
    _, together = run(names)
    for k in (0, 1, len(AMPLITUDES) // 2, len(AMPLITUDES), len(names) - 2):
        _, alone = run((names[k],))
        assert np.abs(alone).max() > 0.0 and np.abs(together[..., k] - alone[..., 0]).max() < 1e-6 * np.abs(alone).max(), names[k]
    for name in ("radiation.emissivity", "clamp_step.step", "capacity_by_temperature.slope", "conductivity_by_temperature.slope"):
        _, alone = run((name,))
        assert np.abs(together[..., names.index(name)] - alone[..., 0]).max() < 1e-6 * np.abs(alone).max() > 0.0, name


def test_nothing_is_evaluated_while_all_are_off(monkeypatch: pytest.MonkeyPatch) -> None:
    def told(*_: Any) -> None:
        raise AssertionError("an effect was evaluated")

    for method in ("factor", "flux", "medium_change", "initial"):
        monkeypatch.setattr(HeatEffects, method, told)
    for power in ("power_by_state", "power_by_place"):
        for where in (sources, heat_effect_rates):
            monkeypatch.setattr(where, power, told)
    history, _ = run(("kappa", "theta_air"))
    heat_run(heat_problem(dogbone(), history, SETTINGS), BASE)


USER = {
    "surface_flux": ("time, surroundings, y, ", "theta", "a * (1.0 + 0.02 * y) * (theta - surroundings) ** 2 * 1e-4", 9.0),
    "surface_flux of no place": ("time, surroundings, ", "theta", "a * (theta - surroundings) ** 2 * 1e-4", 9.0),
    "boundary_temperature": ("time, elapsed, ", "y", "a * np.sin(0.1 * elapsed) + 0.0 * y", 1.0),
    "heat_source": ("accumulated, rate, time, x, y, ", "theta", "a * np.exp(-((y / 10.0) ** 2)) * (theta - 290.0) * time / 60.0", 0.1),
    "capacity": ("theta_ref, ", "theta", "np.exp(a * (theta - theta_ref))", 3e-3),
    "conductivity": ("theta_ref, ", "theta", "np.exp(a * (theta - theta_ref))", 3e-3),
    "initial_temperature": ("y, length, ", "x", "a * (y / length) ** 2 + 0.0 * x", 1.0),
}


def load_made_up(slot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, float]:
    """Name and value of the parameter of an effect of a user, which is loaded for one test."""
    monkeypatch.setattr(catalogue, "EFFECTS", dict(catalogue.EFFECTS))
    monkeypatch.setattr(declared, "OF_EFFECTS", dict(declared.OF_EFFECTS))
    rest, first, formula, probe = USER[slot]
    slot = slot.partition(" ")[0]
    path, name = tmp_path / f"user_{slot}.py", f"user_{slot}.a"
    path.write_text(
        "import numpy as np\nfrom thermofit.core.parameters import Param\n"
        f"SLOT, FORMULA, SOURCE, ON = '{slot}', 'made up', 'made up', ('air', 'clamp')\n"
        f"PARAMS = (Param('{name}', '1', 0.0, -10.0, 10.0, 1.0, 'made up', probe={probe}),)\n"
        f"def {slot}({first}, {rest}a):\n    return {formula}\n"
    )
    load_effect(path)
    return name, probe


@pytest.mark.parametrize("slot", USER)
def test_an_effect_of_a_user_acts_in_every_slot(slot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Off, on, and its derivative, as for those of the package."""
    name, probe = load_made_up(slot, tmp_path, monkeypatch)
    history, rates = run((name,), **{name: probe})
    ahead, back = (run(**{name: s * probe})[0].theta for s in (1.01, 0.99))
    expected = (ahead - back) / (0.02 * probe)
    assert np.abs(history.theta - run()[0].theta).max() > 1e-3
    assert np.abs(rates[..., 0] - expected).max() < 1e-3 * np.abs(expected).max()


SPOT = "np.exp(-(((y - 4.0) / 6.0) ** 2)) * np.cos(0.3 * x) * (1.0 + 0.02 * time)"


def test_a_source_of_place_and_time_is_that_of_all_arguments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Off and on, its heat and derivatives are the same; it is asked once for points above one another, alone and beside another source."""
    monkeypatch.setattr(catalogue, "EFFECTS", dict(catalogue.EFFECTS))
    monkeypatch.setattr(declared, "OF_EFFECTS", dict(declared.OF_EFFECTS))
    for name, arguments, more in (
        ("spot_short", "time, x, y", ""),
        ("spot_long", "theta, accumulated, rate, time, x, y", " + 0.0 * theta"),
    ):
        (tmp_path / f"{name}.py").write_text(
            "import numpy as np\nfrom thermofit.core.parameters import Param\nSLOT, FORMULA, SOURCE = 'heat_source', 'made up', 'made up'\n"
            f"PARAMS = (Param('{name}.power', '1', 0.0, -10.0, 10.0, 1.0, 'made up', probe=0.1),)\nASKED = set()\n"
            f"def heat_source({arguments}, power):\n    ASKED.add(x.size)\n    return power * {SPOT}{more}\n"
        )
        load_effect(tmp_path / f"{name}.py")
    (off, dormant), latent = run(("spot_short.power", "spot_long.power")), {"latent_heat.heat": 20.0, "latent_heat.centre": 0.01}
    assert np.abs(dormant[..., 0] - dormant[..., 1]).max() < 1e-12 * np.abs(dormant).max() and np.abs(dormant).max() > 0.1
    for beside in ({}, latent):
        (short, rates), (long, of_long) = (
            run((f"{n}.power", "kappa"), **{f"{n}.power": 0.1}, **beside) for n in ("spot_short", "spot_long")
        )
        assert np.abs(short.theta - long.theta).max() < 1e-10 and np.abs(short.theta - off.theta).max() > 0.01
        assert np.abs(rates - of_long).max() < 1e-9 * np.abs(rates).max()
    asked, every = (sys.modules[f"thermofit_user_effect_{n}"].ASKED for n in ("spot_short", "spot_long"))
    ((few,), (all_,)) = asked, every
    x, y = dogbone().points
    assert all_ == x.size and few == len(np.unique(np.round(np.stack([x.ravel(), y.ravel()]), 9), axis=1).T) < all_


def test_a_source_that_knows_how_far_across_it_is_is_that_over_half_the_width(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the parallel part, where the width is known without a mesh."""
    monkeypatch.setattr(catalogue, "EFFECTS", dict(catalogue.EFFECTS))
    monkeypatch.setattr(declared, "OF_EFFECTS", dict(declared.OF_EFFECTS))
    half = 0.5 * SPECIMEN.gauge_width
    for name, arguments, where in (("by_share", "time, x, y, across", "across"), ("by_place", "time, x, y", f"(x / {half})")):
        (tmp_path / f"{name}.py").write_text(
            "import numpy as np\nfrom thermofit.core.parameters import Param\nSLOT, FORMULA, SOURCE = 'heat_source', 'made up', 'made up'\n"
            f"PARAMS = (Param('{name}.power', '1', 0.0, -10.0, 10.0, 1.0, 'made up', probe=0.1),)\n"
            f"def heat_source({arguments}, power):\n    return power * {where}**2 * (np.abs(y) < {0.5 * SPECIMEN.parallel_length})\n"
        )
        load_effect(tmp_path / f"{name}.py")
    (off, rates) = run(("by_share.power", "by_place.power"))
    assert np.abs(rates[..., 0] - rates[..., 1]).max() < 1e-9 * np.abs(rates).max() and np.abs(rates).max() > 0.1
    assert off.theta.shape[0] == len(TIMES)


def test_a_source_in_the_middle_makes_the_same_heat_as_one_all_across() -> None:
    """With nothing lost the mean rises by the same; across the specimen the middle is the warmer the more it is concentrated."""
    body = tension_body(dogbone_mesh(SPECIMEN, 4, 40, 1))
    plane = body.plane
    source = effect("local_source").of_place
    assert source is not None
    whole = [plane.heat @ source(1e3, plane.x, plane.y, plane.across, 2.0, 3.0, 8.0, 0.0, 1.0, c) for c in (-3.0, 0.0, 8.0)]
    area = SPECIMEN.gauge_width * SPECIMEN.thickness
    assert [4.0 * w.sum() for w in whole] == pytest.approx([2.0 * area] * 3, rel=0.002)
    axis = body.mesh.nodes[:, 0] == 0.0
    assert whole[0][axis].sum() < whole[1][axis].sum() < whole[2][axis].sum()


@pytest.mark.parametrize("slot", USER)
def test_default_tolerance_is_enough_beside_an_effect_of_a_user(slot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A heat that feels the temperature asks for another sweep, where others leave its guess be."""
    name, probe = load_made_up(slot, tmp_path, monkeypatch)
    names = (name, "M_y0", "beta", "c0")
    (_, exact), (_, quick) = (run(names, **how, **{name: probe}) for how in ({}, {"tolerance": Sensitivities.tolerance}))
    assert np.all(np.abs(quick - exact).max(axis=(0, 1)) < 1e-3 * np.abs(exact).max(axis=(0, 1)))


# Coefficients of films where they are held: no convection, ideal contact.


def test_rates_by_a_film_that_is_off() -> None:
    _, rates = run(("alpha_air",), alpha_air=0.0)
    at = [run(alpha_air=x)[0].theta for x in (0.0, 1e-2, 2e-2)]
    expected = (4.0 * at[1] - 3.0 * at[0] - at[2]) / 2e-2
    assert np.abs(rates[..., 0] - expected).max() < 1e-4 * np.abs(expected).max()


@pytest.mark.parametrize("resistance", [1e-8, 1e-5])
def test_rates_by_the_resistance_of_the_contact(resistance: float) -> None:
    """By 1 / alpha_clamp, down to ideal contact: -alpha^2 d/dalpha is the limit of differences, and that of the march the same.

    At the edge of the jaws the answer to a resistance soon bends: the steps are small.
    """
    held = BASE.replace(alpha_clamp=1.0 / resistance)
    history, coupled = run(("alpha_clamp",), alpha_clamp=1.0 / resistance)
    problem, rates, h = heat_problem(dogbone(), history, SETTINGS), [], 0.1 * resistance
    heat_run_rates(problem, held, ("alpha_clamp",), lambda n, theta, at: rates.append(np.array(at[:, 0])))
    at = [heat_run(problem, held.replace(alpha_clamp=1.0 / (resistance + s * h))) for s in (0.0, 1.0, 2.0)]
    expected = (4.0 * at[1] - 3.0 * at[0] - at[2]) / (2.0 * h)
    found = -np.array(rates) / resistance**2
    assert np.abs(found - expected).max() < 1e-3 * np.abs(expected).max()
    assert np.abs(-coupled[..., 0] / resistance**2 - found).max() < 0.1 * np.abs(expected).max()
