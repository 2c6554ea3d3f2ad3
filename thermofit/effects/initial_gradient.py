"""Specimen that is not yet at rest at the first time: slot initial_temperature. Off at amplitude = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "initial_temperature"
PARAMS = (
    Param("initial_gradient.amplitude", "K", 0.0, -50.0, 50.0, 0.2, "excess of the middle over the ends at the first time", probe=0.5),
    Param("initial_gradient.tilt", "1", 0.0, -10.0, 10.0, 1.0, "excess of the upper end by the same amplitude", scan=(0.0, -3.0, 3.0)),
)
FORMULA = "theta(t_0) += amplitude (cos(pi y / length) + tilt 2 y / length)"
SOURCE = "slowest mode of a bar between two jaws, Carslaw and Jaeger 1959, section 3.3: what is left of handling and mounting"


def initial_temperature(x: np.ndarray, y: np.ndarray, length: float, amplitude: float, tilt: float) -> np.ndarray:
    """Excess over the steady temperature, K; x, y mm from the middle of the specimen, `length` mm its length along y."""
    return np.asarray(amplitude * (np.cos(np.pi * y / length) + tilt * 2.0 * y / length))
