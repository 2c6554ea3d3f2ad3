"""Emissivity of the coating that changes with strain: slot emission. Off at slope = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.scene import Scene

SLOT = "emission"
PARAMS = (Param("ir_emissivity.slope", "1", 0.0, -5.0, 5.0, 0.1, "relative change of the emissivity per axial strain", probe=0.5),)
FORMULA = "theta_seen = theta + slope eps_yy (theta - theta_air)"
SOURCE = "paint that thins and cracks as the specimen stretches; radiance linear in the temperature about that of the surroundings"


def emission(theta: np.ndarray, scene: Scene, slope: float) -> np.ndarray:
    """theta + slope eps (theta - theta_air), K (n_t, n_s); eps is the logarithmic strain along the load."""
    return np.asarray(theta + slope * scene.strain * (theta - scene.theta_air))
