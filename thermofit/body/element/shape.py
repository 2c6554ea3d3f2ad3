"""The hex8: shape functions, Gauss points, and what the element pass needs of a mesh."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_CORNERS = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float)
_G = 1.0 / np.sqrt(3.0)
GAUSS_POINTS = _CORNERS * _G
"""2 x 2 x 2 Gauss points in [-1, 1]^3, all of weight 1."""


def shape_functions(xi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """N (n, 8) and dN/dxi (n, 8, 3) of the hex8 at points xi (n, 3)."""
    f = 1.0 + xi[:, None, :] * _CORNERS
    n = f.prod(axis=2) / 8.0
    dn = np.empty((len(xi), 8, 3))
    for i in range(3):
        others = [j for j in range(3) if j != i]
        dn[:, :, i] = _CORNERS[:, i] * f[:, :, others].prod(axis=2) / 8.0
    return n, dn


SHAPE, SHAPE_DERIVATIVE = shape_functions(GAUSS_POINTS)
"""N (8 points, 8 nodes) and dN/dxi (8 points, 8 nodes, 3)."""


def reference_jacobians(nodes: np.ndarray, hexes: np.ndarray) -> np.ndarray:
    """J_0 = dX/dxi (n_el, 8 points, 3, 3) in mm."""
    return np.einsum("eai,gaj->egij", nodes[hexes], SHAPE_DERIVATIVE)


def reference_gradients(nodes: np.ndarray, hexes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """dN/dX (n_el, 8 points, 8 nodes, 3) in 1/mm and reference volume of each point (n_el, 8) in mm^3."""
    jacobian = reference_jacobians(nodes, hexes)
    gradient = np.einsum("gaj,egji->egai", SHAPE_DERIVATIVE, np.linalg.inv(jacobian))
    return np.ascontiguousarray(gradient), np.linalg.det(jacobian)


class ElementData(NamedTuple):
    """What the element pass needs of the mesh.

    Connectivity `hexes` (n_el, 8), `gradient` dN/dX (n_el, 8 points, 8 nodes, 3), `volume` of the points (n_el, 8), `shape` N (8 points,
    8 nodes), `f_bar` 1 or 0, and `inverse_jacobian` dxi/dX (n_el, 3, 3, 8) with the points last, where they are lanes.
    """

    hexes: np.ndarray
    gradient: np.ndarray
    volume: np.ndarray
    shape: np.ndarray
    f_bar: int
    inverse_jacobian: np.ndarray


def element_data(nodes: np.ndarray, hexes: np.ndarray, *, f_bar: bool = True) -> ElementData:
    """ElementData of a mesh; `f_bar=False` gives standard full integration."""
    gradient, volume = reference_gradients(nodes, hexes)
    inverse = np.linalg.inv(reference_jacobians(nodes, hexes)).transpose(0, 2, 3, 1)
    return ElementData(
        hexes=np.ascontiguousarray(hexes),
        gradient=gradient,
        volume=volume,
        shape=np.ascontiguousarray(SHAPE),
        f_bar=int(f_bar),
        inverse_jacobian=np.ascontiguousarray(inverse),
    )
