"""`interpolate`: what was measured at material points of the model, or as coupon records, with its noise and the phases of the test."""

from __future__ import annotations

from thermofit.experiment.computed_motion import refuse_some_without_displacements
from thermofit.experiment.forms import raw_of
from thermofit.records.key import key_of
from thermofit.records.staging import Outcome, each, job, produce
from thermofit.study.study import Study

NAME = "interpolate"


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record with displacements, temperatures, their sigma and masks, the load steps and the phases of the test.

    Of coupons: their records as read, with noise and phases. DataError, StudyError where files, or the artefact of `calibrate-ir`, are
    missing (names the command), and where a motion is to be computed with what nobody knows.
    """
    if study.experiments:
        refuse_some_without_displacements(study)
        return each(study, NAME, run, lambda one: True, force=force)
    raw = raw_of(study)
    return produce(job(study.run_dir, NAME, key_of(study, NAME), raw.inputs), raw.made, force=force)
