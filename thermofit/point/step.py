"""One step of a material point under uniaxial stress: its equations and its new state, once, for real and for complex numbers.

The load acts along y, axis 2 of the law; lateral contraction is free, and all tensors are diagonal in these axes. Elasticity is
isotropic, so that free lateral faces make both lateral elastic stretches equal. Unknowns of a step are the logarithms a and b of the
elastic stretch across and along the load, the plastic increment dLambda, and theta; with D = dLambda N at the end of the step
(`material.point`):

    mu C_el,x + k = 0                                              free lateral faces (4.8)
    lambda_y = lambda_rest + strain,  or  (mu C_el,y + k) / lambda_y = stress
    mu |C_el|_G = sigma_y,  or  dLambda = 0                        yield surface (4.18), or elastic
    theta = theta_air + (theta_n - theta_air) e + Q phi / c0       lumped heat balance, exact for heat that is released evenly

with e = exp(-dt/tau), phi = (1 - e) tau / dt and Q the dissipated and thermoelastic heat of the step (4.20) to (4.22). A sensor of
first order follows the temperature, which is straight within the step, with the time constant `lag`.

Nothing here is differentiated by hand: an argument moved by i h gives its derivative (`point.solve`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from thermofit.core.jit import kernel
from thermofit.material.law import (
    Law,
    hardening_variable,
    hill_gradient,
    pressure_factor,
    released_energy,
    thermoelastic_heat,
    yield_stress_at_rate,
)

STATE: tuple[str, ...] = (
    "plastic_x",
    "plastic_y",
    "plastic_z",
    "elastic_across",
    "elastic_along",
    "alpha",
    "accumulated",
    "theta",
    "theta_sensor",
    "dissipated",
    "thermoelastic",
    "rest_stretch",
    "strain",
    "stress",
    "lateral_x",
    "lateral_z",
)
"""Entries of the state of a point: logarithmic plastic and elastic stretches, alpha, Lambda, temperatures in K, heat released so far in
mJ/mm^3, stretch at rest, and what is measured: nominal strain along the load and across it, nominal stress in MPa."""
N_STATE = len(STATE)
(
    PLASTIC_X, PLASTIC_Y, PLASTIC_Z, ACROSS, ALONG, ALPHA, LAMBDA, THETA, SENSOR, DISSIPATED, THERMOELASTIC, REST, STRAIN, STRESS,
    LATERAL_X, LATERAL_Z,
) = range(N_STATE)  # fmt: skip
N_UNKNOWNS = 4
BY_STRAIN, BY_STRESS, AT_REST = 0, 1, 2
"""What is prescribed at the end of a step; at rest: no stress, and the temperature as it is."""
_SMALL = 1e-2
_GONE = 40.0
"""exp(-40) is below the last digit of 1."""


class Surroundings(NamedTuple):
    """Time constant of heat loss s, lag of the sensor s, temperature of the air K."""

    tau: float
    lag: float
    theta_air: float


class Input(NamedTuple):
    """What drives a step: length s, nominal strain or stress MPa at its end, which of them, and whether it flows plastically."""

    dt: float
    target: float
    control: int
    flows: bool


class Exchange(NamedTuple):
    """Heat exchange of a step of given length: e and phi of the specimen and of the sensor, theta_air K."""

    kept: float
    share: float
    sensor_kept: float
    sensor_share: float
    theta_air: float


class End(NamedTuple):
    """End of a step: nominal stress MPa, stretch along the load, excess of mu |C_el|_G over the yield stress in units of mu, traction on
    lateral faces in units of mu, alpha, plastic increments D, heat dissipated and thermoelastic in mJ/mm^3."""

    stress: float
    stretch: float
    excess: float
    lateral: float
    alpha: float
    d_x: float
    d_y: float
    d_z: float
    dissipated: float
    thermoelastic: float
    yield_stress: float


@kernel(forceinline=True)
def decay_share(z: float) -> float:
    """phi(z) = (1 - exp(-z)) / z, the mean of exp(-z s) over 0 < s < 1; by its series for small z."""
    if abs(z.real) < _SMALL:
        return 1.0 - z / 2.0 * (1.0 - z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0 * (1.0 - z / 6.0 * (1.0 - z / 7.0)))))
    return (1.0 - np.exp(-z)) / z


@kernel(forceinline=True)
def exchange_of(dt: float, around: Surroundings) -> Exchange:
    """Exchange of a step of length dt; a sensor whose lag is far below dt follows at once, up to its mean delay."""
    z = dt / around.tau
    if around.lag.real * _GONE <= dt:
        return Exchange(np.exp(-z), decay_share(z), 0.0 * around.lag, around.lag / dt, around.theta_air)
    y = dt / around.lag
    return Exchange(np.exp(-z), decay_share(z), np.exp(-y), decay_share(y), around.theta_air)


@kernel(forceinline=True)
def end_of_step(x: tuple[float, float, float, float], s: np.ndarray, step: Input, law: Law) -> End:
    """Stress, flow and heat at the end of a step from state s (N_STATE,) with unknowns x = (a, b, dLambda, theta)."""
    a, b, gamma, theta = x
    c_x, c_y = np.exp(2.0 * a), np.exp(2.0 * b)
    zero = 0.0 * gamma
    d_x, d_y, d_z, excess, sigma_y = zero, zero, zero, zero, zero
    alpha, dissipated = zero + s[ALPHA], zero
    if step.flows:
        g_x, g_y, g_z = hill_gradient(c_x, c_y, c_x, law)
        norm = np.sqrt(g_x * c_x + g_y * c_y + g_z * c_x)
        r = gamma / norm if norm.real > 0.0 else zero
        d_x, d_y, d_z = r * g_x, r * g_y, r * g_z
        alpha = hardening_variable(s[ALPHA], gamma, law)[0]
        accumulated = s[LAMBDA] + gamma
        sigma_y = yield_stress_at_rate(alpha, accumulated, gamma * law.per_second, theta, law)
        excess = norm - sigma_y / law.mu
        dissipated = zero + released_energy(s[ALPHA], alpha, gamma, accumulated, theta, law)
    log_j, log_j_n = 2.0 * a + b, 2.0 * s[ACROSS] + s[ALONG]
    j, j_n = np.exp(log_j), np.exp(log_j_n)
    k = pressure_factor(log_j, j, theta, law)[0]
    stretch = np.exp(s[PLASTIC_Y] + d_y + b)
    heat = thermoelastic_heat(0.5 * (s[THETA] + theta), log_j_n / j_n, log_j / j, law)
    stress, lateral = (law.mu * c_y + k) / stretch, c_x + k / law.mu
    return End(stress, stretch, excess, lateral, alpha, d_x, d_y, d_z, dissipated, heat, sigma_y)


@kernel(forceinline=True)
def residual(
    x: tuple[float, float, float, float], s: np.ndarray, step: Input, law: Law, exchange: Exchange
) -> tuple[float, float, float, float]:
    """The four equations of a step, dimensionless: lateral faces, control, yield or no flow, heat."""
    end = end_of_step(x, s, step, law)
    third = end.excess if step.flows else x[2]
    if step.control == AT_REST:
        return end.lateral, end.stress / law.mu, third, x[3] / s[THETA] - 1.0
    control = end.stretch - s[REST] - step.target if step.control == BY_STRAIN else (end.stress - step.target) / law.mu
    heat = (end.dissipated + end.thermoelastic) / law.c0
    theta = exchange.theta_air + (s[THETA] - exchange.theta_air) * exchange.kept + heat * exchange.share
    return end.lateral, control, third, (x[3] - theta) / exchange.theta_air


@kernel(forceinline=True)
def new_state(x: tuple[float, float, float, float], s: np.ndarray, step: Input, law: Law, exchange: Exchange, out: np.ndarray) -> None:
    """The state at the end of a step that x solves, into out (N_STATE,)."""
    end = end_of_step(x, s, step, law)
    out[PLASTIC_X], out[PLASTIC_Y], out[PLASTIC_Z] = s[PLASTIC_X] + end.d_x, s[PLASTIC_Y] + end.d_y, s[PLASTIC_Z] + end.d_z
    out[ACROSS], out[ALONG] = x[0], x[1]
    out[ALPHA], out[LAMBDA] = end.alpha, s[LAMBDA] + (x[2] if step.flows else 0.0 * x[2])
    out[THETA] = x[3]
    rise = x[3] - s[THETA]
    out[SENSOR] = x[3] - rise * exchange.sensor_share + (s[SENSOR] - s[THETA]) * exchange.sensor_kept
    out[DISSIPATED] = s[DISSIPATED] + end.dissipated
    out[THERMOELASTIC] = s[THERMOELASTIC] + end.thermoelastic
    rest_stretch, across = s[REST], np.exp(x[0])
    if step.control == AT_REST:
        rest_stretch = end.stretch
        out[SENSOR], out[THERMOELASTIC] = x[3], 0.0 * x[3]
    out[REST] = rest_stretch
    out[STRAIN], out[STRESS] = end.stretch - rest_stretch, end.stress
    # At rest the specimen has expanded alike in all directions.
    out[LATERAL_X] = across * np.exp(out[PLASTIC_X]) - rest_stretch
    out[LATERAL_Z] = across * np.exp(out[PLASTIC_Z]) - rest_stretch
