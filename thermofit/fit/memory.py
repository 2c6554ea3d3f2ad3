"""Residuals that remember: how many independent ones a correlated record is worth, and what that does to standard errors.

A record of thousands of samples whose misfit is that of the model, not of the sensor, is worth far fewer independent values. The
correlation is estimated from the residual at the optimum, segment by segment, up to its first sign change, and tapered linearly to
zero (Newey and West, Econometrica 55, 1987), which keeps the covariance positive.

That takes what the model misses for noise. Where the two have to be told apart, noise is what neighbours differ by: second differences
of means over one, two and four samples, which a smooth misfit hardly changes, give its size and the correlation of neighbours of an
autoregressive process of first order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import fftconvolve, lfilter

_LEAST = 8
"""A segment with fewer values is taken as white: its correlation cannot be estimated."""
_MEANS = (1, 2, 4)
"""Samples over which means are taken, whose differences tell the noise."""
_RHO = np.linspace(0.0, 0.95, 96)
"""Correlations of neighbours that are tried."""
_WHITE = 0.15
"""Correlation of neighbours below which noise counts as white: that of white noise comes out as large by chance."""
_SMOOTH = 1.5
"""Times the largest growth of v from one mean to the next that an autoregressive process makes; beyond, it is a smooth misfit."""
_DEGREE, _POINTS = 3, 3
"""Degree in the place of what counts as smooth, and points at a time for each of its coefficients at least."""
_MEDIAN = 0.4549
"""Median of chi-square with one degree of freedom."""


@dataclass(frozen=True)
class Memory:
    """Tapered correlation (n_lags,) of one segment from lag 0 on, its place in the residual, its rms over that of the whole residual."""

    part: slice
    correlation: np.ndarray
    size: float

    @property
    def n(self) -> int:
        """Number of values."""
        return int(self.part.stop - self.part.start)

    @property
    def independent(self) -> float:
        """Number of independent values that the segment is worth: n / (1 + 2 sum rho), at most n."""
        return self.n / max(float(2.0 * self.correlation.sum() - 1.0), 1.0)


def memories(residual: np.ndarray, lengths: Sequence[int]) -> tuple[Memory, ...]:
    """Memory of every segment of a residual (n,); `lengths` add up to n. ValueError where they do not."""
    if sum(lengths) != len(residual):
        raise ValueError(f"segments of {sum(lengths)} values for a residual of {len(residual)}")
    whole, out, at = float(np.sqrt(np.mean(residual**2))), [], 0
    for length in lengths:
        part = slice(at, at + length)
        r = residual[part]
        rms = float(np.sqrt(np.mean(r**2)))
        out.append(Memory(part, tapered_correlation(r), rms / whole if whole > 0.0 else 1.0))
        at += length
    return tuple(out)


def tapered_correlation(r: np.ndarray) -> np.ndarray:
    """Correlation (n_lags,) of a sequence with itself, its mean not taken off: from 1 at lag 0 on, with a linear taper that ends at twice
    the lag of its first sign change."""
    n = len(r)
    if n < _LEAST or not np.any(r):
        return np.ones(1)
    product = fftconvolve(r, r[::-1])[n - 1 :]
    rho = product / product[0]
    below = np.flatnonzero(rho <= 0.0)
    width = min(2 * int(below[0]) if len(below) else n, n)
    tapered = rho[:width] * (1.0 - np.arange(width) / width)
    # A residual that alternates is that of white noise after a fit: errors are never taken smaller for it.
    return np.ones(1) if 2.0 * tapered.sum() - 1.0 < 1.0 else np.asarray(tapered)


def noise_operator(found: Sequence[Memory]) -> Callable[[np.ndarray], np.ndarray]:
    """Applies the covariance of the residual, in units of its mean square, to columns (n, k)."""

    def apply(columns: np.ndarray) -> np.ndarray:
        out = np.empty_like(columns)
        for memory in found:
            rho = memory.correlation
            kernel = np.concatenate([rho[:0:-1], rho])[:, None]
            full = fftconvolve(columns[memory.part], kernel, axes=0)
            out[memory.part] = memory.size**2 * full[len(rho) - 1 : len(rho) - 1 + memory.n]
        return out

    return apply


@dataclass(frozen=True)
class NeighbourNoise:
    """Noise as neighbouring samples show it: variance of one sample, and correlation rho of one with the next."""

    variance: float
    rho: float

    @property
    def of_sums(self) -> float:
        """Variance of the sum of many samples over their number: variance (1 + rho) / (1 - rho)."""
        return self.variance * (1.0 + self.rho) / (1.0 - self.rho)

    def of_blocks(self, v: float) -> float:
        """The same of sums over places, which have a variance of their own, from the v of their second differences in time."""
        return v / float(_of_means(1, np.array([self.rho]))[0]) * (1.0 + self.rho) / (1.0 - self.rho)

    def lag(self, least: float) -> float:
        """Samples after which the correlation is below `least`."""
        return float(np.log(least) / np.log(self.rho)) if self.rho > 0.0 else 0.0


def differences(r: np.ndarray, place: np.ndarray, time: np.ndarray) -> tuple[float, int]:
    """v from second differences in time of sums over places, each in units of what white noise of unit variance gives, by their median; and
    how many there are. `place` and `time` (n,) number the series of every value of r (n,) and where it stands in it."""
    shape = (int(place.max(initial=0)) + 1, int(time.max(initial=0)) + 1)
    if shape[1] < 5:
        return 1.0, 0
    flat = place * shape[1] + time
    sums = np.bincount(flat, r, shape[0] * shape[1]).reshape(shape)
    count = np.bincount(flat, minlength=shape[0] * shape[1]).reshape(shape).astype(float)
    known = count > 0
    level = np.where(known, sums / np.sqrt(np.maximum(count, 1.0)), 0.0)
    three = known[:, :-2] & known[:, 1:-1] & known[:, 2:]
    second = (level[:, :-2] - 2.0 * level[:, 1:-1] + level[:, 2:])[three]
    return (float(np.median(second**2) / 6.0 / _MEDIAN), len(second)) if len(second) > 4 else (1.0, 0)


def _of_means(m: int, rho: np.ndarray) -> np.ndarray:
    """v of means over m samples of an autoregressive process of unit variance: (6 g0 - 8 g1 + 2 g2) / 6, g_k the covariance of the sums
    over m samples that lie k groups apart, over m."""
    step = np.subtract.outer(np.arange(m), np.arange(m))
    g = [np.sum(rho[:, None, None] ** np.abs(step + k * m), axis=(1, 2)) / m for k in range(3)]
    return np.asarray((6.0 * g[0] - 8.0 * g[1] + 2.0 * g[2]) / 6.0)


def neighbours(r: np.ndarray, place: np.ndarray, time: np.ndarray) -> NeighbourNoise:
    """Noise of series of samples, see `differences`, by least squares over _MEANS of log v. Differences tell little of what changes slowly,
    but no more of it is noise than there is at all: its variance is at most the mean square of r. Where a misfit is large beside the noise
    its curvature shows in the longer means: v grows with m^5, which no such noise makes, and these are left out."""
    found = [(m, *differences(r, place, time // m)) for m in _MEANS]
    used: list[tuple[int, float, int]] = []
    for m, v, n in found:
        if not n or v <= 0.0:
            continue
        if used and v > _SMOOTH * used[-1][1] * float(np.max(_of_means(m, _RHO) / _of_means(used[-1][0], _RHO))):
            break
        used.append((m, v, n))
    if not used:
        return NeighbourNoise(found[0][1], 0.0)
    weight = np.array([n for _, _, n in used], dtype=float)
    log = np.array([np.log(v) - np.log(_of_means(m, _RHO)) for m, v, _ in used])
    level = weight @ log / weight.sum()
    possible = np.exp(level) <= max(float(np.mean(r**2)), float(np.exp(level[0])))
    wrong = np.where(possible, weight @ (log - level) ** 2, np.inf)
    best = int(np.argmin(wrong)) if len(used) > 1 else 0
    if _RHO[best] < _WHITE:
        return NeighbourNoise(found[0][1], 0.0)
    return NeighbourNoise(float(np.exp(level[best])), float(_RHO[best]))


def rough_in_place(r: np.ndarray, component: np.ndarray, time: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """What smooth functions of the place leave of r (n,): at every time (n,), and of every component (n,), the polynomial of degree _DEGREE
    in xy (n, 2) that fits best is taken off. What a model misses of a field is smooth in place, its noise is not, and keeps its variance.
    Empty where so few points are seen at a time that little would be left."""
    at = 2.0 * (xy - xy.mean(axis=0)) / np.maximum(np.ptp(xy, axis=0), 1e-300) if len(xy) else xy
    powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    basis = np.stack([at[:, 0] ** i * at[:, 1] ** j for i, j in powers], axis=1)
    out, order = np.empty_like(r), np.lexsort((component, time))
    at_once = np.flatnonzero(np.any(np.diff(np.stack([time[order], component[order]]), axis=1) != 0, axis=0)) + 1
    for own in np.split(order, at_once):
        if len(own) < _POINTS * len(powers):
            return np.zeros(0)
        left = r[own] - basis[own] @ np.linalg.lstsq(basis[own], r[own], rcond=1e-10)[0]
        out[own] = left * np.sqrt(len(own) / (len(own) - len(powers)))
    return out


def autoregressive(series: np.ndarray, sample: np.ndarray, rho: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Applies C, C_ij = rho^|sample_i - sample_j| within each series and none between them, to columns (n, k): a filter forwards and one
    backwards. `series` and `sample` (n,) number the series of every row and its place there, `rho` (n_series,) is that of each."""
    parts = []
    for one in np.unique(rho[rho > 0.0]):
        own = np.flatnonzero(np.isin(series, np.flatnonzero(rho == one)))
        parts.append((float(one), own, sample[own], np.unique(series[own], return_inverse=True)[1]))

    def apply(columns: np.ndarray) -> np.ndarray:
        out = columns.astype(float).copy()
        for one, own, at, column in parts:
            full = np.zeros((int(at.max()) + 1, int(column.max()) + 1, columns.shape[1]))
            full[at, column] = columns[own]
            ahead, back = (lfilter([1.0], [1.0, -one], v, axis=0) for v in (full, full[::-1]))
            out[own] = (ahead + back[::-1] - full)[at, column]
        return out

    return apply
