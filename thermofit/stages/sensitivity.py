"""`sensitivity`: how do the identified parameters react to a quantity that was prescribed (thesis 5.5.3.2, Tables 5.20, 5.21)?"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import is_known, param
from thermofit.experiment.fields import with_identified
from thermofit.experiment.held import thermal_names
from thermofit.experiment.several import own_names
from thermofit.identify.solve import discard_checkpoints
from thermofit.identify.stage import Ready, as_recorded, ready
from thermofit.identify.trials import Setup, StageTrial, optima, record_of, run_trials, setup, shown, total_counts, trial_datasets
from thermofit.identify.variation import nominal
from thermofit.records.artefact import Dataset
from thermofit.records.executor import SERIAL, Executor
from thermofit.records.staging import Job, Made, Outcome, job, produce
from thermofit.report.figures import drawn
from thermofit.report.figures_search import change_figure
from thermofit.study.search import CLOCK, THICKNESS, Sensitivity, weight_of
from thermofit.study.study import Study

NAME = "sensitivity"
FIGURE = "sensitivity-change"
STEP = 0.1
"""Step of a difference by the prescribed quantity, as a share of the largest change that the study asks about."""


def run(study: Study, *, force: bool = False, where: Executor = SERIAL) -> Outcome:
    """Record with the optimum for every prescribed value, its relative change against the nominal one, and the linearised answer beside.

    Every search starts from the optimum of the stage's artefact (StudyError names the command where it is missing); the nominal
    value is identified once more, so that all optima come from the same model. Where the stage is thermal and one-way and the
    quantity is thermal or a boundary temperature, the mechanics is solved once, at the nominal value: boundary temperatures reach
    it only through the thermal strain, of the order of 1e-5 per K. A value that fails is counted and named; a killed run resumes. The
    values run where the executor says.
    """
    settings = study.sensitivity
    if settings is None:
        raise StudyError(f"{study.source.name}: key 'sensitivity' is missing: add its stage, quantity and values, see `thermofit new`")
    if study.fitted and settings.quantity in own_names(study):
        raise StudyError(
            f"{study.source.name}: key 'sensitivity.quantity' is {settings.quantity}, which every experiment has for itself; name "
            f"one of them, such as {settings.quantity}@{study.fitted[0]}"
        )
    stage = _warm(study, settings)
    begin = nominal(study, stage, settings.quantity)
    task = job(study.run_dir, NAME, {**stage.config, **study.config_of("sensitivity")}, stage.inputs)
    outcome = produce(task, lambda: _make(study, stage, begin, task, where), force=force)
    discard_checkpoints(task)
    drawn(study.run_dir, {FIGURE: lambda: change_figure(outcome.record)}, anew=not outcome.fresh)
    return outcome


def _warm(study: Study, settings: Sensitivity) -> Ready:
    """The stage with its identified optimum as the start."""
    stage = ready(study, settings.stage)
    optimum, found = with_identified(study, stage.base, (f"identify-{settings.stage}",))
    return dataclasses.replace(
        as_recorded(study, stage, settings.stage), base=optimum.with_free(stage.settings.free), inputs={**stage.inputs, **found}
    )


def _make(study: Study, stage: Ready, begin: float, task: Job, where: Executor) -> Made:
    settings = study.sensitivity
    assert settings is not None
    values = (begin, *settings.values)
    givens = [given_values(study, settings.quantity, value) for value in values]
    trials = run_trials(_setup(study, stage, task, values), givens, [str(number) for number in range(len(values))], where)
    return _made(study, stage, settings.quantity, trials)


def _setup(study: Study, stage: Ready, task: Job, values: Sequence[float]) -> Setup:
    """Trials that start from the optimum: a detour over the coarse mesh would only lead away from it."""
    settings = study.sensitivity
    assert settings is not None
    direct = study.model_copy(update={"numerics": study.numerics.model_copy(update={"coarse_start": False})})
    shared = stage.base if _thermal_only(stage, settings.quantity) else None
    largest = max(abs(value - values[0]) for value in values)
    direction = dict.fromkeys(given_values(study, settings.quantity, values[0]), 1.0)
    step = STEP * largest if largest > 0.0 else 1e-3 * max(abs(values[0]), 1.0)
    return setup(direct, stage, task, shared, (settings.quantity, direction, step))


def _thermal_only(stage: Ready, quantity: str) -> bool:
    """True where neither the quantity nor a free parameter reaches the mechanics of a one-way stage."""
    reaches = (is_known(quantity) and quantity not in thermal_names()) or quantity in (THICKNESS, CLOCK)
    return stage.settings.coupling == "one-way" and not reaches and set(stage.settings.free) <= thermal_names()


def given_values(study: Study, quantity: str, value: float) -> dict[str, float]:
    """The prescribed value; the specimen rests in the jaws, so that theta_ref follows theta_clamp where the study gives none."""
    follows = quantity == "theta_clamp" and "theta_ref" not in study.parameters
    return {quantity: value, **({"theta_ref": value} if follows else {})}


def unit_of(quantity: str) -> str:
    """Unit of what can be prescribed."""
    if is_known(quantity):
        return param(quantity).unit
    weight = weight_of(quantity)
    if weight is not None:
        return "1/mm^2" if weight[1] else "1"
    return {THICKNESS: "mm", CLOCK: "s"}[quantity]


def _made(study: Study, stage: Ready, quantity: str, trials: list[StageTrial]) -> Made:
    first, others = trials[0], trials[1:]
    if first.failed:
        raise NumericsError(f"sensitivity: the stage fails at its own optimum: {first.summary['message']}")
    names = stage.settings.free
    values = np.array([t.given[quantity] for t in trials])
    change = relative_change(optima(trials, names))
    largest = {name: float(np.nan_to_num(np.abs(change[1:, i])).max(initial=0.0)) for i, name in enumerate(names)}
    linear = linearised(first.summary["response"], first.summary["optimum"], values)
    rows = [shown(t) for t in trials]
    table = []
    for index, row in enumerate(rows):
        row["value"] = row["given"][quantity]
        row["change"] = None if row["failed"] else dict(zip(names, change[index].tolist(), strict=True))
        row["linearised_change"] = {name: slope * (values[index] - values[0]) for name, slope in linear["relative_slope"].items()}
        for answer, of in (("identified", row["change"]), ("linearised", row["linearised_change"])):
            line = {"answer": answer, quantity: row["value"]}
            table.append({**line, **{f"{name} %": 100.0 * share for name, share in (of or {}).items()}})
    record = record_of(first)
    summary = {
        **record.summary,
        "verdict": sensitivity_verdict(quantity, values.tolist(), largest) + _losses(quantity, others),
        "trustworthy": all(t.converged for t in trials),
        "remarks": [*record.summary["remarks"], *([f"no linearised answer: {why}"] if (why := first.summary["no_response"]) else [])],
        "quantity": quantity,
        "unit": unit_of(quantity),
        "nominal": rows[0],
        "values": rows[1:],
        "changes": table,
        "largest_change": largest,
        "linearised": linear,
        "evaluations": total_counts(trials),
        "figures": {FIGURE: str(study.run_dir / "figures" / f"{FIGURE}.png")},
    }
    datasets: dict[str, Dataset] = {
        **record.datasets,
        **trial_datasets(trials, names, "values"),
        "values/value": Dataset(values, unit_of(quantity), ("trial",)),
        "values/change": Dataset(change, "1", ("trial", "parameter")),
    }
    return Made(datasets, summary, record.parameters)


def linearised(slope: Mapping[str, float], optimum: Mapping[str, float], values: np.ndarray) -> dict[str, Any]:
    """The answer of the sensitivities at the nominal value values[0]: dp/dq, d(p/p_0)/dq, and the largest relative change over the values.

    A parameter that is zero at the optimum has no relative change.
    """
    relative = {name: s / abs(optimum[name]) for name, s in slope.items() if optimum[name] != 0.0}
    reach = float(np.max(np.abs(values - values[0])))
    return {"slope": dict(slope), "relative_slope": relative, "largest_change": {name: abs(s) * reach for name, s in relative.items()}}


def relative_change(x: np.ndarray) -> np.ndarray:
    """(x - x_0)/|x_0| (n, n_p) of the rows of x against the first one; where that is zero, over the largest magnitude of the column."""
    size = np.where(x[0] != 0.0, np.abs(x[0]), np.nanmax(np.abs(x), axis=0))
    return np.divide(x - x[0], size, out=np.zeros_like(x), where=size > 0.0)


def sensitivity_verdict(quantity: str, values: Sequence[float], largest: dict[str, float]) -> str:
    """Which parameters react most and least to the values (the first is the nominal one)."""
    unit = "" if unit_of(quantity) == "1" else f" {unit_of(quantity)}"
    order = sorted(largest, key=lambda name: -largest[name])
    span = f"{quantity} from {min(values):.6g} to {max(values):.6g}{unit} (nominal {values[0]:.6g})"
    most = f"{order[0]} reacts most, by up to {100.0 * largest[order[0]]:.2g} %"
    if len(order) == 1:
        return f"{span}: {most}"
    return f"{span}: {most}; {order[-1]} least, by up to {100.0 * largest[order[-1]]:.2g} %"


def _losses(quantity: str, trials: Sequence[StageTrial]) -> str:
    """The values without an optimum, by name."""
    lost: dict[str, Any] = {
        "failed": [t.given[quantity] for t in trials if t.failed],
        "did not converge": [t.given[quantity] for t in trials if not t.failed and not t.converged],
    }
    parts = [f"{len(values)} {what} ({', '.join(f'{v:.6g}' for v in values)})" for what, values in lost.items() if values]
    return f"; {'; '.join(parts)}" if parts else ""
