"""One step of the heat equation, the steady state, and their discrete heat balance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from thermofit.body.body import Body, ThermalGeometry, about_middle
from thermofit.body.heat.effects import (
    HeatEffects,
    Loads,
    Moment,
    add_slopes,
    heat_effects,
    inflow_of,
    loads_of,
    power_of,
    weighted_capacity,
    weighted_conduction,
)
from thermofit.body.solve.linear import Factor, multiply_symmetric
from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.jit import kernel
from thermofit.core.parameters import Parameters
from thermofit.effects.film_exchange import FILM_UNIT
from thermofit.law.page import Law

GAMMA = 1.0 - np.sqrt(0.5)
"""Coefficient of Alexander's two-stage, stiffly accurate, L-stable SDIRK scheme of order 2 (SIAM J. Numer. Anal. 14, 1977)."""

_STEADY_ITERATIONS = 50
_STEADY_CHANGE = 1e-10
"""K; last change of the steady temperature under effects."""


@dataclass(frozen=True)
class HeatConditions:
    """Conductivity mW/(mm K), heat capacity mJ/(mm^3 K), and per film set (coefficient W/(m^2 K), medium temperature K).

    `effects` are those of the catalogue that are on; `moment` is where the step at hand stands, which they need to know.
    """

    kappa: float
    c0: float
    films: Mapping[str, tuple[float, float]]
    effects: HeatEffects | None = None
    moment: Moment | None = None

    def at(self, first: float, start: float, middle: np.ndarray) -> HeatConditions:
        """The same in a step from time `start` s of a test that began at `first`, linear about the temperature `middle` (n_np,) K."""
        return replace(self, moment=Moment(first, start, middle))


def heat_conditions(parameters: Parameters) -> HeatConditions:
    """HeatConditions of named parameters: the film sets are "air" and "clamp" (5.2.2)."""
    v = parameters.values
    films = {"air": (v["alpha_air"], v["theta_air"]), "clamp": (v["alpha_clamp"], v["theta_clamp"])}
    return HeatConditions(v["kappa"], v["c0"], films, heat_effects(parameters))


def expansion_capacity(law: Law) -> float:
    """9 K alpha^2 theta_0 in mJ/(mm^3 K): what heating at constant stress needs more than at constant strain. Complex for a law along an
    imaginary step."""
    return 9.0 * law.bulk * law.alpha_exp**2 * law.theta_ref


def at_constant_stress(conditions: HeatConditions, law: Law) -> HeatConditions:
    """Conditions for mechanics that was solved at one temperature and lacks the thermal expansion.

    The heat that free expansion takes, 3 alpha K theta d(ln J) with d(ln J) = 3 alpha dtheta, enters the heat capacity instead:
    c0 + 9 K alpha^2 theta_0, that of constant stress; without it temperatures rise 3.5 % too much in aluminium.
    """
    return replace(conditions, c0=conditions.c0 + expansion_capacity(law))


@dataclass(frozen=True)
class HeatStep:
    """Temperature at the end of a step (n_np,) K and heat in mJ that left through each film set during it (model, not specimen).

    The rest is what its linearisation needs (`conduction_rates`): temperatures at the start of the step and at the end of the first
    stage of the scheme (`stages` holds one or two, the last is theta), the factor of C + gamma dt E, and what the step was made of:
    `geometry` as it came, `capacity` and `conduction` (n_slots,) with the factors of effects, and their `loads`.
    """

    theta: np.ndarray
    outflow: Mapping[str, float]
    start: np.ndarray
    stages: tuple[np.ndarray, ...]
    factor: Factor
    geometry: ThermalGeometry
    conditions: HeatConditions
    length: float
    capacity: np.ndarray
    conduction: np.ndarray
    loads: Loads | None = None


def exchange(geometry: ThermalGeometry, conditions: HeatConditions) -> tuple[np.ndarray, np.ndarray]:
    """E = kappa K + sum alpha S (n_slots,) in mW/K and q = sum alpha theta_M int N da (n_np,) in mW."""
    matrix = conditions.kappa * geometry.conduction
    for name, (alpha, _) in conditions.films.items():
        _add(matrix, FILM_UNIT * alpha, geometry.film[name])
    return matrix, _inflow(geometry, conditions)


def _inflow(geometry: ThermalGeometry, conditions: HeatConditions) -> np.ndarray:
    inflow = np.zeros_like(next(iter(geometry.film_area.values())))
    for name, (alpha, theta_medium) in conditions.films.items():
        _add(inflow, FILM_UNIT * alpha * theta_medium, geometry.film_area[name])
    return inflow


@kernel
def _add(y: np.ndarray, factor: float, x: np.ndarray) -> None:
    """y += factor x without a further array."""
    for i in range(y.shape[0]):
        y[i] += factor * x[i]


def _film_power(geometry: ThermalGeometry, conditions: HeatConditions, theta: np.ndarray) -> dict[str, float]:
    """Power in mW that leaves through each film set (4.13)."""
    power = {}
    for name, (alpha, theta_medium) in conditions.films.items():
        power[name] = FILM_UNIT * alpha * float(geometry.film_area[name] @ (theta - theta_medium))
    return power


def heat_step(
    body: Body, geometry: ThermalGeometry, conditions: HeatConditions, theta_n: np.ndarray, heat: np.ndarray, step: tuple[float, str]
) -> HeatStep:
    """One step of `step` = (length s, scheme): theta at its end for nodal heat (n_np,) mJ that is released evenly over the step.

    Schemes: "sdirk2" (order 2, L-stable) or "backward-euler". `geometry` is that of the step (mean of both ends).
    """
    dt, scheme = step
    ends = ends_of_stages(scheme)
    gamma, n_stages = (GAMMA, 2) if scheme == "sdirk2" else (1.0, 1)
    loads = step_loads(body, conditions, dt, ends)
    capacity, conduction = _weighted(body, geometry, loads)
    matrix, _ = exchange(replace(geometry, conduction=conduction), conditions)
    if loads is not None:
        add_slopes(body, geometry, loads, matrix)
    matrix *= dt * gamma
    _add(matrix, conditions.c0, capacity)
    factor = Factor(body.thermal, matrix)
    blank = HeatStep(theta_n, {}, theta_n, (theta_n,) * n_stages, factor, geometry, conditions, dt, capacity, conduction, loads)
    return same_step(body, blank, heat)


def ends_of_stages(scheme: str) -> tuple[float, float]:
    """Parts of a step at which the stages of a scheme end; of one stage alone twice."""
    return (GAMMA, 1.0) if scheme == "sdirk2" else (1.0, 1.0)


def step_loads(body: Body, conditions: HeatConditions, dt: float, ends: tuple[float, float]) -> Loads | None:
    """Loads of the effects in a step of dt s whose stages end at the parts `ends` of it; None where there are none."""
    if conditions.effects is None:
        return None
    if conditions.moment is None:
        raise NumericsError("heat: effects are on, but the step does not know its time; give the conditions their moment")
    return loads_of(body, conditions.effects, conditions.films, conditions.moment, (dt, ends))


def _weighted(body: Body, geometry: ThermalGeometry, loads: Loads | None) -> tuple[np.ndarray, np.ndarray]:
    """Capacity and conduction matrices (n_slots,) with the factors of effects."""
    capacity, conduction = body.capacity, geometry.conduction
    if loads is not None and loads.capacity is not None:
        capacity = weighted_capacity(body, loads.capacity)
    if loads is not None and loads.conductivity is not None:
        conduction = weighted_conduction(body, conduction, loads.conductivity)
    return capacity, conduction


def coefficients(conditions: HeatConditions) -> dict[str, float]:
    """Film coefficients in mW/(mm^2 K)."""
    return {name: FILM_UNIT * alpha for name, (alpha, _) in conditions.films.items()}


def same_step(body: Body, solved: HeatStep, heat: np.ndarray) -> HeatStep:
    """A step that was solved, with another nodal heat (n_np,) mJ."""
    dt, geometry, conditions, theta_n, loads = solved.length, solved.geometry, solved.conditions, solved.start, solved.loads
    gamma, weights = (1.0, (1.0,)) if len(solved.stages) == 1 else (GAMMA, (1.0 - GAMMA, GAMMA))
    pattern, supply = body.thermal, gamma * (heat + dt * _inflow(geometry, conditions))
    start, stages = theta_n, []
    outflow = dict.fromkeys(conditions.films, 0.0)
    more = None if loads is None else gamma * dt * inflow_of(body, geometry, coefficients(conditions), loads)
    for stage, weight in enumerate(weights):
        right = conditions.c0 * multiply_symmetric(pattern.row, pattern.column, solved.capacity, start) + supply
        theta = solved.factor.solve(right if more is None else right + more[stage])
        for name, power in _film_power(geometry, conditions, theta).items():
            outflow[name] += dt * weight * power
        if loads is not None:
            for name, power in power_of(geometry, coefficients(conditions), loads, stage, theta).items():
                outflow[name] += dt * weight * power
        start = theta_n + (1.0 - gamma) / gamma * (theta - theta_n)
        stages.append(theta)
    return replace(solved, theta=theta, outflow=outflow, stages=tuple(stages))


def steady_temperature(body: Body, geometry: ThermalGeometry, conditions: HeatConditions) -> np.ndarray:
    """Temperature (n_np,) K of the resting specimen: conduction and film exchange in balance (5.2.2, initial condition).

    With no exchange at all the body takes the clamp temperature. StudyError for a negative film coefficient.
    """
    for name, (alpha, _) in conditions.films.items():
        if alpha < 0.0:
            raise StudyError(f"alpha_{name}: {alpha} W/(m^2 K) found; a film coefficient must not be negative")
    x, y = about_middle(body)
    initial = None if conditions.effects is None else conditions.effects.initial(x, y)
    theta = _balanced(body, geometry, conditions)
    return theta if initial is None else theta + initial


def without_exchange(geometry: ThermalGeometry, conditions: HeatConditions) -> bool:
    """True where no film takes part."""
    return bool(sum(alpha * geometry.film_area[name].sum() for name, (alpha, _) in conditions.films.items()) <= 0.0)


def _balanced(body: Body, geometry: ThermalGeometry, conditions: HeatConditions) -> np.ndarray:
    """`steady_temperature` before effects of slot initial_temperature; fluxes and factors are iterated."""
    if without_exchange(geometry, conditions):
        return np.full(body.mesh.n_nodes, conditions.films["clamp"][1])
    matrix, inflow = exchange(geometry, conditions)
    theta = Factor(body.thermal, matrix).solve(inflow)
    if conditions.effects is None:
        return theta
    for _ in range(_STEADY_ITERATIONS):
        loads, matrix = steady_system(body, geometry, conditions, theta)
        before = theta
        theta = Factor(body.thermal, matrix).solve(inflow + inflow_of(body, geometry, coefficients(conditions), loads)[0])
        if np.max(np.abs(theta - before)) <= _STEADY_CHANGE:
            return theta
    raise NumericsError(f"heat: no steady temperature found in {_STEADY_ITERATIONS} iterations; check the effects on the surface")


def steady_system(body: Body, geometry: ThermalGeometry, conditions: HeatConditions, theta: np.ndarray) -> tuple[Loads, np.ndarray]:
    """Loads of the effects at the first time, linear about theta (n_np,) K, and the matrix (n_slots,) of the steady state with them."""
    first = 0.0 if conditions.moment is None else conditions.moment.first
    here = conditions.at(first, first, theta)
    loads = step_loads(body, here, 0.0, (0.0, 0.0))
    assert loads is not None
    matrix, _ = exchange(replace(geometry, conduction=_weighted(body, geometry, loads)[1]), here)
    add_slopes(body, geometry, loads, matrix)
    return loads, matrix


def stored_heat(
    body: Body, conditions: HeatConditions, theta_n: np.ndarray, theta: np.ndarray, capacity: np.ndarray | None = None
) -> float:
    """c0 int f (theta - theta_n) dV of the model in mJ; `capacity` (n_slots,) is that with a factor f of effects."""
    pattern = body.thermal
    weights = body.capacity if capacity is None else capacity
    return float(conditions.c0 * multiply_symmetric(pattern.row, pattern.column, weights, theta - theta_n).sum())
