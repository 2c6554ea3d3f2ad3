"""Yield stress that falls with a power of the temperature (Johnson-Cook): slot yield_factor. Off at amount = 0."""

from __future__ import annotations

from typing import Any

import numpy as np

from thermofit.core.parameters import Param

SLOT = "yield_factor"
PARAMS = (
    Param("softening_power.amount", "1", 0.0, -2.0, 2.0, 0.05, "relative loss of yield stress at 100 K above the reference", probe=0.1),
    Param("softening_power.exponent", "1", 1.0, 0.2, 8.0, 0.5, "exponent of the softening; 1 is linear", scan=(0.5, 1.5, 3.0)),
)
FORMULA = "sigma_y *= 1 - amount s |s|^(exponent - 1), s = (theta - 293.15 K) / (100 K)"
SOURCE = "Johnson and Cook 1983: amount = (100 K / (T_m - 293.15 K))^exponent; odd about 293.15 K, rounded within 1 K of it"
SPAN = 50.0
_FROM, _UNIT, _ROUND = 293.15, 100.0, 0.01
"""K of no s and of one s, and the s below which the power is rounded: it would be steep there."""


def yield_factor(accumulated: float, rate: float, theta: float, law: Any, amount: float, exponent: float) -> float:
    """1 - amount s (s^2 + e^2)^((exponent - 1) / 2), e far below 1; exactly linear at exponent 1."""
    s = (theta - _FROM) / _UNIT
    return 1.0 - amount * s * np.exp(0.5 * (exponent - 1.0) * np.log(s * s + _ROUND * _ROUND))
