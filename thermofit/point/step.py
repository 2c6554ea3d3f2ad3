"""One step of a material point under uniaxial stress: its equations and its new state, once, for real and for complex numbers.

The load acts along y, axis 2 of the law; lateral contraction is free, and all tensors are diagonal in these axes. Elasticity is
isotropic, so that free lateral faces make both lateral elastic stretches equal. Unknowns of a step are the logarithms a and b of the
elastic stretch across and along the load, the plastic increment dLambda, and theta; with D = dLambda N at the end of the step
(`point.lanes_point`):

    mu C_el,x + k = 0                                              free lateral faces (4.8)
    lambda_y = lambda_rest + strain,  or  (mu C_el,y + k) / lambda_y = stress
    |mu C_el - X|_G = sigma_y,  or  dLambda = 0                    yield surface (4.18), or elastic; X the backstress
    theta = theta_air + (theta_n - theta_air) e + Q phi / c0       lumped heat balance, exact for heat that is released evenly

with e = exp(-dt/tau), phi = (1 - e) tau / dt and Q the dissipated and thermoelastic heat of the step (4.20) to (4.22). The air is that
of the middle of the step; a heat capacity that changes with temperature is taken there as well, and tau with it. A sensor of first order
follows the temperature, which is straight within the step, with the time constant `lag`.

Nothing here is differentiated by hand: an argument moved by i h gives its derivative (`point.solve`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from thermofit.core.jit import kernel
from thermofit.law.backstress import decay_share, recall_over, recalled_energy
from thermofit.law.composition import (
    BACKSTRESSES,
    asymmetry_factor,
    backstress_terms,
    capacity_factor,
    modulus_factor,
    warm_moduli,
)
from thermofit.law.page import (
    Law,
    hardening_variable,
    pressure_factor,
    released_energy,
    surface_gradient,
    thermoelastic_heat,
    yield_stress_at_rate,
)
from thermofit.law.structure import asymmetry_heat, degradation_heat, energy_slope

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
    *BACKSTRESSES,
)
"""Entries of the state of a point: logarithmic plastic and elastic stretches, alpha, Lambda, temperatures in K, heat released so far in
mJ/mm^3, stretch at rest, what is measured: nominal strain along the load and across it, nominal stress in MPa; and
for each backstress X_yy - X_xx in MPa, in uniaxial stress all there is of it."""
N_STATE = len(STATE)
(
    PLASTIC_X, PLASTIC_Y, PLASTIC_Z, ACROSS, ALONG, ALPHA, LAMBDA, THETA, SENSOR, DISSIPATED, THERMOELASTIC, REST, STRAIN, STRESS,
    LATERAL_X, LATERAL_Z,
) = range(N_STATE - len(BACKSTRESSES))  # fmt: skip
N_BACKSTRESSES = len(BACKSTRESSES)
BACKSTRESS = N_STATE - N_BACKSTRESSES
N_UNKNOWNS = 4
BY_STRAIN, BY_STRESS, AT_REST = 0, 1, 2
"""What is prescribed at the end of a step; at rest: no stress, and the temperature as it is."""
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
    """Heat exchange of a step of given length: dt / tau, e and phi of the specimen and of the sensor, theta_air K."""

    lost: float
    kept: float
    share: float
    sensor_kept: float
    sensor_share: float
    theta_air: float


class End(NamedTuple):
    """End of a step: nominal stress MPa, stretch along the load, excess of |mu C_el - X|_G over the yield stress in units of mu, traction
    on lateral faces in units of mu, alpha, plastic increments D, heat dissipated and thermoelastic in mJ/mm^3, yield stress MPa, and
    `along`: S_yy - S_xx over |S|_G of the relative stress S, where a backstress is on."""

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
    along: float


@kernel(forceinline=True)
def recalled(s: np.ndarray, gamma: float, rate: float, theta: float, law: Law) -> tuple[float, float]:
    """What a step leaves of all backstresses in state s, X_yy - X_xx in MPa, and what it adds to them, |.|_G in MPa."""
    left = gained = 0.0 * gamma
    terms, before = backstress_terms(s[LAMBDA] + gamma, rate, theta, law), backstress_terms(s[LAMBDA], rate, s[THETA], law)
    for k in range(N_BACKSTRESSES):
        if terms[k][0] != 0.0:
            over = recall_over(gamma, terms[k][0], terms[k][1])
            left += over.kept * carried(s[BACKSTRESS + k], before[k][0], terms[k][0])
            gained += over.gained
    return left, gained


@kernel(forceinline=True)
def carried(backstress: float, modulus_n: float, modulus: float) -> float:
    """C Y_n of a backstress X_n = C_n Y_n whose modulus has become C."""
    return backstress * (modulus / modulus_n) if modulus_n != 0.0 else backstress


@kernel(forceinline=True)
def recalled_heat(s: np.ndarray, gamma: float, theta: float, along: float, law: Law) -> float:
    """Heat of the recall of all backstresses, mJ/mm^3, at the mean temperature of the step; theta is that of its end."""
    heat, rate = 0.0 * gamma, gamma * law.per_second
    weight = surface_gradient(0.0 * gamma, 0.0 * gamma + 1.0, 0.0 * gamma, law)[1]
    terms, middle = backstress_terms(s[LAMBDA] + gamma, rate, theta, law), 0.5 * (s[THETA] + theta)
    start, between = backstress_terms(s[LAMBDA], rate, s[THETA], law), backstress_terms(s[LAMBDA] + gamma, rate, middle, law)
    for k in range(N_BACKSTRESSES):
        if terms[k][0] != 0.0 and start[k][0] != 0.0:
            over, before = recall_over(gamma, terms[k][0], terms[k][1]), s[BACKSTRESS + k] / start[k][0]
            after = over.kept * before + over.gained / terms[k][0] * along
            before_2, across, after_2 = weight * before * before, weight * before * after, weight * after * after
            heat += recalled_energy(before_2, across, after_2, gamma, between[k][0], between[k][1])
    return heat


@kernel
def set_backstresses(s: np.ndarray, gamma: float, theta: float, along: float, law: Law, out: np.ndarray) -> None:
    """The backstresses at the end of a step into out, from those in s."""
    rate = gamma * law.per_second
    terms, before = backstress_terms(s[LAMBDA] + gamma, rate, theta, law), backstress_terms(s[LAMBDA], rate, s[THETA], law)
    for k in range(N_BACKSTRESSES):
        over = recall_over(gamma, terms[k][0], terms[k][1])
        out[BACKSTRESS + k] = over.kept * carried(s[BACKSTRESS + k], before[k][0], terms[k][0]) + over.gained * along


@kernel(forceinline=True)
def exchange_of(dt: float, around: Surroundings) -> Exchange:
    """Exchange of a step of length dt; a sensor whose lag is far below dt follows at once, up to its mean delay."""
    z = dt / around.tau
    if around.lag.real * _GONE <= dt:
        return Exchange(z, np.exp(-z), decay_share(z), 0.0 * around.lag, around.lag / dt, around.theta_air)
    y = dt / around.lag
    return Exchange(z, np.exp(-z), decay_share(z), np.exp(-y), decay_share(y), around.theta_air)


@kernel(forceinline=True)
def _end_of_step(x: tuple[float, float, float, float], s: np.ndarray, step: Input, law: Law) -> End:
    a, b, gamma, theta = x
    c_x, c_y, middle = np.exp(2.0 * a), np.exp(2.0 * b), 0.5 * (s[THETA] + theta)
    zero = 0.0 * gamma
    d_x, d_y, d_z, excess, sigma_y, along = zero, zero, zero, zero, zero, zero
    alpha, dissipated = zero + s[ALPHA], zero
    stiff = zero + 1.0
    if law.effective == 1:
        stiff = zero + modulus_factor(s[LAMBDA] + (gamma if step.flows else zero), theta, law)
    if step.flows:
        accumulated, rate = s[LAMBDA] + gamma, gamma * law.per_second
        t_x, t_y, gained = c_x, c_y, zero
        if law.effective == 1:
            left, gained = recalled(s, gamma, rate, theta, law)
            t_x, t_y = stiff * c_x, stiff * c_y - left / law.mu
        g_x, g_y, g_z = surface_gradient(t_x, t_y, t_x, law)
        norm = np.sqrt(g_x * t_x + g_y * t_y + g_z * t_x)
        r = gamma / norm if norm.real > 0.0 else zero
        d_x, d_y, d_z = r * g_x, r * g_y, r * g_z
        alpha = hardening_variable(s[ALPHA], gamma, law)[0]
        sigma_y = yield_stress_at_rate(alpha, accumulated, rate, theta, law)
        excess = norm - (sigma_y + gained) / law.mu
        dissipated = zero + released_energy(s[ALPHA], alpha, gamma, accumulated, middle, law)
        if law.effective == 1:
            along = (t_y - t_x) / norm if norm.real > 0.0 else zero
            dissipated += recalled_heat(s, gamma, theta, along, law)
            factor = asymmetry_factor(1.0 if along.real >= 0.0 else -1.0, law)
            if factor != 1.0:
                excess -= (factor - 1.0) * sigma_y / law.mu
                sigma_y = sigma_y * factor
                dissipated += asymmetry_heat(factor, alpha, accumulated, gamma, middle, law)
    log_j, log_j_n = 2.0 * a + b, 2.0 * s[ACROSS] + s[ALONG]
    j, j_n = np.exp(log_j), np.exp(log_j_n)
    k = pressure_factor(log_j, j, theta, law)[0]
    stretch = np.exp(s[PLASTIC_Y] + d_y + b)
    g_n, g, stress = log_j_n / j_n, log_j / j, (law.mu * c_y + k) / stretch
    heat = zero
    if law.effective == 1:
        trace, stress = 2.0 * c_x + c_y, stiff * stress
        if warm_moduli(law):
            accumulated, trace_n = s[LAMBDA] + (gamma if step.flows else zero), 2.0 * np.exp(2.0 * s[ACROSS]) + np.exp(2.0 * s[ALONG])
            lost = modulus_factor(s[LAMBDA], middle, law) - modulus_factor(accumulated, middle, law)
            slope_n = energy_slope(trace_n, log_j_n, s[LAMBDA], s[THETA], law)
            heat += middle * (energy_slope(trace, log_j, accumulated, theta, law) - slope_n)
        else:
            lost = modulus_factor(s[LAMBDA], theta, law) - stiff
            heat += thermoelastic_heat(middle, (stiff + lost) * g_n, stiff * g, law)
        dissipated += degradation_heat(lost, trace, log_j, g, middle, law)
    else:
        heat += thermoelastic_heat(middle, g_n, g, law)
    lateral = c_x + k / law.mu
    return End(stress, stretch, excess, lateral, alpha, d_x, d_y, d_z, dissipated, heat, sigma_y, along)


@kernel
def _end_with_effects(x: tuple[float, float, float, float], s: np.ndarray, step: Input, law: Law) -> End:
    return _end_of_step(x, s, step, law)


@kernel(forceinline=True)
def end_of_step(x: tuple[float, float, float, float], s: np.ndarray, step: Input, law: Law) -> End:
    """Stress, flow and heat at the end of a step from state s (N_STATE,) with unknowns x = (a, b, dLambda, theta)."""
    if law.effective == 0:  # inlined, so that nothing of the effects is left in it
        return _end_of_step(x, s, step, law)
    return _end_with_effects(x, s, step, law)


@kernel(forceinline=True)
def end_of_iteration(x: tuple[float, float, float, float], s: np.ndarray, step: Input, law: Law) -> End:
    """The same for the iterations of Newton, which ask most often: both are inlined, each with nothing of the other left in it."""
    if law.effective == 0:
        return _end_of_step(x, s, step, law)
    return _end_of_step(x, s, step, law)


@kernel
def _by_capacity(theta: float, excess: float, heat: float, law: Law, exchange: Exchange) -> float:
    """What a heat capacity that has changed at theta makes of the end temperature, K: tau changes with it. `excess` over the air and `heat`
    over c0, in K."""
    factor = capacity_factor(theta, law)
    if factor == 1.0:
        return 0.0 * heat
    lost = exchange.lost / factor
    return excess * (np.exp(-lost) - exchange.kept) + heat * (decay_share(lost) / factor - exchange.share)


@kernel(forceinline=True)
def residual(
    x: tuple[float, float, float, float], s: np.ndarray, step: Input, law: Law, exchange: Exchange
) -> tuple[float, float, float, float]:
    """The four equations of a step, dimensionless: lateral faces, control, yield or no flow, heat."""
    return equations(x, s, step, law, exchange, end_of_step(x, s, step, law))


@kernel(forceinline=True)
def equations(
    x: tuple[float, float, float, float], s: np.ndarray, step: Input, law: Law, exchange: Exchange, end: End
) -> tuple[float, float, float, float]:
    """The same where the end of the step is known."""
    third = end.excess if step.flows else x[2]
    if step.control == AT_REST:
        return end.lateral, end.stress / law.mu, third, x[3] / s[THETA] - 1.0
    control = end.stretch - s[REST] - step.target if step.control == BY_STRAIN else (end.stress - step.target) / law.mu
    heat = (end.dissipated + end.thermoelastic) / law.c0
    theta = exchange.theta_air + (s[THETA] - exchange.theta_air) * exchange.kept + heat * exchange.share
    if law.effective == 1:
        theta += _by_capacity(0.5 * (s[THETA] + x[3]), s[THETA] - exchange.theta_air, heat, law, exchange)
    return end.lateral, control, third, (x[3] - theta) / exchange.theta_air


@kernel(forceinline=True)
def new_state(x: tuple[float, float, float, float], s: np.ndarray, step: Input, law: Law, exchange: Exchange, out: np.ndarray) -> None:
    """The state at the end of a step that x solves, into out (N_STATE,)."""
    end = end_of_step(x, s, step, law)
    out[PLASTIC_X], out[PLASTIC_Y], out[PLASTIC_Z] = s[PLASTIC_X] + end.d_x, s[PLASTIC_Y] + end.d_y, s[PLASTIC_Z] + end.d_z
    out[ACROSS], out[ALONG] = x[0], x[1]
    out[ALPHA], out[LAMBDA] = end.alpha, s[LAMBDA] + (x[2] if step.flows else 0.0 * x[2])
    out[THETA] = x[3]
    if law.effective == 1:  # also where nothing flows: what a modulus that changes with temperature makes of them
        set_backstresses(s, x[2] if step.flows else 0.0 * x[2], x[3], end.along, law, out)
    else:
        for i in range(BACKSTRESS, N_STATE):
            out[i] = s[i]
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
