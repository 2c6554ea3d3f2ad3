"""Landmarks found in a frame without a click: edges of the parallel length, and the shoulders, which tell where its middle is.

Both edges are the places of steepest temperature, of opposite sense, in blocks of rows. Their distance is the width, hence the scale; their
mid-line is the axis, hence the roll. Along the axis nothing tells one place from another but the shoulders, where the width grows as
w + 2 (R - sqrt(R^2 - (|y| - L/2)^2)) (DIN 50125-H).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

from thermofit.core.experiment import Landmarks, Specimen
from thermofit.observe.camera import CameraPose, make_pose, specimen_to_pixel
from thermofit.observe.camera_edges import pixel_noise

_BLOCK = 6
"""Rows of which a mean profile is made."""
_BLUR = 1.5
"""px: width of the filter that the slope is taken with."""
_CLEAR = 6.0
"""Slope at an edge over its noise."""
_LEAST_BLOCKS = 6
_NARROWEST = 8.0
"""px between the edges."""
_PARALLEL = 0.03
"""Share by which the width may differ from the usual one in the parallel length."""
_SHOULDER = 1.05
"""Width over that of the parallel length from which on a block lies on a shoulder."""
_LEAST_SHOULDER = 2
_SCATTER = 1.0
"""px: largest scatter of the edges about the outline of the specimen."""


@dataclass(frozen=True)
class Proposal:
    """Outcome: `pose` by edges and, where `shoulders` are in the frame, by them; without them its place along the axis is the middle of the
    frame and means nothing. None where there are no edges, with the `reason` in words. `scatter` px of the edges about the outline."""

    pose: CameraPose | None
    shoulders: bool = False
    scatter: float = 0.0
    reason: str = ""


@dataclass(frozen=True)
class _Edges:
    """Edges (n,) in px by column, at the rows (n,)."""

    row: np.ndarray
    left: np.ndarray
    right: np.ndarray

    def of(self, used: np.ndarray) -> _Edges:
        return _Edges(self.row[used], self.left[used], self.right[used])


def propose(frame: np.ndarray, specimen: Specimen, side: str) -> Proposal:
    """Pose of an upright specimen (crosshead at row 0) in one frame (n_row, n_col) K of the unloaded state; a mean of several is better."""
    frame = np.asarray(frame, dtype=float)
    edges = _edges(frame)
    if len(edges.row) < _LEAST_BLOCKS:
        return Proposal(None, reason=f"both edges stand out of the noise in {len(edges.row)} of {frame.shape[0] // _BLOCK} blocks of rows")
    width = edges.right - edges.left
    usual = float(np.median(width[width <= np.quantile(width, 0.6)]))
    straight = np.abs(width / usual - 1.0) < _PARALLEL
    if straight.sum() < _LEAST_BLOCKS:
        return Proposal(None, reason="the two edges are nowhere parallel")
    inner = edges.of(straight)
    tilt, at = np.polyfit(inner.row, 0.5 * (inner.left + inner.right), 1)
    roll = -float(np.arctan(tilt))
    scale = specimen.gauge_width / (usual * np.cos(roll))
    middle = 0.5 * (frame.shape[0] - 1)
    start = np.array([middle, tilt * middle + at, roll, 0.0])
    wide = edges.row[width > _SHOULDER * usual]
    shoulders = len(wide) >= _LEAST_SHOULDER
    fits = [
        _fitted(edges if shoulders else inner, specimen, scale, side, guess, shoulders) for guess in _guesses(start, wide, specimen, scale)
    ]
    pose, scatter = min(fits, key=lambda fit: fit[1])
    if scatter > _SCATTER:
        return Proposal(None, reason=f"the edges found lie {scatter:.1f} px about the outline of the specimen")
    return Proposal(pose, shoulders, scatter)


def _edges(frame: np.ndarray) -> _Edges:
    """Left and right edge of every block of rows in which both stand out of the noise."""
    n = frame.shape[0] // _BLOCK
    profile = frame[: n * _BLOCK].reshape(n, _BLOCK, -1).mean(axis=1)
    slope = gaussian_filter1d(profile, _BLUR, axis=1, order=1, mode="nearest")
    # Of white noise sigma the filtered slope has sigma / (2 pi^(1/4) blur^(3/2)).
    noise = max(pixel_noise(frame), 1e-6) / np.sqrt(_BLOCK) / (2.0 * np.pi**0.25 * _BLUR**1.5)
    slope[:, [0, 1, -2, -1]] = 0.0
    rows, left, right = [], [], []
    for k, s in enumerate(slope):
        pairs = [(int(np.argmax(sign * s)), int(np.argmin(sign * s)), sign) for sign in (1.0, -1.0)]
        a, b, sign = max(((i, j, g) for i, j, g in pairs if j - i >= _NARROWEST), key=lambda p: abs(s[p[0]] - s[p[1]]), default=(0, 0, 0.0))
        if sign == 0.0 or min(abs(s[a]), abs(s[b])) < _CLEAR * noise:
            continue
        rows.append((k + 0.5) * _BLOCK - 0.5)
        left.append(a + _top(sign * s, a))
        right.append(b + _top(-sign * s, b))
    return _Edges(np.array(rows), np.array(left), np.array(right))


def _top(s: np.ndarray, k: int) -> float:
    """Place of the top of a peak at k, in px from k, by a parabola."""
    below, here, above = s[k - 1], s[k], s[k + 1]
    bend = below - 2.0 * here + above
    return 0.0 if bend == 0.0 else float(np.clip(0.5 * (below - above) / bend, -0.5, 0.5))


def _guesses(start: np.ndarray, wide: np.ndarray, specimen: Specimen, scale: float) -> list[np.ndarray]:
    """Starts of the fit: the middle of the frame, and, with shoulders, the middles that the first and the last wide block suggest."""
    if len(wide) < _LEAST_SHOULDER:
        return [start]
    half = 0.5 * specimen.parallel_length / scale
    above, below = wide[wide < start[0]], wide[wide > start[0]]
    rows = [*([float(above.max()) + half] if len(above) else []), *([float(below.min()) - half] if len(below) else [])]
    return [np.array([row, start[1], start[2], 0.0]) for row in (*rows, *([float(np.mean(rows))] if len(rows) > 1 else []))]


def _fitted(edges: _Edges, specimen: Specimen, scale: float, side: str, start: np.ndarray, along: bool) -> tuple[CameraPose, float]:
    """Pose (row, column of the centre, roll, logarithm of the scale) whose outline goes through the edges, and their scatter in px about
    it; not `along`: the centre stays in its row."""
    pixel = np.concatenate([np.column_stack([edges.row, edges.left]), np.column_stack([edges.row, edges.right])])
    free = np.array([along, True, True, True])

    def pose_of(q: np.ndarray) -> CameraPose:
        p = start.copy()
        p[free] = q
        return make_pose(scale * np.exp(p[3]), p[:2], np.array([-np.cos(p[2]), np.sin(p[2])]), side)

    def error(q: np.ndarray) -> np.ndarray:
        pose = pose_of(q)
        away = (pixel - pose.origin) * pose.scale
        x, y = np.abs(away @ pose.axis_x), away @ pose.axis_y
        return np.asarray((x - half_width(specimen, y)) / pose.scale)

    steps = np.array([5.0, 1.0, 0.02, 0.02])[free]
    found = least_squares(error, start[free], x_scale=steps, loss="soft_l1", f_scale=0.3)
    return pose_of(found.x), float(1.4826 * np.median(np.abs(error(found.x))))


def half_width(specimen: Specimen, y: np.ndarray) -> np.ndarray:
    """Half of the width in mm of the unloaded dogbone at the places y in mm."""
    radius, most = specimen.shoulder_radius, 0.5 * specimen.grip_width
    beyond = np.clip(np.abs(y) - 0.5 * specimen.parallel_length, 0.0, radius)
    return np.asarray(np.minimum(0.5 * specimen.gauge_width + radius - np.sqrt(radius**2 - beyond**2), most))


def landmarks_from(pose: CameraPose, specimen: Specimen, frame: int, image_shape: tuple[int, int]) -> Landmarks:
    """What would have been picked in a frame of that pose: left and right as seen in the image, all inside of it."""
    half = 0.5 * specimen.gauge_width
    left = 1.0 if pose.side == "back" else -1.0
    room = pose.scale * min(pose.origin[0], image_shape[0] - 1.0 - pose.origin[0])
    reach = min(0.4 * specimen.parallel_length, 0.9 * room)
    angle = np.deg2rad([90.0, 210.0, 330.0])
    ring = min(0.8 * half, reach) * np.column_stack([np.cos(angle), np.sin(angle)])

    def px(*xy: tuple[float, float]) -> np.ndarray:
        return specimen_to_pixel(pose, np.array(xy))

    return Landmarks(
        frame=frame,
        length=px((0.0, -reach), (0.0, reach)),
        length_mm=2.0 * reach,
        edge_left=px((left * half, -reach), (left * half, reach)),
        edge_right=px((-left * half, 0.0))[0],
        circle=specimen_to_pixel(pose, ring),
    )


def disagreement(given: CameraPose, found: Proposal, specimen: Specimen) -> tuple[float, float]:
    """Largest distance in px between the two poses' places of the specimen: across the axis at both ends of the parallel length, and along
    it at its middle; nan along where no shoulder was found."""
    assert found.pose is not None
    half, end = 0.5 * specimen.gauge_width, 0.3 * specimen.parallel_length
    places = np.array([(x, y) for x in (-half, half) for y in (-end, end)])
    at = specimen_to_pixel(given, places)
    away = (at - found.pose.origin) * found.pose.scale
    across = np.abs(np.abs(away @ found.pose.axis_x) - half).max() / found.pose.scale
    along = abs((given.origin - found.pose.origin) @ found.pose.axis_y) if found.shoulders else float("nan")
    return float(across), float(along)
