"""Upper and lower jaw differ in temperature: slot boundary_temperature. Off at difference = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "boundary_temperature"
ON = ("clamp",)
PARAMS = (Param("clamp_difference.difference", "K", 0.0, -50.0, 50.0, 0.2, "upper (y > 0) minus lower jaw", probe=0.5),)
FORMULA = "theta_M += difference sign(y) / 2"
SOURCE = "one jaw hangs on the warm actuator, the other on the frame; bar between two temperatures, Carslaw and Jaeger 1959, section 3.3"


def boundary_temperature(y: np.ndarray, time: float, elapsed: float, difference: float) -> np.ndarray:
    """Half the difference above, minus half of it below the middle of the specimen, K; y in mm from its middle."""
    return np.asarray(0.5 * difference * np.sign(y))
