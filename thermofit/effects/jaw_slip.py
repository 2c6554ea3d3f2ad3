"""Specimen that slips in its jaws until they bite: slot load. Off at slip = 0; nothing where the force drives."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

SLOT = "load"
PARAMS = (
    Param("jaw_slip.slip", "mm", 0.0, 0.0, 5.0, 0.05, "slip of both jaws once they hold", probe=0.05),
    Param("jaw_slip.force", "N", 1000.0, 1.0, 1e6, 1e3, "force at which 63 % of it is done", scan=(300.0, 1000.0, 3000.0)),
)
FORMULA = "u_end = u_crosshead - slip (1 - exp(-F_peak / force)), F_peak the largest force so far"
SOURCE = "serrated wedge jaws bite early and do not let go; saturation as of a toe region, ASTM E111"


def load(force: np.ndarray, end: np.ndarray, slip: float, bite: float) -> tuple[np.ndarray, np.ndarray]:
    """end less the slip, mm (n_t,); the force, N (n_t,), as it is."""
    peak = np.maximum.accumulate(np.maximum(force, 0.0))
    return force, np.asarray(end - slip * (1.0 - np.exp(-peak / bite)))
