"""The same stage solved many times, from other starts or with other prescribed values; one that fails does not stop the others.

Every trial leaves a record beside the artefact of its command, so that a killed command finds it again; the evaluations of a trial that
runs are kept as those of any identification. A worker that sees the run folder keeps them there. One that does not keeps them at home
while it works, and only its answer, which is small, comes back.
"""

from __future__ import annotations

import secrets
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from thermofit.core.digest import path_digest
from thermofit.core.errors import DataError, NumericsError
from thermofit.core.jit import set_threads
from thermofit.core.jsonable import json_text
from thermofit.core.parameters import Parameters, units_of
from thermofit.experiment.model import StageModel
from thermofit.identify.outcome import made
from thermofit.identify.solve import COMPARED, ModelOn, Solved, merged_counts, model_on, solve
from thermofit.identify.stage import Ready
from thermofit.identify.variation import Change, response, varied
from thermofit.records.artefact import Dataset, Record, RecordContent, fresh, of_parameters, open_record, write_record
from thermofit.records.executor import Executor, Task, run_all
from thermofit.records.progress import progress
from thermofit.records.staging import Job, Made
from thermofit.study.section import MeshSize
from thermofit.study.study import Study

COUNTS = ("forward", "linearised", "failed", "replayed", "wall_s")
_prepared: dict[str, ModelOn] = {}
"""Models that the trials of one command share in this process, by what decides about them; those of the last command only."""


@dataclass(frozen=True)
class StageTrial:
    """One solution of a stage: what was `given` for it (by name), what came out as plain numbers, and its record (None: it failed)."""

    given: Mapping[str, float]
    summary: Mapping[str, Any]
    record: Record | None

    @property
    def failed(self) -> bool:
        """True where nothing came out; `summary["message"]` says why."""
        return bool(self.summary["failed"])

    @property
    def converged(self) -> bool:
        """True where the search ended at a minimum."""
        return bool(self.summary["converged"])

    @property
    def f(self) -> float:
        """Objective (2.24); nan where it failed."""
        return float("nan") if self.failed else float(self.summary["f"])


@dataclass(frozen=True)
class Setup:
    """What the trials of a command share, in a form that any process can be sent.

    `keep`: where evaluations are kept; `mark`: what a worker reads there that sees the run folder. `shared`: parameters for which one
    model serves all trials (None: each makes its own). `change`: what the given values prescribe, in which direction of named values, and
    a step of it; the first trial, the nominal one, then says how the optimum follows it.
    """

    study: Study
    stage: Ready
    keep: Job
    mark: str = ""
    shared: Parameters | None = None
    change: Change | None = None


def setup(study: Study, stage: Ready, task: Job, shared: Parameters | None, change: Change | None = None) -> Setup:
    """Setup of the trials of a command; its inputs count by their content, which a worker need not see."""
    inputs = {name: path_digest(path) for name, path in task.inputs.items()}
    keep = Job(task.stage, task.path, {**stage.config, "inputs": inputs}, {})
    return Setup(study, stage, keep, "", shared, change)


def run_trials(common: Setup, givens: Sequence[Mapping[str, float]], labels: Sequence[str], where: Executor) -> list[StageTrial]:
    """One trial for every set of given values; those that an earlier, killed run has finished are read from disk."""
    jobs = [_trial_job(common, label, given) for label, given in zip(labels, givens, strict=True)]
    found = {i: _replayed(open_record(job.path)) for i, job in enumerate(jobs) if fresh(job.path, job.stage, job.config, {})}
    missing = [i for i in range(len(jobs)) if i not in found]
    mark = common.keep.path.parent / f".{common.keep.stage}.here"
    common = replace(common, mark=secrets.token_hex(8))
    tasks = [Task(f"{common.keep.stage} {labels[i]}", trial_answer, (common, jobs[i].stage, dict(givens[i]), i == 0)) for i in missing]
    if where.serial or len(tasks) == 1:
        set_threads(common.study.numerics.threads)
    with progress(common.keep.stage, len(jobs)) as advance:
        advance(len(found))

        def done(index: int, answer: Made) -> None:
            i = missing[index]
            content = RecordContent(jobs[i].stage, jobs[i].config, {}, answer.datasets, answer.parameters, answer.summary)
            found[i] = _trial(write_record(jobs[i].path, content))
            advance(1, str(found[i].summary["message"]) if found[i].failed else "")

        try:
            mark.parent.mkdir(parents=True, exist_ok=True)
            mark.write_text(common.mark, encoding="utf-8")
            run_all(tasks, where, done)
        finally:
            mark.unlink(missing_ok=True)
            _prepared.clear()
    return [found[i] for i in range(len(jobs))]


def _trial_job(common: Setup, label: str, given: Mapping[str, float]) -> Job:
    """The record of one trial, beside those of the others and gone with them when the artefact is written."""
    keep = common.keep
    shared = None if common.shared is None else dict(common.shared.values)
    config = {**keep.config, "base": dict(common.stage.base.values), "shared": shared, "given": given, "change": common.change}
    name = f"{keep.stage}.{label}"
    return Job(name, keep.path.parent / f".{name}.h5", config, {})


def _trial(record: Record) -> StageTrial:
    summary = record.summary["trial"]
    return StageTrial(summary["given"], summary, None if summary["failed"] else record)


def _replayed(record: Record) -> StageTrial:
    """A trial of an earlier run: its forward runs were not computed in this one."""
    trial = _trial(record)
    if trial.failed:
        return trial
    counts = dict(trial.summary["evaluations"])
    counts |= {"replayed": counts["replayed"] + counts["forward"], "forward": 0, "linearised": 0, "failed": 0, "wall_s": 0.0}
    return replace(trial, summary={**trial.summary, "evaluations": counts})


def trial_answer(common: Setup, label: str, given: Mapping[str, float], first: bool) -> Made:
    """Solve the stage with the given values over those of the study; a NumericsError or DataError becomes its failure."""
    mark = common.keep.path.parent / f".{common.keep.stage}.here"
    if mark.exists() and mark.read_text(encoding="utf-8") == common.mark:
        return _answer(common, Job(label, common.keep.path, common.keep.config, {}), given, first)
    with tempfile.TemporaryDirectory(prefix="thermofit-") as folder:
        return _answer(common, Job(label, Path(folder) / common.keep.path.name, common.keep.config, {}), given, first)


def _answer(common: Setup, keep: Job, given: Mapping[str, float], first: bool) -> Made:
    study, other = common.study, varied(common.study, common.stage, given)
    stage = other.stage
    if other.reach != "parameters":
        keep = replace(keep, config={**keep.config, "given": given})
    try:
        own = common.shared is None or other.reach == "data"
        models = other.wrap(model_on(stage.experiment, stage.settings) if own else _models(common))
        start, remark = stage.experiment.feasible(stage.base)
        again, scalable = stage.experiment.again, stage.experiment.scalable
        solved = solve(study, stage.settings, start, models, keep, scalable=scalable, f_tolerance=COMPARED, again=again)
        row = trial_summary(given, stage.base, solved, remark)
        if first and common.change is not None:
            row |= _response(common, stage, solved, models)
        record = made(study, stage.base, solved)
    except (NumericsError, DataError) as error:
        return Made({}, {"trial": {"given": dict(given), "failed": True, "converged": False, "message": str(error)}})
    return replace(record, summary={**record.summary, "trial": row})


def _response(common: Setup, stage: Ready, solved: Solved, models: ModelOn) -> dict[str, Any]:
    """How the optimum follows the prescribed quantity, or why that is not known: the optimum itself stands."""
    assert common.change is not None
    try:
        return {"response": response(common.study, stage, solved, models, common.change), "no_response": ""}
    except (NumericsError, DataError) as error:
        return {"response": {}, "no_response": str(error)}


def _models(common: Setup) -> ModelOn:
    """The models that all trials share in this process."""
    assert common.shared is not None
    key = json_text({"config": common.keep.config, "shared": dict(common.shared.values)})
    if key not in _prepared:
        _prepared.clear()
        _prepared[key] = shared_models(model_on(common.stage.experiment, common.stage.settings), common.shared)
    return _prepared[key]


def shared_models(fresh: ModelOn, base: Parameters) -> ModelOn:
    """One model per mesh for all trials, prepared at `base` when first asked for: a one-way stage solves its mechanics once, there.

    All trials then minimise the same function, so that their optima can be compared.
    """
    models: dict[tuple[int, int, int], StageModel] = {}

    def model(size: MeshSize, _: Parameters) -> StageModel:
        key = (size.n_x, size.n_y, size.n_z)
        if key not in models:
            models[key] = replace(fresh(size, base), one_way=False)
        return models[key]

    return model


def trial_summary(given: Mapping[str, float], start: Parameters, solved: Solved, remark: str) -> dict[str, Any]:
    """One trial as plain numbers; `start` are the parameters that it started from.

    `curvature`: J^T J (n_p, n_p) at the optimum, half the Hessian of the objective by Gauss and Newton.
    """
    fit, spread = solved.fit, solved.covariance
    sigma = [None] * len(fit.names) if spread is None else [float(s) if np.isfinite(s) else None for s in spread.sigma]
    return {
        "given": dict(given),
        "failed": False,
        "converged": fit.converged,
        "start": {name: start[name] for name in fit.names},
        "optimum": dict(zip(fit.names, fit.x.tolist(), strict=True)),
        "sigma": dict(zip(fit.names, sigma, strict=True)),
        "at_bound": [name for name, at in zip(fit.names, fit.at_bound, strict=True) if at],
        "f": fit.f,
        "evaluations": dict(merged_counts(*solved.earlier, fit)),
        "message": "; ".join(part for part in (remark, fit.message, *solved.remarks) if part),
        "curvature": None if fit.jacobian is None else (fit.jacobian.T @ fit.jacobian).tolist(),
    }


def shown(trial: StageTrial) -> dict[str, Any]:
    """A trial as it stands in the record of its command."""
    return {key: value for key, value in trial.summary.items() if key not in ("curvature", "response", "no_response")}


def record_of(trial: StageTrial) -> Made:
    """The whole record of one trial, as that of an identification. ValueError where it failed."""
    record = trial.record
    if record is None:
        raise ValueError("a trial that failed has no record")
    summary = {key: value for key, value in record.summary.items() if key not in ("trial", "stage")}
    return Made({name: record[name] for name in record.names}, summary, record.parameters)


def total_counts(trials: Sequence[StageTrial]) -> dict[str, float]:
    """Forward runs, failed and replayed ones and wall time of all trials together."""
    return {name: sum(t.summary["evaluations"][name] for t in trials if not t.failed) for name in COUNTS}


def optima(trials: Sequence[StageTrial], names: Sequence[str]) -> np.ndarray:
    """Optimum of every trial (n_trials, n_p); nan in the rows of those that failed, which `failed` marks in the artefact."""
    rows = [[np.nan] * len(names) if t.failed else [t.summary["optimum"][name] for name in names] for t in trials]
    return np.array(rows, dtype=float).reshape(len(trials), len(names))


def trial_datasets(trials: Sequence[StageTrial], names: Sequence[str], group: str) -> dict[str, Dataset]:
    """Optimum, f and state of every trial as arrays of an artefact, one row per trial."""
    return {
        f"{group}/names": Dataset(np.array(names), "1", ("parameter",)),
        f"{group}/units": Dataset(np.array(units_of(names)), "1", ("parameter",)),
        f"{group}/optimum": of_parameters(optima(trials, names), ("trial", "parameter"), units_of(names)),
        f"{group}/f": Dataset(np.array([t.f for t in trials]), "1", ("trial",)),
        f"{group}/converged": Dataset(np.array([t.converged for t in trials]), "1", ("trial",)),
        f"{group}/failed": Dataset(np.array([t.failed for t in trials]), "1", ("trial",)),
    }
