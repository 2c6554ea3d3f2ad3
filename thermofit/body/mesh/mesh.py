"""Hexahedral mesh of a body: nodes, elements, named facet sets and node sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import NumericsError, StudyError

HEX_FACES = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])
"""Local nodes of the six faces of a hex8, outward normal by the right-hand rule."""


@dataclass(frozen=True)
class Mesh:
    """`nodes` mm (n_np, 3); `hexes` (n_el, 8) in the usual order (bottom face counter-clockwise, then top).

    `facets` maps a name to (n_f, 4) nodes, outward by the right-hand rule; `node_sets` maps a name to node numbers.
    """

    nodes: np.ndarray
    hexes: np.ndarray
    facets: Mapping[str, np.ndarray]
    node_sets: Mapping[str, np.ndarray]

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def n_elements(self) -> int:
        """Number of elements."""
        return len(self.hexes)

    def nearest_node(self, point: tuple[float, float, float]) -> int:
        """Number of the node closest to a point in mm."""
        return int(np.argmin(np.sum((self.nodes - np.asarray(point)) ** 2, axis=1)))


def boundary_facets(hexes: np.ndarray) -> np.ndarray:
    """All facets that belong to one element only, (n_f, 4), outward."""
    faces = hexes[:, HEX_FACES].reshape(-1, 4)
    keys = np.sort(faces, axis=1)
    _, first, counts = np.unique(keys, axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[counts == 1])]


def check_mesh(mesh: Mesh) -> None:
    """Raise NumericsError where an element is inverted or a set names a node that does not exist."""
    from thermofit.body.element.hex8 import reference_gradients

    _, volume = reference_gradients(mesh.nodes, mesh.hexes)
    bad = np.flatnonzero((volume <= 0.0).any(axis=1))
    if bad.size:
        raise NumericsError(f"mesh: {bad.size} elements have non-positive volume, the first is number {bad[0]}; check its node order")
    for name, ids in {**mesh.facets, **mesh.node_sets}.items():
        if ids.size and (ids.min() < 0 or ids.max() >= mesh.n_nodes):
            raise NumericsError(f"mesh: set '{name}' names node {int(ids.max())}, but there are {mesh.n_nodes} nodes; check the set")


def structured_hexes(n_x: int, n_y: int, n_z: int) -> np.ndarray:
    """Elements of an n_x by n_y by n_z block whose nodes are numbered z fastest, then x, then y: planes across the y axis."""
    if min(n_x, n_y, n_z) < 1:
        raise StudyError(f"mesh: {n_x} x {n_y} x {n_z} elements are not possible; every count must be at least 1")
    y, x, z = np.meshgrid(np.arange(n_y), np.arange(n_x), np.arange(n_z), indexing="ij")

    def node(i: int, j: int, k: int) -> np.ndarray:
        return (((y + j) * (n_x + 1) + x + i) * (n_z + 1) + z + k).ravel()

    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    return np.stack([node(*c) for c in corners], axis=1)
