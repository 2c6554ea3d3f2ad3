"""What a measured test says of its material at a first look: elastic slope, largest nominal stress and strain.

They set starts and bounds of a new study, which are good to a factor, not to a percent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.experiment import Experiment
from thermofit.read.ranges import RANGES

_GAUGE = 0.4
"""Part of the parallel length on either side of the middle in which the strain is uniform enough."""
_SURE = 0.1
"""Relative standard error of a chord's strain from which on the chord counts."""
_LEAST_POINTS = 6


@dataclass(frozen=True)
class FirstLook:
    """Elastic slope and largest nominal stress in MPa, largest strain of the gauge length."""

    modulus: float
    stress: float
    strain: float


def looked_at(experiment: Experiment) -> FirstLook | str:
    """The same of an experiment in memory with displacements.

    The steepest chord from the first stage counts: plastic flow makes chords shallower, noise within `_SURE` does not make them much
    steeper.
    """
    course = course_of(experiment)
    if isinstance(course, str):
        return course
    modulus, largest = course.modulus, float(np.abs(course.stress).max())
    if modulus is None or not largest > 0.0:
        return "no strain stands clear of its noise while the force rises"
    low, high = RANGES["modulus"].possible
    if not low < modulus < high:
        return f"its elastic slope would be {modulus:.3g} MPa, which is that of no metal: check units, axes and clocks"
    return FirstLook(modulus, largest, float(np.abs(course.strain).max()))


@dataclass(frozen=True)
class Course:
    """Nominal stress MPa and mean strain of the gauge length over time s, both (n,) from their first values; `sigma` (n,) is the standard
    error of the strain."""

    time: np.ndarray
    strain: np.ndarray
    stress: np.ndarray
    sigma: np.ndarray

    @property
    def modulus(self) -> float | None:
        """Steepest chord from the first value up to the largest stress; None where no strain stands clear of its noise."""
        end = int(np.argmax(np.abs(self.stress)))
        sure = np.flatnonzero(np.hypot(self.sigma, self.sigma[0]) < _SURE * np.abs(self.strain))
        sure = sure[(sure > 0) & (sure <= end)]
        return float(np.max(self.stress[sure] / self.strain[sure])) if len(sure) else None


def course_of(experiment: Experiment) -> Course | str:
    """Stress and strain of an experiment with displacements, or in words why there are none."""
    assert experiment.dic is not None
    strain, sigma = _gauge_strain(experiment)
    force = np.interp(experiment.dic.time, experiment.force.time, experiment.force.force)
    stress = force / (experiment.specimen.gauge_width * experiment.specimen.thickness)
    known = np.flatnonzero(np.isfinite(strain))
    if len(known) < 3:
        return f"only {len(known)} stages have {_LEAST_POINTS} points or more in the gauge length"
    first = known[0]
    return Course(experiment.dic.time[known], strain[known] - strain[first], stress[known] - stress[first], sigma[known])


def _gauge_strain(experiment: Experiment) -> tuple[np.ndarray, np.ndarray]:
    """Mean strain along y of the gauge length and its standard error, each (n_t,), NaN in stages with too few points.

    Slope of u_y over y by least squares; its error is that of the scatter about the line.
    """
    assert experiment.dic is not None
    place, moved = experiment.dic.reference[:, :2], experiment.dic.displacement[:, :, 1]
    inside = (np.abs(place[:, 1]) < _GAUGE * experiment.specimen.parallel_length) & (np.abs(place[:, 0]) < experiment.specimen.gauge_width)
    strain, sigma = np.full(len(moved), np.nan), np.full(len(moved), np.nan)
    for n, u in enumerate(moved):
        used = inside & np.isfinite(u) & np.isfinite(place[:, 1])
        y = place[used, 1] - place[used, 1].mean() if used.any() else np.zeros(0)
        if used.sum() < _LEAST_POINTS or not (size := float(y @ y)) > 0.0:
            continue
        strain[n] = y @ u[used] / size
        left = u[used] - u[used].mean() - strain[n] * y
        sigma[n] = np.sqrt(left @ left / (used.sum() - 2) / size)
    return strain, sigma
