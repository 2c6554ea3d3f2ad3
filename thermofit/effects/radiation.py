"""Radiation to the surroundings: slot surface_flux. Off at emissivity = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "surface_flux"
ON = ("air",)
PARAMS = (Param("radiation.emissivity", "1", 0.0, 0.0, 1.0, 0.1, "total hemispherical emissivity of the surface", probe=0.5),)
FORMULA = "q += sigma_SB emissivity (theta^4 - theta_surroundings^4)"
SOURCE = "Stefan 1879, Boltzmann 1884: small grey body in large surroundings; sigma_SB of CODATA 2018"

SIGMA = 5.670374419e-11
"""Stefan-Boltzmann constant in mW/(mm^2 K^4)."""


def surface_flux(theta: np.ndarray, time: float, surroundings: np.ndarray, emissivity: float) -> np.ndarray:
    """sigma_SB emissivity (theta^4 - surroundings^4), outward, mW/mm^2 of current area; temperatures in K."""
    return np.asarray(SIGMA * emissivity * (theta**4 - surroundings**4))
