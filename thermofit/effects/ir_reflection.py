"""Reflected surroundings whose share grows towards one end (a warm actuator, a person): slot reflection. Off at strength = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.scene import Scene

SLOT = "reflection"
PARAMS = (
    Param("ir_reflection.strength", "K", 0.0, -20.0, 20.0, 0.1, "change of the reflected background over the test", probe=0.5),
    Param(
        "ir_reflection.tilt", "1/mm", 0.0, -0.1, 0.1, 0.01, "relative change of the reflection along the load", scan=(0.0,), follows=True
    ),
)
FORMULA = "theta_seen = theta + strength (1 + tilt y) (t - t_0) / (t_end - t_0)"
SOURCE = "reflected radiation (1 - emissivity) of surroundings that warm up during the test"


def reflection(theta: np.ndarray, scene: Scene, strength: float, tilt: float) -> np.ndarray:
    """theta with a reflected background that grows linearly in time, K (n_t, n_s)."""
    share = (scene.time - scene.time[0]) / (scene.time[-1] - scene.time[0])
    return np.asarray(theta + strength * (1.0 + tilt * scene.position[..., 1]) * share[:, None])
