"""Tilt of the specimen towards the cameras under load, seen by perspective: slot camera. Off where both are zero."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.scene import Scene

SLOT = "camera"
PARAMS = (
    # A tilt of a tenth of a radian, half a metre away.
    Param("dic_tilt.along", "1/mm", 0.0, -2e-4, 2e-4, 1e-7, "change of the scale per mm along the load, at the largest force", probe=2e-6),
    Param(
        "dic_tilt.across", "1/mm", 0.0, -2e-4, 2e-4, 1e-7, "change of the scale per mm across the load, at the largest force", probe=2e-6
    ),
)
FORMULA = "u_camera = u + F / F_max (across x + along y) x"
SOURCE = "pinhole camera at the distance D: scale 1 + dz / D, dz = tilt y of a plane that turns; Sutton, Orteu, Schreier 2009"


def camera(u: np.ndarray, scene: Scene, along: float, across: float) -> np.ndarray:
    """u + F / F_max (across x + along y) x at current positions x, mm (n_t, n_s, 2).

    The optical axis goes through the origin. Another axis adds a scale and a rigid motion.
    """
    x, y = scene.position[..., :1], scene.position[..., 1:]
    return np.asarray(u + scene.load[:, None, None] * (across * x + along * y) * scene.position)
