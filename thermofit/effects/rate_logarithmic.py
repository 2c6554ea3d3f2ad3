"""Logarithmic rate dependence (Johnson-Cook): slot yield_factor. Off at C = 0.

It is relaxation and creep at hold as well: at constant strain the overstress falls with the logarithm of time, at constant stress flow
goes on.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from thermofit.core.parameters import Param

SLOT = "yield_factor"
_SCAN = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
PARAMS = (
    Param("rate_logarithmic.C", "1", 0.0, 0.0, 0.5, 5e-3, "relative rise per e-fold of the rate", probe=0.01),
    Param("rate_logarithmic.reference", "1/s", 1e-4, 1e-9, 1e4, 1e-4, "rate below which there is none", scan=_SCAN, logarithmic=True),
)
FORMULA = "sigma_y *= 1 + C ln(1 + rate / reference)"
SOURCE = "Johnson and Cook 1983; 1 + in the logarithm makes it smooth and zero at rest"


def yield_factor(accumulated: float, rate: float, theta: float, law: Any, C: float, reference: float) -> float:
    """1 + C ln(1 + rate / reference); rate of Lambda in 1/s."""
    return 1.0 + C * np.log(1.0 + rate / reference)
