"""Outer face of any hexahedral mesh: its quadrilaterals, where points lie on it, and how far they are from its edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.body.mesh.mesh import Mesh
from thermofit.body.mesh.sets import facets_within
from thermofit.core.errors import StudyError

_ROUNDS = 30
_INSIDE = 1e-7
"""Natural coordinates beyond 1 by this are still inside."""
_REACH = 0.5
"""A point outside is moved to the nearest place if that is nearer than this share of an element's edge."""


@dataclass(frozen=True)
class FaceQuads:
    """`quads` (n_q, 4) nodes, `xy` (n_np, 2) mm of all nodes; `half`: the model ends at its symmetry plane x = 0."""

    quads: np.ndarray
    xy: np.ndarray
    half: bool

    def folded(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 2) in the model, and the sign (n,) of x that they had."""
        sign = np.where(points[:, 0] < 0.0, -1.0, 1.0) if self.half else np.ones(len(points))
        return points * np.stack([sign, np.ones_like(sign)], axis=1), sign


@dataclass(frozen=True)
class QuadPlace:
    """`quad` (n,), natural coordinates `xi`, `eta` (n,) in [-1, 1] of the nearest place, its `distance` (n,) mm (0 inside)."""

    quad: np.ndarray
    xi: np.ndarray
    eta: np.ndarray
    distance: np.ndarray


def face_quads(mesh: Mesh) -> FaceQuads:
    """The face that the cameras see. StudyError where the set `face` holds no whole facet of the boundary."""
    chosen = np.zeros(mesh.n_nodes, dtype=bool)
    chosen[mesh.node_sets["face"]] = True
    quads = facets_within(mesh.hexes, chosen)
    if not len(quads):
        raise StudyError("mesh: the node set 'face' holds no facet of the boundary; name the surface that the cameras see")
    x = mesh.nodes[mesh.node_sets["face"], 0]
    return FaceQuads(quads, mesh.nodes[:, :2], bool(x.min() >= -1e-6 * np.ptp(x)))


def shape_of(xi: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Bilinear shape functions (n, 4)."""
    return 0.25 * np.stack([(1 - xi) * (1 - eta), (1 + xi) * (1 - eta), (1 + xi) * (1 + eta), (1 - xi) * (1 + eta)], axis=-1)


def place_points(face: FaceQuads, points: np.ndarray) -> QuadPlace:
    """Where points (n, 2) mm of the model lie on the face."""
    corners = face.xy[face.quads]
    low, high = corners.min(axis=1), corners.max(axis=1)
    slack = 0.5 * (high - low)
    point, quad = [], []
    for begin in range(0, len(points), 1000):
        part = points[begin : begin + 1000, None, :]
        here, there = np.nonzero(((part >= low - slack) & (part <= high + slack)).all(axis=2))
        point.append(here + begin)
        quad.append(there)
    p, q = np.concatenate([*point, np.empty(0, dtype=int)]), np.concatenate([*quad, np.empty(0, dtype=int)])
    xi, eta = _natural(corners[q], points[p])
    xi, eta = np.clip(xi, -1.0, 1.0), np.clip(eta, -1.0, 1.0)
    away = np.linalg.norm(np.einsum("na,naj->nj", shape_of(xi, eta), corners[q]) - points[p], axis=1)
    order = np.lexsort((away, p))
    first = order[np.unique(p[order], return_index=True)[1]]
    n = len(points)
    out = QuadPlace(np.zeros(n, dtype=int), np.zeros(n), np.zeros(n), np.full(n, np.inf))
    out.quad[p[first]], out.xi[p[first]], out.eta[p[first]], out.distance[p[first]] = q[first], xi[first], eta[first], away[first]
    size = np.linalg.norm(high - low, axis=1)[out.quad]
    out.distance[out.distance < _INSIDE * size] = 0.0
    return out


def _natural(corners: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Natural coordinates (n,) of points (n, 2) in quadrilaterals (n, 4, 2) by Newton's method, kept within three times the square."""
    xi, eta = np.zeros(len(points)), np.zeros(len(points))
    for _ in range(_ROUNDS):
        gap = points - np.einsum("na,naj->nj", shape_of(xi, eta), corners)
        along = 0.25 * np.einsum("na,naj->nj", np.stack([eta - 1, 1 - eta, 1 + eta, -1 - eta], axis=1), corners)
        across = 0.25 * np.einsum("na,naj->nj", np.stack([xi - 1, -1 - xi, 1 + xi, 1 - xi], axis=1), corners)
        det = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
        det = np.where(np.abs(det) < 1e-14, 1e-14, det)
        step = np.stack([gap[:, 0] * across[:, 1] - gap[:, 1] * across[:, 0], along[:, 0] * gap[:, 1] - along[:, 1] * gap[:, 0]]) / det
        xi, eta = np.clip(xi + step[0], -3.0, 3.0), np.clip(eta + step[1], -3.0, 3.0)
        if np.abs(step).max(initial=0.0) < 1e-12:
            break
    return xi, eta


def quad_weights(face: FaceQuads, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes (n, 4), weights (n, 4) and sign of x (n,) of points xy (n, 2) mm. StudyError for a point that is not on the face."""
    points, sign = face.folded(xy)
    place = place_points(face, points)
    corners = face.xy[face.quads[place.quad]]
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    off = np.flatnonzero(~(place.distance <= _REACH * edge))
    if off.size:
        x, y = xy[off[0]]
        raise StudyError(
            f"mesh: {off.size} observation points lie off the face, the first at ({x:.3f}, {y:.3f}) mm; check geometry and axes"
        )
    return face.quads[place.quad], shape_of(place.xi, place.eta), sign


def distance_to_edge(face: FaceQuads, xy: np.ndarray) -> np.ndarray:
    """Distance in mm (n,) of points (n, 2) from the free edges of the face (outline and holes), negative outside."""
    points, _ = face.folded(xy)
    edges = np.stack([face.quads, np.roll(face.quads, -1, axis=1)], axis=2).reshape(-1, 2)
    _, first, counts = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    free = edges[first[counts == 1]]
    a, b = face.xy[free[:, 0]], face.xy[free[:, 1]]
    if face.half:
        on_axis = np.maximum(np.abs(a[:, 0]), np.abs(b[:, 0])) < 1e-6 * float(np.ptp(face.xy[:, 0]))
        a, b = a[~on_axis], b[~on_axis]
    distance = np.full(len(points), np.inf)
    for start, end in zip(a, b, strict=True):
        along = end - start
        share = np.clip((points - start) @ along / (along @ along), 0.0, 1.0)
        distance = np.minimum(distance, np.linalg.norm(points - start - share[:, None] * along, axis=1))
    inside = place_points(face, points).distance == 0.0
    return np.where(inside, distance, -distance)
