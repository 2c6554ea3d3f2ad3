"""Where, when and how strong a reconstructed term is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label

from thermofit.diagnose.unlisted_field import MissingField

KEPT = 0.3
"""Part of the largest rms over time from which a place belongs to the term."""
HALF = 0.5
"""Part of its plateau at which the term is said to begin and to end."""


@dataclass(frozen=True)
class Place:
    """Centroid and extent (standard deviation) in mm, time window s; `time` (n_k,) s and `strength` (n_k,) with its standard error: power
    in mW where volumes are known, else the mean coefficient; `size`: mean of strength in the window; `doubt`: its standard error beside
    fitted parameters, the ends of the window known to the distance of knots (`unlisted` adds what it moves by where these follow the
    term); `total`: its integral over it."""

    centroid: tuple[float, float]
    extent: tuple[float, float]
    when: tuple[float, float]
    time: np.ndarray
    strength: np.ndarray
    sigma: np.ndarray
    size: float
    doubt: float
    total: float


def compact(values: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Places (n_y, n_x) of the patch that stands out most from its standard error, and hangs together: there the rms over time of values
    (n_k, n_y, n_x, n_c), both as it is and over that of sigma (same shape), is above KEPT of the largest."""
    size, noise = (np.sqrt(np.mean(np.sum(v**2, axis=3), axis=0)) for v in (values, sigma))
    clear = size / np.maximum(noise, 1e-300)
    strong = (size >= KEPT * size.max()) & (clear >= KEPT * clear.max())
    top = np.unravel_index(int(np.argmax(np.where(strong, clear, 0.0))), size.shape)
    patches, _ = label(strong, structure=np.ones((3, 3)))
    return np.asarray(patches == patches[top])


def place_of(field: MissingField, volumes: np.ndarray | None) -> Place:
    """Place of a field. The strength over time is that of all its places together, with the sign of its largest part."""
    grid, values = field.basis.grid, field.values
    weights = np.ones(grid.places) / grid.places if volumes is None else volumes
    flat = values.reshape(len(grid.time), grid.places, grid.components)
    if grid.components == 1:
        strength = flat[:, :, 0] @ weights
        sigma = _sigma(field, weights)
    else:
        strength = np.sqrt(np.mean(np.sum(flat**2, axis=2), axis=1))
        sigma = np.zeros(len(grid.time))
    window = when_of(grid.time, grid.part, strength)
    inside = (grid.time >= window[0]) & (grid.time <= window[1])
    mean = np.abs(np.mean(flat[inside] if inside.any() else flat, axis=0)).sum(axis=1) * weights
    x, y = np.tile(grid.x, len(grid.y)), np.repeat(grid.y, len(grid.x))
    share = mean / max(float(mean.sum()), 1e-300)
    cx, cy = float(share @ x), float(share @ y)
    extent = (float(np.sqrt(share @ (x - cx) ** 2)), float(np.sqrt(share @ (y - cy) ** 2)))
    length = window[1] - window[0]
    mean_of = _mean_of(grid.time, window, int(np.argmax(np.abs(strength))))
    size = float(mean_of @ strength)
    # By places and components: how the strength at a knot follows its coefficients.
    slope = np.broadcast_to(weights[None, :, None], flat.shape)
    if grid.components != 1:
        slope = flat / (grid.places * np.maximum(strength, 1e-300)[:, None, None])
    along = (mean_of[:, None, None] * slope).ravel()[field.basis.chosen]
    own = field.posterior[: len(along), : len(along)]
    variance = max(float(along @ own @ along), 0.0)
    if length > 0.0:
        # Either end is as likely anywhere between two knots; power times length is what the data hold.
        between = float(np.interp(0.5 * sum(window), grid.time[:-1], np.diff(grid.time))) if len(grid.time) > 1 else 0.0
        variance += (size * between / length) ** 2 / 6.0
    doubt = float(np.sqrt(variance))
    return Place((cx, cy), extent, window, grid.time, strength, sigma, size, doubt, size * length)


def _mean_of(time: np.ndarray, window: tuple[float, float], strongest: int) -> np.ndarray:
    """Weights (n_k,) of the knots in the mean over a window; those of the strongest knot alone where it has no length."""
    if window[1] <= window[0]:
        return np.asarray(np.arange(len(time)) == strongest, dtype=float)
    at = np.linspace(window[0], window[1], 200)
    return np.stack([np.interp(at, time, row).mean() for row in np.eye(len(time))])


def _sigma(field: MissingField, weights: np.ndarray) -> np.ndarray:
    """Standard error (n_k,) of the weighted sum over places at every knot."""
    grid, chosen = field.basis.grid, field.basis.chosen
    k, place = np.unravel_index(chosen, (len(grid.time), grid.places))
    out = np.zeros(len(grid.time))
    for n in range(len(grid.time)):
        own = np.flatnonzero(k == n)
        w = weights[place[own]]
        out[n] = np.sqrt(max(float(w @ field.covariance[np.ix_(own, own)] @ w), 0.0))
    return out


def when_of(time: np.ndarray, part: np.ndarray, strength: np.ndarray) -> tuple[float, float]:
    """The window around the strongest time in which the term is above half of its plateau, the median of its upper values."""
    top = int(np.argmax(np.abs(strength)))
    own = np.flatnonzero(part == part[top])
    t, level = time[own], strength[own] * np.sign(strength[top])
    plateau = float(np.median(level[level >= HALF * level.max()]))
    at = int(np.flatnonzero(own == top)[0])
    return _crossing(t, level, HALF * plateau, at, -1), _crossing(t, level, HALF * plateau, at, 1)


def _crossing(t: np.ndarray, level: np.ndarray, limit: float, at: int, step: int) -> float:
    """Time at which the level falls below the limit on one side of index `at`; the end of the record where it does not."""
    k = at
    while 0 <= k + step < len(t) and level[k + step] >= limit:
        k += step
    if not 0 <= k + step < len(t):
        return float(t[k])
    a, b = level[k], level[k + step]
    return float(t[k] + (t[k + step] - t[k]) * (a - limit) / max(a - b, 1e-300))
