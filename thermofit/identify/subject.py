"""What an analysis of identifiability is about: a stage of a study, at its optimum or before a test, ready to be evaluated anywhere.

A Subject is plain data, so that any process can make the model of it again; within a process the model is made once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import with_identified
from thermofit.experiment.model import StageModel
from thermofit.experiment.planned import planned, simulated
from thermofit.experiment.planned_coupon import coupon_assumed, planned_coupon, records_of
from thermofit.experiment.programmes import NAMES as BODY_NAMES
from thermofit.experiment.programmes import OWN, programme_named
from thermofit.identify.linear import MOTION, Linear, Shift, linear_of, motion_shift
from thermofit.identify.solve import remembering
from thermofit.identify.stage import Ready, model_maker, ready
from thermofit.point.programmes import NAMES as COUPON_NAMES
from thermofit.records.checkpoint import Checkpoint
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study


@dataclass(frozen=True)
class Subject:
    """Stage `key` of a study; `programme`: name of a planned test, None for the optimum on what was measured."""

    study: Study
    key: str
    programme: str | None = None


@dataclass(frozen=True)
class Prepared:
    """Settings and model of a subject, the parameters at which it is judged, the artefacts that it rests on, errors of what is
    prescribed, and a remark."""

    settings: StageSettings
    model: StageModel
    base: Parameters
    inputs: Mapping[str, Path]
    shifts: Mapping[str, Shift]
    remark: str


_prepared: dict[tuple[str, str, str | None], Prepared] = {}


def prepared(subject: Subject) -> Prepared:
    """Prepared of a subject, made once per process.

    StudyError where an artefact is missing (names its command) or the study plans no test; NumericsError where the model fails.
    """
    key = (subject.study.model_dump_json(), subject.key, subject.programme)
    if key not in _prepared:
        _prepared.clear()  # fields of one test are large, and analyses come one after the other
        _prepared[key] = _measured(subject) if subject.programme is None else _planned(subject, subject.programme)
    return _prepared[key]


def linear_subject(subject: Subject, store: Checkpoint | None = None) -> Linear:
    """The subject linearised; its forward run is kept in `store`."""
    p = prepared(subject)
    linear = linear_of(subject.study, p.settings, p.model, p.base, subject.programme is not None, store)
    return replace(linear, shifts={**linear.shifts, **p.shifts})


def _measured(subject: Subject) -> Prepared:
    study = subject.study
    stage, inputs = optimum_of(study, subject.key)
    model = remembering(model_maker(study, stage.settings, stage.data)(study.mesh_size, stage.base))
    return Prepared(stage.settings, model, stage.base, inputs, {}, model.remark)


def optimum_of(study: Study, key: str) -> tuple[Ready, Mapping[str, Path]]:
    """A stage at its optimum, and the artefacts that it rests on. StudyError where one is missing (names its command)."""
    stage = ready(study, key)
    optimum, found = with_identified(study, stage.base, (f"identify-{key}",))
    return replace(stage, base=optimum.with_free(stage.settings.free)), {**stage.inputs, **found}


def _planned(subject: Subject, name: str) -> Prepared:
    study = subject.study
    settings = study.stage(subject.key)
    if name != OWN and not isinstance(settings.window, str):
        # A window in seconds belongs to the programme of the study, not to another one.
        settings = settings.model_copy(update={"window": "all"})
    if study.coupon is not None:
        records = records_of(study)
        assumed = coupon_assumed(study, records, settings.free)
        data = planned_coupon(study, records, name, assumed)
        model = model_maker(study, settings, data)(study.mesh_size, assumed)
        return Prepared(settings, model, assumed, {}, {}, f"{name}: {len(data.tests)} planned records, {data.tests[0].time[-1]:.4g} s")
    assumed = study.truth_parameters().with_free(settings.free)
    test = planned(study, programme_named(name, simulated(study)), assumed)
    model = remembering(model_maker(study, settings, test.data)(study.mesh_size, assumed))
    motion = motion_shift(model, test.data.displacement.time, test.motion)
    shifts = {} if motion is None else {MOTION: motion}
    return Prepared(settings, model, assumed, {}, shifts, f"{name}: {test.duration:.4g} s, at most {test.force:.4g} N")


def programme_names(study: Study) -> tuple[str, ...]:
    """Names of the planned tests that a study knows: its own, and those made by name for its driver."""
    return (OWN, *(COUPON_NAMES if study.coupon is not None else BODY_NAMES))
