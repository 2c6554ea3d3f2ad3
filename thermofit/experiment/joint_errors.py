"""Errors of mesh, steps and prescribed force, told at given parameters.

While a model misses more than the error of the force could explain, that error is not taken for noise, which would hide what is missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.experiment.discretisation import Parts, corrected, summed
from thermofit.experiment.joint import JointParts, Known
from thermofit.experiment.missing import MissingTerm
from thermofit.experiment.prediction import Errors

FAR = 9.0
"""Mean square of what the residual shows of the error of the force, over its noise, from which the model itself misses something: three
standard errors."""


@dataclass(frozen=True)
class JointWithErrors:
    """A joint problem that knows its errors; what (n,) of those of mesh and steps is in doubt in its residual, by cause, and what may be
    left of them as if the data held them wholly; the largest Lambda, and whether the force is taken as exact although its error is known:
    `whole`, `left_whole` and `causes_whole` are the problem that takes it for noise."""

    parts: JointParts
    causes: Parts
    left: np.ndarray
    whole: JointParts
    left_whole: np.ndarray
    causes_whole: Parts
    largest_strain: float
    far: bool
    fields: Mapping[str, Mapping[str, Errors]]
    """Errors of mesh and steps that the data hold, as fields, by test and cause."""
    known: Mapping[str, Known]
    """Error fields of each test where they were told, and their derivatives by what is free."""


def told(plain: JointParts, parameters: Parameters, beside: MissingTerm | None = None) -> JointWithErrors:
    """Errors of a joint problem at given parameters; `beside`: a term that the model lacks in its only test. NumericsError where a run
    fails."""
    each = {name: corrected(part, plain.seen_by(parameters, name), beside) for name, part in plain.each.items()}
    parts = plain.rebuilt({name: one.joint for name, one in each.items()})

    def stacked(found: Mapping[str, Parts]) -> dict[str, np.ndarray]:
        causes = next(iter(found.values()))  # on one kind of mesh, all tests have the same
        return {cause: parts.stacked({name: own[cause] for name, own in found.items()}) for cause in causes}

    known = {name: one.known for name, one in each.items()}
    far = too_far(parts, parameters, known)
    whole = summed(stacked({name: one.causes for name, one in each.items()}))
    return JointWithErrors(
        parts=parts.without_force_error() if far else parts,
        causes=stacked({name: one.doubt(far) for name, one in each.items()}),
        left=summed(stacked({name: one.causes_exact for name, one in each.items()})) if far else whole,
        whole=parts,
        left_whole=whole,
        causes_whole=stacked({name: one.doubt(False) for name, one in each.items()}),
        largest_strain=max(one.largest_strain for one in each.values()),
        far=far,
        fields={name: one.fields for name, one in each.items()},
        known=known,
    )


def too_far(parts: JointParts, parameters: Parameters, known: Mapping[str, Known] | None = None) -> bool:
    """Whether a model misses more at given parameters than the error of its prescribed force could explain; `known`: fields of its tests
    there."""
    return parts.knows_force_error and parts.force_misfit(parameters, known) > FAR
