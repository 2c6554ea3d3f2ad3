"""Linear interpolation between scattered points: in a non-degenerate triangle that contains the target, never outside.

Algorithms 2 and 3 of the thesis take the three closest points. These can be collinear (s and t are then 0/0), and the target may
lie outside their triangle, which is extrapolation. Here the triangle is that of the Delaunay triangulation around the target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

GAP_FACTOR = 3.0
"""A triangle with an edge longer than this many median point spacings bridges a hole of the field and is not used."""
LEAST_HEIGHT = 0.02
"""Smallest height over longest edge of a triangle; flatter ones are collinear points, which occur at the rim of the field."""
_ON_EDGE = 1e-9


@dataclass(frozen=True)
class Weights:
    """Value at a target = sum over its three points of weight * value: `index` (m, 3), `weight` (m, 3) >= 0 with sum 1, `inside` (m,).

    Where `inside` is False there is no triangle: the indices are 0 and the weights nan.
    """

    index: np.ndarray
    weight: np.ndarray
    inside: np.ndarray


def point_spacing(points: np.ndarray) -> float:
    """Median distance in mm of points (n, 2) to their nearest neighbours; nan for fewer than two points."""
    if len(points) < 2:
        return float("nan")
    distance, _ = cKDTree(points).query(points, k=2)
    return float(np.median(distance[:, 1]))


def triangle_weights(
    points: np.ndarray, targets: np.ndarray, valid: np.ndarray | None = None, max_distance: float | None = None
) -> Weights:
    """Weights of linear interpolation at targets (m, 2) mm from those points (n, 2) mm that are `valid` (n,).

    `max_distance` mm is the longest edge of a triangle (default: GAP_FACTOR median spacings of the valid points). Targets
    outside the triangulation, in a hole, or between collinear points only, are not inside. Algorithm 2.
    """
    targets = np.asarray(targets, dtype=float).reshape(-1, 2)
    number = np.arange(len(points)) if valid is None else np.flatnonzero(valid)
    index, weight = np.zeros((len(targets), 3), dtype=np.intp), np.full((len(targets), 3), np.nan)
    used = np.asarray(points, dtype=float)[number]
    simplex = np.full(len(targets), -1)
    if len(used) >= 3 and len(targets):
        longest = GAP_FACTOR * point_spacing(used) if max_distance is None else max_distance
        try:
            mesh = Delaunay(used)
        except QhullError:  # all points lie on one line
            mesh = None
        if mesh is not None:
            simplex = _find(mesh, _usable(used[mesh.simplices], longest), targets)
            found = simplex >= 0
            corner = mesh.simplices[simplex[found]]
            index[found] = number[corner]
            weight[found] = _barycentric(used[corner], targets[found])
    return Weights(index, weight, simplex >= 0)


def _usable(corner: np.ndarray, longest: float) -> np.ndarray:
    """True (n,) for triangles (n, 3, 2) that neither bridge a hole nor are flat."""
    edge = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    height = _doubled_area(corner) / np.maximum(edge, np.finfo(float).tiny)
    return np.asarray((edge <= longest) & (height >= LEAST_HEIGHT * edge))


def _doubled_area(corner: np.ndarray) -> np.ndarray:
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    return np.asarray(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def _find(mesh: Delaunay, usable: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Usable triangle (m,) around each target, -1 where there is none.

    A target on the common edge of a flat and a usable triangle belongs to the usable one, whichever was found.
    """
    simplex = mesh.find_simplex(targets, tol=_ON_EDGE)
    # Row -1 of `usable` is read where nothing was found; these stay -1 all the same.
    rejected = np.flatnonzero((simplex >= 0) & ~usable[simplex])
    answer = np.where((simplex >= 0) & usable[simplex], simplex, -1)
    for neighbour in mesh.neighbors[simplex[rejected]].T:
        candidate = np.flatnonzero((neighbour >= 0) & usable[neighbour])
        target = rejected[candidate]
        corner = mesh.points[mesh.simplices[neighbour[candidate]]]
        touches = _barycentric(corner, targets[target]).min(axis=1) >= -_ON_EDGE
        answer[target[touches]] = neighbour[candidate[touches]]
    return np.asarray(answer)


def _barycentric(corner: np.ndarray, target: np.ndarray) -> np.ndarray:
    """1 - s - t, s, t (m, 3) of Algorithm 2 for triangles (m, 3, 2) and targets (m, 2)."""
    a, b, p = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], target - corner[:, 0]
    determinant = b[:, 1] * a[:, 0] - b[:, 0] * a[:, 1]
    s = (b[:, 1] * p[:, 0] - b[:, 0] * p[:, 1]) / determinant
    t = (a[:, 0] * p[:, 1] - a[:, 1] * p[:, 0]) / determinant
    return np.stack([1.0 - s - t, s, t], axis=1)
