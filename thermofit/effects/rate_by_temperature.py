"""Rate dependence that grows with temperature: slot yield_factor. Off at C = 0."""

from __future__ import annotations

from typing import Any

import numpy as np

from thermofit.core.parameters import Param

SLOT = "yield_factor"
_SCAN = (1e-6, 1e-4, 1e-2)
PARAMS = (
    Param("rate_by_temperature.C", "1", 0.0, -0.5, 0.5, 5e-3, "rise per e-fold of the rate, 100 K above 293.15 K", probe=0.01),
    Param("rate_by_temperature.reference", "1/s", 1e-4, 1e-9, 1e4, 1e-4, "rate below which there is none", scan=_SCAN, logarithmic=True),
)
FORMULA = "sigma_y *= 1 + C s ln(1 + rate / reference), s = (theta - 293.15 K) / (100 K)"
SOURCE = (
    "Zerilli and Armstrong 1987, Journal of Applied Physics 61: thermal activation makes the rate sensitivity grow with temperature; to "
    "first order, on top of rate_logarithmic"
)
SPAN = 50.0


def yield_factor(accumulated: float, rate: float, theta: float, law: Any, C: float, reference: float) -> float:
    """1 + C s ln(1 + rate / reference); rate of Lambda in 1/s."""
    return 1.0 + C * (theta - 293.15) / 100.0 * np.log(1.0 + rate / reference)
