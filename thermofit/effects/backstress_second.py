"""Backstress of Armstrong and Frederick, slow term: slot backstress. Off at C = 0."""

from __future__ import annotations

from typing import Any

from thermofit.core.parameters import Param

SLOT = "backstress"
# The first one may have taken the slow part or the fast one: what is missing is then the other.
_SCAN = (0.0, 5.0, 20.0, 100.0, 500.0, 2500.0)
PARAMS = (
    Param("backstress_second.C", "MPa", 0.0, 0.0, 5e6, 300.0, "modulus of the second backstress", probe=1000.0),
    Param("backstress_second.gamma", "1", 5.0, 0.0, 1e4, 5.0, "its recall; 0 is linear kinematic hardening (Prager)", scan=_SCAN),
)
FORMULA = "dX = C N dLambda - gamma X dLambda"
SOURCE = "Chaboche 1986, International Journal of Plasticity 2: sum of terms; Prager 1956 for gamma = 0"


def backstress(accumulated: float, rate: float, theta: float, law: Any, C: float, gamma: float) -> tuple[float, float]:
    """Modulus C in MPa and recall gamma."""
    return C, gamma
