"""The same stage solved many times, from other starts or with other prescribed values; one that fails does not stop the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from thermofit.core.artefact import Dataset
from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.core.staging import Job
from thermofit.core.study import Study
from thermofit.core.study_section import MeshSize
from thermofit.fit.result import FitResult
from thermofit.identify.model import StageModel
from thermofit.identify.several import feasible, spread
from thermofit.identify.solve import ModelOn, Solved, merged_counts, solve
from thermofit.identify.stage import Ready


@dataclass(frozen=True)
class Trial:
    """One solution of a stage: what was `given` for it (by name), and what came out or why nothing did (`failure`)."""

    given: Mapping[str, float]
    solved: Solved | None
    failure: str
    remark: str = ""

    @property
    def fit(self) -> FitResult | None:
        """The fit on the final mesh."""
        return None if self.solved is None else self.solved.fit

    @property
    def converged(self) -> bool:
        """True where the search ended at a minimum."""
        return self.solved is not None and self.solved.fit.converged


def shared_models(model_on: ModelOn, base: Parameters) -> ModelOn:
    """One model per mesh for all trials, prepared at `base` when first asked for: a one-way stage solves its mechanics once, there.

    All trials then minimise the same function, so that their optima can be compared.
    """
    models: dict[tuple[int, int, int], StageModel] = {}

    def model(size: MeshSize, _: Parameters) -> StageModel:
        key = (size.n_x, size.n_y, size.n_z)
        if key not in models:
            models[key] = replace(model_on(size, base), one_way=False)
        return models[key]

    return model


def trial_job(task: Job, stage: Ready, label: str) -> Job:
    """Where the evaluations of one trial are kept: beside those of the others, and gone with them when the artefact is written."""
    return Job(f"{task.stage}.{label}", task.path, stage.config, stage.inputs)


def attempt(study: Study, stage: Ready, model_on: ModelOn, given: Mapping[str, float], kept: Job) -> Trial:
    """Solve the stage with the given values over those of the study; a NumericsError becomes the trial's failure."""
    base = stage.base.replace(**spread(given, stage.data))
    try:
        start, remark = feasible(study, stage.data, base)
        return Trial(given, solve(study, stage.settings, start, model_on, kept), "", remark)
    except NumericsError as error:
        return Trial(given, None, str(error))


def trial_summary(trial: Trial, start: Parameters) -> dict[str, Any]:
    """One trial as plain numbers; `start` are the parameters that it started from."""
    if trial.solved is None:
        return {"given": dict(trial.given), "failed": True, "converged": False, "message": trial.failure}
    solved = trial.solved
    fit, spread = solved.fit, solved.covariance
    sigma = [None] * len(fit.names) if spread is None else [float(s) if np.isfinite(s) else None for s in spread.sigma]
    return {
        "given": dict(trial.given),
        "failed": False,
        "converged": fit.converged,
        "start": {name: start[name] for name in fit.names},
        "optimum": dict(zip(fit.names, fit.x.tolist(), strict=True)),
        "sigma": dict(zip(fit.names, sigma, strict=True)),
        "at_bound": [name for name, at in zip(fit.names, fit.at_bound, strict=True) if at],
        "f": fit.f,
        "evaluations": merged_counts(*solved.earlier, fit),
        "message": "; ".join(part for part in (trial.remark, fit.message, *solved.remarks) if part),
    }


def total_counts(trials: Sequence[Trial]) -> Mapping[str, float]:
    """Forward runs, failed and replayed ones and wall time of all trials together."""
    return merged_counts(*(fit for t in trials if t.solved is not None for fit in (*t.solved.earlier, t.solved.fit)))


def optima(trials: Sequence[Trial], names: Sequence[str]) -> np.ndarray:
    """Optimum of every trial (n_trials, n_p); nan in the rows of those that failed, which `failed` marks in the artefact."""
    return np.array([np.full(len(names), np.nan) if t.fit is None else t.fit.x for t in trials]).reshape(len(trials), len(names))


def objectives(trials: Sequence[Trial]) -> np.ndarray:
    """f (n_trials,) of every trial; nan where it failed."""
    return np.array([np.nan if t.fit is None else t.fit.f for t in trials])


def trial_datasets(trials: Sequence[Trial], names: Sequence[str], group: str) -> dict[str, Dataset]:
    """Optimum, f and state of every trial as arrays of an artefact, one row per trial."""
    return {
        f"{group}/names": Dataset(np.array(names), "1", ("parameter",)),
        f"{group}/units": Dataset(np.array([param(name).unit for name in names]), "1", ("parameter",)),
        f"{group}/optimum": Dataset(optima(trials, names), "1", ("trial", "parameter")),
        f"{group}/f": Dataset(objectives(trials), "1", ("trial",)),
        f"{group}/converged": Dataset(np.array([t.converged for t in trials]), "1", ("trial",)),
        f"{group}/failed": Dataset(np.array([t.solved is None for t in trials]), "1", ("trial",)),
    }
