"""Temperature of a coupon by the work that was measured: stress and strain are both given, so that no hardening law takes part.

What elasticity leaves of the measured strain is plastic, and its work with the measured stress becomes heat:

    exp(a), exp(b): elastic stretches across and along the load that carry tau = P lambda between free lateral faces   (4.8)
    Q = beta f tau d(ln lambda - b) - 3 alpha_exp K theta d(ln J / J), f the factors of slot dissipation
    theta = theta_air + (theta_n - theta_air) e + Q phi / c0, and a sensor of first order, both as in `point.step`

Here beta is the share of the plastic work that becomes heat (Taylor and Quinney 1934). A law that misses the stress misses plastic and
thermoelastic heat by as much; a measured stress misses neither. Arrays are (n_t, m): one column per parameter moved by i h, which gives
the derivatives, and the last one as the parameters are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.effects.catalogue import effects
from thermofit.law.composition import number_of
from thermofit.law.page_rates import NUMBERS, STEP
from thermofit.point.driver import PointHistory, PointRates, PointSettings, Programme, run_numbers
from thermofit.point.solve import AIR, LAG, START, TAU
from thermofit.point.step import STATE

_PASSES = 60
_NEWTON = 30
_CONVERGED = 1e-12
_LOST = 1.0
"""Logarithmic elastic stretch beyond which an iteration is lost."""
_GONE = 40.0
"""exp(-40) is below the last digit of 1, as in `point.step`."""
_SMALL = 1e-6
"""dt over a time constant below which exp is expanded."""


@dataclass(frozen=True)
class MeasuredCurve:
    """What was measured: times s, nominal strain and stress MPa, each (n_t,), temperature at the start in K (None: that of the air)."""

    time: np.ndarray
    strain: np.ndarray
    stress: np.ndarray
    theta_start: float | None = None


def with_measured_work(
    parameters: Parameters, work: MeasuredCurve, settings: PointSettings, found: tuple[PointHistory, PointRates | None]
) -> tuple[PointHistory, PointRates | None]:
    """A history, and its derivatives where there are any, with the temperatures that the measured work makes.

    NumericsError where no elastic stretch carries the measured stress.
    """
    history, rates = found
    names = () if rates is None else rates.names
    programme = Programme.by_strain(work.time, work.strain, work.theta_start)
    numbers, along, _ = run_numbers(parameters, names, programme, settings)
    moved = numbers[:, None] + 1j * STEP * np.column_stack([along, np.zeros(len(numbers))])
    theta, sensor = _temperatures(moved, work)
    history = replace(history, theta=theta[:, -1].real, theta_sensor=sensor[:, -1].real)
    if rates is None:
        return history, None
    slopes = rates.rates.copy()
    slopes[:, STATE.index("theta")] = theta[:, :-1].imag / STEP
    slopes[:, STATE.index("theta_sensor")] = sensor[:, :-1].imag / STEP
    return history, PointRates(names, slopes)


def _temperatures(numbers: np.ndarray, work: MeasuredCurve) -> tuple[np.ndarray, np.ndarray]:
    """Temperatures (n_t, m) of specimen and sensor, K, of complex numbers (N_ALL, m) of a run.

    The temperature moves the elastic stretch by thermal expansion only: heat and temperature in turn settle in a few passes.
    """
    law = SimpleNamespace(**dict(zip(NUMBERS, numbers, strict=False)))
    start = numbers[START][None, :]
    theta = np.repeat(start, len(work.time), axis=0)
    dt = np.diff(work.time)[:, None]
    kept, share = _decay(dt / numbers[TAU])
    for _ in range(_PASSES):
        heat = _heat(theta, work, law)
        after = _follow(start - numbers[AIR], kept, heat * share / law.c0) + numbers[AIR]
        change = after - theta
        theta = after
        if _settled(change.real, theta.real) and _settled(change.imag, theta.imag):
            return theta, _lagged(theta, dt, numbers[LAG])
    raise NumericsError(f"measured work: temperatures do not settle in {_PASSES} passes; check alpha_exp, c0 and the unit of the stress")


def _settled(change: np.ndarray, value: np.ndarray) -> bool:
    return bool(np.all(np.abs(change).max(axis=0) <= _CONVERGED * np.abs(value).max(axis=0)))


def _heat(theta: np.ndarray, work: MeasuredCurve, law: Any) -> np.ndarray:
    """Heat released in every interval (n_t - 1, m), mJ/mm^3."""
    rest = _elastic(0.0 * theta[:1], theta[:1], law)[1]
    stretch = np.exp(rest) + work.strain[:, None]
    tau = work.stress[:, None] * stretch
    across, along = _elastic(tau, theta, law)
    log_j = 2.0 * across + along
    flow = np.diff(np.log(stretch) - along, axis=0)
    middle, g = 0.5 * (theta[1:] + theta[:-1]), log_j / np.exp(log_j)
    plastic = law.beta * 0.5 * (tau[1:] + tau[:-1]) * flow * _factor(flow, np.diff(work.time)[:, None], theta[1:], law)
    heat: np.ndarray = plastic - 3.0 * law.alpha_exp * law.bulk * middle * np.diff(g, axis=0)
    return heat


def _factor(flow: np.ndarray, dt: np.ndarray, theta: np.ndarray, law: Any) -> np.ndarray:
    """Product of the effects of slot dissipation (n_t - 1, m)."""
    size = np.where(flow.real < 0.0, -flow, flow) * np.sqrt(law.F + law.H)
    accumulated, value = np.cumsum(size, axis=0), np.ones_like(flow)
    for e in effects(("dissipation",)):
        value = value * e.act(accumulated, size / dt, theta, law, *(getattr(law, number_of(name)) for name in e.names))
    return value


def _elastic(tau: np.ndarray, theta: np.ndarray, law: Any) -> tuple[np.ndarray, np.ndarray]:
    """Logarithmic elastic stretches across and along the load under tau = P lambda, MPa: one Newton equation, mu C_x + k = 0 (4.8)."""
    across = np.zeros_like(theta)
    for _ in range(_NEWTON):
        c_x = np.exp(2.0 * across)
        c_y = c_x + tau / law.mu
        if not np.all(np.isfinite(c_y)) or np.any(c_y.real <= 0.0) or np.any(np.abs(across.real) > _LOST):
            break
        log_j, slope_j = 2.0 * across + 0.5 * np.log(c_y), 2.0 + c_x / c_y
        thermal = 3.0 * law.alpha_exp * law.bulk * (theta - law.theta_ref) / np.exp(log_j)
        k, slope_k = law.lame * log_j - law.mu - thermal * (1.0 - log_j), law.lame + thermal * (2.0 - log_j)
        step = (law.mu * c_x + k) / (2.0 * law.mu * c_x + slope_k * slope_j)
        across = across - step
        if _settled(step.real, np.ones_like(step.real)) and _settled(step.imag, np.maximum(np.abs(across.imag), STEP * _CONVERGED)):
            return across, 0.5 * np.log(np.exp(2.0 * across) + tau / law.mu)
    worst = float(np.abs(tau.real).max())
    raise NumericsError(f"measured work: no elastic stretch gives {worst:.4g} MPa; check E, and area and unit of the stress")


def _decay(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """exp(-z) and (1 - exp(-z)) / z."""
    safe = np.where(np.abs(z) < _SMALL, 1.0, z)
    return np.exp(-z), np.where(np.abs(z) < _SMALL, 1.0 - 0.5 * z, (1.0 - np.exp(-safe)) / safe)


def _follow(first: np.ndarray, kept: np.ndarray, gained: np.ndarray) -> np.ndarray:
    """y_(n+1) = y_n kept + gained (n_t, m) from the first (1, m)."""
    out = np.empty((len(gained) + 1, gained.shape[1]), dtype=complex)
    out[0] = first
    kept = np.broadcast_to(kept, gained.shape)
    for n in range(len(gained)):
        out[n + 1] = out[n] * kept[n] + gained[n]
    return out


def _lagged(theta: np.ndarray, dt: np.ndarray, lag: np.ndarray) -> np.ndarray:
    """What a sensor of first order shows of a temperature that is straight between its values; a lag far below dt is a mean delay."""
    prompt = lag.real * _GONE <= dt
    kept, share = _decay(dt / np.where(prompt, dt, lag))
    rise = np.diff(theta, axis=0)
    return theta + _follow(0.0 * theta[:1], np.where(prompt, 0.0, kept), -rise * np.where(prompt, lag / dt, share))
