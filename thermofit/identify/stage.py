"""One identification stage from its records to its record; the three stage modules say what is particular about theirs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.core.staging import Made, Outcome, artefact_path, job, produce
from thermofit.core.study import Study
from thermofit.core.study_section import MeshSize
from thermofit.core.study_stages import StageSettings
from thermofit.identify.inputs import INTERPOLATE, Measured, measured, start_parameters, with_identified
from thermofit.identify.model import StageModel, stage_model
from thermofit.identify.outcome import made
from thermofit.identify.start import feasible_start
from thermofit.identify.solve import Solved, discard_checkpoints, solve
from thermofit.identify.window import window_times
from thermofit.material.bounds import beta_warning

_SECTIONS = ("model", "mesh", "parameters", "evaluation", "numerics")
Remarks = Callable[[Study, Measured, Solved], tuple[str, ...]]


@dataclass(frozen=True)
class StageKind:
    """A stage: command name, key under `stages`, the earlier stages whose results it takes, and its own remarks on the result."""

    name: str
    key: str
    earlier: tuple[str, ...]
    remarks: Remarks


def inputs_of(study: Study, kind: StageKind) -> dict[str, Path]:
    """Artefacts that a stage reads."""
    return {name: artefact_path(study.run_dir, name) for name in (INTERPOLATE, *kind.earlier)}


def identify(study: Study, kind: StageKind, *, force: bool = False) -> Outcome:
    """Run a stage, or find it fresh. StudyError where an artefact is missing (names the command that makes it)."""
    settings = study.stage(kind.key)
    data = measured(study)
    base, _ = with_identified(study, start_parameters(study, data), kind.earlier)
    task = job(study.run_dir, kind.name, study.config_of(*_SECTIONS, f"stages.{kind.key}"), inputs_of(study, kind))

    def make() -> Made:
        set_threads(study.numerics.threads)
        return identified(study, settings, base, data, kind)

    outcome = produce(task, make, force=force)
    discard_checkpoints(task)
    return outcome


def identified(study: Study, settings: StageSettings, base: Parameters, data: Measured, kind: StageKind) -> Made:
    """Solve a stage from given parameters; also used for other starts and other prescribed values."""
    task = job(study.run_dir, kind.name, {"stage": settings.model_dump(mode="json")}, inputs_of(study, kind))
    start, replaced = feasible_start(study, data, base.with_free(settings.free))
    solved = solve(study, settings, start, model_maker(study, settings, data), task)
    warning = beta_warning(solved.parameters, study.model)
    return made(study, base, solved, (replaced, *kind.remarks(study, data, solved), warning or ""))


def model_maker(study: Study, settings: StageSettings, data: Measured) -> Callable[[MeshSize, Parameters], StageModel]:
    """StageModel on any mesh for the window of a stage."""
    times = window_times(settings.window, data, data.steps["displacement"])
    return lambda size, base: stage_model(study, data, settings, base, size, times)
