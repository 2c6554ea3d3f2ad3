"""Refined camera pose from the specimen's own edges in one frame: offset across the width and roll.

Landmarks picked by hand are good to about 0.1 px; the straight edges of the parallel length, seen over hundreds of
rows, fix the mid-line ten times better, provided that specimen and background differ in temperature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from thermofit.core.experiment import Specimen
from thermofit.observe.camera import CameraPose, make_pose, specimen_to_pixel

MINIMUM_CONTRAST = 10.0
"""Step of temperature at the edge, in standard deviations of the pixel noise, that an edge must have to be used."""

_BAND = (3.5, 8.5)
"""px from the edge between which the levels on either side are taken: away from the blur."""
_STEP = 0.25
_SEARCH = 3.0
_BLOCK = 8
_MARGIN = 3.0
"""mm by which the evaluated length ends before the shoulders."""
_LEAST_BLOCKS, _LEAST_SHARE = 6, 0.5
_LARGEST_SCATTER = 0.5
_WIDTH_TOLERANCE = 0.05


@dataclass(frozen=True)
class EdgeRefinement:
    """Outcome: `pose` is None where the edges cannot be used, with the `reason` in words.

    `shift_px` of the origin to the right in the image, `roll_change` rad (clockwise) and their standard deviations from the
    scatter along the edges, `width_mm` between the edges by the pose's scale, `contrast` (median, in noise levels) and the
    number of edge positions used, `n_used` (left, right).
    """

    pose: CameraPose | None
    reason: str
    shift_px: float = 0.0
    roll_change: float = 0.0
    sigma_shift_px: float = 0.0
    sigma_roll: float = 0.0
    width_mm: float = float("nan")
    contrast: float = 0.0
    n_used: tuple[int, int] = (0, 0)


@dataclass(frozen=True)
class _Edge:
    """One edge: `along` (n,) px from the origin, outward deviation `out` (n,) px from the expected place, contrast K (n,).

    `common` px is the standard deviation of what all deviations of the edge share: the error of the levels' slope.
    """

    along: np.ndarray
    out: np.ndarray
    contrast: np.ndarray
    usable: np.ndarray
    common: float


def pixel_noise(frame: np.ndarray) -> float:
    """Standard deviation in K of the white noise of a frame, from second differences down the columns (median based)."""
    second = frame[:-2] - 2.0 * frame[1:-1] + frame[2:]
    return float(1.4826 * np.median(np.abs(second - np.median(second))) / np.sqrt(6.0))


def refine_pose(pose: CameraPose, frame: np.ndarray, specimen: Specimen, netd: float | None = None) -> EdgeRefinement:
    """Correct offset across the width and roll of `pose` so that its mid-line runs midway between the visible edges.

    `frame` (n_row, n_col) K of the specimen before it is loaded (a mean of several frames is better); `netd` K is the noise
    of a pixel, estimated where None. An edge is where the temperature passes midway between specimen and background,
    found in blocks of eight rows; one robust line per edge. Scale and offset along the axis are kept.
    """
    frame = np.asarray(frame, dtype=float)
    noise = max(pixel_noise(frame) if netd is None else netd, 1e-6)
    along = _visible_rows(pose, frame.shape, specimen)
    if len(along) < _LEAST_BLOCKS * _BLOCK:
        return EdgeRefinement(None, f"both edges are seen over {len(along)} px only, at least {_LEAST_BLOCKS * _BLOCK} are needed")
    edges = [_edge(pose, frame, along, sign * 0.5 * specimen.gauge_width / pose.scale, noise) for sign in (-1.0, 1.0)]
    contrast = float(min(np.median(np.abs(edge.contrast)) for edge in edges) / noise)
    used = (int(edges[0].usable.sum()), int(edges[1].usable.sum()))
    for edge, name in zip(edges, ("left", "right"), strict=True):
        good = edge.along[edge.usable]
        if len(good) < _LEAST_BLOCKS or np.ptp(good) < _LEAST_SHARE * np.ptp(along):
            reason = (
                f"the {name} edge has a contrast of {np.median(np.abs(edge.contrast)):.3f} K at a noise of {noise:.3f} K and is found in "
                f"{len(good)} of {len(edge.along)} places, at least {_LEAST_BLOCKS} with {MINIMUM_CONTRAST:g} times the noise are needed"
            )
            return EdgeRefinement(None, reason, contrast=contrast, n_used=used)
    return _fit_midline(pose, specimen, edges, contrast)


def _fit_midline(pose: CameraPose, specimen: Specimen, edges: list[_Edge], contrast: float) -> EdgeRefinement:
    """Pose whose axis is the mean of both edge lines."""
    lines = [_robust_line(e.along[e.usable], e.out[e.usable], np.abs(e.contrast[e.usable])) for e in edges]
    (left, cov_left, scatter_left), (right, cov_right, scatter_right) = lines
    middle = 0.5 * (right - left)
    shared = np.array([edges[0].common ** 2 + edges[1].common ** 2, 0.0])
    sigma = 0.5 * np.sqrt(np.diag(cov_left) + np.diag(cov_right) + shared)
    width = specimen.gauge_width + (left[0] + right[0]) * pose.scale
    used = (int(edges[0].usable.sum()), int(edges[1].usable.sum()))
    scatter = max(scatter_left, scatter_right)
    reason = ""
    if scatter > _LARGEST_SCATTER:
        reason = f"the edge positions scatter by {scatter:.2f} px about a straight line, at most {_LARGEST_SCATTER:g} px are expected"
    elif abs(width / specimen.gauge_width - 1.0) > _WIDTH_TOLERANCE:
        reason = f"the edges found are {width:.2f} mm apart, the specimen is {specimen.gauge_width:g} mm wide"
    if reason:
        return EdgeRefinement(None, reason, width_mm=float(width), contrast=contrast, n_used=used)
    across = np.array([pose.axis_y[1], -pose.axis_y[0]])
    refined = make_pose(pose.scale, pose.origin + middle[0] * across, pose.axis_y + middle[1] * across, pose.side)
    return EdgeRefinement(
        refined,
        "",
        float(middle[0]),
        float(np.arctan(middle[1])),
        float(sigma[0]),
        float(sigma[1]),
        float(width),
        contrast,
        used,
    )


def _visible_rows(pose: CameraPose, shape: tuple[int, ...], specimen: Specimen) -> np.ndarray:
    """Positions along the axis, px from the origin in steps of one, where both edges and their bands lie in the frame."""
    half = (0.5 * specimen.parallel_length - _MARGIN) / pose.scale
    if half <= 0.0:
        return np.empty(0)
    along = np.arange(np.ceil(-half), np.floor(half) + 1.0)
    reach = 0.5 * specimen.gauge_width + (_BAND[1] + 1.0) * pose.scale
    seen = np.ones(len(along), dtype=bool)
    for x in (-reach, reach):
        pixel = specimen_to_pixel(pose, np.column_stack([np.full(len(along), x), along * pose.scale]))
        seen &= ((pixel >= 0.0) & (pixel <= np.array(shape) - 1.0)).all(axis=1)
    return along[seen]


def _edge(pose: CameraPose, frame: np.ndarray, along: np.ndarray, place: float, noise: float) -> _Edge:
    """Positions of the edge expected `place` px to the right of the axis, one for each block of rows."""
    across = np.array([pose.axis_y[1], -pose.axis_y[0]])
    outward = np.arange(-_BAND[1], _BAND[1] + 0.5 * _STEP, _STEP)
    right = place + np.sign(place) * outward
    pixel = pose.origin + along[:, None, None] * pose.axis_y + right[None, :, None] * across
    profile = map_coordinates(frame, [pixel[..., 0], pixel[..., 1]], order=1, mode="nearest")
    n = len(along) // _BLOCK
    # The remainder of the rows is shared between both ends.
    start = (len(along) - n * _BLOCK) // 2
    profile = profile[start : start + n * _BLOCK].reshape(n, _BLOCK, -1).mean(axis=1)
    centre = along[start : start + n * _BLOCK].reshape(n, _BLOCK).mean(axis=1)
    inner, outer = outward <= -_BAND[0], outward >= _BAND[0]
    (inside, sigma_in), (outside, sigma_out) = _level(profile, outward, inner), _level(profile, outward, outer)
    contrast = outside - inside
    out, found = _crossing(profile, outward, 0.5 * (inside + outside))
    usable = found & (np.abs(contrast) > MINIMUM_CONTRAST * noise)
    common = 0.5 * np.hypot(sigma_in, sigma_out) / _steepness(profile, outward, contrast, usable) if usable.any() else np.inf
    return _Edge(centre, out, contrast, usable, float(common))


def _level(profile: np.ndarray, outward: np.ndarray, band: np.ndarray) -> tuple[np.ndarray, float]:
    """Temperature at the edge itself (n,), carried on linearly from a band beside it with one slope for all blocks.

    Also the standard deviation of the part that the slope brings into all of them; 1.25: a median instead of a mean.
    """
    s = outward[band] - outward[band].mean()
    slopes = profile[:, band] @ s / (s @ s)
    spread = 1.4826 * float(np.median(np.abs(slopes - np.median(slopes))))
    reach = float(outward[band].mean())
    return profile[:, band].mean(axis=1) - float(np.median(slopes)) * reach, 1.25 * spread / np.sqrt(len(slopes)) * abs(reach)


def _steepness(profile: np.ndarray, outward: np.ndarray, contrast: np.ndarray, usable: np.ndarray) -> float:
    """Largest slope K/px of the mean profile over two pixels, at least that of a blur as wide as the search."""
    mean = np.average(profile[usable] * np.sign(contrast[usable])[:, None], axis=0)
    lag = round(2.0 / _STEP)
    near = np.abs(outward[lag:] - 1.0) <= _SEARCH
    steepest = float((mean[lag:] - mean[:-lag])[near].max()) / 2.0
    return max(steepest, float(np.mean(np.abs(contrast[usable]))) / (2.0 * _SEARCH))


def _crossing(profile: np.ndarray, outward: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where each profile (n, n_s) passes its level `half` (n,): the passage nearest to the expected edge, and whether there is one."""
    near = np.abs(outward) <= _SEARCH
    s, above = outward[near], profile[:, near] - half[:, None]
    passes = above[:, :-1] * above[:, 1:] <= 0.0
    drop = above[:, :-1] - above[:, 1:]
    place = s[:-1] + np.diff(s) * above[:, :-1] / np.where(drop == 0.0, 1.0, drop)
    distance = np.where(passes & (drop != 0.0), np.abs(place), np.inf)
    best = distance.argmin(axis=1)
    rows = np.arange(len(profile))
    return place[rows, best], np.isfinite(distance[rows, best])


def _robust_line(t: np.ndarray, value: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Line value = a + b t with weights (inverse standard deviations) by Huber's iteration; (a, b), covariance (2, 2), scatter."""
    design = np.column_stack([np.ones(len(t)), t])
    weight = weight / weight.max()
    huber = np.ones(len(t))
    for _ in range(20):
        w = weight * np.sqrt(huber)
        line = np.linalg.lstsq(design * w[:, None], value * w, rcond=None)[0]
        residual = (value - design @ line) * weight
        scatter = 1.4826 * float(np.median(np.abs(residual)))
        huber = np.minimum(1.0, 1.5 * scatter / np.maximum(np.abs(residual), 1e-300))
    w = weight * np.sqrt(huber)
    inverse = np.linalg.inv((design * w[:, None]).T @ (design * w[:, None]))
    variance = float((huber * residual**2).sum() / max(len(t) - 2, 1))
    return line, inverse * variance, float(np.sqrt(np.mean((value - design @ line) ** 2 * huber)))
