"""Virtual infrared camera: fixed in space, looking at the back face, so that the specimen moves through the image.

Pose: with (right, up) mm in the image plane and roll phi (specimen axis clockwise), back view,
right = -x cos(phi) + y sin(phi), up = x sin(phi) + y cos(phi); column = c_0 + right / p, row = r_0 - up / p.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from thermofit.core.errors import StudyError
from thermofit.core.experiment import CELSIUS, Landmarks, Specimen
from thermofit.observe.face import FaceGrid, interpolate, invert_motion, locate, outline
from thermofit.study.virtual import VirtualIr
from thermofit.virtual.setup import RigidMotion, VirtualFields, stream

_JAW_MARGIN = 8.0
"""mm by which the jaws are wider than the grip section on either side."""
_PICK_LENGTH = 60.0


@dataclass(frozen=True)
class VirtualPose:
    """`centre` (row, col) px of the specimen's centre before the test, `pixel_size` mm, `roll` rad."""

    centre: tuple[float, float]
    pixel_size: float
    roll: float


def camera_pose(settings: VirtualIr, seed: int) -> VirtualPose:
    """Where the operator has put the camera: the centre of the specimen is a few pixels off the image centre."""
    rng = stream(seed, "ir.pose")
    rows, columns = settings.image_shape
    row, column = 0.53 * (rows - 1), 0.5 * (columns - 1)
    shift = rng.uniform(-0.02, 0.02, 2) * settings.image_shape
    return VirtualPose((row + shift[0], column + shift[1]), settings.pixel_size, np.deg2rad(settings.roll_deg))


def to_pixel(pose: VirtualPose, xy: np.ndarray) -> np.ndarray:
    """Pixels (..., 2) as (row, col) of points (..., 2) mm in space."""
    c, s = np.cos(pose.roll), np.sin(pose.roll)
    right, up = -c * xy[..., 0] + s * xy[..., 1], s * xy[..., 0] + c * xy[..., 1]
    return np.stack([pose.centre[0] - up / pose.pixel_size, pose.centre[1] + right / pose.pixel_size], axis=-1)


def to_space(pose: VirtualPose, pixel: np.ndarray) -> np.ndarray:
    """Points (..., 2) mm in space seen at pixels (..., 2) given as (row, col); inverse of `to_pixel`."""
    c, s = np.cos(pose.roll), np.sin(pose.roll)
    up = (pose.centre[0] - pixel[..., 0]) * pose.pixel_size
    right = (pixel[..., 1] - pose.centre[1]) * pose.pixel_size
    return np.stack([-c * right + s * up, s * right + c * up], axis=-1)


def pick_landmarks(pose: VirtualPose, specimen: Specimen, settings: VirtualIr, seed: int) -> Landmarks:
    """Landmarks as an operator picks them in frame 0, with the picking error, to a tenth of a pixel.

    StudyError where the image is too small to show them.
    """
    half = 0.5 * specimen.gauge_width
    rows = settings.image_shape[0]
    reach = 0.9 * pose.pixel_size * min(pose.centre[0], rows - 1 - pose.centre[0]) - half * abs(np.sin(pose.roll))
    length = min(_PICK_LENGTH, 10.0 * np.floor(0.2 * reach))
    radius, angle = 0.7 * half, np.deg2rad([80.0, 200.0, 320.0])
    true = np.array(
        [
            [0.0, -0.5 * length],
            [0.0, 0.5 * length],
            [half, -0.52 * length],
            [half, 0.55 * length],
            [-half, 0.05 * length],
            *np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1),
        ]
    )
    pixel = to_pixel(pose, true)
    if length < 10.0 or (pixel < 1.0).any() or (pixel > np.array(settings.image_shape) - 2.0).any():
        raise StudyError(
            f"simulate.ir: an image of {rows} x {settings.image_shape[1]} pixels of {settings.pixel_size:g} mm does not show both edges "
            f"over 10 mm of a specimen {specimen.gauge_width:g} mm wide; enlarge image_shape or pixel_size"
        )
    picked = np.round(pixel + settings.landmark_noise_px * stream(seed, "ir.landmarks").standard_normal(pixel.shape), 1)
    return Landmarks(0, picked[:2], float(length), picked[2:4], picked[4], picked[5:])


def background_field(settings: VirtualIr, seed: int) -> np.ndarray:
    """Temperature in K (n_row, n_col) of the surroundings: warmer at the top, with a gentle wave."""
    rng = stream(seed, "ir.background")
    rows, columns = settings.image_shape
    v, h = np.linspace(-1.0, 1.0, rows)[:, None], np.linspace(-1.0, 1.0, columns)[None, :]
    slope, wave = -rng.uniform(0.7, 1.3), rng.uniform(-0.3, 0.3, 2)
    phase = rng.uniform(0.0, 2.0 * np.pi, 2)
    shape = slope * v + wave[0] * np.cos(3.0 * v + phase[0]) + wave[1] * np.cos(2.0 * h + v + phase[1])
    return np.asarray(settings.background + settings.background_spread * shape)


@dataclass(frozen=True)
class ImageScene:
    """What does not change from frame to frame: pixel positions in space (n_px, 2) mm, background (n_row, n_col) K."""

    settings: VirtualIr
    grid: FaceGrid
    specimen: Specimen
    theta_clamp: float
    space: np.ndarray
    background: np.ndarray


def scene_of(fields: VirtualFields, grid: FaceGrid, settings: VirtualIr, seed: int) -> ImageScene:
    """The fixed part of all frames."""
    rows, columns = np.indices(settings.image_shape)
    pixel = np.stack([rows.ravel(), columns.ravel()], axis=-1).astype(float)
    space = to_space(camera_pose(settings, seed), pixel)
    return ImageScene(settings, grid, fields.specimen, fields.theta_clamp, space, background_field(settings, seed))


def _cover(distance: np.ndarray, pixel_size: float) -> np.ndarray:
    """Share of a pixel that lies inside an edge `distance` mm away (positive inside)."""
    return np.clip(0.5 + distance / pixel_size, 0.0, 1.0)


def render(scene: ImageScene, body: np.ndarray, u: np.ndarray, theta: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Radiating temperature (n_row, n_col) K before the optics.

    `body` (n_px, 2) mm: pixel positions with the rigid motion taken off; `u` (n_y, n_x, 3) mm, `theta` (n_y, n_x) K on the
    face; `reference` (n_px, 2) mm: undeformed positions of `invert_motion`. Pixels on an edge are mixed by area.
    """
    grid, specimen, size = scene.grid, scene.specimen, scene.settings.pixel_size
    place = locate(grid, reference)
    edge = np.interp(reference[:, 1], grid.y, grid.half_width + u[:, -1, 0])
    half = outline(grid, reference[:, 1])
    slope = np.interp(reference[:, 1], grid.y, np.gradient(grid.half_width, grid.y))
    aside = half - np.abs(reference[:, 0])
    aside = aside * np.where(aside > 0.0, edge / half, 1.0) / np.sqrt(1.0 + slope**2)
    # Beyond an end of the specimen there are only jaws, which are painted last.
    share = _cover(aside, size) * ((reference[:, 1] > grid.y[0]) & (reference[:, 1] < grid.y[-1]))
    image = scene.background.ravel() + share * (interpolate(place, theta) - scene.background.ravel())
    mouth = 0.5 * specimen.total_length - specimen.gripped_length
    lower, upper = (y + float(np.interp(y, grid.y, u[:, 0, 1])) for y in (-mouth, mouth))
    between = np.maximum(lower - body[:, 1], body[:, 1] - upper)
    beside = 0.5 * specimen.grip_width + _JAW_MARGIN - np.abs(body[:, 0])
    jaw = _cover(between, size) * _cover(beside, size)
    return np.asarray(image + jaw * (scene.theta_clamp - image)).reshape(scene.settings.image_shape)


def measure_infrared(fields: VirtualFields, scene: ImageScene, motion: RigidMotion, seed: int) -> np.ndarray:
    """Frames (n_f, n_row, n_col) K as the camera delivers them: blurred, with offset and white noise (NETD)."""
    settings, grid = scene.settings, scene.grid
    noise = stream(seed, "ir.noise")
    depth = -0.5 * fields.specimen.thickness
    frames = np.empty((len(fields.ir_time), *settings.image_shape))
    reference = scene.space.copy()
    for k, (u, theta) in enumerate(zip(fields.ir_u, fields.ir_theta, strict=True)):
        # Where the line of sight (along z) meets the plane of the back face: x = R_2x2 X + R_2z depth + d.
        turn = motion.rotation[k]
        body = np.linalg.solve(turn[:2, :2], (scene.space - motion.shift[k, :2] - depth * turn[:2, 2]).T).T
        reference = invert_motion(grid, u[grid.order], body, reference)
        ideal = render(scene, body, u[grid.order], theta[grid.order], reference)
        blurred = gaussian_filter(ideal, settings.blur_px, mode="nearest") if settings.blur_px > 0.0 else ideal
        frames[k] = blurred + settings.offset + settings.netd * noise.standard_normal(settings.image_shape)
    return frames


def write_infrared(folder: Path, time: np.ndarray, frames: np.ndarray) -> None:
    """One file `frame_NNNN.csv` per frame, degC with three decimals, one line per pixel row."""
    folder.mkdir()
    row = ",".join(["%.3f"] * frames.shape[2])
    for k, t in enumerate(time):
        lines = [f"# time_s: {t:.3f}"]
        lines += [row % tuple(values) for values in (frames[k] - CELSIUS).tolist()]
        (folder / f"frame_{k:04d}.csv").write_text("\n".join(lines) + "\n", encoding="ascii")
