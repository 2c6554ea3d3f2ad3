"""Gain error of the load cell: slot load. Off at gain = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "load"
PARAMS = (Param("force_scale.gain", "1", 0.0, -0.5, 0.5, 1e-2, "relative error of the recorded force", probe=0.02),)
FORMULA = "F = (1 + gain) F_recorded"
SOURCE = "calibration of the load cell; ISO 7500-1 allows 0.5 to 3 % by class"


def load(force: np.ndarray, end: np.ndarray, gain: float) -> tuple[np.ndarray, np.ndarray]:
    """(1 + gain) force, N (n_t,); the crosshead end, mm (n_t,), as it is."""
    return np.asarray(force * (1.0 + gain)), end
