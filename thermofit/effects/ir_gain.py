"""Wrong gain of the infrared camera about the temperature of the surroundings: slot sensor. Off at gain = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.scene import Scene

SLOT = "sensor"
PARAMS = (Param("ir_gain.gain", "1", 0.0, -0.5, 0.5, 1e-2, "relative error of temperature differences", probe=0.05),)
FORMULA = "theta_camera = theta + gain (theta - theta_air)"
SOURCE = "calibration of a camera against a black body: slope of the characteristic; a wrong emissivity acts in the same way"


def sensor(theta: np.ndarray, scene: Scene, gain: float) -> np.ndarray:
    """theta + gain (theta - theta_air), K (n_t, n_s)."""
    return np.asarray(theta + gain * (theta - scene.theta_air))
