"""Intervals of the parameters of a linearised stage by four ways: Laplace, block bootstrap, profile, Markov chain.

What costs forward runs goes through one executor, one task for each side of a profile and for each few repeats of a full bootstrap; every
finished task and every evaluation of one that is not finished is kept on disk, so that a killed run goes on where it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import norm, t

from thermofit.fit.bootstrap import (
    Blocks,
    drawn_residual,
    effective_blocks,
    linearised_repeats,
    percentile_interval,
    require_blocks,
)
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.memory import memories
from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.fit.profile import Optimum, Side, profile_side
from thermofit.fit.settings import Hooks, Settings
from thermofit.identify.blocks import residual_blocks
from thermofit.identify.identifiability import Analysis
from thermofit.identify.linear import Linear
from thermofit.identify.solve import DIFFERENCE_STEP, stage_problem
from thermofit.identify.subject import Subject, linear_subject, prepared
from thermofit.identify.variables import FitVariables
from thermofit.records.checkpoint import Checkpoint
from thermofit.records.executor import Executor, Task, run_all
from thermofit.records.progress import progress

LEVEL = 0.95
F_TOLERANCE = 1e-3
_CHUNK = 5
"""Full refits in one task."""


@dataclass(frozen=True)
class Interval:
    """`low` to `high` at the level of 95 %; `open_low`, `open_high` where a bound, not the data, ends it; `remark` for the user."""

    low: float
    high: float
    open_low: bool = False
    open_high: bool = False
    remark: str = ""


@dataclass(frozen=True)
class KeptEvaluations:
    """Where evaluations of an analysis are kept: folder, and the key of all that they depend on."""

    folder: Path
    key: str

    def store(self, label: str = "done") -> Checkpoint:
        """Checkpoint of one part of the work."""
        return Checkpoint(self.folder / label, self.key)


def half_width(linear: Linear, analysis: Analysis) -> float:
    """Half width of an interval in standard errors: normal before a test, else Student's; where the memory of records was estimated from
    the residual itself, the critical value of Kiefer and Vogelsang (Econometric Theory 21, 2005, table 1, Bartlett, 97.5 %), which knows
    that this estimate is uncertain and too small."""
    if linear.before:
        return float(norm.ppf(0.5 * (1.0 + LEVEL)))
    plain = float(t.ppf(0.5 * (1.0 + LEVEL), max(analysis.covariance.degrees_of_freedom, 1.0)))
    if linear.model.segments is None:
        return plain
    found = memories(linear.error[: sum(linear.model.segments)], linear.model.segments)
    n = sum(memory.n for memory in found)
    share = sum(memory.n * len(memory.correlation) for memory in found) / n**2
    return max(plain, float(np.polynomial.polynomial.polyval(min(share, 1.0), (1.96, 2.9694, 0.4160, -0.5324))))


def laplace(linear: Linear, analysis: Analysis) -> dict[str, Interval]:
    """x +- t sigma, with the honest covariance; open where the data do not give the parameter, or where a bound cuts it off."""
    out = {}
    for i, name in enumerate(linear.names):
        half = half_width(linear, analysis) * float(analysis.sigma[i])
        low, high = max(linear.x[i] - half, linear.lower[i]), min(linear.x[i] + half, linear.upper[i])
        out[name] = Interval(float(low), float(high), low > linear.x[i] - half, high < linear.x[i] + half)
    return out


def bootstrap(linear: Linear, repeats: int, seed: int) -> tuple[dict[str, Interval], np.ndarray, Blocks]:
    """Intervals, optima (repeats, n_p) and blocks of a bootstrap with the Jacobian at hand. UntrustworthyError for too few blocks."""
    blocks = residual_blocks(linear.model, linear.residual)
    kept = np.flatnonzero(~linear.at_bound)
    x = np.tile(linear.x, (repeats, 1))
    x[:, kept] += linearised_repeats(linear.inside, blocks, seed=seed, count=repeats)
    return _percentiles(linear, x, blocks), x, blocks


def _percentiles(linear: Linear, x: np.ndarray, blocks: Blocks) -> dict[str, Interval]:
    """Percentiles of the optima, widened as Student's t is for as few blocks as a parameter rests on."""
    kept = np.flatnonzero(~linear.at_bound)
    count = np.full(len(linear.names), float(blocks.count))
    count[kept] = effective_blocks(linear.jacobian[:, kept], blocks)
    wide = t.ppf(0.5 * (1.0 + LEVEL), np.maximum(count - 1.0, 1.0)) / norm.ppf(0.5 * (1.0 + LEVEL))
    out = {}
    for i, name in enumerate(linear.names):
        low, high = percentile_interval(linear.x[i] + float(wide[i]) * (x[:, i] - linear.x[i]), LEVEL)
        low, high = max(low, float(linear.lower[i])), min(high, float(linear.upper[i]))
        out[name] = Interval(low, high, low <= linear.lower[i], high >= linear.upper[i])
    return out


def full_bootstrap(
    subject: Subject, linear: Linear, count: int, seed: int, kept: KeptEvaluations, where: Executor
) -> tuple[dict[str, Interval], np.ndarray, Blocks]:
    """The same with every repeat fitted anew. UntrustworthyError for too few blocks."""
    blocks = residual_blocks(linear.model, linear.residual)
    require_blocks(blocks)
    chunks = [tuple(range(first, min(first + _CHUNK, count))) for first in range(0, count, _CHUNK)]
    tasks = [Task(f"repeats {c[0] + 1} to {c[-1] + 1}", refit_task, (subject, kept, seed, c)) for c in chunks]
    with progress("bootstrap", count) as advance:
        x = np.concatenate(run_all(tasks, where, lambda index, _: advance(len(chunks[index]))))
    return _percentiles(linear, x, blocks), x, blocks


def refit_task(subject: Subject, kept: KeptEvaluations, seed: int, numbers: tuple[int, ...]) -> np.ndarray:
    """Optima (n, n_p) of some repeats of a full bootstrap."""
    done = kept.store()
    linear = linear_subject(subject, kept.store("linear"))
    blocks = residual_blocks(linear.model, linear.residual)
    outside = linear.inside.outside(blocks.label)
    out = []
    for number in numbers:
        key = np.array([1.0, float(seed), float(number)])
        found = done.get(key)
        if found is None:
            drawn = drawn_residual(outside, blocks, seed, number)
            problem, change, _ = fit_problem(subject, linear, linear.residual - drawn)
            mine = kept.store(f"repeat-{number}")
            fit = minimise(problem, "least-squares", _settings(subject), Hooks(store=mine))
            found = {"optimum": change.parameters(fit.x)}
            done.put(key, **found)
            mine.discard()
        out.append(found["optimum"])
    return np.array(out)


def profiles(
    subject: Subject, linear: Linear, analysis: Analysis, kept: KeptEvaluations, where: Executor
) -> tuple[dict[str, Interval], dict[str, np.ndarray]]:
    """Profile intervals, and per parameter the points (m, 2) of its profile: value, and rise of f in units of s2 and its inflation."""
    rises = allowed_rises(linear, analysis)
    sides = [(i, sign) for i in range(len(linear.names)) for sign in (-1, 1)]
    tasks = [Task(f"profile of {linear.names[i]}", profile_task, (subject, kept, (i, sign), float(rises[i]))) for i, sign in sides]
    with progress("profile", len(sides)) as advance:
        found = run_all(tasks, where, lambda index, side: advance(1, linear.names[sides[index][0]]))
    out, curves = {}, {}
    level = half_width(linear, analysis) ** 2
    for i, name in enumerate(linear.names):
        ends = sorted((found[2 * i], found[2 * i + 1]), key=lambda side: side[0])
        (low, open_low, words_low, points_low), (high, open_high, words_high, points_high) = ends
        said = "; ".join(dict.fromkeys(words for words in (words_low, words_high) if words))
        out[name] = Interval(low, high, open_low, open_high, said)
        points = np.concatenate([points_low, points_high, [[linear.x[i], 0.0]]])
        points[:, 1] *= level / rises[i]
        curves[name] = points[np.argsort(points[:, 0])]
    return out, curves


def allowed_rises(linear: Linear, analysis: Analysis) -> np.ndarray:
    """Rise of f (n_p,) at the end of each interval: t^2 times the variance of an independent error, which is that of the residual times
    what its correlation adds to the variance of this parameter."""
    ratio = np.full(len(linear.names), np.nan)
    free = np.flatnonzero(~linear.at_bound)
    scaled = linear.jacobian * linear.size
    for i in range(len(ratio)):
        left = LinearModel(scaled[:, i], scaled[:, [k for k in free if k != i]]).left
        whole = float(np.linalg.norm(scaled[:, i]))
        if np.isfinite(analysis.sigma[i]) and float(np.linalg.norm(left)) > 1e-7 * whole:
            ratio[i] = (analysis.sigma[i] / linear.size[i]) ** 2 * float(left @ left)
    known = ratio[np.isfinite(ratio)]
    ratio[~np.isfinite(ratio)] = float(np.median(known)) if known.size else analysis.s2
    return np.asarray(half_width(linear, analysis) ** 2 * ratio)


Answer = tuple[float, bool, str, np.ndarray]


def profile_task(subject: Subject, kept: KeptEvaluations, at: tuple[int, int], rise: float) -> Answer:
    """End, whether it is open, remark, and points (m, 2) of value and rise of one side of a profile, in terms of the parameter itself."""
    done = kept.store()
    i, sign = at
    key = np.array([2.0, float(i), float(sign), rise])
    found = done.get(key)
    if found is None:
        linear = linear_subject(subject, kept.store("linear"))
        problem, change, y = fit_problem(subject, linear, linear.residual if linear.before else None)
        mine = kept.store(f"side-{i}{'+' if sign > 0 else '-'}")
        f = 0.0 if linear.before else float(linear.residual @ linear.residual)
        optimum = Optimum(y, f, change.by_variables(linear.jacobian, linear.x))
        side = profile_side(problem, optimum, at, rise, _settings(subject), mine)
        found = _in_parameters(side, change, i, f, y)
        done.put(key, **found)
        mine.discard()
    return float(found["end"]), bool(found["open"]), str(found["remark"]), found["points"]


def _in_parameters(side: Side, change: FitVariables, i: int, f: float, y: np.ndarray) -> dict[str, np.ndarray]:
    """A side in terms of the parameter: end and points (m, 2)."""

    def parameter(value: float) -> float:
        at = y.copy()
        at[i] = value
        return float(change.parameters(at)[i])

    points = np.array([[parameter(v), g - f] for v, g in zip(side.value, side.f, strict=True)]).reshape(-1, 2)
    return {"end": np.array(parameter(side.end)), "open": np.array(side.open), "remark": np.array(side.remark), "points": points}


def fit_problem(subject: Subject, linear: Linear, offset: np.ndarray | None) -> tuple[Problem, FitVariables, np.ndarray]:
    """The stage's problem with `offset` (n,) taken off its residual, the map of its variables, and the optimum in these."""
    p = prepared(subject)
    problem, change = stage_problem(subject.study, p.settings, p.base, p.model)
    if offset is not None:
        problem = shifted(problem, offset)
    return problem, change, change.variables(linear.x)


def shifted(problem: Problem, offset: np.ndarray) -> Problem:
    """The problem of other data: its residual less `offset` (n,)."""
    plain, exact = problem.residual, problem.linearise

    def linearise(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        assert exact is not None
        residual, jacobian = exact(x)
        return residual - offset, jacobian

    return replace(problem, residual=lambda x: plain(x) - offset, linearise=None if exact is None else linearise)


def _settings(subject: Subject) -> Settings:
    stage = prepared(subject).settings
    return Settings(
        x_tolerance=stage.tolerance,
        f_tolerance=F_TOLERANCE,
        max_evaluations=stage.max_evaluations,
        difference_step=DIFFERENCE_STEP,
        covariance=False,
    )


def wider(bootstrapped: dict[str, Interval], plain: dict[str, Interval], names: Sequence[str]) -> float:
    """Largest ratio of the widths of two sets of intervals over the parameters."""
    ratios = [(bootstrapped[n].high - bootstrapped[n].low) / (plain[n].high - plain[n].low) for n in names if plain[n].high > plain[n].low]
    return max(ratios, default=1.0)
