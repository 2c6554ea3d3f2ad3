"""Errors of mesh, steps and prescribed force, told at given parameters.

While a model misses more than the error of the force could explain, that error is not taken for noise, which would hide what is missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.experiment.discretisation import MESH, STEPS, Parts, corrected, summed
from thermofit.experiment.joint import JointParts
from thermofit.experiment.prediction import Errors

FAR = 9.0
"""Mean square of what the residual shows of the error of the force, over its noise, from which the model itself misses something: three
standard errors."""


@dataclass(frozen=True)
class Told:
    """A joint problem that knows its errors, what (n,) mesh and steps may leave in its residual, by cause, the largest Lambda, and whether
    the force is taken as exact although its error is known: `whole` and `left_whole` are the problem that takes it for noise."""

    parts: JointParts
    causes: Parts
    whole: JointParts
    left_whole: np.ndarray
    largest_strain: float
    far: bool
    fields: Mapping[str, Mapping[str, Errors]]
    """Errors of mesh and steps that the data hold, as fields, by test and cause."""

    @property
    def left(self) -> np.ndarray:
        """Error (n,) of mesh and steps that may be left in the residual."""
        return summed(self.causes)


def told(plain: JointParts, parameters: Parameters) -> Told:
    """Errors of a joint problem at given parameters. NumericsError where a run fails."""
    each = {name: corrected(part, plain.seen_by(parameters, name)) for name, part in plain.each.items()}
    parts = plain.rebuilt({name: one.joint for name, one in each.items()})

    def stacked(key: str) -> dict[str, np.ndarray]:
        found = {name: getattr(one, key) for name, one in each.items()}
        return {cause: parts.stacked({name: own[cause] for name, own in found.items()}) for cause in (MESH, STEPS)}

    far, known, exact = too_far(parts, parameters), stacked("causes"), stacked("causes_exact")
    strain = max(one.largest_strain for one in each.values())
    fields = {name: one.fields for name, one in each.items()}
    return Told(parts.without_force_error() if far else parts, exact if far else known, parts, summed(known), strain, far, fields)


def too_far(parts: JointParts, parameters: Parameters) -> bool:
    """Whether a model misses more at given parameters than the error of its prescribed force could explain."""
    return parts.knows_force_error and parts.force_misfit(parameters) > FAR
