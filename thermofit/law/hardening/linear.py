"""Linear hardening from the initial yield limit; associated, alpha = Lambda.

The linear part itself, H_lin Lambda, is an effect of the base law that every hardening law may have (effects.linear_hardening).
"""

from __future__ import annotations

import numpy as np

PARAMS = ("M_y0",)
FITTED = ("M_y0", "H_lin")
FORMULA = "sigma_y = M_y0 (+ H_lin Lambda)"
SOURCE = "thesis (4.6)"
RAISES = ("M_y0", "H_lin")
METALS = {"M_y0": (2e2, 1.0, 1e4), "H_lin": (1e3, 0.0, 1e5)}
MEANING = {"M_y0": "MPa", "H_lin": "MPa"}


def yield_stress(alpha: float, M_y0: float) -> tuple[float, float]:
    """Yield stress in MPa and its derivative by alpha, without H_lin Lambda."""
    return M_y0 + 0.0 * alpha, 0.0 * alpha


def stored_energy(alpha: float, M_y0: float) -> float:
    """Integral of sigma_y - M_y0, without H_lin Lambda^2 / 2: nothing."""
    return 0.0 * alpha


def search(stress: float, strain: float) -> dict[str, tuple[float, float, float]]:
    """Start and bounds by the largest stress of a test in MPa and its largest strain."""
    return {"M_y0": (0.8 * stress, 0.02 * stress, 5.0 * stress), "H_lin": (0.2 * stress / strain, 0.0, min(1e5, 20.0 * stress / strain))}


def first_guess(accumulated: np.ndarray, stress: np.ndarray) -> dict[str, float]:
    """The straight line of least squares."""
    slope, start = np.polyfit(accumulated, stress, 1)
    return {"M_y0": float(start), "H_lin": float(max(slope, 0.0))}
