"""Observations at material points, and the same quantities predicted by a run of the model (History -> Prediction)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from thermofit.body.mesh.mesh import Mesh
from thermofit.core.errors import DataError
from thermofit.observe.face import face_grid, is_face_grid, locate
from thermofit.observe.face_quads import face_quads, quad_weights
from thermofit.observe.interpolation import time_weights
from thermofit.observe.patches import MOMENTS, averaged, derivatives, terms


@dataclass(frozen=True)
class FieldObservation:
    """One measured field: `time` s (n_t,), `xy` mm (n_s, 2) reference positions, `value` and `sigma` (n_t, n_s, n_c), `mask` (n_t, n_s).

    n_c is 2 for displacements (x, y) in mm and 1 for temperatures in K. `mask` is True where the value is measured; elsewhere value
    and sigma are nan and never used. `moments` (n_t, n_s, 5) mm, mm^2: values are means over patches with these moments (`patches`); None:
    they are values at xy.
    """

    name: str
    time: np.ndarray
    xy: np.ndarray
    value: np.ndarray
    sigma: np.ndarray
    mask: np.ndarray
    unit: str
    moments: np.ndarray | None = None

    @property
    def place(self) -> np.ndarray:
        """Material position (n_t, n_s, 2) mm that a value of a linear field belongs to: the centre of the measured points of its patch."""
        where = np.broadcast_to(self.xy, (*self.mask.shape, 2))
        return where if self.moments is None else where + self.moments[:, :, :2]

    def averaged(self, field: np.ndarray) -> np.ndarray:
        """What the values are of a field (n_t, n_s, ...) at its points: the field itself, or its means over the patches."""
        return field if self.moments is None else averaged(field, self.moments, self.xy)

    def averaged_at(self, time: np.ndarray, field: np.ndarray) -> np.ndarray:
        """The same of a field (k, n_s, ...) at other times (k,) s, with patches as they are at the observed time before and after."""
        if self.moments is None:
            return field
        w = time_weights(self.time, time)
        share = w.share[:, None, None]
        return averaged(field, (1.0 - share) * self.moments[w.left] + share * self.moments[w.right], self.xy)

    def between(self, t0: float, t1: float) -> FieldObservation:
        """The observations at t0 <= t <= t1; DataError where none is left."""
        keep = (self.time >= t0 - 1e-9) & (self.time <= t1 + 1e-9)
        if not self.mask[keep].any():
            raise DataError(
                f"{self.name}: no observation between {t0:g} s and {t1:g} s; the measured times run from {self.time[0]:g} s to "
                f"{self.time[-1]:g} s, check the window of the stage"
            )
        return self.at_times(keep)

    def at_times(self, keep: np.ndarray) -> FieldObservation:
        """The observations at the times for which keep (n_t,) is True."""
        moments = None if self.moments is None else self.moments[keep]
        return replace(self, time=self.time[keep], value=self.value[keep], sigma=self.sigma[keep], mask=self.mask[keep], moments=moments)


@dataclass(frozen=True)
class FaceOperator:
    """Values at points of the measured face: nodes (n_s, k), weights (n_s, k), sign of x (n_s,).

    A point at a node has weight one there, so that a prediction on the mesh of the observation points is the nodal value itself.
    """

    node: np.ndarray
    weight: np.ndarray
    sign: np.ndarray

    def displacement(self, u: np.ndarray) -> np.ndarray:
        """In-plane displacement (n_t, n_s, 2) mm from nodal u (n_t, n_np, 3); u_x changes sign with the mirror image."""
        value = np.einsum("tsaj,sa->tsj", u[:, self.node, :2], self.weight)
        value[:, :, 0] *= self.sign
        return np.asarray(value)

    def temperature(self, theta: np.ndarray) -> np.ndarray:
        """Temperature (n_t, n_s, 1) K from nodal theta (n_t, n_np)."""
        return np.asarray(np.einsum("tsa,sa->ts", theta[:, self.node], self.weight))[:, :, None]


ReadsFace = Callable[[Mesh, np.ndarray], FaceOperator]
"""The operator for reference points (n_s, 2) mm on the face of a mesh."""


def face_operator(mesh: Mesh, xy: np.ndarray) -> FaceOperator:
    """FaceOperator for reference points xy (n_s, 2) mm on the face of a mesh, by symmetry on its other half too.

    StudyError where a point is not on the face.
    """
    face = mesh.node_sets["face"]
    if not is_face_grid(mesh.nodes[face, :2]):
        return FaceOperator(*quad_weights(face_quads(mesh), xy))
    grid = face_grid(mesh.nodes[face, :2])
    place = locate(grid, xy)
    r, c = place.row, place.column
    corners = np.stack([grid.order[r, c], grid.order[r, c + 1], grid.order[r + 1, c], grid.order[r + 1, c + 1]], axis=1)
    xi, eta = place.xi, place.eta
    weight = np.stack([(1 - xi) * (1 - eta), xi * (1 - eta), (1 - xi) * eta, xi * eta], axis=1)
    return FaceOperator(face[corners], weight, place.sign)


def smooth_operator(mesh: Mesh, xy: np.ndarray) -> FaceOperator:
    """The same read off smoothly: the quadratics about the nodes of the element, each through its own value and as near as may be to those
    around it, weighted by the bilinear functions. Exact where a field is quadratic; there bilinear values are off by up to h^2/8 of its
    second derivative inside an element of length h."""
    at, face = face_operator(mesh, xy), np.sort(mesh.node_sets["face"])
    nodes, corner = mesh.nodes[face, :2], np.searchsorted(face, at.node)
    n, by = len(face), derivatives(nodes)
    points = xy * np.stack([at.sign, np.ones_like(at.sign)], axis=1)
    factor = at.weight[..., None] * terms(points[:, None, :] - nodes[corner])
    row = np.broadcast_to(np.arange(len(xy))[:, None], corner.shape)
    found = csr_array((at.weight.ravel(), (row.ravel(), corner.ravel())), shape=(len(xy), n))
    for k in range(MOMENTS):
        found = found + csr_array((factor[..., k].ravel(), (row.ravel(), corner.ravel())), shape=(len(xy), n)) @ by[k * n : (k + 1) * n]
    return _padded(csr_array(found), face, at.sign)


def _padded(weights: csr_array, face: np.ndarray, sign: np.ndarray) -> FaceOperator:
    """FaceOperator of weights (n_s, n) of the nodes of the face."""
    weights.sum_duplicates()
    counts = np.diff(weights.indptr)
    node = np.zeros((len(counts), int(counts.max(initial=1))), dtype=int)
    weight = np.zeros(node.shape)
    row = np.repeat(np.arange(len(counts)), counts)
    place = np.arange(weights.nnz) - np.repeat(weights.indptr[:-1], counts)
    node[row, place], weight[row, place] = weights.indices, weights.data
    return FaceOperator(face[node], weight, sign)
