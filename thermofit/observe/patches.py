"""Patch of a node: the material points that are nearer to it than to any other node of the face; and what a mean over it shows of a field.

The mean of a field theta over the n measured points of a patch, at dx, dy from the node, is to second order in the size of the patch

    (S theta)_i = theta_i + m_x theta,x + m_y theta,y + m_xx theta,xx + m_xy theta,xy + m_yy theta,yy

with the moments m_x = mean dx, m_y = mean dy, m_xx = mean dx^2 / 2, m_xy = mean dx dy, m_yy = mean dy^2 / 2 of those very points.
The derivatives at the node are those of the quadratic through the nodes around it. So S is exact for linear and quadratic fields, whatever
points a patch holds; what is left out is of the third order in the size of the patch. A mean that was measured is compared with S of the
prediction: smoothing is then no bias.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

MOMENTS = 5
"""m_x, m_y (mm), m_xx, m_xy, m_yy (mm^2)."""
_AROUND = 24
"""Nodes about a node, nearest first, of which the quadratic is made."""
_RANGE = 1.2
"""Distance, over that of the next nodes, at which the weight of a node in the quadratic has fallen to 1/e."""
_RANK = 1e-9
"""Singular values below this share of the largest count as zero: fields that the nodes do not tell apart have no derivative."""


def terms(away: np.ndarray) -> np.ndarray:
    """dx, dy, dx^2/2, dx dy, dy^2/2 (..., 5) of distances (..., 2) mm: the factors of the derivatives in Taylor's series."""
    dx, dy = away[..., 0], away[..., 1]
    return np.stack([dx, dy, 0.5 * dx**2, dx * dy, 0.5 * dy**2], axis=-1)


def averaged(field: np.ndarray, moments: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """S of a field (n_t, n_s, ...) at nodes xy (n_s, 2) mm, with the moments (n_t, n_s, 5) of its patches at every time."""
    near, by = _quadratics(np.ascontiguousarray(xy, dtype=float).tobytes())
    out = np.array(field)
    # One operator for every time: a node's own value, and what the moments there make of the derivatives.
    for shown, value, own in zip(out, field, moments, strict=True):
        weight = np.einsum("sk,skj->sj", own, by)
        shown += (_rows(near, weight) @ value.reshape(len(value), -1)).reshape(value.shape)
    return out


def derivatives(xy: np.ndarray) -> csr_array:
    """Operator (5 n_s, n_s) that gives the derivatives x, y, xx, xy, yy of a field at every node xy (n_s, 2) mm, one kind after the other.

    They are those of the quadratic through the node's own value that fits the nodes around it best, near ones most.
    """
    near, by = _quadratics(np.ascontiguousarray(xy, dtype=float).tobytes())
    return _rows(np.tile(near, (MOMENTS, 1)), np.concatenate([by[:, k] for k in range(MOMENTS)]), len(near))


def _rows(near: np.ndarray, weight: np.ndarray, n: int | None = None) -> csr_array:
    """Operator (n_rows, n) of weights (n_rows, k) on the nodes `near` (n_rows, k); n is n_rows unless given."""
    begins = np.arange(len(near) + 1) * near.shape[1]
    return csr_array((weight.ravel(), near.ravel(), begins), shape=(len(near), len(near) if n is None else n))


@lru_cache(maxsize=16)
def _quadratics(given: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Nodes about each node and itself behind them (n, k), and the factors (n, 5, k) of their values in its derivatives."""
    xy = np.frombuffer(given).reshape(-1, 2)
    n = len(xy)
    if n < 2:
        return np.zeros((n, 0), dtype=int), np.zeros((n, MOMENTS, 0))
    size = spacings(xy)
    count = min(_AROUND + 1, n)
    near = cKDTree(xy / size).query(xy / size, k=count)[1].reshape(n, count)
    away = (xy[near] - xy[:, None, :]) / size
    weight = np.exp(-0.5 * (away**2).sum(axis=2) / _RANGE**2)
    # The fit is of differences to the node's own value: (W A) d = W (theta_j - theta_i).
    fit = np.linalg.pinv(weight[:, :, None] * terms(away), rcond=_RANK) * weight[:, None, :]
    fit /= terms(size)[None, :, None] * np.array([1.0, 1.0, 2.0, 1.0, 2.0])[None, :, None]
    own = np.arange(n)[:, None]
    return np.concatenate([near, own], axis=1), np.concatenate([fit, -fit.sum(axis=2, keepdims=True)], axis=2)


def spacings(xy: np.ndarray) -> np.ndarray:
    """Usual distance (2,) mm of a node to the next one in x and in y: the median over nodes of the nearest in the cone about each axis."""
    near = cKDTree(xy).query(xy, k=min(2 * _AROUND, len(xy)))[1].reshape(len(xy), -1)
    away = np.abs(xy[near] - xy[:, None, :])
    spread = np.ptp(xy, axis=0)
    whole = float(spread.max())
    usual = []
    for axis in range(2):
        ahead = np.where((away[..., axis] > 1e-9 * whole) & (away[..., 1 - axis] < 0.5 * away[..., axis]), away[..., axis], np.inf)
        nearest = ahead.min(axis=1)
        found = nearest[np.isfinite(nearest)]
        usual.append(float(np.median(found)) if len(found) else whole)
    return np.array(usual)
