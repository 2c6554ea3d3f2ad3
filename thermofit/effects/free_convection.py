"""Free convection: a film to the air that grows with the difference of temperatures: slot surface_flux. Off at film = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.film_exchange import FILM_UNIT

SLOT = "surface_flux"
ON = ("air",)
_STILL = 0.1
"""K; up to about this difference the film stays as it is: at a plate of 0.1 m Ra is 1e4 there, where the law of laminar flow begins."""
_MOST = 10.0
"""W/(m^2 K) at 1 K. Laminar air has 1.42 length^(-1/4), in metres, at an upright plate (Holman, Heat Transfer, table of simplified
equations for air): 2.5 at 0.1 m, 4.5 at 0.01 m."""
PARAMS = (
    Param("free_convection.film", "W/(m^2 K)", 0.0, 0.0, _MOST, 1.0, "film coefficient of still air at a difference of 1 K", probe=2.0),
    Param("free_convection.exponent", "1", 0.25, 0.1, 0.5, 0.1, "1/4 of laminar flow, 1/3 of turbulent flow", scan=(0.25, 1.0 / 3.0)),
)
FORMULA = "q += film ((theta - theta_surroundings)^2 + (0.1 K)^2)^(exponent / 2) (theta - theta_surroundings)"
SOURCE = "upright plates in air that nothing else moves, Nu ~ Ra^(1/4): Churchill and Chu, Int. J. Heat Mass Transfer 18 (1975) 1323"


def surface_flux(theta: np.ndarray, time: float, surroundings: np.ndarray, film: float, exponent: float) -> np.ndarray:
    """film |theta - surroundings|^exponent (theta - surroundings), outward, mW/mm^2 of current area; film in W/(m^2 K) at 1 K."""
    difference = theta - surroundings
    return np.asarray(FILM_UNIT * film * (difference * difference + _STILL**2) ** (0.5 * exponent) * difference)
