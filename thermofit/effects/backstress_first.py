"""Backstress of Armstrong and Frederick, fast term: slot backstress. Off at C = 0."""

from __future__ import annotations

from typing import Any

from thermofit.core.parameters import Param

SLOT = "backstress"
_SCAN = (30.0, 100.0, 300.0, 1000.0, 2500.0, 5000.0)
"""The fastest of them is what rounds the knee of a tension record."""
PARAMS = (
    Param("backstress_first.C", "MPa", 0.0, 0.0, 5e6, 1e3, "modulus of the backstress", probe=4000.0),
    Param("backstress_first.gamma", "1", 100.0, 0.0, 1e4, 50.0, "its recall; it saturates at C / gamma", scan=_SCAN),
)
FORMULA = "dX = C N dLambda - gamma X dLambda"
SOURCE = "Armstrong and Frederick 1966; Chaboche 1986, International Journal of Plasticity 2"


def backstress(accumulated: float, rate: float, theta: float, law: Any, C: float, gamma: float) -> tuple[float, float]:
    """Modulus C in MPa and recall gamma."""
    return C, gamma
