"""`gridsearch`: one stage from several starts; is its optimum unique (thesis 2.8.4, Tables 5.6, 5.10, 5.19)?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import Parameters, units_of
from thermofit.experiment.fields import with_identified
from thermofit.identify.draws import drawn_starts
from thermofit.identify.solve import discard_checkpoints
from thermofit.identify.stage import Ready, as_recorded, ready
from thermofit.identify.trials import StageTrial, optima, record_of, run_trials, setup, shown, total_counts, trial_datasets
from thermofit.identify.uniqueness import Uniqueness, uniqueness
from thermofit.records.artefact import Dataset, of_parameters
from thermofit.records.executor import SERIAL, Executor
from thermofit.records.staging import Job, Made, Outcome, artefact_path, job, produce
from thermofit.report.figures import drawn
from thermofit.report.figures_search import basin_figure
from thermofit.study.search import GridSearch
from thermofit.study.study import Study

NAME = "gridsearch"
FIGURE = "gridsearch-basins"


def run(study: Study, *, force: bool = False, where: Executor = SERIAL) -> Outcome:
    """Record with every start, its optimum and the verdict on uniqueness; `parameters` are those of the best optimum.

    The starts run where the executor says. A killed run resumes: finished starts are read from disk. A start that fails is counted and
    named. StudyError where the study lists no starts or names a parameter that the stage does not identify; NumericsError where
    every start fails.
    """
    settings = settings_of(study)
    stage, optimum = with_optimum(study, settings, ready(study, settings.stage))
    starts = (*settings.starts, *(drawn_starts(study, settings.draw, stage.base) if settings.draw is not None else ()))
    task = job(study.run_dir, NAME, {**stage.config, **study.config_of("gridsearch")}, stage.inputs)
    outcome = produce(task, lambda: _make(study, stage, optimum, starts, task, where), force=force)
    discard_checkpoints(task)
    drawn(study.run_dir, {FIGURE: lambda: basin_figure(outcome.record)}, anew=not outcome.fresh)
    return outcome


def with_optimum(study: Study, settings: GridSearch, stage: Ready) -> tuple[Ready, Parameters]:
    """The parameters for which a one-way model is made: the optimum where the stage has been identified, else the study's start."""
    command = f"identify-{settings.stage}"
    if not artefact_path(study.run_dir, command).exists():
        return stage, stage.base
    optimum, found = with_identified(study, stage.base, (command,))
    return replace(as_recorded(study, stage, settings.stage), inputs={**stage.inputs, **found}), optimum.with_free(stage.settings.free)


def settings_of(study: Study) -> GridSearch:
    """The study's section `gridsearch`; StudyError where it has none or names what the stage does not fit."""
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


def _make(study: Study, stage: Ready, optimum: Parameters, starts: tuple[Mapping[str, float], ...], task: Job, where: Executor) -> Made:
    labels = [str(number) for number in range(1, len(starts) + 1)]
    trials = run_trials(setup(study, stage, task, optimum), starts, labels, where)
    names = stage.settings.free
    record = record_of(_best(trials))
    verdict = _verdict(trials, names)
    remarks = [*record.summary["remarks"], *_remarks(trials)]
    summary = {**record.summary, **_summary(study, trials, verdict), "remarks": remarks}
    begun = np.array([[start.get(name, stage.base[name]) for name in names] for start in starts])
    datasets = {
        **record.datasets,
        **trial_datasets(trials, names, "starts"),
        "starts/start": of_parameters(begun, ("trial", "parameter"), units_of(names)),
        "starts/group": Dataset(np.array(verdict.groups), "1", ("trial",)),
    }
    seed = None if study.gridsearch is None or study.gridsearch.draw is None else study.gridsearch.draw.seed
    return Made(datasets, summary, record.parameters, seed)


def _verdict(trials: list[StageTrial], names: tuple[str, ...]) -> Uniqueness:
    none = np.full((len(names), len(names)), np.nan)
    known = [none if t.failed or t.summary["curvature"] is None else np.array(t.summary["curvature"]) for t in trials]
    f, converged = np.array([t.f for t in trials]), np.array([t.converged for t in trials])
    return uniqueness(names, optima(trials, names), f, converged, np.array(known))


def _best(trials: list[StageTrial]) -> StageTrial:
    """The trial with the lowest f, a converged one where there is any."""
    solved = [t for t in trials if t.converged] or [t for t in trials if not t.failed]
    if not solved:
        raise NumericsError(f"gridsearch: all {len(trials)} starts failed, the first with: {trials[0].summary['message']}")
    return min(solved, key=lambda t: t.f)


def _summary(study: Study, trials: list[StageTrial], verdict: Uniqueness) -> dict[str, Any]:
    return {
        "verdict": verdict.text + _losses(trials),
        "trustworthy": verdict.kind == "unique",
        "uniqueness": verdict.kind,
        "spread": verdict.spread,
        "constant_ratios": {name: asdict(ratio) for name, ratio in verdict.ratios.items()},
        "relation": verdict.relation,
        "optima": [_row(number, t, group) for number, (t, group) in enumerate(zip(trials, verdict.groups, strict=True), start=1)],
        "starts": [shown(t) for t in trials],
        "evaluations": total_counts(trials),
        "figures": {FIGURE: str(study.run_dir / "figures" / f"{FIGURE}.png")},
    }


def _row(number: int, trial: StageTrial, group: int) -> dict[str, Any]:
    """A start as a line of a table: where it ended, with which objective and after how many runs."""
    if trial.failed:
        return {"start": number, "ends in": "failed"}
    runs = trial.summary["evaluations"]
    ends = f"optimum {group}" if group else "not converged"
    return {"start": number, "ends in": ends, **trial.summary["optimum"], "f": trial.f, "runs": runs["forward"] + runs["replayed"]}


def _losses(trials: list[StageTrial]) -> str:
    """How many starts gave no optimum."""
    failed = sum(t.failed for t in trials)
    short = sum(not t.failed and not t.converged for t in trials)
    parts = [f"{n} {what}" for n, what in ((failed, "failed"), (short, "did not converge")) if n]
    return f"; {', '.join(parts)}" if parts else ""


def _remarks(trials: list[StageTrial]) -> list[str]:
    """Every start that failed or did not converge, by its number."""
    out = []
    for number, trial in enumerate(trials, start=1):
        if trial.failed:
            out.append(f"start {number} failed: {trial.summary['message']}")
        elif not trial.converged:
            out.append(f"start {number} did not converge: {trial.summary['message']}")
    return out
