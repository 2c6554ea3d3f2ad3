"""Named sets of a mesh: nodes on planes, facets of the outer boundary, films on what is left."""

from __future__ import annotations

import numpy as np

from thermofit.body.mesh.mesh import Mesh, boundary_facets, check_mesh

PLANE_SHARE = 1e-6
"""A node lies on a plane if it is nearer than this share of the body's size."""


def on_plane(nodes: np.ndarray, axis: int, at: float) -> np.ndarray:
    """True (n_np,) for nodes on the plane where coordinate `axis` is `at` mm."""
    size = float(np.max(np.ptp(nodes, axis=0)))
    return np.asarray(np.abs(nodes[:, axis] - at) <= PLANE_SHARE * size)


def facets_within(hexes: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Boundary facets (n_f, 4), outward, all of whose nodes are chosen (n_np,)."""
    outer = boundary_facets(hexes)
    return np.asarray(outer[chosen[outer].all(axis=1)])


def tension_sets(nodes: np.ndarray, hexes: np.ndarray, gripped_length: float = 0.0, *, lower_gripped: bool = True) -> Mesh:
    """The mesh of a tension test with the sets of the dogbone's: x0, z0 on their planes, bottom, top, face, and the films.

    x0 and z0 are planes of symmetry where the body ends there, else the nodes inside on which a symmetric body does not move across.
    clamp: free facets within `gripped_length` mm of the ends, the end faces at least; air: the others.
    """
    y_low, y_high, z_high = float(nodes[:, 1].min()), float(nodes[:, 1].max()), float(nodes[:, 2].max())
    planes = {
        "x0": on_plane(nodes, 0, 0.0),
        "z0": on_plane(nodes, 2, 0.0),
        "bottom": on_plane(nodes, 1, y_low),
        "top": on_plane(nodes, 1, y_high),
        "face": on_plane(nodes, 2, z_high),
    }
    outer = boundary_facets(hexes)
    symmetric = planes["x0"][outer].all(axis=1) | planes["z0"][outer].all(axis=1)
    if not lower_gripped:
        symmetric |= planes["bottom"][outer].all(axis=1)
    free = outer[~symmetric]
    y = nodes[free, 1].mean(axis=1)
    held = y >= y_high - gripped_length
    if lower_gripped:
        held |= y <= y_low + gripped_length
    mesh = Mesh(
        nodes=nodes,
        hexes=hexes,
        facets={"air": free[~held], "clamp": free[held]},
        node_sets={name: np.flatnonzero(chosen) for name, chosen in planes.items()},
    )
    check_mesh(mesh)
    return mesh


_MIRRORED = np.array([1, 0, 3, 2, 5, 4, 7, 6])
"""Local nodes of a hex8 after a reflection, so that its volume stays positive."""


def mirrored(nodes: np.ndarray, hexes: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """The body and its mirror image across the plane where coordinate `axis` is zero; nodes on the plane are shared."""
    shared = on_plane(nodes, axis, 0.0)
    image = np.arange(len(nodes))
    image[~shared] = len(nodes) + np.arange(int((~shared).sum()))
    factor = np.ones(3)
    factor[axis] = -1.0
    both = np.concatenate([nodes, nodes[~shared] * factor])
    return both, np.concatenate([hexes, image[hexes][:, _MIRRORED]])
