"""Conductivity that changes with temperature: slot conductivity. Off at slope = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "conductivity"
PARAMS = (Param("conductivity_by_temperature.slope", "1/K", 0.0, -0.02, 0.02, 1e-3, "relative change of conductivity per K", probe=5e-3),)
FORMULA = "kappa *= 1 + slope (theta - theta_0)"
SOURCE = "tables of aluminium and steel near room temperature, Touloukian 1970, volume 1; linear about the reference temperature"


def conductivity(theta: np.ndarray, theta_ref: float, slope: float) -> np.ndarray:
    """1 + slope (theta - theta_0)."""
    return np.asarray(1.0 + slope * (theta - theta_ref))
