"""Which form of experiment a study has: the only place that asks."""

from __future__ import annotations

from collections.abc import Sequence

from thermofit.experiment.body import BodyExperiment
from thermofit.experiment.coupon import CouponExperiment, record_files
from thermofit.experiment.coupon_records import interpolated
from thermofit.experiment.drive import SECTIONS
from thermofit.experiment.interpolated import RawData, raw_fields
from thermofit.experiment.many import SeveralExperiments
from thermofit.experiment.protocol import Experiment
from thermofit.records.artefact import open_record
from thermofit.records.staging import artefact_path
from thermofit.study.study import Study


def experiment_of(study: Study) -> Experiment:
    """All that a study fits. Nothing is read yet."""
    if study.fitted:
        return SeveralExperiments(study)
    return BodyExperiment(study) if study.coupon is None else CouponExperiment(study)


def experiment_after(study: Study, stages: Sequence[str]) -> Experiment:
    """All that a study fits, driven as the records of the given stages (by their commands) say that it was."""
    experiment = experiment_of(study)
    paths = [artefact_path(study.run_dir, stage) for stage in stages]
    if any(open_record(path).summary.get("drive") == SECTIONS for path in paths if path.exists()):
        return experiment.by_sections or experiment
    return experiment


def raw_of(study: Study) -> RawData:
    """What the artefact of `interpolate` of one experiment is made of. DataError, StudyError where its files, or an artefact that it needs,
    are missing (names the command)."""
    return raw_fields(study) if study.coupon is None else RawData(record_files(study), lambda: interpolated(study))
