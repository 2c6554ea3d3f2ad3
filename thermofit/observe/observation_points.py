"""Material points at which model and measurement are compared: nodes of the outer face and their mirror images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import StudyError

_ON_AXIS = 1e-9


@dataclass(frozen=True)
class ObservationPoints:
    """`node` (n_s,) index into the nodes of the quarter model, `mirror` (n_s,) +1.0 or -1.0, `xy` (n_s, 2) mm in the unloaded specimen.

    A point with mirror -1 is the image of its node under x -> -x: there u_x is minus and u_y, theta are equal to the node's.
    """

    node: np.ndarray
    mirror: np.ndarray
    xy: np.ndarray


def observation_points(nodes: np.ndarray, face_ids: np.ndarray, abs_x_max: float, abs_y_max: float) -> ObservationPoints:
    """Face nodes with |x| <= abs_x_max and |y| <= abs_y_max (mm, section 5.1.2), then the mirror images of those off the axis.

    `nodes` (n_np, 3) mm of the quarter model x >= 0, `face_ids` (n_f,) nodes of the face z = t/2. StudyError where no node
    is in the window, or where the model is no quarter model.
    """
    face_ids = np.asarray(face_ids, dtype=np.intp)
    xy = np.asarray(nodes, dtype=float)[face_ids, :2]
    tolerance = _ON_AXIS * max(1.0, float(np.abs(xy).max(initial=0.0)))
    if (xy[:, 0] < -tolerance).any():
        raise StudyError(
            f"mesh: node {face_ids[np.argmin(xy[:, 0])]} of the measured face lies at x = {xy[:, 0].min():g} mm, expected a quarter model "
            "with x >= 0; shift the mesh so that x = 0 is its symmetry plane"
        )
    inside = (xy[:, 0] <= abs_x_max + tolerance) & (np.abs(xy[:, 1]) <= abs_y_max + tolerance)
    if not inside.any():
        raise StudyError(
            f"evaluation window: none of the {len(face_ids)} nodes of the measured face lies within |x| <= {abs_x_max:g} mm and "
            f"|y| <= {abs_y_max:g} mm; widen the window or refine the mesh"
        )
    node, place = face_ids[inside], xy[inside]
    off_axis = place[:, 0] > tolerance
    mirrored = place[off_axis] * np.array([-1.0, 1.0])
    return ObservationPoints(
        node=np.concatenate([node, node[off_axis]]),
        mirror=np.concatenate([np.ones(len(node)), -np.ones(len(mirrored))]),
        xy=np.concatenate([place, mirrored]),
    )
