"""One step of the heat equation, the steady state, and their discrete heat balance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.jit import kernel
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
    """Temperature at the end of a step (n_np,) K and heat in mJ that left through each film set during it (model, not specimen).

    The rest is what its linearisation needs (`conduction_rates`): temperatures at the start of the step and at the end of the first
    stage of the scheme (`stages` holds one or two, the last is theta), the factor of C + gamma dt E, and what the step was made of.
    """

    theta: np.ndarray
    outflow: Mapping[str, float]
    start: np.ndarray
    stages: tuple[np.ndarray, ...]
    factor: Factor
    geometry: ThermalGeometry
    conditions: HeatConditions
    length: float


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
    matrix, _ = exchange(geometry, conditions)
    matrix *= dt * (GAMMA if scheme == "sdirk2" else 1.0)
    _add(matrix, conditions.c0, body.capacity)
    blank = HeatStep(
        theta_n, {}, theta_n, (theta_n,) * (2 if scheme == "sdirk2" else 1), Factor(body.thermal, matrix), geometry, conditions, dt
    )
    return same_step(body, blank, heat)


def same_step(body: Body, solved: HeatStep, heat: np.ndarray) -> HeatStep:
    """A step that was solved, with another nodal heat (n_np,) mJ."""
    dt, geometry, conditions, theta_n = solved.length, solved.geometry, solved.conditions, solved.start
    gamma, weights = (1.0, (1.0,)) if len(solved.stages) == 1 else (GAMMA, (1.0 - GAMMA, GAMMA))
    pattern, supply = body.thermal, gamma * (heat + dt * _inflow(geometry, conditions))
    start, stages = theta_n, []
    outflow = dict.fromkeys(conditions.films, 0.0)
    for weight in weights:
        theta = solved.factor.solve(conditions.c0 * multiply_symmetric(pattern.row, pattern.column, body.capacity, start) + supply)
        for name, power in _film_power(geometry, conditions, theta).items():
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
    total = sum(alpha * geometry.film_area[name].sum() for name, (alpha, _) in conditions.films.items())
    if total <= 0.0:
        return np.full(body.mesh.n_nodes, conditions.films["clamp"][1])
    matrix, inflow = exchange(geometry, conditions)
    return Factor(body.thermal, matrix).solve(inflow)


def stored_heat(body: Body, conditions: HeatConditions, theta_n: np.ndarray, theta: np.ndarray) -> float:
    """c0 int (theta - theta_n) dV of the model in mJ."""
    pattern = body.thermal
    return float(conditions.c0 * multiply_symmetric(pattern.row, pattern.column, body.capacity, theta - theta_n).sum())
