"""What the law refuses: bounds of the dissipation factor beta, inside which the printed proof of a non-negative dissipation holds, and
effects that a driver does not have."""

from __future__ import annotations

import math
from collections.abc import Sequence

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.effects.catalogue import effects
from thermofit.law.composition import POINT_ONLY


def beta_bounds_model2(M_y0: float, M_yinf: float, H_exp: float) -> tuple[float, float]:
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


def beta_warning(parameters: Parameters, model: int) -> str | None:
    """Warning where beta of model 2 lies outside [0, 1] and [beta_l, beta_u] (4.24, read as in E.13); else None.

    The bounds are sufficient, not necessary: alpha never exceeds 1/b, and up to there the dissipation is non-negative for
    every beta >= 0. So this warns and does not forbid; beta >= 0, all that model 1 needs (4.23), is a physical bound.
    """
    if model != 2:
        return None
    beta = parameters["beta"]
    lower, upper = beta_bounds_model2(parameters["M_y0"], parameters["M_yinf"], parameters["H_exp"])
    if 0.0 <= beta <= 1.0 or lower <= beta <= upper:
        return None
    return (
        f"beta = {beta:g} lies outside 0 to {upper:.3g}, the bounds (4.24) that are sufficient for a non-negative dissipation of model 2 "
        f"(beta_l = {lower:.3g}, beta_u = {upper:.3g}): compare it with the literature before you trust it"
    )


def check_beta(parameters: Parameters) -> None:
    """StudyError where beta is negative: flow would absorb heat, against the second law (4.23), (4.24), in both models."""
    if not parameters["beta"] >= 0.0:
        raise StudyError(
            f"beta = {parameters['beta']:g}: expected at least 0, else plastic flow absorbs heat, against the second law (4.23), (4.24)"
        )


def check_body_effects(parameters: Parameters, names: Sequence[str] = ()) -> None:
    """StudyError where an effect that only the point driver has is on, or one of its Params is among `names` to be differentiated."""
    for e in effects(POINT_ONLY):
        if parameters[e.amplitude.name] != e.amplitude.neutral or set(names) & set(e.names):
            raise StudyError(
                f"effect '{e.name}': the finite element body does not have it yet, only the point driver of coupon records; "
                f"leave {e.amplitude.name} at {e.amplitude.neutral:g} and fixed, or use a coupon record"
            )
