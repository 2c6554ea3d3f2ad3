"""Extrapolation in time, or over a load that grows."""

from __future__ import annotations

import numpy as np


def lagrange(places: list[float], at: float) -> list[float]:
    """Weights of the polynomial through different `places` (times, loads)."""
    return [float(np.prod([(at - b) / (a - b) for b in places if b != a])) for a in places]
