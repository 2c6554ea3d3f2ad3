"""The infrared image lies beside the specimen: slot optics. Shift, rotation and scale; off where all are zero."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.scene import Scene

SLOT = "optics"
PARAMS = (
    Param("ir_registration.shift_y", "mm", 0.0, -10.0, 10.0, 0.1, "along the load", probe=0.5),
    Param("ir_registration.shift_x", "mm", 0.0, -10.0, 10.0, 0.1, "across the load", probe=0.5),
    Param("ir_registration.rotation", "rad", 0.0, -0.1, 0.1, 0.01, "about the thickness", probe=0.02),
    # A camera that has moved by a twentieth of its distance.
    Param("ir_registration.scale", "1", 0.0, -0.05, 0.05, 0.01, "relative error of mm per pixel", probe=0.02),
)
FORMULA = "theta_camera(x) = theta(x + xi), xi = shift + rotation e_z x x + scale x"
SOURCE = "calibration of the camera by hand-picked landmarks; errors of their pixels"


def optics(theta: np.ndarray, scene: Scene, shift_y: float, shift_x: float, rotation: float, scale: float) -> np.ndarray:
    """theta + xi . grad theta, K (n_t, n_s), the gradient in space at the current position."""
    x, y = scene.position[..., 0], scene.position[..., 1]
    by_x, by_y = scene.gradient(theta)
    return np.asarray(theta + (shift_x - rotation * y + scale * x) * by_x + (shift_y + rotation * x + scale * y) * by_y)
