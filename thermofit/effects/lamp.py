"""A lamp that is switched on during the test and shines on the free surface: slot surface_flux. Off at absorbed = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "surface_flux"
ON = ("air",)
RAMP = 1.0
"""s; half of the time in which a lamp usually reaches its power, from 12 to 88 per cent."""
_STARTS = (0.02, *(k / 20 for k in range(1, 19)))
PARAMS = (
    Param("lamp.absorbed", "mW/mm^2", 0.0, -10.0, 10.0, 0.05, "absorbed power per area once the lamp is on", probe=0.1),
    Param("lamp.start", "s", 30.0, -1e5, 1e5, 5.0, "time of the test at which it is switched on", scan=_STARTS, scan_of="time"),
    Param("lamp.onset", "s", RAMP, 0.05, 1e4, 1.0, "half of the time in which it comes on", scan=(RAMP,), follows=True, logarithmic=True),
)
FORMULA = "q -= absorbed (1 + tanh((t - start) / onset)) / 2"
SOURCE = "heat flux on a boundary, Carslaw and Jaeger 1959, section 1.9; incandescent lamps take about a second to warm up"


def surface_flux(theta: np.ndarray, time: float, surroundings: np.ndarray, absorbed: float, start: float, onset: float) -> np.ndarray:
    """Outward flux -absorbed (1 + tanh((t - start) / onset)) / 2, mW/mm^2."""
    return np.asarray(-0.5 * absorbed * (1.0 + np.tanh((time - start) / onset)) + 0.0 * theta)
