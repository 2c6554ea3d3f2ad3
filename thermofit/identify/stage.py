"""One identification stage from its records to its record; the three stage modules say what is particular about theirs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.experiment.computed_motion import valued
from thermofit.experiment.drive import driven_remark
from thermofit.experiment.fields import with_identified
from thermofit.experiment.forms import experiment_after
from thermofit.experiment.model import StageModel
from thermofit.experiment.protocol import Experiment, FieldTest, Kept
from thermofit.fit.memory import memories
from thermofit.identify.beside import answers, remark_of
from thermofit.identify.combined import with_budget
from thermofit.identify.correlated import with_correlated_noise
from thermofit.identify.outcome import made, nothing_identified
from thermofit.identify.solve import DRIVE, Solved, discard_checkpoints, model_on, solve, within
from thermofit.law.bounds import beta_warning
from thermofit.records.artefact import open_record
from thermofit.records.key import stage_key
from thermofit.records.staging import Job, Made, Note, Outcome, artefact_path, job, named, produce
from thermofit.study.reading import reading
from thermofit.study.stages import ElasticStage, StageSettings
from thermofit.study.study import Study

EARLIER: dict[str, tuple[str, ...]] = {
    "elastic": (),
    "plastic": ("identify-elastic",),
    "thermal": ("identify-elastic", "identify-plastic"),
}
"""The earlier stages whose results a stage takes, by its key under `stages`."""
PLASTIC = "plastic"
"""The stage that a load maximum matters to."""
Remarks = Callable[[FieldTest, Solved], tuple[str, ...]]
"""What is particular about the result of a stage on one specimen, in words."""


@dataclass(frozen=True)
class StageKind:
    """A stage: command name, key under `stages`, and its own remarks on the result."""

    name: str
    key: str
    remarks: Remarks


@dataclass(frozen=True)
class Ready:
    """A stage about to run: its settings, the experiment, the parameters from which it starts, and what decides whether a
    result is fresh (sections of the study, artefacts that it reads)."""

    settings: StageSettings
    experiment: Experiment
    base: Parameters
    config: dict[str, Any]
    inputs: dict[str, Path]
    kept: Kept = Kept()
    """Parameters that the stage would identify, did the data tell them."""
    told: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Bounds within which an earlier stage has told parameters that are free again."""


def ready(study: Study, key: str) -> Ready:
    """The stage of that key. StudyError where an artefact is missing (names the command that makes it)."""
    config = stage_key(study, key)
    with reading(config):
        experiment = experiment_after(study, EARLIER[key])
        settings, kept = experiment.stage(key)
        base, _ = with_identified(study, experiment.start(), EARLIER[key])
        inputs = {**experiment.inputs, **{name: artefact_path(study.run_dir, name) for name in EARLIER[key]}}
        told = experiment.earlier_estimates(key)
    settings = settings.model_copy(update={"free": (*settings.free, *told)})
    return Ready(settings, experiment, base.with_free(settings.free), config, inputs, kept, told)


def as_recorded(study: Study, stage: Ready, key: str) -> Ready:
    """The stage of that key, ready and identified before, driven as its record says."""
    return replace(stage, experiment=experiment_after(study, (*EARLIER[key], f"identify-{key}")))


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
    is free leaves a record that says so, and the chain goes on.

    Where the model cannot carry the measured force, or that is near its maximum where plastic flow is identified, the motion of sections
    drives the specimen; the record tells it, and later stages follow. NumericsError where that fails too, or is not known.
    """
    other = stage.experiment.by_sections
    if other is None:
        return _identified(study, stage, kind, task)
    plastic = kind.key == PLASTIC
    why = stage.experiment.near_maximum if plastic else ""
    if not why:
        try:
            return _identified(study, stage, kind, task, to_the_end=not plastic)
        except NumericsError as error:
            why = f"the model finds no equilibrium at the measured force ({error})"
    turned, keyed = replace(stage, experiment=other), replace(task, config={**task.config, DRIVE: other.drive})
    return _identified(study, turned, kind, keyed, driven_remark(other, why))


def _identified(study: Study, stage: Ready, kind: StageKind, task: Job, said: str = "", *, to_the_end: bool = True) -> Made:
    """Solve a stage in the drive that its experiment has; `said`: why that is not the force."""
    kept = _kept(stage)
    if not stage.settings.free:
        return nothing_identified(stage.base, kept or ("nothing is free: E is prescribed by the study (a number without a start)",))
    experiment = stage.experiment
    start, replaced = experiment.feasible(stage.base)
    model, scalable, again = model_on(experiment, stage.settings), experiment.scalable, experiment.again
    bound = within(study, stage.base, stage.told)
    solved = solve(bound, stage.settings, start, model, task, scalable=scalable, again=again, to_the_end=to_the_end)
    solved, honest = _widened(study, solved)
    if study.static is None:
        records = {name: open_record(stage.inputs[name]) for name in EARLIER[kind.key]}
        solved = with_budget(stage.settings, experiment, solved, records)
    warning = beta_warning(solved.parameters, study.hardening_law)
    remarks = (*kept, said, replaced, *_own_remarks(stage, kind, solved), warning or "", honest)
    if not isinstance(stage.settings, ElasticStage) or not stage.settings.beside:
        return _driven(made(bound, stage.base, solved, remarks), experiment)
    rows = answers(study, stage.settings, solved, experiment, task, lambda other: _widened(study, other))
    record = made(bound, stage.base, solved, (*remarks, remark_of(rows)))
    return _driven(replace(record, summary={**record.summary, "side_by_side": rows}), experiment)


def _driven(record: Made, experiment: Experiment) -> Made:
    """The record that says what drove its model."""
    return replace(record, summary={**record.summary, "drive": experiment.drive})


def _kept(stage: Ready) -> tuple[str, ...]:
    """A remark where no datum tells parameters that the stage should identify."""
    kept = stage.kept
    if not kept.names:
        return ()
    values = ", ".join(f"{name} = {valued(name, stage.base[name])}" for name in kept.names)
    return (f"{kept.why}: {values} of the study {'is' if len(kept.names) == 1 else 'are'} kept as prescribed; {kept.mend}",)


def _own_remarks(stage: Ready, kind: StageKind, solved: Solved) -> tuple[str, ...]:
    """What is particular about the result of a stage: what records are worth, then specimen by specimen."""
    out = [*memory_remarks(solved.model, solved.fit.residual)]
    for test in stage.experiment.fields:
        here = replace(solved, parameters=stage.experiment.seen_by(solved.parameters, test.name))
        out += [named(test.name, text) for text in kind.remarks(test, here)]
    return tuple(out)


def memory_remarks(model: StageModel, residual: np.ndarray) -> tuple[str, ...]:
    """How many independent values the correlated misfit of each channel is worth; nothing where the noise of the comparisons says it."""
    if model.segments is None:
        return ()
    found, out = memories(residual, model.segments), []
    at = 0
    for c in model.comparisons:
        here = [m for m in found if at <= m.part.start < at + c.n]
        at += c.n
        worth = sum(m.independent for m in here)
        out.append(Note(f"{c.channel}: {c.n} values count as {worth:.3g} independent ones, because their misfit is correlated in time"))
    return tuple(out)


def _widened(study: Study, solved: Solved) -> tuple[Solved, str]:
    """Standard errors for the correlation of neighbouring points, which a single field has in plenty and no time to average."""
    return with_correlated_noise(solved) if study.static is not None else (solved, "")
