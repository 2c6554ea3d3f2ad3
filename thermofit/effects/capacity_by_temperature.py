"""Heat capacity that changes with temperature: slot capacity. Off at slope = 0."""

from __future__ import annotations

from typing import Any

from thermofit.core.parameters import Param

SLOT = "capacity"
PARAMS = (Param("capacity_by_temperature.slope", "1/K", 0.0, -0.02, 0.02, 1e-3, "relative change of the heat capacity per K", probe=5e-3),)
FORMULA = "c0 *= 1 + slope (theta - theta_0)"
SOURCE = "tables of aluminium and steel near room temperature, Touloukian 1970, volume 4; linear about the reference temperature"


def capacity(theta: Any, theta_ref: float, slope: float) -> Any:
    """1 + slope (theta - theta_0), in the shape of theta."""
    return 1.0 + slope * (theta - theta_ref)
