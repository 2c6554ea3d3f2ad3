"""Temperatures of the jaws that drift during the test, both together or apart: slot boundary_temperature. Off at rate = apart = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.air_drift import TIMES
from thermofit.effects.air_drift import boundary_temperature as drift

SLOT = "boundary_temperature"
ON = ("clamp",)
PARAMS = (
    Param("clamp_drift.rate", "K/s", 0.0, -0.5, 0.5, 1e-3, "drift of the jaws at the first time, mean of both", probe=5e-3),
    Param("clamp_drift.apart", "K/s", 0.0, -0.5, 0.5, 1e-3, "the same, upper (y > 0) minus lower jaw", probe=5e-3),
    Param("clamp_drift.time", "s", 1e5, 1.0, 1e7, 100.0, "time constant with which the drift dies away", scan=TIMES, scan_of="duration"),
)
FORMULA = "theta_M += (rate + apart sign(y) / 2) time (1 - exp(-(t - t_0) / time)); one jaw alone: apart = 2 rate or -2 rate"
SOURCE = "jaws of a machine whose hydraulics warm up, or that take the heat of the specimen; first-order warming"


def boundary_temperature(y: np.ndarray, time: float, elapsed: float, rate: float, apart: float, constant: float) -> np.ndarray:
    """Change of the temperature of the jaws since the first time, K; y in mm from the middle of the specimen."""
    return drift(y, time, elapsed, 1.0, constant) * (rate + 0.5 * apart * np.sign(y))
