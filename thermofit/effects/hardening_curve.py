"""Yield stress over plastic strain of any form: slot yield_stress. Off at level = step_k = 0.

It names nothing. The loop asks for it where displacements hold more than any other effect explains, and holds the hardening law then.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from thermofit.core.parameters import Param

SLOT = "yield_stress"
LAST = True
N = 12
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
FORMULA = "sigma_y += level + sum_k step_k [S(u - k) - S(-k)], u from 0 at Lambda = 0 to N at Lambda = range"
SOURCE = "cubic splines as sums of smooth steps, de Boor 1978, A Practical Guide to Splines, chapter IX; u grows with Lambda^(2/3)"
_OFFSET = (0.5 / N) ** 1.5
"""Added to Lambda over the range, so that u begins with a finite slope."""
_LOW, _HIGH = (float(np.exp(2.0 / 3.0 * np.log(share + _OFFSET))) for share in (0.0, 1.0))


def yield_stress(
    accumulated: float, rate: float, theta: float, law: Any, level: float, s1: float, s2: float, s3: float,
    s4: float, s5: float, s6: float, s7: float, s8: float, s9: float, s10: float, s11: float, s12: float, reach: float,
) -> float:  # fmt: skip
    """The level and the steps, MPa. The slope by u is a sum of quadratic B-splines, each 3 wide: step k rises between u = k - 2
    and k + 1, so that S(t) = [(t + 2)_+^3 - 3 (t + 1)_+^3 + 3 t_+^3 - (t - 1)_+^3] / 6, with t_+ = (t + |t|) / 2."""
    steps = (s1, s2, s3, s4, s5, s6, s7, s8, s9, s10, s11, s12)
    u = N * (np.exp(2.0 / 3.0 * np.log(accumulated / reach + _OFFSET)) - _LOW) / (_HIGH - _LOW)
    u = 0.5 * (u + N + 1.0 - np.sqrt((u - N - 1.0) * (u - N - 1.0)))  # beyond the last step nothing rises, and powers would cancel
    value = level - steps[0] / 6.0 + 0.0 * u
    # Of every power (u - m)_+^3 the steps around it have a part.
    for m in range(-1, N + 2):
        t = u - m
        t = 0.5 * (t + np.sqrt(t * t))
        part = 0.0 * level
        if m + 1 < N:
            part = part + steps[m + 1]
        if 0 <= m < N:
            part = part - 3.0 * steps[m]
        if 0 <= m - 1 < N:
            part = part + 3.0 * steps[m - 1]
        if m - 2 >= 0:
            part = part - steps[m - 2]
        value = value + part * t * t * t / 6.0
    return value
