"""Motion of the specimen towards the cameras under load, seen as a growing scale: slot camera. Off at strain = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.scene import Scene

SLOT = "camera"
PARAMS = (Param("dic_out_of_plane.strain", "1", 0.0, -0.05, 0.05, 1e-4, "apparent strain at the largest force", probe=1e-3),)
FORMULA = "u_camera = u + strain F / F_max (x + u)"
SOURCE = "single-camera and 2-D correlation: apparent strain -delta_z / distance; Sutton et al. 2008, Optics and Lasers in Engineering 46"


def camera(u: np.ndarray, scene: Scene, strain: float) -> np.ndarray:
    """u + strain F / F_max (x + u), mm (n_t, n_s, 2)."""
    return np.asarray(u + strain * scene.load[:, None, None] * scene.position)
