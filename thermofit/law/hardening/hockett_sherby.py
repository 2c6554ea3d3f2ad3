"""Hardening of Hockett and Sherby: saturating like Voce's, with an exponent on the strain; associated, alpha = Lambda.

As published sigma_y = s_inf - (s_inf - s_0) exp(-a Lambda^p); here a = H_exp^p, so that H_exp is one over a strain and exponent 1 is Voce's
law. Below exponent 1 its slope would be infinite at first yield: the strain counts from `_BEGIN` / H_exp.
"""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param
from thermofit.law.hardening import voce

PARAMS = (
    "M_y0",
    "M_yinf",
    "H_exp",
    Param("hockett_sherby.exponent", "1", 1.0, 0.1, 5.0, 0.2, "exponent of H_exp Lambda; 1 is Voce's law"),
)
FORMULA = "sigma_y = M_yinf - (M_yinf - M_y0) exp(-(H_exp Lambda)^exponent)"
SOURCE = "Hockett and Sherby 1975, Journal of the Mechanics and Physics of Solids 23"
ASCENDING, WHY, RAISES = voce.ASCENDING, voce.WHY, voce.RAISES
METALS = {**voce.METALS, "hockett_sherby.exponent": (0.8, 0.1, 3.0)}
MEANING = {**voce.MEANING, "hockett_sherby.exponent": "1 is Voce's law"}
_BEGIN = 1e-4
_LAST_DIGIT = 1e-17


def yield_stress(alpha: float, M_y0: float, M_yinf: float, H_exp: float, exponent: float) -> tuple[float, float]:
    """Yield stress in MPa and its derivative by alpha."""
    z = H_exp * alpha + _BEGIN
    power, begin = np.exp(exponent * np.log(z)), np.exp(exponent * np.log(_BEGIN))
    saturation = (M_yinf - M_y0) * np.exp(begin - power)
    return M_yinf - saturation, exponent * H_exp * power / z * saturation


def stored_energy(alpha: float, M_y0: float, M_yinf: float, H_exp: float, exponent: float) -> float:
    """Integral of sigma_y - M_y0 in mJ/mm^3, by the series of the incomplete gamma function, all of whose terms are positive:

    int_0^z exp(-t^p) dt = z exp(-w) [1 + w / (s + 1) + w^2 / ((s + 1)(s + 2)) + ...], w = z^p, s = 1 / p.
    """
    z, both = H_exp * alpha + _BEGIN, 0.0 * alpha
    for sign, end in ((1.0, z), (-1.0, 0.0 * z + _BEGIN)):
        w = np.exp(exponent * np.log(end))
        term, total, k = 1.0 + 0.0 * w, 1.0 + 0.0 * w, 0
        while abs(term) > _LAST_DIGIT * abs(total):
            k += 1
            term = term * w / (1.0 / exponent + k)
            total = total + term
        both = both + sign * end * np.exp(-w) * total
    begin = np.exp(np.exp(exponent * np.log(_BEGIN)))
    return (M_yinf - M_y0) * (alpha - begin * both / H_exp)


def search(stress: float, strain: float) -> dict[str, tuple[float, float, float]]:
    """Start and bounds by the largest stress of a test in MPa and its largest strain."""
    return {**voce.search(stress, strain), "hockett_sherby.exponent": (0.8, 0.1, 3.0)}


def first_guess(accumulated: np.ndarray, stress: np.ndarray) -> dict[str, float]:
    """That of Voce's law, a little rounder."""
    return {**voce.first_guess(accumulated, stress), "hockett_sherby.exponent": 0.9}
