"""The same stage with other measures of the displacement: their answers side by side (thesis Table 5.2)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.experiment.channels import field_of
from thermofit.experiment.protocol import Experiment
from thermofit.identify.solve import Solved, model_on, solve
from thermofit.records.staging import Job
from thermofit.study.stages import ChannelSettings, ElasticStage, RelativeDisplacement
from thermofit.study.study import Study

Widen = Callable[[Solved], tuple[Solved, str]]
"""Standard errors of a solved stage made honest, and a remark."""


def measure_of(settings: ElasticStage) -> str:
    """What a stage compares: "u", or the scheme of its relative displacements."""
    return settings.du.scheme if "du" in settings.channels else "u"


def answers(study: Study, settings: ElasticStage, first: Solved, experiment: Experiment, task: Job, widen: Widen) -> list[dict[str, Any]]:
    """One row for the stage itself and for every measure in `beside`: parameters, standard errors, K and G, rms of what is left."""
    rows = [_row(measure_of(settings), first)]
    for name in settings.beside:
        other = settings.model_copy(update=_compared(name))
        job = dataclasses.replace(task, stage=f"{task.stage}.{name}", config={**task.config, "beside": name})
        solved = solve(study, other, first.parameters, model_on(experiment, other), job, scalable=experiment.scalable)
        rows.append(_row(name, widen(solved)[0]))
    return rows


def _compared(name: str) -> dict[str, Any]:
    if name == "u":
        return {"channels": {"u": ChannelSettings()}}
    return {"channels": {"du": ChannelSettings()}, "du": RelativeDisplacement.model_validate({"scheme": name})}


def bulk_and_shear(parameters: Parameters) -> tuple[float, float]:
    """K = E / (3 (1 - 2 nu)) and G = E / (2 (1 + nu)) in MPa."""
    modulus, ratio = parameters["E"], parameters["nu"]
    return modulus / (3.0 * (1.0 - 2.0 * ratio)), modulus / (2.0 * (1.0 + ratio))


def _row(name: str, solved: Solved) -> dict[str, Any]:
    names = solved.fit.names
    sigma = np.full(len(names), np.nan) if solved.covariance is None else solved.covariance.sigma
    row: dict[str, Any] = {"measure": name}
    for index, free in enumerate(names):
        row[free] = float(solved.parameters[free])
        row[f"{free} +-"] = float(sigma[index]) if np.isfinite(sigma[index]) else None
    bulk, shear = bulk_and_shear(solved.parameters)
    row |= {"K GPa": 1e-3 * bulk, "G GPa": 1e-3 * shear}
    errors = solved.model.errors(solved.parameters)
    c = solved.model.comparisons[0]
    left = c.residual(errors[field_of(c)]) / np.sqrt(c.weight)
    return {**row, "rms": float(np.sqrt(np.mean(left**2))), "unit": c.unit, "times noise": float(np.sqrt(np.mean((left / c.sigma) ** 2)))}


def remark_of(rows: list[dict[str, Any]]) -> str:
    """The other answers in words, for those who see no table."""
    parts = []
    for row in rows:
        parts.append(f"{row['measure']}: E {1e-3 * row['E']:.1f} GPa, nu {row['nu']:.3f}, rms {row['rms']:.2g} {row['unit']}")
    return "side by side: " + "; ".join(parts)
