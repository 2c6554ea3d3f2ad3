"""Elastic moduli that fall with temperature: slot elasticity. Off at slope = 0."""

from __future__ import annotations

from typing import Any

import numpy as np

from thermofit.core.parameters import Param

SLOT = "elasticity"
PARAMS = (
    Param("modulus_by_temperature.slope", "1/K", 0.0, 0.0, 0.01, 1e-4, "relative loss of the moduli per K, from 293.15 K", probe=5e-4),
)
FORMULA = "E, K, mu *= [x + (x^2 + 4 e^2)^(1/2)] / [1 + (1 + 4 e^2)^(1/2)], x = 1 - slope (theta - 293.15 K), e = 0.02"
SOURCE = (
    "Wachtman et al. 1961, Physical Review 122; Varshni 1970, Physical Review B 2. Their forms are linear above about half the Debye "
    "temperature. Rounded off near x = 0, so that moduli stay positive"
)
SPAN = 50.0
_FROM, _ROUND = 293.15, 0.04
"""K of no change; twice e, the x of which the moduli keep half."""


def elasticity(theta: float, law: Any, slope: float) -> float:
    """Factor on all elastic moduli: x within 0.1 % down to x = 0.6, and positive for any x."""
    x = 1.0 - slope * (theta - _FROM)
    return (x + np.sqrt(x * x + _ROUND * _ROUND)) / (1.0 + np.sqrt(1.0 + _ROUND * _ROUND))
