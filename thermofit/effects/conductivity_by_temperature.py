"""Conductivity that changes with temperature: slot conductivity. Off at slope = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "conductivity"
# Bounds by judgement: sapphire loses 0.003 per K above 300 K, AISI 304 gains 0.001 (Incropera and DeWitt, tables A.1 and A.2).
PARAMS = (Param("conductivity_by_temperature.slope", "1/K", 0.0, -0.01, 0.01, 1e-3, "relative change of conductivity per K", probe=5e-3),)
FORMULA = "kappa *= 1 + slope (theta - theta_0)"
SOURCE = "tables of aluminium and steel near room temperature, Touloukian 1970, volume 1; linear about the reference temperature"


def conductivity(theta: np.ndarray, theta_ref: float, slope: float) -> np.ndarray:
    """1 + slope (theta - theta_0)."""
    return np.asarray(1.0 + slope * (theta - theta_ref))
