"""Linear functionals of the displacements of neighbouring points: differences (2.11) to (2.14), gradients (2.15) to (2.17), local planes.

Points may lie on a grid or anywhere. A neighbour lies in a triangle about the axis (figure 2.12b); where none lies on the axis itself,
the nearest ones on either side of it are weighted so that their mean does. So translation and small rotation leave du_xx and du_yy, and
the symmetric shear, exactly at zero on unstructured sets of points as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

_HALF_WIDTH = 0.5
"""Half width of the triangle in which a neighbour lies, over its length."""
_STRAIGHT = 0.02
"""A neighbour that is this much off the axis, over its distance, counts as lying on it."""
_RING = 1.5
"""Radius of a local plane in distances to the next points."""
_LEAST_POINTS = 4


@dataclass(frozen=True)
class Stencil:
    """Functionals D u of the displacements (n_s, 2) at one time: `matrix` D (m, 2 n_s), columns 2 s + c.

    `point` (m,) is the point that a functional belongs to, `component` (m,) 0 or 1 the displacement it is of, `kind` (m,) numbers the
    quantities (2.26 takes the largest of each), `unit` is theirs.
    """

    matrix: csr_array
    point: np.ndarray
    component: np.ndarray
    kind: np.ndarray
    unit: str

    def at(self, field: np.ndarray) -> np.ndarray:
        """Functionals (n_t, m) of a field (n_t, n_s, 2)."""
        return np.asarray((self.matrix @ field.reshape(len(field), -1).T).T)

    def measured(self, mask: np.ndarray) -> np.ndarray:
        """True (n_t, m) where all points of a functional are measured; mask (n_t, n_s)."""
        lost = np.repeat(~mask, 2, axis=1).astype(float)
        return np.asarray((abs(self.matrix) @ lost.T).T < 1e-300)


@dataclass(frozen=True)
class Neighbours:
    """Of every point that has them: `point` (m,), the neighbours (m, 2) whose weighted mean lies straight ahead, their weights (m, 2), and
    its distance mm (m,)."""

    point: np.ndarray
    other: np.ndarray
    weight: np.ndarray
    length: np.ndarray


def neighbours(xy: np.ndarray, direction: int, distance: float | None = None, reach: float | None = None) -> Neighbours:
    """Neighbours of points xy (n, 2) in the direction of x (0) or y (1); the nearest, or those nearest to `distance` mm ahead.

    A point without a neighbour straight ahead, or on both sides of that, within `reach` mm has none.
    """
    found = [_ahead(xy, s, direction, (distance, reach)) for s in range(len(xy))]
    kept = [(s, *one) for s, one in enumerate(found) if one is not None]
    point = np.array([k[0] for k in kept], dtype=int)
    other = np.array([k[1] for k in kept], dtype=int).reshape(-1, 2)
    weight = np.array([k[2] for k in kept], dtype=float).reshape(-1, 2)
    ahead = (xy[other, direction] * weight).sum(axis=1) - xy[point, direction]
    return Neighbours(point, other, weight, ahead)


def _ahead(
    xy: np.ndarray, s: int, direction: int, wanted: tuple[float | None, float | None]
) -> tuple[tuple[int, int], tuple[float, float]] | None:
    distance, reach = wanted
    away = xy - xy[s]
    along, across = away[:, direction], away[:, 1 - direction]
    near = (along > 1e-6) & (np.abs(across) < _HALF_WIDTH * along)
    if reach is not None:
        near &= along <= reach * (1.0 + 1e-9)
    index = np.flatnonzero(near)
    if not index.size:
        return None
    cost = (along[index] if distance is None else np.abs(along[index] - distance)) + np.abs(across[index])
    index = index[np.argsort(cost, kind="stable")]
    first = int(index[0])
    if abs(across[first]) <= _STRAIGHT * along[first]:
        return (first, first), (1.0, 0.0)
    beyond = index[across[index] * across[first] <= 0.0]
    if not beyond.size:
        return None
    second = int(beyond[0])
    share = float(across[second] / (across[second] - across[first]))
    return (first, second), (share, 1.0 - share)


def differences(
    xy: np.ndarray, components: tuple[str, ...], *, gradient: bool, distance: float | None = None, reach: float | None = None
) -> Stencil:
    """Differences (2.11) to (2.14) to the neighbour in mm; with `gradient` divided by its distance, xy then the mean of both shears (2.17).

    A component ij is displacement i along direction j.
    """
    ahead = {d: neighbours(xy, d, distance, reach) for d in {"xy".index(name[1]) for name in components} | ({0, 1} if gradient else set())}
    parts = []
    for kind, name in enumerate(components):
        i, j = "xy".index(name[0]), "xy".index(name[1])
        part = _difference(ahead[j], i, len(xy), gradient=gradient)
        if gradient and i != j:
            part = _mean(part, _difference(ahead[1 - j], 1 - i, len(xy), gradient=True))
        matrix, point = part
        parts.append((matrix, point, np.full(len(point), i), np.full(len(point), kind)))
    return _stacked(parts, len(xy), "1" if gradient else "mm")


Part = tuple[csr_array, np.ndarray]
"""Functionals (m, 2 n_s) and their points (m,)."""


def _difference(ahead: Neighbours, component: int, n: int, *, gradient: bool) -> Part:
    """u_here - u_ahead of one component, divided by the distance where it is a gradient."""
    m = len(ahead.point)
    scale = 1.0 / ahead.length if gradient else np.ones(m)
    row = np.tile(np.arange(m), 3)
    column = np.concatenate([ahead.point, ahead.other[:, 0], ahead.other[:, 1]])
    value = np.concatenate([scale, -scale * ahead.weight[:, 0], -scale * ahead.weight[:, 1]])
    return _sparse(value, row, 2 * column + component, (m, 2 * n)), ahead.point


def _mean(a: Part, b: Part) -> Part:
    """Mean of two functionals at the points that have both."""
    both, at_a, at_b = np.intersect1d(a[1], b[1], return_indices=True)
    return csr_array(0.5 * (a[0][at_a] + b[0][at_b])), both


def planes(xy: np.ndarray, components: tuple[str, ...], radius: float | None = None) -> Stencil:
    """Components xx, yy, xy (mean of both shears), or single derivatives "x,x", "x,y", "y,x", "y,y", of the plane through all points
    within `radius` mm of a point (least squares); None: the next ring of points. Points without a plane have none."""
    reach = ring(xy) if radius is None else radius
    slopes = [_slopes(xy, reach, direction) for direction in (0, 1)]
    parts = []
    for kind, name in enumerate(components):
        pairs = {"xx": [(0, 0)], "yy": [(1, 1)], "xy": [(0, 1), (1, 0)]}.get(name) or [("xy".index(name[0]), "xy".index(name[-1]))]
        made = [_of_component(slopes[j], i, len(xy)) for i, j in pairs]
        part = made[0] if len(made) == 1 else _mean(*made)
        parts.append((*part, np.full(len(part[1]), pairs[0][0]), np.full(len(part[1]), kind)))
    return _stacked(parts, len(xy), "1")


def ring(xy: np.ndarray) -> float:
    """Radius in mm that holds the next points in x and in y of a usual point."""
    usual = [np.median(found.length) for found in (neighbours(xy, 0), neighbours(xy, 1)) if len(found.length)]
    return _RING * float(max(usual, default=0.0))


def _slopes(xy: np.ndarray, radius: float, direction: int) -> Part:
    """d/dx (0) or d/dy (1) of scalars (n,) by the plane through the points near each, as (m, n), and the points that have one."""
    near = cKDTree(xy).query_ball_point(xy, radius * (1.0 + 1e-9))
    value: list[np.ndarray] = []
    row: list[np.ndarray] = []
    column: list[np.ndarray] = []
    point: list[int] = []
    for s, group in enumerate(near):
        index = np.array(sorted(group), dtype=int)
        away = xy[index] - xy[index].mean(axis=0)
        if len(index) < _LEAST_POINTS or np.linalg.matrix_rank(away, tol=0.1 * np.abs(away).max()) < 2:
            continue
        value.append(np.linalg.pinv(away)[direction])
        row.append(np.full(len(index), len(point)))
        column.append(index)
        point.append(s)
    if not point:
        return csr_array((0, len(xy))), np.zeros(0, dtype=int)
    found = _sparse(np.concatenate(value), np.concatenate(row), np.concatenate(column), (len(point), len(xy)))
    return found, np.array(point)


def _of_component(part: Part, component: int, n: int) -> Part:
    """The same functionals of one component of displacements."""
    entries = coo_array(part[0])
    return _sparse(entries.data, entries.coords[0], 2 * entries.coords[1] + component, (part[0].shape[0], 2 * n)), part[1]


def _sparse(value: np.ndarray, row: np.ndarray, column: np.ndarray, shape: tuple[int, int]) -> csr_array:
    matrix = csr_array((value, (row, column)), shape=shape)
    matrix.eliminate_zeros()
    return matrix


def _stacked(parts: list[tuple[csr_array, np.ndarray, np.ndarray, np.ndarray]], n: int, unit: str) -> Stencil:
    row, column, value, at = [], [], [], 0
    for matrix, *_ in parts:
        entries = coo_array(matrix)
        row.append(entries.coords[0] + at)
        column.append(entries.coords[1])
        value.append(entries.data)
        at += matrix.shape[0]
    whole = _sparse(np.concatenate(value), np.concatenate(row), np.concatenate(column), (at, 2 * n))
    point, component, kind = (np.concatenate([part[k] for part in parts]) for k in (1, 2, 3))
    return Stencil(whole, point, component, kind, unit)
