"""Noise of one field of displacements: the scatter of every point about the plane through its nearest neighbours."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

NEIGHBOURS = 12
"""Points of a plane besides the one that is judged: a patch of about four spacings, over which an elastic field is nearly linear."""
_MAD = 1.4826


def local_scatter(xy: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Robust standard deviation (n_c,) of u (n, n_c) about local planes over xy (n, 2) mm.

    The plane is that of the neighbours alone; the residual is divided by the square root of 1 + the leverage of the point, so that
    white noise is estimated without bias.
    """
    k = min(NEIGHBOURS, len(xy) - 1)
    _, near = cKDTree(xy).query(xy, k=k + 1)
    here, others = near[:, 0], near[:, 1:]
    offset = xy[others] - xy[here][:, None]
    scale = np.sqrt((offset**2).sum(axis=(1, 2)) / k)[:, None, None]
    a = np.concatenate([np.ones((len(xy), k, 1)), offset / scale], axis=2)
    weights = np.linalg.pinv(a)[:, 0]
    residual = u[here] - np.einsum("nk,nkc->nc", weights, u[others])
    gain = np.sqrt(1.0 + (weights**2).sum(axis=1))
    scaled = residual / gain[:, None]
    return np.asarray(_MAD * np.median(np.abs(scaled - np.median(scaled, axis=0)), axis=0))
