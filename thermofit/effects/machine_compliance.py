"""Frame, load cell and jaws give way in proportion to the force: slot load. Off at compliance = 0; nothing where the force drives."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "load"
PARAMS = (
    Param("machine_compliance.compliance", "mm/N", 0.0, -1e-3, 1e-2, 1e-5, "give of the machine beyond force.compliance", probe=2e-5),
)
FORMULA = "u_end = u_crosshead - compliance F"
SOURCE = "springs in series, why ASTM E111 measures strain on the specimen itself; negative where force.compliance was taken too large"


def load(force: np.ndarray, end: np.ndarray, compliance: float) -> tuple[np.ndarray, np.ndarray]:
    """end - compliance force, mm (n_t,); the force, N (n_t,), as it is."""
    return force, np.asarray(end - compliance * force)
