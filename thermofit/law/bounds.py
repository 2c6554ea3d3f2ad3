"""What the law refuses or doubts: values of the dissipation factor beta."""

from __future__ import annotations

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
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
