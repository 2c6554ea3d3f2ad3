"""What a measured test says of its material at a first look: elastic slope, largest nominal stress and strain.

They set starts and bounds of a new study, which are good to a factor, not to a percent.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thermofit.core.errors import ThermofitError
from thermofit.core.experiment import Experiment
from thermofit.read.raw import read_experiment

_GAUGE = 0.4
"""Part of the parallel length on either side of the middle in which the strain is uniform enough."""
_SURE = 0.1
"""Relative standard error of a chord's strain from which on the chord counts."""
_LEAST_POINTS = 6
_METAL = (5e3, 1e6)
"""MPa: a slope outside of this is that of no metal, but of a wrong unit, a rigid-body motion or a slipping mark."""


@dataclass(frozen=True)
class FirstLook:
    """Elastic slope and largest nominal stress in MPa, largest strain of the gauge length."""

    modulus: float
    stress: float
    strain: float


def first_look(folder: Path) -> FirstLook | str:
    """What the raw folder of a test says of its material, or in words why it does not."""
    try:
        experiment = read_experiment(folder, ("force", "dic"))
    except ThermofitError as error:
        return f"the data cannot be read yet ({error})"
    if experiment.dic is None:
        return "the experiment has no displacements"
    return looked_at(experiment)


def looked_at(experiment: Experiment) -> FirstLook | str:
    """The same of an experiment in memory with displacements.

    The steepest chord from the first stage counts: plastic flow makes chords shallower, noise within `_SURE` does not make them much
    steeper.
    """
    assert experiment.dic is not None
    strain, sigma = _gauge_strain(experiment)
    force = np.interp(experiment.dic.time, experiment.force.time, experiment.force.force)
    stress = force / (experiment.specimen.gauge_width * experiment.specimen.thickness)
    known = np.flatnonzero(np.isfinite(strain))
    if len(known) < 3:
        return f"only {len(known)} stages have {_LEAST_POINTS} points or more in the gauge length"
    strain, stress, sigma = (value[known] - value[known[0]] * shift for value, shift in ((strain, 1.0), (stress, 1.0), (sigma, 0.0)))
    largest, end = float(np.abs(stress).max()), int(np.argmax(np.abs(stress)))
    sure = np.flatnonzero(np.hypot(sigma, sigma[0]) < _SURE * np.abs(strain))
    sure = sure[(sure > 0) & (sure <= end)]
    if not len(sure) or not largest > 0.0:
        return "no strain stands clear of its noise while the force rises"
    modulus = float(np.max(stress[sure] / strain[sure]))
    if not _METAL[0] < modulus < _METAL[1]:
        return f"its elastic slope would be {modulus:.3g} MPa, which is that of no metal: check units, axes and clocks"
    return FirstLook(modulus, largest, float(np.abs(strain).max()))


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
