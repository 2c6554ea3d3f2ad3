"""Share of plastic work that becomes heat changes with plastic strain: slot dissipation. Off at slope = 0."""

from __future__ import annotations

from typing import Any

from thermofit.core.parameters import Param

SLOT = "dissipation"
PARAMS = (Param("stored_energy.slope", "1", 0.0, -20.0, 20.0, 0.5, "relative change of the dissipation per plastic strain", probe=2.0),)
FORMULA = "D_mech *= 1 + slope Lambda"
SOURCE = "Rosakis et al. 2000, Journal of the Mechanics and Physics of Solids 48; Zehnder 1991"


def dissipation(accumulated: float, rate: float, theta: float, law: Any, slope: float) -> float:
    """1 + slope Lambda."""
    return 1.0 + slope * accumulated
