"""In-plane bending by jaws that hold the specimen off its centre, as its field of first order: slot kinematics. Off at curvature = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.scene import Scene

SLOT = "kinematics"
PARAMS = (
    Param("bending.curvature", "1/mm", 0.0, -1e-2, 1e-2, 1e-6, "curvature of the axis at the largest force", probe=1e-5),
    Param("bending.contraction", "1", 0.33, 0.0, 0.6, 0.1, "lateral contraction of the bent fibres", scan=(0.33,)),
)
FORMULA = "u_x -= k (y^2 + contraction x^2) / 2, u_y += k x y, k = curvature F / F_max"
SOURCE = "bar under constant moment F e: eps_yy = k x, eps_xx = -contraction k x, no shear; Timoshenko and Goodier, Theory of Elasticity"


def kinematics(u: np.ndarray, scene: Scene, curvature: float, contraction: float) -> np.ndarray:
    """u with the displacements of pure bending added, mm (n_t, n_s, 2); elastic: in proportion to the force."""
    x, y = scene.position[..., 0], scene.position[..., 1]
    bent = np.stack([-0.5 * (y * y + contraction * x * x), x * y + 0.0 * contraction * x], axis=-1)
    return np.asarray(u + curvature * scene.load[:, None, None] * bent)
