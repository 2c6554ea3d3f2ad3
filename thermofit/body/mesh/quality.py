"""Is a mesh fit for a computation: positive Jacobians, a closed boundary, one piece; and what symmetry its sets say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from thermofit.body.element.hex8 import reference_gradients
from thermofit.body.mesh.mesh import HEX_FACES, Mesh, boundary_facets, check_mesh
from thermofit.core.errors import NumericsError


@dataclass(frozen=True)
class Quality:
    """Volume mm^3; smallest ratio of the Jacobians within one element (1: a parallelepiped); largest aspect ratio; boundary facets."""

    volume: float
    jacobian_ratio: float
    aspect_ratio: float
    boundary: int


_COINCIDENT = 1e-7
"""Share of the body's size within which two nodes are one."""


def quality(mesh: Mesh) -> Quality:
    """Quality of a mesh. NumericsError where an element is inverted, the boundary is not closed or the mesh falls apart."""
    check_mesh(mesh)
    check_watertight(mesh)
    _, volume = reference_gradients(mesh.nodes, mesh.hexes)
    edges = mesh.nodes[mesh.hexes[:, _EDGES[:, 0]]] - mesh.nodes[mesh.hexes[:, _EDGES[:, 1]]]
    length = np.linalg.norm(edges, axis=2)
    return Quality(
        volume=float(volume.sum()),
        jacobian_ratio=float((volume.min(axis=1) / volume.max(axis=1)).min()),
        aspect_ratio=float((length.max(axis=1) / length.min(axis=1)).max()),
        boundary=len(boundary_facets(mesh.hexes)),
    )


_EDGES = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]])


def check_watertight(mesh: Mesh) -> None:
    """NumericsError unless the free faces are the skin of one body.

    Every face belongs to at most two elements, no two nodes coincide (a tear), every node belongs to an element, and all elements hang
    together.
    """
    faces = np.sort(mesh.hexes[:, HEX_FACES].reshape(-1, 4), axis=1)
    _, counts = np.unique(faces, axis=0, return_counts=True)
    if counts.max(initial=0) > 2:
        raise NumericsError(f"mesh: a face belongs to {counts.max()} elements, at most 2 are possible; remove duplicate elements")
    size = float(np.max(np.ptp(mesh.nodes, axis=0)))
    twins = cKDTree(mesh.nodes).query_pairs(_COINCIDENT * size, output_type="ndarray")
    if len(twins):
        raise NumericsError(
            f"mesh: {len(twins)} pairs of nodes coincide, the first {twins[0, 0]} and {twins[0, 1]}: the body is torn there; merge "
            "coincident nodes"
        )
    unused = mesh.n_nodes - len(np.unique(mesh.hexes))
    if unused:
        raise NumericsError(f"mesh: {unused} nodes belong to no element; remove them")
    pieces = _pieces(mesh)
    if pieces > 1:
        raise NumericsError(f"mesh: {pieces} pieces that share no node; merge coincident nodes or mesh one body")


def _pieces(mesh: Mesh) -> int:
    i, j = np.repeat(mesh.hexes[:, :1], 7, axis=1).ravel(), mesh.hexes[:, 1:].ravel()
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(mesh.n_nodes, mesh.n_nodes))
    return int(connected_components(graph, directed=False, return_labels=False))


def symmetry_of(mesh: Mesh) -> float:
    """Factor from model to specimen: twice for each of x0 and z0 that holds whole facets of the boundary, a plane of symmetry."""
    outer, factor = boundary_facets(mesh.hexes), 1.0
    for name in ("x0", "z0"):
        held = np.zeros(mesh.n_nodes, dtype=bool)
        held[mesh.node_sets[name]] = True
        factor *= 2.0 if held[outer].all(axis=1).any() else 1.0
    return factor
