"""What an analysis of identifiability is about: a stage of a study, at its optimum or before a test, ready to be evaluated anywhere.

A Subject is plain data, so that any process can make the model of it again; within a process the model is made once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import with_identified
from thermofit.experiment.forms import experiment_of
from thermofit.experiment.model import StageModel
from thermofit.experiment.programmes import OWN
from thermofit.identify.linear import MOTION, Linear, Shift, linear_of, motion_shift
from thermofit.identify.solve import remembering
from thermofit.identify.stage import Ready, as_recorded, ready
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
class PreparedSubject:
    """Settings and model of a subject, the parameters at which it is judged, the artefacts that it rests on, errors of what is
    prescribed, and a remark."""

    settings: StageSettings
    model: StageModel
    base: Parameters
    inputs: Mapping[str, Path]
    shifts: Mapping[str, Shift]
    remark: str


_prepared: dict[tuple[str, str, str | None], PreparedSubject] = {}


def prepared(subject: Subject) -> PreparedSubject:
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


def _measured(subject: Subject) -> PreparedSubject:
    study = subject.study
    stage, inputs = optimum_of(study, subject.key)
    model = remembering(stage.experiment.model(stage.settings, stage.base, study.mesh_size))
    return PreparedSubject(stage.settings, model, stage.base, inputs, {}, model.remark)


def optimum_of(study: Study, key: str) -> tuple[Ready, Mapping[str, Path]]:
    """A stage at its optimum, and the artefacts that it rests on. StudyError where one is missing (names its command)."""
    stage = ready(study, key)
    optimum, found = with_identified(study, stage.base, (f"identify-{key}",))
    return replace(as_recorded(study, stage, key), base=optimum.with_free(stage.settings.free)), {**stage.inputs, **found}


def _planned(subject: Subject, name: str) -> PreparedSubject:
    study = subject.study
    settings = study.stage(subject.key)
    if name != OWN and not isinstance(settings.window, str):
        # A window in seconds belongs to the programme of the study, not to another one.
        settings = settings.model_copy(update={"window": "all"})
    test = experiment_of(study).planned(settings, name)
    model = remembering(test.experiment.model(settings, test.assumed, study.mesh_size))
    motion = None if test.motion is None else motion_shift(model, test.motion.time, test.motion.added)
    shifts = {} if motion is None else {MOTION: motion}
    return PreparedSubject(settings, model, test.assumed, {}, shifts, f"{name}: {test.words}")
