"""What a stage reports: parameters with standard errors, channels against the noise floor, the log of evaluations, a verdict."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from thermofit.core.parameters import Parameters, param, physical_bounds, units_of
from thermofit.experiment.fields import field_datasets
from thermofit.experiment.model import StageModel
from thermofit.experiment.prediction import Errors
from thermofit.experiment.prescribed import counted_as_exact
from thermofit.fit.budget import Budget
from thermofit.identify.budget import budget_datasets, budget_summary
from thermofit.identify.solve import Solved, merged_counts
from thermofit.records.artefact import Dataset, ParameterResult, of_parameters
from thermofit.records.staging import Made, sorted_out
from thermofit.study.study import Study

MISFIT = 1.5
"""Error of a channel over its noise above which a fit is remarked on; the same limit as that of `verify`."""


def parameter_results(study: Study, start: Parameters, solved: Solved) -> dict[str, ParameterResult]:
    """Every parameter by name; sigma, at_bound and the study's bounds where it was free, else the physical bounds: the stage reads none."""
    free = solved.fit.names
    noise = None if solved.covariance is None else solved.covariance.sigma
    sigma = noise if solved.budget is None else solved.budget.sigma
    results = {}
    for name in solved.parameters.given():
        is_free = name in free
        low, high = study.bounds(name) if is_free else physical_bounds(name)
        index = free.index(name) if is_free else -1
        both = [None if s is None or not is_free or not np.isfinite(s[index]) else float(s[index]) for s in (sigma, noise)]
        results[name] = ParameterResult(
            value=solved.parameters[name],
            sigma=both[0],
            sigma_noise=both[1],
            unit=param(name).unit,
            free=is_free,
            at_bound=bool(is_free and solved.fit.at_bound[index]),
            start=start[name],
            lower=low,
            upper=high,
        )
    return results


def channel_table(model: StageModel, errors: Errors) -> dict[str, dict[str, Any]]:
    """Per channel: number, rms of the compared error, its unit, reduced chi-square and the rms that noise alone would give."""
    table = {}
    for c, r in zip(model.comparisons, model.parts(errors), strict=True):
        used = c.weight > 0.0
        physical = r[used] / np.sqrt(c.weight[used])
        table[c.channel] = {
            "n": c.n,
            "rms": float(np.sqrt(np.mean(physical**2))),
            "unit": c.unit,
            "chi2_reduced": float(np.mean((physical / c.sigma[used]) ** 2)),
            "floor_rms": float(np.sqrt(np.mean(c.sigma[used] ** 2))),
        }
    return table


def verdict(solved: Solved, channels: Mapping[str, Mapping[str, Any]]) -> tuple[str, bool]:
    """One line for the user, and whether the answer can be trusted."""
    fit = solved.fit
    doubts = [] if fit.converged else [f"not converged: {fit.message}"]
    doubts += [f"{name} is at its bound" for name, at in zip(fit.names, fit.at_bound, strict=True) if at]
    if solved.covariance is None:
        doubts += list(solved.remarks)
    elif not solved.covariance.identifiable:
        doubts.append("not identifiable: " + "; ".join(" ~ ".join(direction.names) for direction in solved.covariance.null))
    errors = ", ".join(f"{name} rms {c['rms']:.3g} {c['unit']} (noise {c['floor_rms']:.3g})" for name, c in channels.items())
    if doubts:
        return f"not trustworthy: {'; '.join(doubts)}; {errors}", False
    return f"identified {', '.join(fit.names)}; {errors}", True


def misfits(channels: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    """A remark for every channel whose error is far above its noise: the standard errors then say little about the parameters."""
    return tuple(
        f"{name} is left at {np.sqrt(c['chi2_reduced']):.3g} times its noise: model or choice of channel does not explain the data"
        for name, c in channels.items()
        if c["chi2_reduced"] > MISFIT**2
    )


def made(study: Study, start: Parameters, solved: Solved, remarks: tuple[str, ...] = ()) -> Made:
    """The record of an identification stage."""
    errors = solved.model.errors(solved.parameters)
    channels = channel_table(solved.model, errors)
    line, trustworthy = verdict(solved, channels)
    counts = merged_counts(*solved.earlier, solved.fit)
    fit = solved.fit
    datasets = {
        "evaluations/x": of_parameters(
            np.array([e.x for e in fit.log]).reshape(-1, len(fit.names)), ("evaluation", "parameter"), units_of(fit.names)
        ),
        "evaluations/f": Dataset(np.array([np.nan if e.failed else e.f for e in fit.log]), "1", ("evaluation",)),
        "evaluations/failed": Dataset(np.array([e.failed for e in fit.log]), "1", ("evaluation",)),
        "evaluations/seconds": Dataset(np.array([e.seconds for e in fit.log]), "s", ("evaluation",)),
        "evaluations/purpose": Dataset(np.array([str(e.purpose) for e in fit.log]), "1", ("evaluation",)),
        "evaluations/names": Dataset(np.array(fit.names), "1", ("parameter",)),
        **_matrices(solved),
        **budget_datasets(solved.budget),
        **_fields(solved.model, errors),
    }
    summary = {
        "verdict": line,
        "trustworthy": trustworthy,
        "objective": fit.f,
        "method": fit.method,
        "converged": bool(fit.converged),
        "algorithm": fit.algorithm,
        "channels": channels,
        "evaluations": counts,
        **({} if solved.budget is None else _budget(study, solved, solved.budget)),
        **sorted_out((*remarks, solved.model.remark, *solved.remarks, *misfits(channels))),
    }
    return Made(datasets, summary, parameter_results(study, start, solved))


def _budget(study: Study, solved: Solved, budget: Budget) -> dict[str, Any]:
    """`budget_summary`, and `exact`: keys of `uncertainty` that are not stated, so that what they stand for counts as exact."""
    channels, records = [c.channel for c in solved.model.comparisons], solved.model.segments is not None
    exact = counted_as_exact(study, channels, solved.fit.names, records=records)
    return {**budget_summary(budget), "exact": list(exact)}


def nothing_identified(base: Parameters, remarks: tuple[str, ...]) -> Made:
    """The record of an identification stage that has nothing to identify: all parameters as they were, and the remarks say why."""
    results = {
        name: ParameterResult(
            value=base[name],
            sigma=None,
            unit=param(name).unit,
            free=False,
            at_bound=False,
            start=base[name],
            lower=physical_bounds(name)[0],
            upper=physical_bounds(name)[1],
        )
        for name in base.given()
    }
    summary = {
        "verdict": f"nothing to identify: {remarks[0]}",
        "trustworthy": True,
        "converged": True,
        "channels": {},
        "evaluations": merged_counts(),
        **sorted_out(remarks[1:]),
    }
    return Made({}, summary, results)


def _matrices(solved: Solved) -> dict[str, Dataset]:
    if solved.covariance is None:
        return {}
    dims, spread = ("parameter", "parameter"), solved.covariance
    units = units_of(spread.names)
    return {
        "covariance": of_parameters(spread.matrix if solved.budget is None else solved.budget.covariance, dims, units),
        "covariance_noise": of_parameters(spread.matrix, dims, units),
        "correlation": Dataset(spread.correlation_parameters, "1", dims),
        "correlation_sensitivity": Dataset(spread.correlation_sensitivity, "1", dims),
    }


def _fields(model: StageModel, errors: Errors) -> dict[str, Dataset]:
    out: dict[str, Dataset] = {}
    for name, observation in model.observations.items():
        out.update(field_datasets(observation))
        out[f"{name}/predicted"] = Dataset(errors[name] + observation.value, observation.unit, ("time", "point", "component"))
    return out
