"""Two clocks: the offset between two recorders that saw the same signal, by cross-correlation and least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import fftconvolve

from thermofit.core.errors import DataError
from thermofit.measure.phases import noise_level

_MOST = 60_000
_OVERLAP = 0.5
_LEAST_CORRELATION = 0.9
_RIVAL = 4.0
_ROUNDS = 20


@dataclass(frozen=True)
class ClockOffset:
    """`offset` s: time of the second clock minus that of the first; `sigma` s its standard error; `correlation` of the repeated signal."""

    offset: float
    sigma: float
    correlation: float


def clock_offset(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> ClockOffset:
    """Offset between two clocks from (time, signal) of both, in any units and with either sign.

    Cross-correlation on a common grid over all lags with at least half of the shorter record in common, then least squares of
    f_1(t) = a f_2(t + offset) + b. DataError where no lag correlates, or where another one does as well.
    """
    t1, t2 = first[0], second[0]
    step = max(float(np.median(np.diff(t1))), float(np.median(np.diff(t2))), max(np.ptp(t1), np.ptp(t2)) / _MOST)
    x1, x2 = (np.interp(np.arange(t[0], t[-1], step), t, f) for t, f in (first, second))
    if min(x1.size, x2.size) < 8 or np.ptp(x1) == 0.0 or np.ptp(x2) == 0.0:
        raise DataError("the repeated signal is too short or constant in one of the files, expected the same force in both; give offset_s")
    lags, correlation = _correlations(x1, x2)
    strength = np.abs(correlation)
    best = int(np.argmax(strength))
    if strength[best] < _LEAST_CORRELATION:
        raise DataError(
            f"the repeated signals correlate by {strength[best]:.2f} at best, expected at least {_LEAST_CORRELATION}; "
            "name the column that repeats the force, or give offset_s"
        )
    _no_rival(strength, best, step)
    guess = float(t2[0] - t1[0] - lags[best] * step)
    offset, sigma = _refined(first, second, guess, step)
    return ClockOffset(offset, sigma, float(correlation[best]))


def _correlations(x1: np.ndarray, x2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lags (in steps, x2 shifted right by the lag lies on x1) and correlation coefficients of the common parts."""
    x1, x2 = x1 - x1.mean(), x2 - x2.mean()
    one1, one2 = np.ones_like(x1), np.ones_like(x2)

    def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.asarray(fftconvolve(a, b[::-1]))

    n = np.maximum(np.round(cross(one1, one2)), 1.0)
    s1, s2, s11, s22, s12 = cross(x1, one2), cross(one1, x2), cross(x1**2, one2), cross(one1, x2**2), cross(x1, x2)
    v1, v2 = s11 - s1**2 / n, s22 - s2**2 / n
    enough = (n >= _OVERLAP * min(x1.size, x2.size)) & (v1 > 1e-3 * x1.var() * n) & (v2 > 1e-3 * x2.var() * n)
    correlation = np.where(enough, (s12 - s1 * s2 / n) / np.sqrt(np.where(enough, v1 * v2, 1.0)), 0.0)
    return np.arange(1 - x2.size, x1.size), correlation


def _no_rival(strength: np.ndarray, best: int, step: float) -> None:
    """DataError where a separate peak leaves less than four times the unexplained variance of the best."""
    low = high = best
    while low > 0 and strength[low - 1] < strength[low]:
        low -= 1
    while high < strength.size - 1 and strength[high + 1] < strength[high]:
        high += 1
    others = np.concatenate([strength[:low], strength[high + 1 :]])
    if others.size and 1.0 - others.max() ** 2 < _RIVAL * (1.0 - strength[best] ** 2 + 1e-6):
        rival = int(np.flatnonzero(strength == others.max())[0])
        apart = abs(rival - best) * step
        raise DataError(
            f"the repeated signals fit at two offsets {apart:.3g} s apart (correlation {strength[best]:.4f} and {others.max():.4f}), "
            "expected one; give offset_s"
        )


def _refined(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray], guess: float, step: float) -> tuple[float, float]:
    """Least-squares offset near the guess and its standard error; neighbouring residuals that belong together are counted as one."""
    (t1, f1), (t2, f2) = first, second
    offset, sigma = guess, step
    for _ in range(_ROUNDS):
        inside = (t1 + offset > t2[0] + 2 * step) & (t1 + offset < t2[-1] - 2 * step)
        t, f = t1[inside] + offset, f1[inside]
        value = np.interp(t, t2, f2)
        slope = (np.interp(t + step, t2, f2) - np.interp(t - step, t2, f2)) / (2.0 * step)
        design = np.stack([value, np.ones_like(value)], axis=1)
        (gain, base), *_ = np.linalg.lstsq(design, f, rcond=None)
        residual, rate = f - gain * value - base, gain * slope
        # The offset's own column, cleaned of gain and base.
        rate = rate - design @ np.linalg.lstsq(design, rate, rcond=None)[0]
        power = float(rate @ rate)
        if power == 0.0:
            break
        change = float(np.clip(rate @ residual / power, -step, step))
        offset += change
        spread = float(np.sqrt(np.mean(residual**2)))
        white = noise_level(t1[inside], residual)
        sigma = spread / np.sqrt(power) * max(1.0, np.sqrt(_together(residual)) if spread > white else 1.0)
        if abs(change) < 1e-4 * step:
            break
    return offset, float(sigma)


def _together(residual: np.ndarray) -> float:
    """How many neighbouring residuals count as one: (1 + r) / (1 - r) with the autocorrelation r at lag one."""
    centred = residual - residual.mean()
    total = float(centred @ centred)
    r = float(centred[1:] @ centred[:-1]) / total if total > 0.0 else 0.0
    r = min(max(r, 0.0), 0.999)
    return (1.0 + r) / (1.0 - r)
