"""Yield stress that is higher (or lower) in compression than in tension: slot asymmetry. Off at difference = 0."""

from __future__ import annotations

from typing import Any

from thermofit.core.parameters import Param

SLOT = "asymmetry"
PARAMS = (
    Param("tension_compression.difference", "1", 0.0, -0.9, 5.0, 0.02, "relative excess of the yield stress in compression", probe=0.05),
)
FORMULA = "sigma_y *= 1 + difference (1 - sense) / 2, sense 1 in tension, -1 in compression"
SOURCE = (
    "strength differential, Spitzig, Sober and Richmond 1975, Acta Metallurgica 23; by the sense of the stress that makes it flow, "
    "Cazacu and Barlat 2004, International Journal of Plasticity 20"
)


def asymmetry(sense: float, law: Any, difference: float) -> float:
    """1 where sense is +1 (uniaxial tension), 1 + difference where it is -1 (compression), between in between."""
    return 1.0 + 0.5 * (1.0 - sense) * difference
