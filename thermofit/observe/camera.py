"""Infrared camera: pose of the image from landmarks (Algorithm 1, section 2.5.4), for the front and the mirrored back view.

p = o + (x e_x + y e_y) / s with p = (row, col) px, o the specimen's centre, s mm/px, and unit vectors e_x, e_y in
(row, col). y points to the moving crosshead, which is on the side of row 0. Seen from the front x points to the right,
seen from the back to the left; Algorithm 1 as printed knows the front view only.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import Landmarks, Specimen

_KEY = "experiment.yaml: key 'ir.landmarks"
_COINCIDENT = 1.0
"""px: two picked points that are nearer cannot be told apart by hand."""
_FLAT = 0.02
"""Height of the triangle of the circle points over its longest side: below it the centre runs away."""
_WIDTH_TOLERANCE = 0.05


@dataclass(frozen=True)
class CameraPose:
    """How the camera sees the specimen: `scale` mm/px, `origin` (2,) px of the specimen's centre, `axis_x`, `axis_y` (2,)
    unit vectors, all in (row, col), pixel centres integer; `side` is "front" or "back".
    """

    scale: float
    origin: np.ndarray
    axis_x: np.ndarray
    axis_y: np.ndarray
    side: str

    @property
    def roll(self) -> float:
        """Angle in rad of the specimen's axis, clockwise in the image."""
        return float(np.arctan2(self.axis_y[1], -self.axis_y[0]))


@dataclass(frozen=True)
class PoseUncertainty:
    """Standard deviations: `origin` (2,) px in row and column, `roll` rad, `scale` mm/px."""

    origin: np.ndarray
    roll: float
    scale: float


@dataclass(frozen=True)
class LandmarkChecks:
    """What the landmarks say twice: `width_mm` between the edges, `width_error` against the specimen's gauge width (relative),
    `centre_offset_mm` of the circle's centre from the line midway between the edges, positive to the right in the image.
    """

    width_mm: float
    width_error: float
    centre_offset_mm: float


def make_pose(scale: float, origin: np.ndarray, axis_y: np.ndarray, side: str) -> CameraPose:
    """Pose from the direction of the specimen's axis in (row, col); the side gives the handedness of x."""
    axis_y = np.asarray(axis_y, dtype=float)
    axis_y = axis_y / np.linalg.norm(axis_y)
    return CameraPose(float(scale), np.asarray(origin, dtype=float), _right(axis_y) * (1.0 if side == "front" else -1.0), axis_y, side)


def _right(axis_y: np.ndarray) -> np.ndarray:
    """Unit vector (row, col) to the right of the specimen's axis as seen in the image."""
    return np.array([axis_y[1], -axis_y[0]])


def pose_from_landmarks(landmarks: Landmarks, side: str, image_shape: tuple[int, int]) -> CameraPose:
    """Algorithm 1: scale from two points, axes from the left edge, origin from three points on a circle.

    `image_shape` (rows, columns); `side` "front" or "back". DataError for landmarks outside the frame, coincident or
    collinear, a specimen axis that is not upright in the image, and a right edge that lies left of the left edge.
    """
    if side not in ("front", "back"):
        raise DataError(f"experiment.yaml: key 'ir.side' is '{side}'; expected front or back")
    _check_points(landmarks, image_shape)
    pose = _algorithm_1(landmarks, side)
    if abs(pose.roll) > 0.25 * np.pi:
        raise DataError(
            f"{_KEY}.edge_left' makes an angle of {np.degrees(pose.roll):.0f} deg with the columns of the image, expected an upright "
            "specimen with the crosshead at row 0; turn the frames or pick the points again"
        )
    if (width := _width(landmarks, pose)) <= 0.0:
        raise DataError(
            f"{_KEY}.edge_right' lies {-width:.1f} px left of edge_left, which contradicts the declared side '{side}': "
            "left and right are meant as seen in the image; exchange the edges or mirror the frames back"
        )
    return pose


def _algorithm_1(landmarks: Landmarks, side: str) -> CameraPose:
    """The formulae of Algorithm 1 without checks: s = l_m / l_p, y along the edge upwards, o = centre of the circle."""
    scale = landmarks.length_mm / float(np.linalg.norm(landmarks.length[1] - landmarks.length[0]))
    axis_y = landmarks.edge_left[1] - landmarks.edge_left[0]
    axis_y = axis_y if axis_y[0] <= 0.0 else -axis_y
    return make_pose(scale, circle_centre(landmarks.circle), axis_y, side)


def _width(landmarks: Landmarks, pose: CameraPose) -> float:
    """Distance in px of the right edge from the left one, positive to the right."""
    return float((landmarks.edge_right - landmarks.edge_left[0]) @ _right(pose.axis_y))


def circle_centre(points: np.ndarray) -> np.ndarray:
    """Centre (2,) of the circle through three points (3, 2): equal distances make two linear equations."""
    chords = points[1:] - points[0]
    return np.asarray(points[0] + np.linalg.solve(chords, 0.5 * (chords**2).sum(axis=1)))


def _check_points(landmarks: Landmarks, image_shape: tuple[int, int]) -> None:
    """Every landmark inside the frame; no two of one group coincide; the circle's points are not on a line."""
    groups = {
        "length": landmarks.length,
        "edge_left": landmarks.edge_left,
        "edge_right": landmarks.edge_right[None],
        "circle": landmarks.circle,
    }
    last = np.array(image_shape) - 0.5
    for name, points in groups.items():
        for k, point in enumerate(points):
            if not ((point >= -0.5) & (point <= last)).all():
                raise DataError(
                    f"{_KEY}.{name}.p{k + 1}' is [{point[0]:g}, {point[1]:g}], outside the frame of {image_shape[0]} rows "
                    f"x {image_shape[1]} columns; expected [row, col] counted from 0: pick it again"
                )
            near = [j for j in range(k) if np.linalg.norm(point - points[j]) < _COINCIDENT]
            if near:
                raise DataError(f"{_KEY}.{name}': points p{near[0] + 1} and p{k + 1} coincide; pick points that lie far apart")
    chords = landmarks.circle[[1, 2, 2]] - landmarks.circle[[0, 0, 1]]
    area = abs(chords[0, 0] * chords[1, 1] - chords[0, 1] * chords[1, 0])
    if area < _FLAT * (chords**2).sum(axis=1).max():
        raise DataError(f"{_KEY}.circle': the three points lie on a line, so that no circle goes through them; pick them around the centre")


def landmark_checks(landmarks: Landmarks, pose: CameraPose, specimen: Specimen) -> LandmarkChecks:
    """Redundancy of the landmarks; DataError where the width between the edges is more than 5 % off the gauge width."""
    width = _width(landmarks, pose)
    middle = landmarks.edge_left[0] + 0.5 * width * _right(pose.axis_y)
    checks = LandmarkChecks(
        width_mm=width * pose.scale,
        width_error=width * pose.scale / specimen.gauge_width - 1.0,
        centre_offset_mm=float((pose.origin - middle) @ _right(pose.axis_y)) * pose.scale,
    )
    if abs(checks.width_error) > _WIDTH_TOLERANCE:
        raise DataError(
            f"{_KEY}': the edges are {checks.width_mm:.2f} mm apart by the scale of 'length' ({pose.scale:.4f} mm/px), "
            f"but specimen.gauge_width_mm is {specimen.gauge_width:g}; check length_mm and the points"
        )
    return checks


def pose_uncertainty(landmarks: Landmarks, sigma_px: float) -> PoseUncertainty:
    """Standard deviation of the pose where every landmark coordinate has the independent picking error `sigma_px`.

    First order: covariance J J^T sigma^2 with J by central differences of Algorithm 1 over all coordinates.
    """
    names = ("length", "edge_left", "circle")
    step = 1e-4
    columns = []
    for name in names:
        points = np.asarray(getattr(landmarks, name), dtype=float)
        for k in range(points.size):
            shift = step * (np.arange(points.size) == k).reshape(points.shape)
            above, below = (_algorithm_1(dataclasses.replace(landmarks, **{name: points + sign * shift}), "front") for sign in (1.0, -1.0))
            change = [*(above.origin - below.origin), above.roll - below.roll, above.scale - below.scale]
            columns.append(np.array(change) / (2.0 * step))
    sigma = sigma_px * np.sqrt((np.array(columns) ** 2).sum(axis=0))
    return PoseUncertainty(sigma[:2], float(sigma[2]), float(sigma[3]))


def pixel_to_specimen(pose: CameraPose, row_col: np.ndarray) -> np.ndarray:
    """Positions (..., 2) mm as (x, y) of pixels (..., 2) as (row, col)."""
    away = (np.asarray(row_col, dtype=float) - pose.origin) * pose.scale
    return np.stack([away @ pose.axis_x, away @ pose.axis_y], axis=-1)


def specimen_to_pixel(pose: CameraPose, xy: np.ndarray) -> np.ndarray:
    """Pixels (..., 2) as (row, col) of positions (..., 2) mm as (x, y); inverse of `pixel_to_specimen`."""
    xy = np.asarray(xy, dtype=float) / pose.scale
    return np.asarray(pose.origin + xy[..., :1] * pose.axis_x + xy[..., 1:] * pose.axis_y)


def pixel_coordinates(pose: CameraPose, shape: tuple[int, int]) -> np.ndarray:
    """Positions (n_row, n_col, 2) mm as (x, y) of all pixel centres of a frame."""
    return pixel_to_specimen(pose, np.moveaxis(np.indices(shape, dtype=float), 0, -1))
