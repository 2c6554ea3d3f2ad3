"""Lueders plateau of a bar as a whole, with an upper yield point where it is given: slot yield_stress. Off at share = 0."""

from __future__ import annotations

from typing import Any

import numpy as np

from thermofit.core.parameters import Param
from thermofit.effects.curve import hardening

SLOT = "yield_stress"
PARAMS = (
    # Not the length is the amplitude: to first order in a length, a saturating curve only shifts, which is a change of M_y0.
    Param("yield_plateau.share", "1", 0.0, 0.0, 3.0, 0.2, "share of the law's hardening that begins late; 1 is a flat plateau", probe=0.5),
    Param("yield_plateau.length", "1", 0.02, 1e-3, 0.2, 5e-3, "plastic strain at the end of the plateau", scan=(0.005, 0.01, 0.02, 0.04)),
    # No amplitude of its own: a few samples tell it, and without them it would spoil what the others predict.
    Param("yield_plateau.upper", "MPa", 0.0, 0.0, 500.0, 10.0, "excess of the upper yield point", scan=(0.0,)),
    Param("yield_plateau.drop", "1", 1e-3, 1e-5, 0.05, 1e-3, "plastic strain in which the excess decays", scan=(1e-3,)),
)
FORMULA = "a share of the hardening begins at Lambda = length; sigma_y += share upper exp(-Lambda / drop)"
SOURCE = "Lueders bands seen over a gauge length: constant mean stress until the band has passed; Hall 1970, Yield Point Phenomena"
STORED = True
_ROUNDING = 0.1
"""Part of the plateau's length over which its end is rounded."""


def yield_stress(accumulated: float, rate: float, theta: float, law: Any, share: float, length: float, upper: float, drop: float) -> float:
    """A share of the base law's hardening from max(Lambda - length, 0) instead of Lambda, and the upper yield point; MPa."""
    ahead, before = accumulated - length, 0.0 * accumulated - length
    round_off = (_ROUNDING * length) ** 2
    late = 0.5 * (ahead + np.sqrt(ahead * ahead + round_off)) - 0.5 * (before + np.sqrt(before * before + round_off))
    return share * (hardening(late, law) - hardening(accumulated, law) + upper * np.exp(-accumulated / drop))
