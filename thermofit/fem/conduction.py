"""One step of the heat equation, the steady state, and their discrete heat balance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.effects.film_exchange import FILM_UNIT
from thermofit.fem.body import Body, ThermalGeometry
from thermofit.fem.linear import Factor, multiply_symmetric
from thermofit.material.law import Law

GAMMA = 1.0 - np.sqrt(0.5)
"""Coefficient of Alexander's two-stage, stiffly accurate, L-stable SDIRK scheme of order 2 (SIAM J. Numer. Anal. 14, 1977)."""


@dataclass(frozen=True)
class HeatConditions:
    """Conductivity mW/(mm K), heat capacity mJ/(mm^3 K), and per film set (coefficient W/(m^2 K), medium temperature K)."""

    kappa: float
    c0: float
    films: Mapping[str, tuple[float, float]]


def heat_conditions(parameters: Parameters) -> HeatConditions:
    """HeatConditions of named parameters: the film sets are "air" and "clamp" (5.2.2)."""
    v = parameters.values
    return HeatConditions(v["kappa"], v["c0"], {"air": (v["alpha_air"], v["theta_air"]), "clamp": (v["alpha_clamp"], v["theta_clamp"])})


def at_constant_stress(conditions: HeatConditions, law: Law) -> HeatConditions:
    """Conditions for mechanics that was solved at one temperature and lacks the thermal expansion.

    The heat that free expansion takes, 3 alpha K theta d(ln J) with d(ln J) = 3 alpha dtheta, enters the heat capacity instead:
    c0 + 9 K alpha^2 theta_0, that of constant stress; without it temperatures rise 3.5 % too much in aluminium.
    """
    return replace(conditions, c0=conditions.c0 + 9.0 * law.bulk * law.alpha_exp**2 * law.theta_ref)


@dataclass(frozen=True)
class HeatStep:
    """Temperature at the end of a step (n_np,) K and heat in mJ that left through each film set during it (model, not specimen)."""

    theta: np.ndarray
    outflow: Mapping[str, float]


def _exchange(geometry: ThermalGeometry, conditions: HeatConditions) -> tuple[np.ndarray, np.ndarray]:
    """kappa K + sum alpha S (n_slots,) in mW/K and sum alpha theta_M int N da (n_np,) in mW."""
    matrix = conditions.kappa * geometry.conduction
    inflow = np.zeros_like(next(iter(geometry.film_area.values())))
    for name, (alpha, theta_medium) in conditions.films.items():
        matrix += FILM_UNIT * alpha * geometry.film[name]
        inflow += FILM_UNIT * alpha * theta_medium * geometry.film_area[name]
    return matrix, inflow


def _film_power(body: Body, geometry: ThermalGeometry, conditions: HeatConditions, theta: np.ndarray) -> dict[str, float]:
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
    exchange, inflow = _exchange(geometry, conditions)
    gamma = GAMMA if scheme == "sdirk2" else 1.0
    capacity = conditions.c0 * body.capacity
    pattern = body.thermal
    factor = Factor(pattern, capacity + gamma * dt * exchange)
    supply = gamma * (heat + dt * inflow)
    theta = factor.solve(multiply_symmetric(pattern.row, pattern.column, capacity, theta_n) + supply)
    power = _film_power(body, geometry, conditions, theta)
    if scheme != "sdirk2":
        return HeatStep(theta, {name: dt * value for name, value in power.items()})
    start = theta_n + (1.0 - gamma) / gamma * (theta - theta_n)
    theta = factor.solve(multiply_symmetric(pattern.row, pattern.column, capacity, start) + supply)
    end_power = _film_power(body, geometry, conditions, theta)
    return HeatStep(theta, {name: dt * ((1.0 - gamma) * power[name] + gamma * end_power[name]) for name in power})


def steady_temperature(body: Body, geometry: ThermalGeometry, conditions: HeatConditions) -> np.ndarray:
    """Temperature (n_np,) K of the resting specimen: conduction and film exchange in balance (5.2.2, initial condition).

    With no exchange at all the body takes the clamp temperature. StudyError for a negative film coefficient.
    """
    for name, (alpha, _) in conditions.films.items():
        if alpha < 0.0:
            raise StudyError(f"alpha_{name}: {alpha} W/(m^2 K) found; a film coefficient must not be negative")
    total = sum(alpha * geometry.film_area[name].sum() for name, (alpha, _) in conditions.films.items())
    if total <= 0.0:
        return np.full(body.mesh.n_nodes, conditions.films["clamp"][1])
    exchange, inflow = _exchange(geometry, conditions)
    return Factor(body.thermal, exchange).solve(inflow)


def stored_heat(body: Body, conditions: HeatConditions, theta_n: np.ndarray, theta: np.ndarray) -> float:
    """c0 int (theta - theta_n) dV of the model in mJ."""
    pattern = body.thermal
    return float(conditions.c0 * multiply_symmetric(pattern.row, pattern.column, body.capacity, theta - theta_n).sum())
