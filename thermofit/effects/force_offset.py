"""Zero error of the load cell: slot load. Off at offset = 0."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "load"
PARAMS = (Param("force_offset.offset", "N", 0.0, -1e4, 1e4, 10.0, "force on the specimen where the record says none", probe=50.0),)
FORMULA = "F = F_recorded + offset"
SOURCE = "weight of the jaws, tare at a clamped specimen, drift of the amplifier's zero; ISO 7500-1"


def load(force: np.ndarray, end: np.ndarray, offset: float) -> tuple[np.ndarray, np.ndarray]:
    """force + offset, N (n_t,); the crosshead end, mm (n_t,), as it is."""
    return np.asarray(force + offset), end
