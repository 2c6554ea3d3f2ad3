"""Temperature of the jaws that drifts during the test: slot boundary_temperature. Off at rate = 0."""

from __future__ import annotations

from thermofit.core.parameters import Param
from thermofit.effects.air_drift import FORMULA, TIMES, boundary_temperature

__all__ = ["FORMULA", "ON", "PARAMS", "SLOT", "SOURCE", "boundary_temperature"]
SLOT = "boundary_temperature"
ON = ("clamp",)
PARAMS = (
    Param("clamp_drift.rate", "K/s", 0.0, -0.5, 0.5, 1e-3, "drift of the jaws at the first time", probe=5e-3),
    Param("clamp_drift.time", "s", 1e5, 1.0, 1e7, 100.0, "time constant with which the drift dies away", scan=TIMES, scan_of="duration"),
)
SOURCE = "jaws of a machine whose hydraulics warm up, or that take the heat of the specimen; first-order warming"
