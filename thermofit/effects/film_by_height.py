"""A film to the air that changes along the load, as in air that rises at the specimen: slot surface_flux. Off at slope = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.film_exchange import FILM_UNIT

SLOT = "surface_flux"
ON = ("air",)
PARAMS = (
    Param(
        "film_by_height.slope",
        "W/(m^2 K mm)",
        0.0,
        -1.0,
        1.0,
        0.01,
        "change of the film coefficient per mm along the load; alpha_air is that in the middle of the specimen",
        probe=0.05,
    ),
)
FORMULA = "q += slope y (theta - theta_surroundings)"
SOURCE = "local film of a boundary layer that grows along a plate, h ~ x^(-1/4); Holman, Heat Transfer, free convection on a vertical plate"


def surface_flux(theta: np.ndarray, time: float, surroundings: np.ndarray, y: np.ndarray, slope: float) -> np.ndarray:
    """slope y (theta - surroundings), outward, mW/mm^2 of current area; y in mm from the middle, slope in W/(m^2 K) per mm."""
    return np.asarray(FILM_UNIT * slope * y * (theta - surroundings))
