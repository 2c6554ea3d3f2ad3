"""Residuals that remember: how many independent ones a correlated record is worth, and what that does to standard errors.

A record of thousands of samples whose misfit is that of the model, not of the sensor, is worth far fewer independent values. The
correlation is estimated from the residual at the optimum, segment by segment, up to its first sign change, and tapered linearly to
zero (Newey and West, Econometrica 55, 1987), which keeps the covariance positive.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import fftconvolve

_LEAST = 8
"""A segment with fewer values is taken as white: its correlation cannot be estimated."""


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
