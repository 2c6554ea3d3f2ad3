"""Yield stress that falls with temperature: slot yield_factor. Off at slope = 0."""

from __future__ import annotations

from typing import Any

from thermofit.core.parameters import Param

SLOT = "yield_factor"
PARAMS = (Param("thermal_softening.slope", "1/K", 0.0, -0.02, 0.02, 1e-3, "relative loss of yield stress per K", probe=2e-3),)
FORMULA = "sigma_y *= 1 - slope (theta - theta_0)"
SOURCE = "Johnson and Cook 1983 with m = 1, about the reference temperature"


def yield_factor(accumulated: float, rate: float, theta: float, law: Any, slope: float) -> float:
    """1 - slope (theta - theta_0)."""
    return 1.0 - slope * (theta - law.theta_ref)
