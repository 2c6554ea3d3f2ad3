"""`sensitivity`: how do the identified parameters react to a quantity that was prescribed (thesis 5.5.3.2, Tables 5.20, 5.21)?"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from thermofit.core.artefact import Dataset
from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.jit import set_threads
from thermofit.core.parameters import param
from thermofit.core.progress import progress
from thermofit.core.staging import Job, Made, Outcome, job, produce
from thermofit.core.study import Study
from thermofit.core.study_models import Sensitivity
from thermofit.identify.held import thermal_names
from thermofit.identify.inputs import with_identified
from thermofit.identify.outcome import made
from thermofit.identify.several import own_names
from thermofit.identify.solve import discard_checkpoints
from thermofit.identify.stage import Ready, model_maker, ready
from thermofit.identify.trials import Trial, attempt, optima, shared_models, total_counts, trial_datasets, trial_job, trial_summary

NAME = "sensitivity"


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record with the optimum for every prescribed value and its relative change against the nominal one.

    Every search starts from the optimum of the stage's artefact (StudyError names the command where it is missing); the nominal
    value is identified once more, so that all optima come from the same model. Where the stage is thermal and one-way and the
    quantity is thermal or a boundary temperature, the mechanics is solved once, at the nominal value: boundary temperatures reach
    it only through the thermal strain, of the order of 1e-5 per K. A value that fails is counted and named; a killed run resumes.
    """
    if study.sensitivity is None:
        raise StudyError(f"{study.source.name}: key 'sensitivity' is missing: add its stage, quantity and values, see `thermofit new`")
    if study.fitted and study.sensitivity.quantity in own_names(study):
        raise StudyError(
            f"{study.source.name}: key 'sensitivity.quantity' is {study.sensitivity.quantity}, which every experiment has for itself; name "
            f"one of them, such as {study.sensitivity.quantity}@{study.fitted[0]}"
        )
    stage = _warm(study, study.sensitivity)
    task = job(study.run_dir, NAME, {**stage.config, **study.config_of("sensitivity")}, stage.inputs)
    outcome = produce(task, lambda: _make(study, stage, task), force=force)
    discard_checkpoints(task)
    return outcome


def _warm(study: Study, settings: Sensitivity) -> Ready:
    """The stage with its identified optimum as the start."""
    stage = ready(study, settings.stage)
    optimum, found = with_identified(study, stage.base, (f"identify-{settings.stage}",))
    return dataclasses.replace(stage, base=optimum.with_free(stage.settings.free), inputs={**stage.inputs, **found})


def _make(study: Study, stage: Ready, task: Job) -> Made:
    settings = study.sensitivity
    assert settings is not None
    set_threads(study.numerics.threads)
    # The start is the optimum already: a detour over the coarse mesh would only lead away from it.
    direct = study.model_copy(update={"numerics": study.numerics.model_copy(update={"coarse_start": False})})
    make_model = model_maker(direct, stage.settings, stage.data)
    shared = shared_models(make_model, stage.base)
    models = shared if _thermal_only(stage, settings.quantity) else make_model
    nominal = stage.base[settings.quantity]
    trials: list[Trial] = []
    with progress(NAME, 1 + len(settings.values)) as advance:
        for number, value in enumerate((nominal, *settings.values)):
            kept = trial_job(task, stage, str(number))
            trials.append(attempt(direct, stage, models, _given(study, settings.quantity, value), kept))
            advance(1, trials[-1].failure)
    return _made(study, stage, settings.quantity, trials)


def _thermal_only(stage: Ready, quantity: str) -> bool:
    """True where neither the quantity nor a free parameter reaches the mechanics of a one-way stage."""
    return stage.settings.coupling == "one-way" and {quantity, *stage.settings.free} <= thermal_names()


def _given(study: Study, quantity: str, value: float) -> dict[str, float]:
    """The prescribed value; the specimen rests in the jaws, so that theta_ref follows theta_clamp where the study gives none."""
    follows = quantity == "theta_clamp" and "theta_ref" not in study.parameters
    return {quantity: value, **({"theta_ref": value} if follows else {})}


def _made(study: Study, stage: Ready, quantity: str, trials: list[Trial]) -> Made:
    nominal, others = trials[0], trials[1:]
    if nominal.solved is None:
        raise NumericsError(f"sensitivity: the stage fails at its own optimum: {nominal.failure}")
    names = stage.settings.free
    change = relative_change(optima(trials, names))
    largest = {name: float(np.nan_to_num(np.abs(change[1:, i])).max(initial=0.0)) for i, name in enumerate(names)}
    record = made(study, stage.base, nominal.solved)
    rows = [trial_summary(t, stage.base.replace(**t.given)) for t in trials]
    for row, values in zip(rows, change, strict=True):
        row |= {"value": row["given"][quantity], "change": None if row["failed"] else dict(zip(names, values.tolist(), strict=True))}
    summary = {
        **record.summary,
        "verdict": sensitivity_verdict(quantity, [t.given[quantity] for t in trials], largest) + _losses(quantity, others),
        "trustworthy": all(t.converged for t in trials),
        "quantity": quantity,
        "nominal": rows[0],
        "values": rows[1:],
        "largest_change": largest,
        "evaluations": total_counts(trials),
    }
    values = np.array([t.given[quantity] for t in trials])
    datasets: dict[str, Dataset] = {
        **record.datasets,
        **trial_datasets(trials, names, "values"),
        "values/value": Dataset(values, param(quantity).unit, ("trial",)),
        "values/change": Dataset(change, "1", ("trial", "parameter")),
    }
    return Made(datasets, summary, record.parameters)


def relative_change(x: np.ndarray) -> np.ndarray:
    """(x - x_0)/|x_0| (n, n_p) of the rows of x against the first one; where that is zero, over the largest magnitude of the column."""
    size = np.where(x[0] != 0.0, np.abs(x[0]), np.nanmax(np.abs(x), axis=0))
    return np.divide(x - x[0], size, out=np.zeros_like(x), where=size > 0.0)


def sensitivity_verdict(quantity: str, values: Sequence[float], largest: dict[str, float]) -> str:
    """Which parameters react most and least to the values (the first is the nominal one)."""
    unit = "" if param(quantity).unit == "1" else f" {param(quantity).unit}"
    order = sorted(largest, key=lambda name: -largest[name])
    span = f"{quantity} from {min(values):.6g} to {max(values):.6g}{unit} (nominal {values[0]:.6g})"
    most = f"{order[0]} reacts most, by up to {100.0 * largest[order[0]]:.2g} %"
    if len(order) == 1:
        return f"{span}: {most}"
    return f"{span}: {most}; {order[-1]} least, by up to {100.0 * largest[order[-1]]:.2g} %"


def _losses(quantity: str, trials: Sequence[Trial]) -> str:
    """The values without an optimum, by name."""
    lost: dict[str, Any] = {
        "failed": [t.given[quantity] for t in trials if t.solved is None],
        "did not converge": [t.given[quantity] for t in trials if t.solved is not None and not t.converged],
    }
    parts = [f"{len(values)} {what} ({', '.join(f'{v:.6g}' for v in values)})" for what, values in lost.items() if values]
    return f"; {'; '.join(parts)}" if parts else ""
