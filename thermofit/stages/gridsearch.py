"""`gridsearch`: one stage from several starts; is its optimum unique (thesis 2.8.4, Tables 5.6, 5.10, 5.19)?"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.core.progress import progress
from thermofit.core.staging import Job, Made, Outcome, artefact_path, job, produce
from thermofit.core.study import Study
from thermofit.core.study_models import GridSearch
from thermofit.identify.inputs import with_identified
from thermofit.identify.outcome import made
from thermofit.identify.solve import discard_checkpoints
from thermofit.identify.stage import Ready, model_maker, ready
from thermofit.identify.trials import (
    Trial,
    attempt,
    objectives,
    optima,
    shared_models,
    total_counts,
    trial_datasets,
    trial_job,
    trial_summary,
)
from thermofit.identify.uniqueness import Uniqueness, uniqueness

NAME = "gridsearch"


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record with every start, its optimum and the verdict on uniqueness; `parameters` are those of the best optimum.

    A killed run resumes: finished starts are read from disk. A start that fails is counted and named. StudyError where the
    study lists no starts or names a parameter that the stage does not identify; NumericsError where every start fails.
    """
    settings = _settings(study)
    stage, optimum = _with_optimum(study, settings, ready(study, settings.stage))
    task = job(study.run_dir, NAME, {**stage.config, **study.config_of("gridsearch")}, stage.inputs)
    outcome = produce(task, lambda: _make(study, stage, optimum, task), force=force)
    discard_checkpoints(task)
    return outcome


def _with_optimum(study: Study, settings: GridSearch, stage: Ready) -> tuple[Ready, Parameters]:
    """The parameters for which a one-way model is made: the optimum where the stage has been identified, else the study's start."""
    command = f"identify-{settings.stage}"
    if not artefact_path(study.run_dir, command).exists():
        return stage, stage.base
    optimum, found = with_identified(study, stage.base, (command,))
    return replace(stage, inputs={**stage.inputs, **found}), optimum.with_free(stage.settings.free)


def _settings(study: Study) -> GridSearch:
    settings = study.gridsearch
    if settings is None:
        raise StudyError(f"{study.source.name}: key 'gridsearch' is missing: add its stage and starts, see `thermofit new`")
    free = study.stage(settings.stage).free
    for number, start in enumerate(settings.starts):
        if other := [name for name in start if name not in free]:
            raise StudyError(
                f"{study.source.name}: key 'gridsearch.starts.{number}' gives {', '.join(other)}, which stages.{settings.stage}.free does "
                f"not identify; expected some of {', '.join(free)}"
            )
    return settings


def _make(study: Study, stage: Ready, optimum: Parameters, task: Job) -> Made:
    settings = _settings(study)
    set_threads(study.numerics.threads)
    models = shared_models(model_maker(study, stage.settings, stage.data), optimum)
    trials: list[Trial] = []
    with progress(NAME, len(settings.starts)) as advance:
        for number, start in enumerate(settings.starts, start=1):
            trials.append(attempt(study, stage, models, start, trial_job(task, stage, str(number))))
            advance(1, trials[-1].failure)
    best = _best(trials)
    assert best.solved is not None
    names = stage.settings.free
    verdict = uniqueness(names, optima(trials, names), objectives(trials), np.array([t.converged for t in trials]))
    record = made(study, stage.base.replace(**best.given), best.solved)
    summary = {**record.summary, **_summary(stage, trials, verdict), "remarks": [*record.summary["remarks"], *_remarks(trials)]}
    return Made({**record.datasets, **trial_datasets(trials, names, "starts")}, summary, record.parameters)


def _best(trials: list[Trial]) -> Trial:
    """The trial with the lowest f, a converged one where there is any."""
    solved = [t for t in trials if t.converged] or [t for t in trials if t.solved is not None]
    if not solved:
        raise NumericsError(f"gridsearch: all {len(trials)} starts failed, the first with: {trials[0].failure}")
    return min(solved, key=lambda t: float("inf") if t.fit is None else t.fit.f)


def _summary(stage: Ready, trials: list[Trial], verdict: Uniqueness) -> dict[str, Any]:
    return {
        "verdict": verdict.text + _losses(trials),
        "trustworthy": verdict.kind == "one optimum",
        "uniqueness": verdict.kind,
        "spread": verdict.spread,
        "constant_ratios": verdict.ratios,
        "starts": [trial_summary(t, stage.base.replace(**t.given)) for t in trials],
        "evaluations": total_counts(trials),
    }


def _losses(trials: list[Trial]) -> str:
    """How many starts gave no optimum."""
    failed = sum(t.solved is None for t in trials)
    short = sum(t.solved is not None and not t.converged for t in trials)
    parts = [f"{n} {what}" for n, what in ((failed, "failed"), (short, "did not converge")) if n]
    return f"; {', '.join(parts)}" if parts else ""


def _remarks(trials: list[Trial]) -> list[str]:
    """Every start that failed or did not converge, by its number."""
    out = []
    for number, trial in enumerate(trials, start=1):
        if trial.solved is None:
            out.append(f"start {number} failed: {trial.failure}")
        elif not trial.converged:
            out.append(f"start {number} did not converge: {trial.solved.fit.message}")
    return out
