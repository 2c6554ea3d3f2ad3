"""Standard errors when the errors of neighbouring points are alike: correlation over distance, measured on the residual."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from thermofit.fit.linear_model import LinearModel
from thermofit.identify.solve import Solved
from thermofit.observe.triangles import point_spacing

_REACH = 0.1
"""Largest distance of a pair in units of the field's size."""
_GONE = 0.02
"""Correlation below which points at this distance and beyond count as independent."""
_MOST_PAIRS = 4_000_000


def correlogram(xy: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances mm (n_b,) and correlations (n_b,) of `error` (n, n_c) between points xy (n, 2), up to where it has died away."""
    spacing, reach = point_spacing(xy), _REACH * float(np.ptp(xy, axis=0).max())
    pairs = _pairs(xy, reach)
    away = np.linalg.norm(xy[pairs[:, 0]] - xy[pairs[:, 1]], axis=1)
    number = (away / spacing).astype(int)
    product = (error[pairs[:, 0]] * error[pairs[:, 1]]).mean(axis=1)
    count = np.bincount(number)
    rho = np.bincount(number, product) / np.maximum(count, 1) / float(np.mean(error**2))
    rho = np.where(count > 0, rho, np.nan)
    used = np.flatnonzero(count > 0)
    low = used[rho[used] < _GONE]
    end = low[0] if low.size else len(rho)
    keep = used[used < end]
    return (keep + 0.5) * spacing, np.minimum(rho[keep], 1.0)


def _pairs(xy: np.ndarray, reach: float) -> np.ndarray:
    """Pairs (n, 2) of points at most `reach` apart; fewer, of nearer points, where there would be too many."""
    tree = cKDTree(xy)
    while tree.count_neighbors(tree, reach) > 2 * _MOST_PAIRS:
        reach *= 0.8
    return tree.query_pairs(reach, output_type="ndarray")


def with_correlated_noise(solved: Solved) -> tuple[Solved, str]:
    """The same answer with standard errors for errors that are correlated as the residual is, and a remark; of one displacement field.

    The residual of a model that misfits is correlated too: what the model lacks widens the errors, it does not hide in them.
    """
    comparison, observation = solved.model.comparisons[0], solved.model.observations["u"]
    fit = solved.fit
    if solved.covariance is None or fit.jacobian is None or comparison.noise is not None or len(solved.model.comparisons) > 1:
        return solved, ""
    rows = comparison.rows
    points = rows[rows[:, 2] == 0, 1]
    field = np.stack([fit.residual[rows[:, 2] == c] for c in (0, 1)], axis=1)
    xy = observation.xy[points]
    distance, rho = correlogram(xy, field)
    if not distance.size:
        return solved, "errors of neighbouring points are independent"
    matrix = _matrix(xy, distance, rho)

    def noise(v: np.ndarray) -> np.ndarray:
        out = np.empty_like(v)
        for c in (0, 1):
            out[rows[:, 2] == c] = matrix @ v[rows[:, 2] == c]
        return out

    spread = LinearModel(fit.residual, fit.jacobian, noise).covariance(fit.names, fit.at_bound)
    ratio = float(np.max(spread.sigma / solved.covariance.sigma))
    if not np.isfinite(ratio) or ratio < 1.0:
        return solved, "standard errors hold white noise: the correlation of the residual would lower them"
    text = (
        f"errors of neighbouring points are correlated ({rho[0]:.2f} at {distance[0]:.1f} mm, gone at {distance[-1]:.1f} mm): standard "
        f"errors are up to {ratio:.1f} times those of independent points"
    )
    return dataclasses.replace(solved, covariance=spread), text


def _matrix(xy: np.ndarray, distance: np.ndarray, rho: np.ndarray) -> csr_array:
    """Correlation matrix (n, n) of one component: unit diagonal, `rho` at the distances between points, zero beyond."""
    step = distance[1] - distance[0] if len(distance) > 1 else 2.0 * distance[0]
    pairs = _pairs(xy, float(distance[-1] + 0.5 * step))
    value = np.interp(np.linalg.norm(xy[pairs[:, 0]] - xy[pairs[:, 1]], axis=1), distance, rho)
    n, diagonal = len(xy), np.arange(len(xy))
    i = np.concatenate([pairs[:, 0], pairs[:, 1], diagonal])
    j = np.concatenate([pairs[:, 1], pairs[:, 0], diagonal])
    return csr_array((np.concatenate([value, value, np.ones(n)]), (i, j)), shape=(n, n))
