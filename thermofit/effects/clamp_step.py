"""Jaws whose temperature changes during the test, both alike or apart: slot boundary_temperature. Off at step = apart = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "boundary_temperature"
ON = ("clamp",)
ONSET = 5.0
"""s; half of the time in which a jaw usually takes its new temperature, from 12 to 88 per cent."""
_STARTS = (0.02, *(k / 20 for k in range(1, 19)))
PARAMS = (
    Param("clamp_step.step", "K", 0.0, -100.0, 100.0, 0.2, "change of the jaws, mean of both", probe=0.5),
    Param("clamp_step.apart", "K", 0.0, -100.0, 100.0, 0.2, "the same, upper (y > 0) minus lower jaw", probe=0.5),
    Param("clamp_step.start", "s", 30.0, -1e5, 1e5, 5.0, "time of the test at which half of it is done", scan=_STARTS, scan_of="time"),
    Param("clamp_step.onset", "s", ONSET, 0.05, 1e4, 1.0, "half of the time that it takes", scan=(ONSET,), follows=True, logarithmic=True),
)
FORMULA = "theta_M += (step + apart sign(y) / 2) (1 + tanh((t - start) / onset)) / 2; one jaw alone: apart = 2 step or -2 step"
SOURCE = "hydraulics or a cooling circuit that is switched; bar with an end of given temperature, Carslaw and Jaeger 1959, section 3.3"


def boundary_temperature(y: np.ndarray, time: float, elapsed: float, step: float, apart: float, start: float, onset: float) -> np.ndarray:
    """Change of the temperature of the jaws, K; y in mm from the middle of the specimen."""
    return np.asarray(0.5 * (1.0 + np.tanh((time - start) / onset)) * (step + 0.5 * apart * np.sign(y)))
