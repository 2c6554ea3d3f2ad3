"""One identification stage from its records to its record; the three stage modules say what is particular about theirs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.core.staging import Job, Made, Outcome, artefact_path, job, produce
from thermofit.core.study import Study
from thermofit.core.study_section import MeshSize
from thermofit.core.study_stages import ElasticStage, StageSettings
from thermofit.identify.beside import answers, remark_of
from thermofit.identify.correlated import with_correlated_noise
from thermofit.identify.coupon_inputs import CouponData, coupon_data
from thermofit.identify.coupon_model import coupon_model, memory_remarks
from thermofit.identify.inputs import INTERPOLATE, Measured, measured, start_parameters, with_identified
from thermofit.identify.model import StageModel, stage_model
from thermofit.identify.outcome import made
from thermofit.identify.solve import Solved, discard_checkpoints, solve
from thermofit.identify.start import feasible_start
from thermofit.identify.window import window_times
from thermofit.material.bounds import beta_warning

Data = Measured | CouponData
"""What was measured: fields of one specimen, or records of coupons."""
_SECTIONS = ("model", "material_axes", "mesh", "geometry", "parameters", "evaluation", "force", "numerics", "coupon")
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


def ready(study: Study, key: str) -> Ready:
    """The stage of that key. StudyError where an artefact is missing (names the command that makes it)."""
    settings = study.stage(key)
    data: Data = measured(study) if study.coupon is None else coupon_data(study)
    base, _ = with_identified(study, start_parameters(study, data), EARLIER[key])
    inputs = {name: artefact_path(study.run_dir, name) for name in (INTERPOLATE, *EARLIER[key])}
    return Ready(settings, data, base.with_free(settings.free), study.config_of(*_SECTIONS, f"stages.{key}"), inputs)


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
    """Solve a stage; its evaluations are kept under the name of `task` until that has left its record."""
    start, replaced = feasible_start(study, stage.data, stage.base)
    solved = solve(study, stage.settings, start, model_maker(study, stage.settings, stage.data), task)
    solved, honest = _widened(study, solved)
    warning = beta_warning(solved.parameters, study.model)
    if isinstance(stage.data, CouponData):
        own = memory_remarks(solved.model, solved.fit.residual)
    else:
        own = kind.remarks(study, stage.data, solved)
    remarks = (replaced, *own, warning or "", honest)
    if isinstance(stage.data, CouponData) or not isinstance(stage.settings, ElasticStage) or not stage.settings.beside:
        return made(study, stage.base, solved, remarks)
    data = stage.data
    makers = (lambda other: model_maker(study, other, data), task)
    rows = answers(study, stage.settings, solved, makers, lambda other: _widened(study, other))
    record = made(study, stage.base, solved, (*remarks, remark_of(rows)))
    return replace(record, summary={**record.summary, "side_by_side": rows})


def _widened(study: Study, solved: Solved) -> tuple[Solved, str]:
    """Standard errors for the correlation of neighbouring points, which a single field has in plenty and no time to average."""
    return with_correlated_noise(solved) if study.static is not None else (solved, "")


def model_maker(study: Study, settings: StageSettings, data: Data) -> Callable[[MeshSize, Parameters], StageModel]:
    """StageModel on any mesh for the window of a stage; coupons have no mesh."""
    if isinstance(data, CouponData):
        return lambda _, base: coupon_model(study, data, settings, base)
    times = window_times(settings.window, data, data.steps["displacement"])
    return lambda size, base: stage_model(study, data, settings, base, size, times)
