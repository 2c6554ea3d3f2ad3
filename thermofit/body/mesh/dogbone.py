"""Mesh of a dogbone after DIN 50125-H: quarter model x in [0, w/2], z in [0, t/2], full length in y, grips included."""

from __future__ import annotations

import numpy as np

from thermofit.body.mesh.mesh import Mesh, boundary_facets, check_mesh, structured_hexes
from thermofit.body.mesh.planes import planes, split_at
from thermofit.core.errors import StudyError
from thermofit.core.experiment import Specimen

_GAUGE_SHARE, _GRIP_SHARE = 0.5, 0.15


def half_width(specimen: Specimen, y: np.ndarray) -> np.ndarray:
    """Half width in mm of the unloaded specimen at y: gauge, circular shoulder tangential to it, straight grip."""
    distance = np.abs(np.asarray(y, dtype=float)) - 0.5 * specimen.parallel_length
    inside = np.clip(distance, 0.0, shoulder_length(specimen))
    radius = specimen.shoulder_radius
    return 0.5 * specimen.gauge_width + radius - np.sqrt(radius**2 - inside**2)


def shoulder_length(specimen: Specimen) -> float:
    """Length of one shoulder along y, mm: the arc of radius R from the gauge width to the grip width."""
    rise = 0.5 * (specimen.grip_width - specimen.gauge_width)
    radius = specimen.shoulder_radius
    if not 0.0 <= rise <= radius:
        raise StudyError(
            f"specimen: grip_width {specimen.grip_width} mm and gauge_width {specimen.gauge_width} mm do not fit a shoulder of radius "
            f"{radius} mm; half their difference must lie between 0 and the radius"
        )
    return float(np.sqrt(radius**2 - (radius - rise) ** 2))


def plane_positions(specimen: Specimen, n_y: int) -> np.ndarray:
    """y in mm of the n_y + 1 node planes: uniform in the gauge, finer in the shoulders, uniform in the grips, one at the mouth of the jaws;
    symmetric. StudyError for impossible dimensions or counts."""
    if n_y < 8 or n_y % 2:
        raise StudyError(f"mesh.n_y: {n_y} found; an even number of at least 8 is needed (gauge, shoulders and grips)")
    half = n_y // 2
    gauge_end, shoulder = 0.5 * specimen.parallel_length, shoulder_length(specimen)
    end = 0.5 * specimen.total_length
    if end <= gauge_end + shoulder:
        raise StudyError(
            f"specimen: total_length {specimen.total_length} mm leaves no straight grip behind gauge and shoulders of "
            f"{gauge_end + shoulder:.2f} mm; check total_length, parallel_length and shoulder_radius"
        )
    n_gauge = max(1, round(_GAUGE_SHARE * half))
    n_grip = max(1, round(_GRIP_SHARE * half))
    n_shoulder = max(1, half - n_gauge - n_grip)
    counts = (n_gauge, n_shoulder, half - n_gauge - n_shoulder)
    upper = planes(*split_at((0.0, gauge_end, gauge_end + shoulder, end), counts, end - specimen.gripped_length))
    return np.concatenate([-upper[:0:-1], upper])


def dogbone_mesh(specimen: Specimen, n_x: int, n_y: int, n_z: int) -> Mesh:
    """Quarter model with n_x by n_y by n_z hex8.

    Node sets: x0, z0 (symmetry), bottom, top (ends), face (z = t/2, what the cameras see). Facet sets: air, clamp (the last
    `gripped_length` of both ends: face, edge and end face). StudyError for impossible dimensions or counts.
    """
    y = plane_positions(specimen, n_y)
    x_share, z_share = np.linspace(0.0, 1.0, n_x + 1), np.linspace(0.0, 1.0, n_z + 1)
    width, half_thickness = half_width(specimen, y), 0.5 * specimen.thickness
    block = np.empty((n_y + 1, n_x + 1, n_z + 1, 3))
    block[..., 0] = (width[:, None] * x_share)[:, :, None]
    block[..., 1] = y[:, None, None]
    block[..., 2] = half_thickness * z_share
    nodes = block.reshape(-1, 3)
    hexes = structured_hexes(n_x, n_y, n_z)
    number = np.arange(len(nodes)).reshape(n_y + 1, n_x + 1, n_z + 1)
    facets = boundary_facets(hexes)
    flat = np.zeros(len(nodes), dtype=bool)
    symmetric = np.zeros(len(facets), dtype=bool)
    for plane in (number[:, 0, :], number[:, :, 0]):
        flat[:] = False
        flat[plane.ravel()] = True
        symmetric |= flat[facets].all(axis=1)
    outer = facets[~symmetric]
    gripped = 0.5 * specimen.total_length - specimen.gripped_length
    in_jaw = np.abs(nodes[outer, 1]).mean(axis=1) > gripped
    mesh = Mesh(
        nodes=nodes,
        hexes=hexes,
        facets={"air": outer[~in_jaw], "clamp": outer[in_jaw]},
        node_sets={
            "x0": number[:, 0, :].ravel(),
            "z0": number[:, :, 0].ravel(),
            "bottom": number[0].ravel(),
            "top": number[-1].ravel(),
            "face": number[:, :, -1].ravel(),
        },
    )
    check_mesh(mesh)
    return mesh
