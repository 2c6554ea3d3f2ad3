"""Extrapolation in time."""

from __future__ import annotations

import numpy as np


def lagrange(times: list[float], t: float) -> list[float]:
    """Weights of the polynomial through `times` at t."""
    return [float(np.prod([(t - b) / (a - b) for b in times if b != a])) for a in times]
