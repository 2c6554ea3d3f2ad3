"""Elongation of the part of a specimen that a model covers, from the DIC points near its two end sections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField

_LEAST = 6
"""Points of an end section at least: its plane has three coefficients."""


@dataclass(frozen=True)
class EndMotion:
    """`elongation` mm (n_t,) at `time` s (n_t,), zero at the first; `noise` mm of one value; `points`, the least number at an end."""

    time: np.ndarray
    elongation: np.ndarray
    noise: float
    points: int

    def at(self, times: np.ndarray, load_start: float) -> np.ndarray:
        """Elongation (n,) at times s between the stages, zero before loading. DataError where loading begins before the first stage, or
        a time lies after the last."""
        if self.time[0] > load_start + 1e-6:
            raise DataError(
                f"force.drives is 'dic', but loading begins at {load_start:g} s, before the first DIC stage at {self.time[0]:g} s: the "
                "elongation until then is not known; let the force drive, or take a stage at rest"
            )
        if times[-1] > self.time[-1] + 1e-6:
            raise DataError(
                f"force.drives is 'dic', but the last DIC stage is at {self.time[-1]:g} s and {times[-1]:g} s is asked for; end the "
                "evaluation times at the last stage"
            )
        return np.asarray(np.interp(times, self.time, self.elongation))


def end_motion(dic: DicField, ends: tuple[float, float], band: float) -> EndMotion:
    """Elongation between the sections y = ends[0] and y = ends[1] (mm) at the DIC stages.

    At each end u_y = a + b x + c (y - y_end) is fitted by least squares to the points within `band` mm: a is the displacement of the
    centre, free of rotation and of the strain within the band, and averages the noise of its points. DataError where an end has
    fewer than six measured points at a stage.
    """
    motion, variance, least = [], [], len(dic.point_id)
    for y_end in ends:
        centre, factor, count = _centre(dic, y_end, band)
        motion.append(centre)
        variance.append(factor)
        least = min(least, count)
    elongation = motion[1] - motion[0]
    noise = float(np.sqrt(np.median(variance[0] + variance[1])))
    return EndMotion(np.asarray(dic.time, dtype=float), elongation - elongation[0], noise, least)


def _centre(dic: DicField, y_end: float, band: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Displacement of the centre of a section (n_t,), its variance (n_t,) mm^2, and the least number of points."""
    x, y = dic.reference[:, 0], dic.reference[:, 1] - y_end
    near = np.flatnonzero(np.abs(y) <= band)
    value, variance, least = np.empty(len(dic.time)), np.empty(len(dic.time)), len(near)
    for n in range(len(dic.time)):
        here = near[np.isfinite(dic.displacement[n, near, 1])]
        if len(here) < _LEAST:
            raise DataError(
                f"force.drives is 'dic', but {len(here)} DIC points are measured within {band:g} mm of the model's end y = {y_end:g} mm at "
                f"{dic.time[n]:g} s, at least {_LEAST} are needed; let the model end inside the field (geometry.shape bar with a shorter "
                "specimen.total_length) or widen force.band"
            )
        a = np.stack([np.ones(len(here)), x[here], y[here]], axis=1)
        u = dic.displacement[n, here, 1]
        inverse = np.linalg.pinv(a)
        coefficient = inverse @ u
        left = u - a @ coefficient
        value[n] = coefficient[0]
        variance[n] = float(left @ left) / (len(here) - 3) * float(inverse[0] @ inverse[0])
        least = min(least, len(here))
    return value, variance, least
