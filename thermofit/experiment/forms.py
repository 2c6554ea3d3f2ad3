"""Which form of experiment a study has: the only place that asks."""

from __future__ import annotations

from thermofit.experiment.body import BodyExperiment
from thermofit.experiment.coupon import CouponExperiment, record_files
from thermofit.experiment.coupon_records import interpolated
from thermofit.experiment.interpolated import RawData, raw_fields
from thermofit.experiment.many import SeveralExperiments
from thermofit.experiment.protocol import Experiment
from thermofit.study.study import Study


def experiment_of(study: Study) -> Experiment:
    """All that a study fits. Nothing is read yet."""
    if study.fitted:
        return SeveralExperiments(study)
    return BodyExperiment(study) if study.coupon is None else CouponExperiment(study)


def raw_of(study: Study) -> RawData:
    """What the artefact of `interpolate` of one experiment is made of. DataError, StudyError where its files, or an artefact that it needs,
    are missing (names the command)."""
    return raw_fields(study) if study.coupon is None else RawData(record_files(study), lambda: interpolated(study))
