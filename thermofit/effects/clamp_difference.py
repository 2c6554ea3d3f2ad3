"""Upper and lower jaw differ in temperature: slot boundary_temperature. Off at difference = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "boundary_temperature"
ON = ("clamp",)
DECLARED = 0.5
"""K; standard error of one declared temperature as that of both jaws. 0.14 K are two thermocouples of 0.1 K each; the rest is what jaws may
differ by where one was measured: in a resting machine they lie 0.7 to 1.15 K from the air (thesis Table 3.2), and no farther apart."""
PARAMS = (Param("clamp_difference.difference", "K", 0.0, -50.0, 50.0, 0.2, "upper (y > 0) minus lower jaw", probe=0.5, prior=DECLARED),)
FORMULA = "theta_M += difference sign(y) / 2"
SOURCE = "one jaw hangs on the warm actuator, the other on the frame; bar between two temperatures, Carslaw and Jaeger 1959, section 3.3"


def boundary_temperature(y: np.ndarray, time: float, elapsed: float, difference: float) -> np.ndarray:
    """Half the difference above, minus half of it below the middle of the specimen, K; y in mm from its middle."""
    return np.asarray(0.5 * difference * np.sign(y))
