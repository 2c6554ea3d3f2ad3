"""Yield stress that falls with temperature: slot yield_factor. Off at slope = 0."""

from __future__ import annotations

from typing import Any

from thermofit.core.parameters import Param

SLOT = "yield_factor"
PARAMS = (
    Param("thermal_softening.slope", "1/K", 0.0, -0.02, 0.02, 1e-3, "relative loss of yield stress per K", probe=2e-3),
    Param("thermal_softening.reference", "K", 293.15, 100.0, 2000.0, 10.0, "temperature of the law's yield stress", scan=(293.15,)),
)
FORMULA = "sigma_y *= 1 - slope (theta - reference)"
SOURCE = "Johnson and Cook 1983 with m = 1; the reference is one for all specimens, whatever temperature they start from"


def yield_factor(accumulated: float, rate: float, theta: float, law: Any, slope: float, reference: float) -> float:
    """1 - slope (theta - reference)."""
    return 1.0 - slope * (theta - reference)
