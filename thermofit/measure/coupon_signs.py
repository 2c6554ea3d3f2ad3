"""Signs of a coupon record against physics: a specimen cools in elastic tension, and its stress rises with its strain."""

from __future__ import annotations

import numpy as np

_BLOCKS = 4000
_LAGS = 4
_LEAST = 12
_SIGNIFICANT = 4.0
_FAST = 0.3


def sign_suspicion(time: np.ndarray, stress: np.ndarray, temperature: np.ndarray) -> str | None:
    """A sentence where the temperature says that the sign of the stress is flipped, None where it does not.

    `time` s (n,), `stress` MPa or force (n,), `temperature` K (n,). Thermoelastic coupling: dtheta/dt = -(alpha theta / rho c) dsigma/dt
    (Kelvin 1853). The rate of temperature is regressed on the rate of stress where that is fast, hence elastic; plastic heating has no
    part in it, and a lag of the sensor of some s is allowed for. Too few or contradictory samples give None.
    """
    found = thermoelastic_slope(time, stress, temperature)
    if found is None:
        return None
    slope, score = found
    if score < _SIGNIFICANT:
        return None
    return (
        f"the temperature rises by {slope:.2g} K per MPa in elastic tension, where it must fall: "
        "the sign of force and strain looks flipped (tension: negative?)"
    )


def thermoelastic_slope(time: np.ndarray, stress: np.ndarray, temperature: np.ndarray) -> tuple[float, float] | None:
    """Slope d theta / d sigma in elastic parts and its t value, at the lag where it is most significant; None for too few samples."""
    known = np.isfinite(time) & np.isfinite(stress) & np.isfinite(temperature)
    if known.sum() < _LEAST or np.ptp(stress[known]) == 0.0 or np.ptp(temperature[known]) == 0.0:
        return None
    t, sigma, theta = time[known], stress[known], temperature[known]
    step = _block_length(t, sigma)
    edges = np.arange(t[0], t[-1] + step, step)
    which = np.digitize(t, edges) - 1
    count = np.bincount(which, minlength=edges.size)
    full = count > 0
    mean_t, mean_sigma, mean_theta = (np.bincount(which, x, edges.size)[full] / count[full] for x in (t, sigma, theta))
    if mean_t.size < _LEAST:
        return None
    rate_sigma, rate_theta = np.diff(mean_sigma) / np.diff(mean_t), np.diff(mean_theta) / np.diff(mean_t)
    fast = np.abs(rate_sigma) > _FAST * np.quantile(np.abs(rate_sigma), 0.98)
    fits = [_slope(rate_sigma[: rate_sigma.size - lag], rate_theta[lag:], fast[: rate_sigma.size - lag]) for lag in range(_LAGS)]
    known_fits = [fit for fit in fits if fit is not None]
    return max(known_fits, key=lambda fit: abs(fit[1])) if known_fits else None


def _block_length(time: np.ndarray, stress: np.ndarray) -> float:
    """Length of the blocks whose means are compared, s: a fiftieth of the time in which the stress passes its range."""
    travel = float(np.abs(np.diff(stress)).sum())
    noise = float(np.median(np.abs(np.diff(stress)))) * (stress.size - 1)
    passes = max(1.0, (travel - noise) / float(np.ptp(stress)))
    duration = float(time[-1] - time[0])
    return max(duration / (50.0 * passes), duration / _BLOCKS, 2.0 * duration / max(1, time.size - 1))


def _slope(x: np.ndarray, y: np.ndarray, use: np.ndarray) -> tuple[float, float] | None:
    """Slope of y over x with a constant, and slope over its standard error."""
    x, y = x[use], y[use]
    if x.size < _LEAST or np.ptp(x) == 0.0:
        return None
    dx, dy = x - x.mean(), y - y.mean()
    slope = float(dx @ dy / (dx @ dx))
    error = float(np.sqrt(np.sum((dy - slope * dx) ** 2) / (x.size - 2) / (dx @ dx)))
    return slope, slope / max(error, 1e-12 * abs(slope), np.finfo(float).tiny)


def branch_suspicion(strain: np.ndarray, stress: np.ndarray) -> str | None:
    """A sentence where stress and strain contradict each other in sign, or where the whole test is one of compression; else None."""
    steps, rises = np.diff(strain), np.diff(stress)
    weight = float(np.sum(steps * rises))
    size = float(np.sqrt(np.sum(steps**2) * np.sum(rises**2)))
    peak = int(np.argmax(np.abs(stress)))
    if float(strain[peak] - strain[0]) * float(stress[peak] - stress[0]) < 0.0 and weight < -0.1 * size:
        return "the stress falls while the strain rises: the signs of both contradict each other (give tension for each of them)"
    if stress[peak] < 0.0 and float(stress.max()) < 0.2 * abs(float(stress[peak])):
        return (
            "all of the record is compression (stress and strain negative): a compression test, or the sign is flipped (tension: negative?)"
        )
    return None
