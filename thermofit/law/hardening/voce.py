"""Voce's saturating hardening: model 1 of the thesis, associated, alpha = Lambda (4.6)."""

from __future__ import annotations

import numpy as np

MODEL = 1
PARAMS = ("M_y0", "M_yinf", "H_exp")
FORMULA = "sigma_y = M_yinf - (M_yinf - M_y0) exp(-H_exp alpha)"
SOURCE = "Voce 1948, Journal of the Institute of Metals 74; thesis (4.6)"
ASCENDING = (("M_y0", "M_yinf"),)
WHY = "the material must harden, 4.28"
RAISES = ("M_yinf",)
SMALL = True
METALS = {"M_y0": (2e2, 1.0, 1e4), "M_yinf": (5e2, 2.0, 2e4), "H_exp": (1e1, 1e-2, 1e3)}
MEANING = {"M_y0": "MPa, M_yinf > M_y0", "M_yinf": "MPa", "H_exp": "saturation: reached at a strain of a few 1/H_exp"}
_SATURATED = 1.0 - np.exp(-1.0)


def yield_stress(alpha: float, M_y0: float, M_yinf: float, H_exp: float) -> tuple[float, float]:
    """Yield stress in MPa and its derivative by alpha."""
    saturation = (M_yinf - M_y0) * np.exp(-H_exp * alpha)
    return M_yinf - saturation, H_exp * saturation


def stored_energy(alpha: float, M_y0: float, M_yinf: float, H_exp: float) -> float:
    """psi_pl in mJ/mm^3, the integral of sigma_y - M_y0 (4.6)."""
    return (M_yinf - M_y0) * (alpha + (np.exp(-H_exp * alpha) - 1.0) / H_exp)


def search(stress: float, strain: float) -> dict[str, tuple[float, float, float]]:
    """Start and bounds by the largest stress S of a test in MPa and its largest strain: M_y0 is sqrt(F + H) times a part of S and M_yinf
    perhaps far above; 1/H_exp lies within a hundredth to a hundred times the strain."""
    return {
        "M_y0": (0.7 * stress, 0.02 * stress, 5.0 * stress),
        "M_yinf": (1.3 * stress, 0.2 * stress, 20.0 * stress),
        "H_exp": (1.0 / strain, 0.01 / strain, 100.0 / strain),
    }


def first_guess(accumulated: np.ndarray, stress: np.ndarray) -> dict[str, float]:
    """Limits a little outside the curve; 1/H_exp where it has risen by 63 %."""
    first, last = float(stress[0]), float(np.max(stress))
    risen = int(np.argmax(stress >= first + _SATURATED * (last - first)))
    return {"M_y0": first, "M_yinf": last + 0.05 * max(last - first, 1e-3 * last), "H_exp": 1.0 / max(float(accumulated[risen]), 1e-6)}
