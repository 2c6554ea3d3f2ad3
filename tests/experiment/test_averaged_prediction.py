"""Observations that are means over patches: the prediction goes through the same means, in the residual and in its derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.virtual_pulls import SIZE, TIME, TRUTH, XY, pulled, study
from thermofit.core.parameters import Parameters
from thermofit.experiment.body import BodyExperiment
from thermofit.experiment.fields import Measured
from thermofit.observe.observation import FieldObservation

FREE = ("E", "M_y0", "F", "alpha_exp", "c0", "beta", "registration.shift_y", "camera_gain.gain")


def means(field: FieldObservation, seed: int) -> FieldObservation:
    """The observation as means over patches of a few millimetres, with moments of their own at every time."""
    rng = np.random.default_rng(seed)
    moments = np.concatenate([rng.uniform(-1.0, 1.0, (*field.mask.shape, 2)), rng.uniform(0.0, 0.6, (*field.mask.shape, 3))], axis=2)
    one = replace(field, moments=moments)
    return replace(one, value=one.averaged(field.value))
