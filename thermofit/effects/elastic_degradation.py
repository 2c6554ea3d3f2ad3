"""Elastic moduli that fall with plastic strain (damage): slot free_energy. Off at amount = 0."""

from __future__ import annotations

from typing import Any

import numpy as np

from thermofit.core.parameters import Param

SLOT = "free_energy"
PARAMS = (
    Param("elastic_degradation.amount", "1", 0.0, 0.0, 0.9, 0.05, "part of the moduli that is lost in the end", probe=0.1),
    Param("elastic_degradation.scale", "1", 0.02, 1e-4, 10.0, 0.02, "plastic strain in which it is lost", scan=(0.005, 0.02, 0.1)),
)
FORMULA = "E, K, mu *= 1 - amount (1 - exp(-Lambda / scale))"
SOURCE = "Yoshida, Uemori and Fujiwara 2002, International Journal of Plasticity 18; Lemaitre 1985"


def free_energy(accumulated: float, law: Any, amount: float, scale: float) -> float:
    """Factor on all elastic moduli."""
    return 1.0 - amount * (1.0 - np.exp(-accumulated / scale))
