"""Slow drift of the infrared camera's offset: slot sensor. Off at rate = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.scene import Scene

SLOT = "sensor"
PARAMS = (Param("ir_drift.rate", "K/s", 0.0, -0.1, 0.1, 1e-4, "drift of the camera's offset", probe=1e-3),)
FORMULA = "theta_camera = theta + rate (t - t_0)"
SOURCE = "uncooled and cooled cameras between two shutter corrections; VDI/VDE 5585 part 2"


def sensor(theta: np.ndarray, scene: Scene, rate: float) -> np.ndarray:
    """theta + rate (t - t_0), K (n_t, n_s); t_0 is the first time of the test."""
    return np.asarray(theta + rate * (scene.time - scene.time[0])[:, None])
