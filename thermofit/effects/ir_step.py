"""Step of the infrared camera's offset during the test: slot sensor. Off at step = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.scene import Scene

SLOT = "sensor"
_TIMES = (0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
PARAMS = (
    Param("ir_step.step", "K", 0.0, -20.0, 20.0, 0.05, "what the camera's offset has changed by after the step", probe=0.1),
    Param("ir_step.time", "s", 5.0, -1e5, 1e5, 5.0, "time of the test in the middle of the step", scan=_TIMES, scan_of="time"),
    Param(
        "ir_step.width", "s", 5.0, 0.1, 1e5, 5.0, "half the time that the step takes", scan=(0.01, 0.1), scan_of="duration", limiting=True
    ),
)
FORMULA = "theta_camera = theta + step (1 + tanh((t - time) / width)) / 2"
SOURCE = "shutter correction or change of range during a test, or a housing that warms up and stays warm; VDI/VDE 5585 part 2"


def sensor(theta: np.ndarray, scene: Scene, step: float, time: float, width: float) -> np.ndarray:
    """theta + step (1 + tanh((t - time) / width)) / 2, K (n_t, n_s)."""
    return np.asarray(theta + (0.5 * step * (1.0 + np.tanh((scene.time - time) / width)))[:, None])
