"""Scale of the displacement field (calibration of the stereo rig): slot camera. Off at error = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.scene import Scene

SLOT = "camera"
PARAMS = (Param("dic_scale.error", "1", 0.0, -0.2, 0.2, 1e-3, "relative error of all displacements", probe=0.01),)
FORMULA = "u_camera = (1 + error) u"
SOURCE = "scale bar of the calibration object; Sutton, Orteu, Schreier 2009"


def camera(u: np.ndarray, scene: Scene, error: float) -> np.ndarray:
    """(1 + error) u, mm (n_t, n_s, 2)."""
    return np.asarray(u * (1.0 + error))
