"""Model 2 of the thesis: linear in alpha, which saturates; non-associated, d alpha = (1 - b alpha) d Lambda (4.7), (4.27), (4.28).

With b = H_exp and h = b (M_yinf - M_y0); its curve over Lambda in monotonic flow is Voce's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.law.hardening import voce

MODEL = 2
PARAMS = voce.PARAMS
FORMULA = "sigma_y = M_y0 + h alpha, d alpha = (1 - b alpha) d Lambda, b = H_exp, h = b (M_yinf - M_y0)"
SOURCE = "thesis (4.7), (4.27), (4.28)"
ASCENDING, WHY, RAISES, SMALL, METALS, MEANING = voce.ASCENDING, voce.WHY, voce.RAISES, voce.SMALL, voce.METALS, voce.MEANING
search, first_guess, monotonic = voce.search, voce.first_guess, voce.yield_stress


def hardening_variable(alpha_n: float, d_lambda: float, closed_form: int, M_y0: float, M_yinf: float, H_exp: float) -> tuple[float, float]:
    """alpha after d_lambda, and its derivative by d_lambda: exact (1 - (1 - b alpha_n) exp(-b d_lambda)) / b (errata 2), or backward Euler
    (alpha_n + d_lambda) / (1 + b d_lambda)."""
    if closed_form == 1:
        remaining = (1.0 - H_exp * alpha_n) * np.exp(-H_exp * d_lambda)
        return (1.0 - remaining) / H_exp, remaining
    alpha = (alpha_n + d_lambda) / (1.0 + H_exp * d_lambda)
    return alpha, (1.0 - H_exp * alpha_n) / (1.0 + H_exp * d_lambda) ** 2


def yield_stress(alpha: float, M_y0: float, M_yinf: float, H_exp: float) -> tuple[float, float]:
    """Yield stress in MPa and its derivative by alpha."""
    by_alpha = H_exp * (M_yinf - M_y0)
    return M_y0 + by_alpha * alpha, by_alpha


def stored_energy(alpha: float, M_y0: float, M_yinf: float, H_exp: float) -> float:
    """psi_pl = h alpha^2 / 2 in mJ/mm^3 (4.7)."""
    return 0.5 * H_exp * (M_yinf - M_y0) * alpha * alpha


def dissipated_energy(
    alpha_n: float, alpha: float, d_lambda: float, closed_form: int, beta: float, M_y0: float, M_yinf: float, H_exp: float
) -> float:
    """Dissipation of an increment in mJ/mm^3: the integral of (4.22) over d_lambda.

    In closed form: with d alpha = (1 - b alpha) d Lambda, b int alpha dLambda = d_lambda - d_alpha and
    b int alpha^2 dLambda = (d_lambda - d_alpha)/b - (alpha^2 - alpha_n^2)/2.
    """
    h = H_exp * (M_yinf - M_y0)
    if closed_form == 1:
        slack = d_lambda - (alpha - alpha_n)
        squared = slack / H_exp - 0.5 * (alpha * alpha - alpha_n * alpha_n)
        return h * squared + (1.0 - beta) * M_y0 * slack + beta * M_y0 * d_lambda
    return d_lambda * (H_exp * h * alpha * alpha + (1.0 - beta) * H_exp * M_y0 * alpha + beta * M_y0)


def beta_bounds(M_y0: float, M_yinf: float, H_exp: float) -> tuple[float, float]:
    """Bounds (beta_l, beta_u) of model 2 (4.25), dimensionless.

    beta_{u,l} = (M_y0 b + 2 h [1 +- sqrt(M_y0 b / h + 1)]) / (M_y0 b), with b = H_exp and h = b (M_yinf - M_y0), limits
    in MPa; b cancels. They are the roots of the discriminant of the dissipation (4.22) in alpha, and 0 < beta_l < 1 < beta_u.
    StudyError where M_yinf <= M_y0 or a value is not positive: the material must harden.
    """
    if not (0.0 < M_y0 < M_yinf and H_exp > 0.0):
        raise StudyError(
            f"M_y0 = {M_y0:g} MPa, M_yinf = {M_yinf:g} MPa, H_exp = {H_exp:g}: expected 0 < M_y0 < M_yinf and H_exp > 0, "
            "else the bounds of beta (4.25) do not exist"
        )
    b = H_exp
    h = b * (M_yinf - M_y0)
    ratio = 2.0 * h / (M_y0 * b)
    root = math.sqrt(M_y0 * b / h + 1.0)
    return 1.0 + ratio * (1.0 - root), 1.0 + ratio * (1.0 + root)


def dissipation_remark(values: Mapping[str, float]) -> str | None:
    """What is doubtful about beta: outside [0, 1] and [beta_l, beta_u] (4.24, read as in E.13); None where nothing is.

    The bounds are sufficient, not necessary: alpha never exceeds 1/b, and up to there the dissipation is non-negative for
    every beta >= 0. So this warns and does not forbid; beta >= 0, all that an associated law needs (4.23), is a physical bound.
    """
    beta = values["beta"]
    lower, upper = beta_bounds(*(values[name] for name in PARAMS))
    if 0.0 <= beta <= 1.0 or lower <= beta <= upper:
        return None
    return (
        f"beta = {beta:g} lies outside 0 to {upper:.3g}, the bounds (4.24) that are sufficient for a non-negative dissipation of model 2 "
        f"(beta_l = {lower:.3g}, beta_u = {upper:.3g}): compare it with the literature before you trust it"
    )
