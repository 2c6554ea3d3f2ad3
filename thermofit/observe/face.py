"""Outer face of the finite-element model as the cameras see it: bilinear interpolation and its inverse.

The model is the quarter x >= 0, z >= 0; the whole face follows by symmetry (x -> -x, u_x -> -u_x).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import NumericsError, StudyError

_ROUNDS = 40
_MAP_TOLERANCE = 1e-6
"""mm; a thousandth of the in-plane DIC noise."""


@dataclass(frozen=True)
class FaceGrid:
    """Face nodes in rows of constant y: `order` (n_y, n_x) node indices, `x` (n_y, n_x) mm increasing from 0, `y` (n_y,) mm."""

    order: np.ndarray
    x: np.ndarray
    y: np.ndarray

    @property
    def half_width(self) -> np.ndarray:
        """Half width in mm (n_y,) of every row."""
        return np.asarray(self.x[:, -1])


@dataclass(frozen=True)
class PlaceOnFace:
    """Where points lie on the face: `row`, `column` of the quadrilateral, its coordinates `xi`, `eta` in [0, 1], and the
    `sign` of x; all (n_p,). Points outside are moved to the nearest place of their row.
    """

    row: np.ndarray
    column: np.ndarray
    xi: np.ndarray
    eta: np.ndarray
    sign: np.ndarray


def face_grid(nodes: np.ndarray) -> FaceGrid:
    """Rows and columns of the face nodes (n_n, 2) mm given in any order; StudyError where they form no such grid."""
    tolerance = 1e-6 * float(np.ptp(nodes[:, 1]))
    by_y = np.argsort(nodes[:, 1], kind="stable")
    starts = np.concatenate([[0], np.flatnonzero(np.diff(nodes[by_y, 1]) > tolerance) + 1, [len(nodes)]])
    counts = np.diff(starts)
    if counts.size < 2 or counts.min() != counts.max() or counts[0] < 2:
        raise StudyError(
            f"virtual experiment: the {len(nodes)} nodes of the outer face lie in rows of {counts.min()} to {counts.max()} nodes, expected "
            "at least two rows of equal length along x; use the dogbone mesh"
        )
    rows = by_y.reshape(-1, counts[0])
    order = np.take_along_axis(rows, np.argsort(nodes[rows, 0], axis=1), axis=1)
    x = nodes[order, 0]
    if np.abs(x[:, 0]).max() > tolerance or np.diff(x, axis=1).min() <= 0.0:
        raise StudyError("virtual experiment: the outer face must span x = 0 to half the width (quarter model); use the dogbone mesh")
    return FaceGrid(order, x, nodes[order, 1].mean(axis=1))


def is_face_grid(nodes: np.ndarray) -> bool:
    """True where face nodes (n_n, 2) mm are the rows and columns of a quarter model."""
    try:
        face_grid(nodes)
    except StudyError:
        return False
    return True


def locate(grid: FaceGrid, points: np.ndarray) -> PlaceOnFace:
    """Quadrilateral and natural coordinates of reference points (n_p, 2) mm.

    The rows are level, so eta follows from y alone and xi from x on the row interpolated in between: no iteration.
    """
    y = np.clip(points[:, 1], grid.y[0], grid.y[-1])
    row = np.clip(np.searchsorted(grid.y, y, side="right") - 1, 0, len(grid.y) - 2)
    eta = (y - grid.y[row]) / (grid.y[row + 1] - grid.y[row])
    columns = grid.x[row] * (1.0 - eta)[:, None] + grid.x[row + 1] * eta[:, None]
    x = np.minimum(np.abs(points[:, 0]), columns[:, -1])
    column = np.clip((columns <= x[:, None]).sum(axis=1) - 1, 0, grid.x.shape[1] - 2)
    pick = np.arange(len(x))
    left, right = columns[pick, column], columns[pick, column + 1]
    return PlaceOnFace(row, column, (x - left) / (right - left), eta, np.where(points[:, 0] < 0.0, -1.0, 1.0))


def interpolate(place: PlaceOnFace, values: np.ndarray) -> np.ndarray:
    """Bilinear values (n_p, ...) at places, from `values` (n_y, n_x, ...) on the grid; scalars and even components."""
    shape = (-1,) + (1,) * (values.ndim - 2)
    xi, eta = place.xi.reshape(shape), place.eta.reshape(shape)
    r, c = place.row, place.column
    low = values[r, c] * (1.0 - xi) + values[r, c + 1] * xi
    high = values[r + 1, c] * (1.0 - xi) + values[r + 1, c + 1] * xi
    return np.asarray(low * (1.0 - eta) + high * eta)


def displacement_at(place: PlaceOnFace, u: np.ndarray) -> np.ndarray:
    """Displacement (n_p, k) mm at places from `u` (n_y, n_x, k) mm; u_x changes its sign across the symmetry plane."""
    value = interpolate(place, u)
    value[:, 0] *= place.sign
    return value


def outline(grid: FaceGrid, y: np.ndarray) -> np.ndarray:
    """Half width in mm (n_p,) of the undeformed face at `y` (n_p,)."""
    return np.asarray(np.interp(y, grid.y, grid.half_width))


def _row_stretch(grid: FaceGrid, u: np.ndarray) -> np.ndarray:
    """Mean stretch (n_y, 2) across and along every row: the diagonal that makes the inverse map contract quickly."""
    across = 1.0 + u[:, -1, 0] / grid.half_width
    along = 1.0 + np.gradient(u[..., 1].mean(axis=1), grid.y)
    return np.stack([across, along], axis=1)


def invert_motion(grid: FaceGrid, u: np.ndarray, current: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Reference positions X (n_p, 2) mm of points at `current` (n_p, 2) mm: X + u(X) = x, with u (n_y, n_x, >=2) mm.

    Outside the face u is continued by its value at the edge, so that X tells inside from outside exactly. `guess` is
    usually the answer of the frame before. NumericsError where the map does not converge.
    """
    stretch = np.maximum(_row_stretch(grid, u), 0.2)
    reference = guess.copy()
    active = np.arange(len(current))
    for _ in range(_ROUNDS):
        place = locate(grid, reference[active])
        error = current[active] - reference[active] - displacement_at(place, u[..., :2])
        inside_x = np.abs(reference[active, 0]) <= outline(grid, reference[active, 1])
        inside_y = (reference[active, 1] >= grid.y[0]) & (reference[active, 1] <= grid.y[-1])
        inside = np.stack([inside_x, inside_y], axis=1)
        # Outside, the continued map has unit slope in that direction.
        reference[active] += error / np.where(inside, stretch[place.row], 1.0)
        active = active[np.abs(error).max(axis=1) > _MAP_TOLERANCE]
        if active.size == 0:
            return reference
    raise NumericsError(
        f"virtual experiment: {active.size} of {len(current)} points of the deformed face could not be traced back to the undeformed one; "
        "the simulated strains are too large or the mesh is folded"
    )
