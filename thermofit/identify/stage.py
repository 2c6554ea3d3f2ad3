"""One identification stage from its records to its record; the three stage modules say what is particular about theirs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.experiment.coupon_model import answerable, coupon_model, memory_remarks
from thermofit.experiment.coupon_records import CouponData, coupon_data
from thermofit.experiment.fields import INTERPOLATE, Measured, measured, start_parameters, with_identified
from thermofit.experiment.model import StageModel, stage_model
from thermofit.experiment.several import (
    Part,
    Several,
    expanded,
    feasible,
    interpolate_paths,
    seen_by,
    several,
    several_model,
    several_start,
)
from thermofit.experiment.window import window_times
from thermofit.identify.beside import answers, remark_of
from thermofit.identify.correlated import with_correlated_noise
from thermofit.identify.outcome import made, nothing_identified
from thermofit.identify.solve import Solved, discard_checkpoints, solve
from thermofit.law.bounds import beta_warning
from thermofit.records.key import stage_key
from thermofit.records.staging import Job, Made, Outcome, artefact_path, job, produce
from thermofit.study.section import MeshSize
from thermofit.study.stages import ElasticStage, StageSettings
from thermofit.study.study import Study

Data = Measured | CouponData | Several
"""What was measured: fields of one specimen or of several, or records of coupons."""
EARLIER: dict[str, tuple[str, ...]] = {
    "elastic": (),
    "plastic": ("identify-elastic",),
    "thermal": ("identify-elastic", "identify-plastic"),
}
"""The earlier stages whose results a stage takes, by its key under `stages`."""
Remarks = Callable[[Study, Measured, Solved], tuple[str, ...]]


@dataclass(frozen=True)
class StageKind:
    """A stage: command name, key under `stages`, and its own remarks on the result."""

    name: str
    key: str
    remarks: Remarks


@dataclass(frozen=True)
class Ready:
    """A stage about to run: its settings, what was measured, the parameters from which it starts, and what decides whether a
    result is fresh (sections of the study, artefacts that it reads)."""

    settings: StageSettings
    data: Data
    base: Parameters
    config: dict[str, Any]
    inputs: dict[str, Path]
    kept: tuple[str, ...] = ()
    """Elastic constants that the stage would identify, had any record an elastic range."""


def ready(study: Study, key: str) -> Ready:
    """The stage of that key. StudyError where an artefact is missing (names the command that makes it)."""
    settings, data = study.stage(key), data_of(study)
    if isinstance(data, Several):
        settings = settings.model_copy(update={"free": expanded(settings.free, data)})
    kept: tuple[str, ...] = ()
    if isinstance(data, CouponData):
        settings, kept = answerable(settings, data)
    base, _ = with_identified(study, start_of(study, data), EARLIER[key])
    inputs = {**data_paths(study), **{name: artefact_path(study.run_dir, name) for name in EARLIER[key]}}
    return Ready(settings, data, base.with_free(settings.free), stage_key(study, key), inputs, kept)


def data_of(study: Study) -> Data:
    """What was measured. StudyError where it has not been interpolated (names the command)."""
    if study.fitted:
        return several(study)
    return measured(study) if study.coupon is None else coupon_data(study)


def data_paths(study: Study) -> dict[str, Path]:
    """Artefacts of `interpolate` that a fit reads."""
    return interpolate_paths(study, study.fitted) if study.fitted else {INTERPOLATE: artefact_path(study.run_dir, INTERPOLATE)}


def start_of(study: Study, data: Data) -> Parameters:
    """Start values of a study."""
    return several_start(study, data) if isinstance(data, Several) else start_parameters(study, data)


def identify(study: Study, kind: StageKind, *, force: bool = False) -> Outcome:
    """Run a stage, or find it fresh. StudyError where an artefact is missing (names the command that makes it)."""
    stage = ready(study, kind.key)
    task = job(study.run_dir, kind.name, stage.config, stage.inputs)

    def make() -> Made:
        set_threads(study.numerics.threads)
        return identified(study, stage, kind, task)

    outcome = produce(task, make, force=force)
    discard_checkpoints(task)
    return outcome


def identified(study: Study, stage: Ready, kind: StageKind, task: Job) -> Made:
    """Solve a stage; its evaluations are kept under the name of `task` until that has left its record. A stage of coupons in which nothing
    is free leaves a record that says so, and the chain goes on."""
    kept = _kept(stage)
    if not stage.settings.free:
        return nothing_identified(study, stage.base, kept or ("nothing is free: E is prescribed by the study (a number without a start)",))
    start, replaced = feasible(study, stage.data, stage.base)
    solved = solve(study, stage.settings, start, model_maker(study, stage.settings, stage.data), task)
    solved, honest = _widened(study, solved)
    warning = beta_warning(solved.parameters, study.hardening_law)
    remarks = (*kept, replaced, *_own_remarks(study, stage, kind, solved), warning or "", honest)
    data = stage.data
    if not isinstance(data, Measured) or not isinstance(stage.settings, ElasticStage) or not stage.settings.beside:
        return made(study, stage.base, solved, remarks)
    makers = (lambda other: model_maker(study, other, data), task)
    rows = answers(study, stage.settings, solved, makers, lambda other: _widened(study, other))
    record = made(study, stage.base, solved, (*remarks, remark_of(rows)))
    return replace(record, summary={**record.summary, "side_by_side": rows})


def _kept(stage: Ready) -> tuple[str, ...]:
    """A remark where no record tells the elastic constants that the stage should identify."""
    if not stage.kept:
        return ()
    values = ", ".join(f"{name} = {stage.base[name]:g}{' MPa' if name == 'E' else ''}" for name in stage.kept)
    return (
        f"no record begins with an elastic range (a straight line from rest through five samples): {values} of the study is kept as "
        "prescribed; give what is known, or the window as [t0, t1] in s",
    )


def _own_remarks(study: Study, stage: Ready, kind: StageKind, solved: Solved) -> tuple[str, ...]:
    """What is particular about the result of a stage, experiment by experiment."""
    if isinstance(stage.data, CouponData):
        return memory_remarks(solved.model, solved.fit.residual)
    if isinstance(stage.data, Measured):
        return kind.remarks(study, stage.data, solved)
    out = []
    for part in stage.data.parts:
        here = replace(solved, parameters=seen_by(solved.parameters, part.name))
        out += [f"{part.name}: {text}" for text in kind.remarks(part.study, part.data, here)]
    return tuple(out)


def _widened(study: Study, solved: Solved) -> tuple[Solved, str]:
    """Standard errors for the correlation of neighbouring points, which a single field has in plenty and no time to average."""
    return with_correlated_noise(solved) if study.static is not None else (solved, "")


def model_maker(study: Study, settings: StageSettings, data: Data) -> Callable[[MeshSize, Parameters], StageModel]:
    """StageModel on any mesh for the window of a stage; coupons have no mesh."""
    if isinstance(data, CouponData):
        return lambda _, base: coupon_model(study, data, settings, base)
    if isinstance(data, Several):
        return lambda size, base: several_model(
            data,
            settings,
            base,
            lambda part, own, here: stage_model(part.study, part.data, own, here, size, _times(part, settings)),
        )
    times = window_times(settings.window, data, data.steps["displacement"])
    return lambda size, base: stage_model(study, data, settings, base, size, times)


def _times(part: Part, settings: StageSettings) -> tuple[float, float, str]:
    """Window of a stage on one of several experiments, s, and a remark."""
    own = next(s for s in (part.study.stages.elastic, part.study.stages.plastic, part.study.stages.thermal) if type(s) is type(settings))
    return window_times(own.window, part.data, part.data.steps["displacement"])
