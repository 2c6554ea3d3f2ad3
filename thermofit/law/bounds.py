"""What the law refuses or doubts: values of the dissipation factor beta, and effects that a driver does not have."""

from __future__ import annotations

from collections.abc import Sequence

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.effects.catalogue import effects
from thermofit.law.composition import POINT_ONLY
from thermofit.law.hardening.catalogue import hardening


def beta_warning(parameters: Parameters, model: int | str) -> str | None:
    """Warning where beta may make the dissipation of a hardening law (by number or name) negative, by what that law says; else None."""
    return hardening(model).doubts(parameters)


def check_beta(parameters: Parameters) -> None:
    """StudyError where beta is negative: flow would absorb heat, against the second law (4.23), (4.24), in all models."""
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
