"""Signs of a coupon record against physics: a specimen cools in elastic tension, and its stress rises with its strain."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from thermofit.read.coupon_phases import turning_points

_BLOCK = 0.04
_SMALLEST_BRANCH = 0.1
_FAST = 0.5
_LAGS = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
_LEAST = 6
_SIGNIFICANT = 5.0
_TOGETHER = 0.5
_PARTS = 200
"""Parts of a record whose means are compared: single samples of a flow curve differ by their noise."""


def sign_suspicion(time: np.ndarray, stress: np.ndarray, temperature: np.ndarray) -> str | None:
    """A sentence where the temperature says that the sign of the stress is flipped, None where it does not.

    `time` s (n,), `stress` MPa or force (n,), `temperature` K (n,). Thermoelastic coupling: dtheta/dt = -(alpha theta / rho c) dsigma/dt
    (Kelvin 1853). The change of temperature is regressed on that of stress where the stress changes fast, hence elastically; plastic
    heating has no part in it, and a lag of the sensor is allowed for. Too few or contradictory samples give None.
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
    """Slope d theta / d sigma in elastic parts and its t value, at the lag of the sensor (0 to 3 s) where it is most significant.

    Every branch between two reversals of the stress is cut into pieces of 4 % of the range; the elastic ones are those in which the stress
    changes at least half as fast as anywhere in the branch. None for fewer than six of them.
    """
    known = np.isfinite(time) & np.isfinite(stress) & np.isfinite(temperature)
    t, sigma, theta = time[known], stress[known], temperature[known]
    rising = np.concatenate([[True], np.diff(t) > 0.0])
    t, sigma, theta = t[rising], sigma[rising], theta[rising]
    if t.size < 4 * _LEAST or np.ptp(sigma) == 0.0 or np.ptp(theta) == 0.0:
        return None
    pieces = _elastic_pieces(t, sigma)
    if len(pieces) < _LEAST:
        return None
    start, end = (np.array([piece[k] for piece in pieces]) for k in (0, 1))
    x = sigma[end] - sigma[start]
    fits = [_slope(x, np.interp(t[end] + lag, t, theta) - np.interp(t[start] + lag, t, theta)) for lag in _LAGS]
    return max(fits, key=lambda fit: abs(fit[1]))


def _elastic_pieces(time: np.ndarray, stress: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of every elastic piece."""
    pieces: list[tuple[int, int]] = []
    for a, b in pairwise(turning_points(time, stress)):
        change = float(stress[b] - stress[a])
        if abs(change) < _SMALLEST_BRANCH * np.ptp(stress) or b - a < 8:
            continue
        passed = np.maximum.accumulate((stress[a : b + 1] - stress[a]) * np.sign(change))
        levels = np.arange(0.0, abs(change), _BLOCK * float(np.ptp(stress)))
        edges = np.unique(a + np.searchsorted(passed, levels))
        rate = np.abs(np.diff(stress[edges]) / np.diff(time[edges]))
        if rate.size:
            pieces += [(int(edges[k]), int(edges[k + 1])) for k in np.flatnonzero(rate >= _FAST * rate.max())]
    return pieces


def _slope(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Slope of y over x and slope over its standard error; with a constant (heating in every piece) where x has both signs."""
    if x.min() < 0.0 < x.max():
        x, y = x - x.mean(), y - y.mean()
    slope = float(x @ y / (x @ x))
    error = float(np.sqrt(np.sum((y - slope * x) ** 2) / (x.size - 2) / (x @ x)))
    return slope, slope / max(error, 1e-12 * abs(slope), np.finfo(float).tiny)


def lateral_suspicion(strain: np.ndarray, lateral: np.ndarray) -> str | None:
    """A sentence where the lateral strain (n,), NaN in gaps, grows with the strain (n,), against every known metal; else None."""
    known = np.isfinite(strain) & np.isfinite(lateral)
    x, y = strain[known], lateral[known]
    if x.size < _LEAST or np.ptp(x) == 0.0 or np.ptp(y) == 0.0 or float(np.corrcoef(x, y)[0, 1]) < _TOGETHER:
        return None
    return (
        "the lateral strain grows with the strain, where the specimen must get narrower: contraction is positive in the file? (contraction)"
    )


def branch_suspicion(strain: np.ndarray, stress: np.ndarray) -> str | None:
    """A sentence where stress and strain contradict each other in sign, or where the whole test is one of compression; else None."""
    steps, rises = (np.diff([part.mean() for part in np.array_split(x, min(x.size, _PARTS))]) for x in (strain, stress))
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
