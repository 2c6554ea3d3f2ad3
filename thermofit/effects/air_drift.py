"""Temperature of the air that drifts during the test: slot boundary_temperature. Off at rate = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "boundary_temperature"
ON = ("air",)
TIMES = (0.1, 0.5, 100.0)
"""Time constants that are tried, in durations of the test."""
PARAMS = (
    Param("air_drift.rate", "K/s", 0.0, -0.5, 0.5, 1e-3, "drift of the air at the first time", probe=5e-3),
    Param("air_drift.time", "s", 1e5, 1.0, 1e7, 100.0, "time constant with which the drift dies away", scan=TIMES, scan_of="duration"),
)
FORMULA = "theta_M += rate time (1 - exp(-(t - t_0) / time))"
SOURCE = "air conditioning and waste heat of the machine; first-order warming"


def boundary_temperature(y: np.ndarray, time: float, elapsed: float, rate: float, constant: float) -> np.ndarray:
    """Change of a temperature of the surroundings since the first time, K: rate x elapsed far below the time constant."""
    return np.asarray(-rate * constant * np.expm1(-elapsed / constant) + 0.0 * y)
