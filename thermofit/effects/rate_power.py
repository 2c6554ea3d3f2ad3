"""Viscous overstress by a power law (Perzyna, Norton): slot yield_stress. Off at K = 0.

It is relaxation and creep at hold as well: at constant strain the overstress s falls by ds/dt = -E rate(s), at constant stress it flows on.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from thermofit.core.parameters import Param

SLOT = "yield_stress"
PARAMS = (
    Param("rate_power.K", "MPa", 0.0, 0.0, 2000.0, 5.0, "overstress scale", probe=10.0),
    Param("rate_power.m", "1", 0.2, 0.02, 1.0, 0.1, "rate sensitivity exponent", scan=(0.1, 0.3, 1.0), logarithmic=True),
    Param("rate_power.reference", "1/s", 1e-3, 1e-9, 1e4, 1e-3, "rate of the power law", scan=(1e-4, 1e-2), logarithmic=True),
)
FORMULA = "sigma_y += K ((1 + rate / reference)^m - 1)"
SOURCE = "Perzyna 1966; Norton 1929; smooth at rest"


def yield_stress(accumulated: float, rate: float, theta: float, law: Any, K: float, m: float, reference: float) -> float:
    """K ((1 + rate / reference)^m - 1), MPa; rate of Lambda in 1/s."""
    return K * (np.exp(m * np.log(1.0 + rate / reference)) - 1.0)
