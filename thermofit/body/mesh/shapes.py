"""Meshes of simple shapes: straight bar, plate with a hole, arm of a cruciform; x across, y along the load, z through the thickness."""

from __future__ import annotations

import numpy as np

from thermofit.body.mesh.mesh import Mesh, structured_hexes
from thermofit.body.mesh.planes import planes, split_at
from thermofit.body.mesh.sets import mirrored, tension_sets
from thermofit.core.errors import StudyError
from thermofit.core.experiment import Specimen
from thermofit.study.section import MeshSize

_GRADING = 1.4
"""Exponent of the radial positions around a hole: elements are smallest where stresses concentrate."""


def bar_mesh(specimen: Specimen, size: MeshSize, *, full: bool = False) -> Mesh:
    """Straight bar of gauge_width x thickness x total_length: quarter model, or the whole one with n_x, n_z elements on either side."""
    width, thickness, length = 0.5 * specimen.gauge_width, 0.5 * specimen.thickness, specimen.total_length
    y = _with_jaws(length, specimen.gripped_length, size.n_y)
    nodes, hexes = _swept(y, np.full(len(y), width), thickness, size)
    if full:
        nodes, hexes = mirrored(*mirrored(nodes, hexes, 0), 2)
    return tension_sets(nodes, hexes, specimen.gripped_length)


def _with_jaws(length: float, gripped: float, n_y: int) -> np.ndarray:
    """Node planes (n_y + 1,) of a bar from end to end, evenly spaced in the jaws and between them. StudyError where they are too few, or
    where the jaws leave nothing between them."""
    end = 0.5 * length
    if gripped <= 0.0:
        return planes((-end, end), (n_y,))
    if gripped >= end:
        raise StudyError(f"specimen: gripped_length {gripped:g} mm leaves nothing between the jaws of a bar of {length:g} mm; shorten it")
    in_jaw = min(max(round(n_y * gripped / length), 1), (n_y - 1) // 2)
    if in_jaw < 1:
        raise StudyError(f"mesh.n_y: {n_y} found; at least 3 are needed for a bar of which jaws hold {gripped:g} mm at either end")
    return planes((-end, gripped - end, end - gripped, end), (in_jaw, n_y - 2 * in_jaw, in_jaw))


def cruciform_arm_mesh(specimen: Specimen, fillet_radius: float, size: MeshSize) -> Mesh:
    """One arm of a cruciform with its half of the central zone, loaded along y: quarter in x and z, y from the centre (symmetry plane).

    Arms of gauge_width with fillets of `fillet_radius` r between them; the other arms are cut off where their fillets end, at
    x = w/2 + r. total_length is that from end to end of both arms. StudyError where the arm is shorter than its fillet.
    """
    half, end = 0.5 * specimen.gauge_width, 0.5 * specimen.total_length
    if end <= half + fillet_radius:
        raise StudyError(
            f"specimen: half of total_length, {end:g} mm, leaves no arm behind half the width and the fillet, {half + fillet_radius:g} "
            "mm; check total_length, gauge_width and geometry.fillet_radius"
        )
    if size.n_y < 3:
        raise StudyError(f"mesh.n_y: {size.n_y} found; at least 3 are needed for centre, fillet and arm")
    n_centre = max(1, round(size.n_y * 0.25))
    n_fillet = max(1, round(size.n_y * 0.4))
    n_centre = min(n_centre, size.n_y - n_fillet - 1)
    angle = np.linspace(0.0, 0.5 * np.pi, n_fillet + 1)
    arm = planes(*split_at((half + fillet_radius, end), (size.n_y - n_centre - n_fillet,), end - specimen.gripped_length))
    y = np.concatenate([np.linspace(0.0, half, n_centre + 1), half + fillet_radius * (1.0 - np.cos(angle[1:])), arm[1:]])
    width = np.full(len(y), half)
    width[: n_centre + 1] = half + fillet_radius
    width[n_centre : n_centre + n_fillet + 1] = half + fillet_radius * (1.0 - np.sin(angle))
    nodes, hexes = _swept(y, width, 0.5 * specimen.thickness, size)
    return tension_sets(nodes, hexes, specimen.gripped_length, lower_gripped=False)


def _swept(y: np.ndarray, width: np.ndarray, thickness: float, size: MeshSize) -> tuple[np.ndarray, np.ndarray]:
    """Block x in [0, width(y)], z in [0, thickness] with node planes at y."""
    block = np.empty((len(y), size.n_x + 1, size.n_z + 1, 3))
    block[..., 0] = (width[:, None] * np.linspace(0.0, 1.0, size.n_x + 1))[:, :, None]
    block[..., 1] = y[:, None, None]
    block[..., 2] = thickness * np.linspace(0.0, 1.0, size.n_z + 1)
    return block.reshape(-1, 3), structured_hexes(size.n_x, len(y) - 1, size.n_z)


def plate_with_hole_mesh(specimen: Specimen, radius: float, size: MeshSize, *, full: bool = False) -> Mesh:
    """Plate of gauge_width x thickness x total_length with a hole of `radius` mm in its middle: quarter x, z >= 0, or the whole one.

    An O-grid of the square around the hole, n_x elements on each eighth of its edge and the rings graded towards it, then straight
    strips to the ends; n_y elements along the length, half of them in the rings. StudyError where the hole or the square do not fit.
    """
    half, end = 0.5 * specimen.gauge_width, 0.5 * specimen.total_length
    if not 0.0 < radius < half or end <= half:
        raise StudyError(
            f"geometry.hole_radius: radius {radius:g} mm in a plate of {specimen.gauge_width:g} mm x {specimen.total_length:g} mm "
            "is not possible; the radius must be below half the width and the length above the width"
        )
    if size.n_y < 6:
        raise StudyError(f"mesh.n_y: {size.n_y} found; at least 6 are needed for rings and strips on both sides of the hole")
    n_ring = max(2, size.n_y // 4)
    n_strip = max(1, size.n_y // 2 - n_ring)
    rays = 4 * size.n_x + 1
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rays)
    on_square = _square(half, size.n_x)
    share = (np.linspace(0.0, 1.0, n_ring + 1) ** _GRADING)[:, None, None]
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) * (1.0 - share) + on_square * share
    ring[:, [0, -1], 0] = 0.0
    plane, quads = _grid(ring)
    for sign in (1.0, -1.0):
        y = planes(*split_at((half, end), (n_strip,), end - specimen.gripped_length))
        strip = np.empty((n_strip + 1, size.n_x + 1, 2))
        strip[..., 0] = np.linspace(0.0, half, size.n_x + 1)
        strip[..., 1] = sign * y[:, None]
        more, cells = _grid(strip)
        quads = np.concatenate([quads, (cells if sign < 0.0 else cells[:, ::-1]) + len(plane)])
        plane = np.concatenate([plane, more])
    nodes, hexes = _extruded(*_merged(plane, quads), 0.5 * specimen.thickness, size.n_z)
    if full:
        nodes, hexes = mirrored(*mirrored(nodes, hexes, 0), 2)
    return tension_sets(nodes, hexes, specimen.gripped_length)


def _square(half: float, n: int) -> np.ndarray:
    """Ends (4 n + 1, 2) of the rays on the half square x >= 0, from below counter-clockwise, n between two corners or mid points."""
    step = np.linspace(0.0, half, n + 1)
    below = np.stack([step, np.full(n + 1, -half)], axis=1)
    side = np.stack([np.full(2 * n + 1, half), np.linspace(-half, half, 2 * n + 1)], axis=1)
    above = np.stack([step[::-1], np.full(n + 1, half)], axis=1)
    return np.concatenate([below, side[1:], above[1:]])


def _grid(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and quadrilaterals of a grid (n, m, 2) of points, oriented as (next row, next column) turn."""
    n, m = points.shape[:2]
    number = np.arange(n * m).reshape(n, m)
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    return points.reshape(-1, 2), quads.reshape(-1, 4)


def _merged(plane: np.ndarray, quads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The plane mesh with coincident nodes merged."""
    key = np.round(plane / (1e-9 * float(np.ptp(plane, axis=0).max()))).astype(np.int64)
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return plane[first], inverse.ravel()[quads]


def _extruded(plane: np.ndarray, quads: np.ndarray, thickness: float, n_z: int) -> tuple[np.ndarray, np.ndarray]:
    """Hexahedra over a plane mesh of counter-clockwise quadrilaterals, z in [0, thickness], nodes z fastest."""
    z = np.linspace(0.0, thickness, n_z + 1)
    nodes = np.concatenate([np.repeat(plane, n_z + 1, axis=0), np.tile(z, len(plane))[:, None]], axis=1)
    layer = np.arange(n_z)[None, :, None]
    low = quads[:, None, :] * (n_z + 1) + layer
    return nodes, np.concatenate([low, low + 1], axis=2).reshape(-1, 8)
