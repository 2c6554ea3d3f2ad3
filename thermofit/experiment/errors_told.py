"""Errors of the mesh and of the prescribed force, told at given parameters.

While a model misses more than the error of the force could explain, that error is not taken for noise, which would hide what is missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.experiment.discretisation import Discretised, corrected
from thermofit.experiment.joint import JointParts

FAR = 9.0
"""Mean square of what the residual shows of the error of the force, over its noise, from which the model itself misses something: three
standard errors."""


@dataclass(frozen=True)
class Told:
    """A joint problem that knows its errors, the error (n,) of the mesh that may be left in its residual, the largest Lambda, and whether
    the force is taken as exact although its error is known: `whole` and `left_whole` are the problem that takes it for noise."""

    parts: JointParts
    left: np.ndarray
    whole: JointParts
    left_whole: np.ndarray
    largest_strain: float
    far: bool


def told(plain: JointParts, parameters: Parameters) -> Told:
    """Errors of a joint problem at given parameters. NumericsError where a run fails."""
    each = {name: corrected(part, plain.seen_by(parameters, name)) for name, part in plain.each.items()}
    parts = plain.rebuilt({name: one.joint for name, one in each.items()})
    left, exact = (parts.stacked({name: getattr(one, key) for name, one in each.items()}) for key in ("left", "left_exact"))
    return _chosen(parts, left, exact, list(each.values()), parameters)


def _chosen(parts: JointParts, left: np.ndarray, exact: np.ndarray, found: list[Discretised], parameters: Parameters) -> Told:
    far = too_far(parts, parameters)
    strain = max(one.largest_strain for one in found)
    return Told(parts.without_force_error() if far else parts, exact if far else left, parts, left, strain, far)


def too_far(parts: JointParts, parameters: Parameters) -> bool:
    """Whether a model misses more at given parameters than the error of its prescribed force could explain."""
    return parts.knows_force_error and parts.force_misfit(parameters) > FAR
