"""Temperature that falls from the centre to cold jaws, as of a strip that a current heats: slot axial_temperature. Off at fall = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "axial_temperature"
PARAMS = (
    Param("heating_profile.fall", "1/mm^2", 0.0, 0.0, 0.1, 1e-4, "share of centre over jaws that is lost per square mm", probe=1e-4),
    Param("heating_profile.centre", "mm", 0.0, -50.0, 50.0, 1.0, "place of the hottest section", scan=(0.0,), follows=True),
)
FORMULA = "theta(y) = theta_0 - fall (y - centre)^2 (theta_0 - theta_clamp)"
SOURCE = "steady conduction with an even source between cold ends, kappa theta'' = -q: a parabola; Carslaw and Jaeger 1959, section 4.9"


def axial_temperature(y: np.ndarray, excess: float, fall: float, centre: float) -> np.ndarray:
    """Change (n,) of the temperature at y mm (n,) along the axis, K; `excess` K of the declared one over the jaws."""
    return np.asarray(-fall * (y - centre) ** 2 * excess)
