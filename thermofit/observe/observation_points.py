"""Material points at which model and measurement are compared: nodes of the outer face and their mirror images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.experiment import DicField, Specimen
from thermofit.study.models import EvaluationWindow

_ON_AXIS = 1e-9


@dataclass(frozen=True)
class ObservationPoints:
    """`node` (n_s,) index into the nodes of the quarter model, `mirror` (n_s,) +1.0 or -1.0, `xy` (n_s, 2) mm in the unloaded specimen.

    A point with mirror -1 is the image of its node under x -> -x: there u_x is minus and u_y, theta are equal to the node's.
    """

    node: np.ndarray
    mirror: np.ndarray
    xy: np.ndarray


_ACROSS, _ALONG = 0.44, 0.2
"""Parts of gauge width and parallel length on either side of the centre that are compared: 11 and 20 mm in the thesis (5.1.2)."""
_SEEN = 0.5
"""Share of the stages in which a point must be there to count as one of the field."""


def reach_of(dic: DicField) -> tuple[float, float]:
    """Largest |x| and |y| in mm of the DIC points that are there in half of the stages; of all points where none is."""
    often = np.isfinite(dic.displacement[:, :, 0]).mean(axis=0) >= _SEEN
    x, y = np.abs(dic.reference[often if often.any() else slice(None), :2]).max(axis=0)
    return float(x), float(y)


def observed_window(given: EvaluationWindow, specimen: Specimen, straight: bool, reach: tuple[float, float]) -> tuple[float, float]:
    """Limits of |x| and |y| in mm of the nodes that are compared: those given, else the `reach` of the data; of a `straight` specimen not
    beyond the part in which its ends are not felt."""
    most = (_ACROSS * specimen.gauge_width, _ALONG * specimen.parallel_length) if straight else (np.inf, np.inf)
    x, y = (min(data, limit) for data, limit in zip(reach, most, strict=True))
    return (x if given.abs_x_max is None else given.abs_x_max), (y if given.abs_y_max is None else given.abs_y_max)


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
