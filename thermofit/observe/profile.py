"""Profiles along the load: means of an observed field over the width, and integrals of them against a weight that is zero at both rims.

With w(y) = (1 - s^2)^2 on a piece, s from -1 at one rim to 1 at the other, w and dw/dy vanish at the rims. So derivatives of what was
measured go over to w by parts and nothing noisy is differentiated:

    int w e,y dy = -int w,y e dy,     int w e,yy dy = int w,yy e dy.

Between rows the profile is straight. Integrals of hats against w and its derivatives are exact but for the quadrature of w itself, so
that a constant has no first derivative and a straight line no second one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array

from thermofit.observe.triangles import point_spacing

_FINE = 400
"""Places at which a weight is summed over a piece."""
_ROW = 1e-3
"""mm; points whose y differs by less lie in one row."""
_MEDIAN = 0.4549
"""Median of chi-square with one degree of freedom."""
_INDEPENDENT = 4.0
"""Rows of a profile that are taken for independent of each other at most."""
_SURE = 3.0
"""Standard errors by which the scatter between times has to exceed the noise before it replaces that."""


@dataclass(frozen=True)
class RowProfile:
    """Rows y (n_b,) mm along the load, `gather` (n_b, n_s) which point lies in which, and `mask` (n_t, n_s) of the points that count."""

    y: np.ndarray
    gather: csr_array
    mask: np.ndarray

    @property
    def count(self) -> np.ndarray:
        """Points (n_t, n_b) in every mean."""
        return np.asarray((self.gather @ self.mask.T.astype(float)).T)

    def mean(self, field: np.ndarray) -> np.ndarray:
        """Means (n_t, n_b) of a field (n_t, n_s) over its rows; zero where a row has no point (`count`)."""
        total = (self.gather @ np.where(self.mask, field, 0.0).T).T
        return np.asarray(total / np.maximum(self.count, 1.0))

    def sigma(self, sigma: np.ndarray) -> np.ndarray:
        """Standard errors (n_t, n_b) of the means for independent points of standard error sigma (n_t, n_s)."""
        total = (self.gather @ np.where(self.mask, sigma**2, 0.0).T).T
        return np.asarray(np.sqrt(total) / np.maximum(self.count, 1.0))


def profile_of(xy: np.ndarray, mask: np.ndarray) -> RowProfile:
    """Profile of points xy (n_s, 2) mm with a mask (n_t, n_s): rows of a grid as they are, else bands as wide as the points lie apart."""
    y = np.round(xy[:, 1] / _ROW) * _ROW
    rows, label = np.unique(y, return_inverse=True)
    if len(rows) > max(2.0 * np.sqrt(len(xy)), 2.0):
        step = point_spacing(xy)
        band = np.floor((y - y.min()) / step).astype(int)
        _, label = np.unique(band, return_inverse=True)
        rows = np.bincount(label, y) / np.bincount(label)
    gather = csr_array(coo_array((np.ones(len(xy)), (label, np.arange(len(xy)))), shape=(len(rows), len(xy))))
    return RowProfile(rows, gather, mask)


def bump(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """w = (1 - s^2)^2 and its first two derivatives by s; zero outside of -1 to 1."""
    inside = np.abs(s) < 1.0
    one = 1.0 - s**2
    return inside * one**2, inside * (-4.0 * s * one), inside * (12.0 * s**2 - 4.0)


def integrals(knots: np.ndarray, centre: float, half: float) -> np.ndarray:
    """Integrals (3, n) of the hats at increasing knots (n,) against w, w' and w'' of a piece from centre - half to centre + half."""
    s = (np.arange(_FINE) + 0.5) / _FINE * 2.0 - 1.0
    at, step = centre + half * s, 2.0 * half / _FINE
    n = len(knots)
    left = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, max(n - 2, 0))
    right = np.minimum(left + 1, n - 1)
    share = np.clip((at - knots[left]) / np.maximum(knots[right] - knots[left], 1e-12), 0.0, 1.0)
    out = np.zeros((3, n))
    for k, weight in enumerate(bump(s)):
        value = weight * step / half**k
        out[k] = np.bincount(left, (1.0 - share) * value, n) + np.bincount(right, share * value, n)
    return out


def spans_piece(knots: np.ndarray, centre: float, half: float, widest: float) -> bool:
    """True where knots (n,) reach from rim to rim of a piece, up to `widest` at each end, and lie nowhere farther apart than that."""
    inside = knots[(knots >= centre - half - widest) & (knots <= centre + half + widest)]
    if len(inside) < 3:
        return False
    ends = max(inside[0] - (centre - half), (centre + half) - inside[-1])
    return bool(ends <= 0.5 * widest and np.diff(inside).max() <= widest)


def excess_noise(value: np.ndarray, sigma: np.ndarray, time: np.ndarray, known: np.ndarray) -> float:
    """By how much the scatter of a profile (n_t, n_b) between neighbouring times exceeds its noise sigma (n_t, n_b), as a factor of
    sigma; `known` (n_t, n_b) are the measured ones. One where it does not, by three standard errors.

    Neighbouring points share noise, which a mean over the width does not reduce as it would independent noise. What is smooth in time
    does not count: every value is compared with the straight line between the one before and the one after.
    """
    if len(time) < 5:
        return 1.0
    w = ((time[1:-1] - time[:-2]) / (time[2:] - time[:-2]))[:, None]
    off = value[1:-1] - (1.0 - w) * value[:-2] - w * value[2:]
    variance = sigma[1:-1] ** 2 + ((1.0 - w) * sigma[:-2]) ** 2 + (w * sigma[2:]) ** 2
    used = known[1:-1] & known[:-2] & known[2:] & (variance > 0.0)
    n = int(used.sum())
    if n < 10:
        return 1.0
    ratio = float(np.median(off[used] ** 2 / variance[used])) / _MEDIAN
    # The median of n independent squares has a relative standard error of 2.3 / sqrt(n); rows that share noise count as _INDEPENDENT.
    error = 2.3 / np.sqrt(n * min(1.0, _INDEPENDENT / known.shape[1]))
    return float(np.sqrt(ratio)) if ratio > 1.0 + _SURE * error else 1.0
