"""From which side does the infrared camera see the specimen? Its sideways motion tells: both instruments see the same one.

The specimen never moves straight: jaws slip and turn by a few hundredths of a millimetre. DIC measures that along x. The frames show it as
a motion of the specimen's mid-line to the right or to the left. Where the declared side is the wrong one, or the frames were mirrored, the
two have opposite signs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.experiment import DicField, InfraredSequence, Specimen
from thermofit.observe.camera import CameraPose
from thermofit.observe.camera_edges import refine_pose

_FRAMES = 40
"""Most frames that are looked at."""
_LEAST_FRAMES, _LEAST_POINTS = 5, 12
_RESOLVED = 0.01
"""px of the mid-line that the edges of a frame resolve at best: blur and pattern are systematic along an edge."""


@dataclass(frozen=True)
class SeenAcross:
    """Motion of the mid-line in the image over that of DIC as the pose has it: `slope` is 1 where the side is right, -1 where it is
    mirrored; its standard error `sigma`, and the number of `frames`."""

    slope: float
    sigma: float
    frames: int


def seen_across(pose: CameraPose, infrared: InfraredSequence, dic: DicField, specimen: Specimen) -> SeenAcross | None:
    """Slope of the mid-line's motion over that of DIC. None where fewer than five frames show both edges, or nothing moved sideways."""
    during = np.flatnonzero((infrared.time >= dic.time[0]) & (infrared.time <= dic.time[-1]))
    if not len(during):
        return None
    chosen = np.unique(during[np.linspace(0, len(during) - 1, _FRAMES).astype(int)])
    axis, narrower = _motion_of_axis(dic)
    known = np.isfinite(axis)
    if known.sum() < 2:
        return None
    moved, seen, sigma = [], [], []
    start = pose
    for k in chosen:
        width = specimen.gauge_width * (1.0 + float(np.interp(infrared.time[k], dic.time[known], narrower[known])))
        found = refine_pose(start, infrared.frames[k], replace(specimen, gauge_width=width))
        if found.pose is None:
            continue
        moved.append(float(np.interp(infrared.time[k], dic.time[known], axis[known])))
        seen.append(found.shift_px * pose.scale)
        sigma.append(float(np.hypot(found.sigma_shift_px, _RESOLVED)) * pose.scale)
    if len(seen) < _LEAST_FRAMES or not np.ptp(moved) > 0.0:
        return None
    right = float(pose.axis_x @ np.array([pose.axis_y[1], -pose.axis_y[0]]))
    weight = 1.0 / np.array(sigma) ** 2
    x, y = right * np.array(moved), np.array(seen)
    x, y = x - weight @ x / weight.sum(), y - weight @ y / weight.sum()
    size = float(weight @ x**2)
    slope = float(weight @ (x * y)) / size
    scatter = float(weight @ (y - slope * x) ** 2) / (len(x) - 2)
    return SeenAcross(slope, float(np.sqrt(max(scatter, 1.0) / size)), len(x))


def _motion_of_axis(dic: DicField) -> tuple[np.ndarray, np.ndarray]:
    """Displacement u_x in mm of the specimen's axis where it passes y = 0 of the image, and the mean strain across, each (n_t,)."""
    axis, across = np.full(len(dic.time), np.nan), np.full(len(dic.time), np.nan)
    for n, u in enumerate(dic.displacement):
        used = np.isfinite(u[:, :2]).all(axis=1)
        if used.sum() < _LEAST_POINTS:
            continue
        x, y = dic.reference[used, 0], dic.reference[used, 1] + u[used, 1]
        terms = np.column_stack([np.ones(len(x)), y, x])
        found, _, rank, _ = np.linalg.lstsq(terms, u[used, 0], rcond=None)
        if rank == 3:
            axis[n], across[n] = found[0], found[2]
    return axis, across
