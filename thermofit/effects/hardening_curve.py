"""Yield stress over plastic strain of any form: slot yield_stress. Off at level = step_k = 0.

It names nothing. The loop asks for it where displacements hold more than any other effect explains, and holds the hardening law then.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from thermofit.core.parameters import Param

SLOT = "yield_stress"
LAST = True
N = 10
"""Steps, the denser the smaller the strain."""
_HIGHEST = 1000.0
PARAMS = (
    Param("hardening_curve.level", "MPa", 0.0, -_HIGHEST, _HIGHEST, 10.0, "change of the yield stress at first yield", probe=10.0),
    *(Param(f"hardening_curve.step{k}", "MPa", 0.0, -_HIGHEST, _HIGHEST, 10.0, f"height of step {k}", probe=2.0) for k in range(1, N + 1)),
    Param(
        "hardening_curve.range",
        "1",
        0.1,
        1e-3,
        10.0,
        0.05,
        "plastic strain up to which there are steps",
        scan=(1.0, 0.5, 0.25),
        scan_of="strain",
    ),
)
FORMULA = "sigma_y += level + sum_k step_k [S(Lambda) - S(0)], S = (1 + z / sqrt(1 + z^2)) / 2, z = (Lambda - e_k) / w_k"
SOURCE = "smooth steps at e_k = range ((k - 1/2) / N)^(3/2), as wide as half of their distance"
PLACES = tuple(float(((k - 0.5) / N) ** 1.5) for k in range(1, N + 1))
"""e_k over the range."""
WIDTHS = tuple(float(0.75 * ((k - 0.5) / N) ** 0.5 / N) for k in range(1, N + 1))
"""w_k over the range: half of the derivative of e by k."""


def yield_stress(
    accumulated: float, rate: float, theta: float, law: Any, level: float,
    s1: float, s2: float, s3: float, s4: float, s5: float, s6: float, s7: float, s8: float, s9: float, s10: float, reach: float,
) -> float:  # fmt: skip
    """The level and the steps, MPa."""
    steps = (s1, s2, s3, s4, s5, s6, s7, s8, s9, s10)
    share = accumulated / reach
    value = level + 0.0 * share
    for k in range(N):
        z, z0 = (share - PLACES[k]) / WIDTHS[k], -PLACES[k] / WIDTHS[k]
        value = value + 0.5 * steps[k] * (z / np.sqrt(1.0 + z * z) - z0 / np.sqrt(1.0 + z0 * z0))
    return value
