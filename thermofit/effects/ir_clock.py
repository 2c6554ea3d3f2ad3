"""The clock of the infrared camera is not that of the load cell: slot sensor. Off at offset = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.scene import Scene

SLOT = "sensor"
PARAMS = (Param("ir_clock.offset", "s", 0.0, -20.0, 20.0, 0.1, "frames show the specimen this much later than their stamps", probe=0.5),)
FORMULA = "theta_camera(t) = theta(t + offset)"
SOURCE = "two computers, one trigger: delay of the frame grabber and drift of free-running clocks"


def sensor(theta: np.ndarray, scene: Scene, offset: float) -> np.ndarray:
    """theta at t + offset by straight lines between the times of the history, K (n_t, n_s)."""
    return scene.later(theta, offset)
