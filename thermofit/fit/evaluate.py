"""Every evaluation of the residual goes through here: counted, timed, logged, remembered, replayed."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.fit.problem import Problem, ResidualFunction
from thermofit.fit.settings import Hooks

Purpose = Literal["step", "jacobian"]

PENALTY = 10.0
"""A failed evaluation counts as this multiple of the largest f seen: worse than all, but finite and not so large that it
spoils the quadratic model of BOBYQA."""


class EvaluationLimit(Exception):
    """The allowed number of evaluations is used up; ends an optimiser from inside, never reaches the user."""


@dataclass(frozen=True)
class Outcome:
    """One residual (n,) with f = r.r (2.24), or None with the reason of the failure (f is then infinite)."""

    f: float
    residual: np.ndarray | None
    reason: str
    seconds: float


@dataclass(frozen=True)
class Evaluation:
    """One line of the log. `replayed`: taken from the store, not computed again."""

    number: int
    x: np.ndarray
    f: float
    failed: bool
    reason: str
    seconds: float
    purpose: Purpose
    replayed: bool


@dataclass(frozen=True)
class Counts:
    """Forward runs that were computed, of these failed; replayed from the store; asked again and answered from memory;
    exact Jacobians; wall time of the forward runs and Jacobians in s (sum over parallel runs)."""

    forward: int
    failed: int
    replayed: int
    repeated: int
    jacobians: int
    wall_s: float


def attempt(residual: ResidualFunction, x: np.ndarray) -> Outcome:
    """One evaluation with its failure caught; at module level, so that a process pool can pickle it."""
    begin = time.perf_counter()
    try:
        value = np.asarray(residual(x.copy()), dtype=float).ravel()
    except NumericsError as error:
        return Outcome(float("inf"), None, str(error) or "numerical failure without a text", time.perf_counter() - begin)
    seconds = time.perf_counter() - begin
    # A sum of squares is finite only if every entry is: one pass instead of two over a long vector.
    with np.errstate(over="ignore", invalid="ignore"):
        f = float(value @ value)
    if not np.isfinite(f):
        bad = int(np.count_nonzero(~np.isfinite(value)))
        return Outcome(float("inf"), None, f"residual has {bad} of {value.size} values that are not finite (f = {f})", seconds)
    return Outcome(f, value, "", seconds)


class Evaluations:
    """Log and memory of one fit; the only thing in `fit` that changes while a fit runs.

    f of every x stays in memory, the residuals of the last few x and of the best step do too. `best` is the step (never a
    point of finite differences) with the lowest f.
    """

    def __init__(self, problem: Problem, hooks: Hooks | None = None, limit: int | None = None) -> None:
        self.problem = problem
        self.hooks = Hooks() if hooks is None else hooks
        self.limit = limit
        self.log: list[Evaluation] = []
        self.best: tuple[np.ndarray, Outcome] | None = None
        self._known: dict[bytes, Outcome] = {}
        self._recent: OrderedDict[bytes, np.ndarray] = OrderedDict()
        self._keep = 2 * len(problem.names) + 4
        self._repeated = 0
        self._jacobian: tuple[bytes, np.ndarray] | None = None
        self._jacobian_count = 0
        self._jacobian_seconds = 0.0
        self.size = 0
        self._worst = 0.0

    def counts(self) -> Counts:
        """What the fit has cost so far."""
        computed = [e for e in self.log if not e.replayed]
        return Counts(
            forward=len(computed),
            failed=sum(e.failed for e in computed),
            replayed=len(self.log) - len(computed),
            repeated=self._repeated,
            jacobians=self._jacobian_count,
            wall_s=sum(e.seconds for e in computed) + self._jacobian_seconds,
        )

    def outcome(self, x: np.ndarray, purpose: Purpose = "step", need_residual: bool = True) -> Outcome:
        """Outcome at x; with need_residual=False its residual may be None although it did not fail."""
        return self.batch([x], purpose, need_residual)[0]

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Residual (n,) at x; NumericsError with the reason where the forward model fails."""
        outcome = self.outcome(x)
        if outcome.residual is None:
            raise NumericsError(f"the forward model fails at {self.describe(x)}: {outcome.reason}; start from parameters for which it runs")
        return outcome.residual

    def objective(self, x: np.ndarray) -> float:
        """f(x), finite: a failed evaluation counts as PENALTY times the largest f so far."""
        outcome = self.outcome(x, need_residual=False)
        return outcome.f if not outcome.reason else self.penalty()

    def penalty(self) -> float:
        """The finite objective that stands for a failed evaluation."""
        return PENALTY * max(self._worst, np.finfo(float).tiny)

    def batch(self, xs: Sequence[np.ndarray], purpose: Purpose, need_residual: bool = True) -> list[Outcome]:
        """Outcomes at all xs, in order; what is neither in memory nor in the store goes through the map function."""
        found = [self._recall(x, need_residual) for x in xs]
        new = [x for x, (outcome, _) in zip(xs, found, strict=True) if outcome is None]
        fresh = sum(1 for _, origin in found if origin != "memory")
        if self.limit is not None and len(self.log) + fresh > self.limit:
            raise EvaluationLimit(f"the limit of {self.limit} evaluations is reached")
        computed = iter(self.hooks.map_function(partial(attempt, self.problem.residual), new))
        results = []
        for x, (outcome, origin) in zip(xs, found, strict=True):
            if outcome is None:
                outcome = next(computed)
            if origin == "memory":
                self._repeated += 1
            else:
                self._record(x, outcome, purpose, (origin == "store", need_residual))
            results.append(outcome)
        return results

    def exact_jacobian(self, x: np.ndarray) -> np.ndarray:
        """dr/dx (n, n_p) from the problem's own derivative; the last one is remembered. NumericsError if it is not finite."""
        key = x.tobytes()
        if self._jacobian is not None and self._jacobian[0] == key:
            return self._jacobian[1]
        store = self.hooks.store
        kept = store.get(x) if store is not None else None
        if kept is not None and "jacobian" in kept:
            matrix = np.asarray(kept["jacobian"], dtype=float)
        else:
            residual = self.residual(x)
            matrix = self._compute_jacobian(x, residual.size)
            if store is not None:
                store.put(x, f=np.array(float(residual @ residual)), residual=residual, jacobian=matrix)
        self._jacobian = (key, matrix)
        return matrix

    def describe(self, x: np.ndarray) -> str:
        """The parameters in words, for messages."""
        return ", ".join(f"{name} = {value:.6g}" for name, value in zip(self.problem.names, x, strict=True))

    def _compute_jacobian(self, x: np.ndarray, size: int) -> np.ndarray:
        assert self.problem.jacobian is not None
        begin = time.perf_counter()
        matrix = np.asarray(self.problem.jacobian(x.copy()), dtype=float)
        self._jacobian_count += 1
        self._jacobian_seconds += time.perf_counter() - begin
        if matrix.shape != (size, x.size):
            raise ValueError(f"Jacobian has shape {matrix.shape}, expected {(size, x.size)}")
        if not np.isfinite(matrix).all():
            raise NumericsError(f"the Jacobian at {self.describe(x)} has values that are not finite; use finite differences")
        return matrix

    def _recall(self, x: np.ndarray, need_residual: bool) -> tuple[Outcome | None, str]:
        key = x.tobytes()
        known = self._known.get(key)
        if known is not None:
            residual = self._recent.get(key)
            if residual is None and self.best is not None and self.best[0].tobytes() == key:
                residual = self.best[1].residual
            if known.reason or not need_residual or residual is not None:
                return Outcome(known.f, residual, known.reason, known.seconds), "memory"
        kept = self.hooks.store.get(x) if self.hooks.store is not None else None
        if kept is not None and "reason" in kept:
            return Outcome(float("inf"), None, str(kept["reason"]), 0.0), "store"
        if kept is not None and ("residual" in kept or not need_residual):
            residual = np.asarray(kept["residual"], dtype=float) if "residual" in kept else None
            return Outcome(float(kept["f"]), residual, "", 0.0), "store"
        return None, "new"

    def _record(self, x: np.ndarray, outcome: Outcome, purpose: Purpose, how: tuple[bool, bool]) -> None:
        replayed, need_residual = how
        x = x.copy()
        x.setflags(write=False)
        self._check_size(outcome.residual)
        entry = Evaluation(len(self.log), x, outcome.f, bool(outcome.reason), outcome.reason, outcome.seconds, purpose, replayed)
        self.log.append(entry)
        key = x.tobytes()
        self._known[key] = Outcome(outcome.f, None, outcome.reason, outcome.seconds)
        improves = not outcome.reason and purpose == "step" and (self.best is None or outcome.f < self.best[1].f)
        if outcome.residual is not None:
            self._worst = max(self._worst, outcome.f)
            self._recent[key] = outcome.residual
            if len(self._recent) > self._keep:
                self._recent.popitem(last=False)
        elif not outcome.reason:
            self._worst = max(self._worst, outcome.f)
        if improves:
            self.best = (x, outcome)
        if self.hooks.store is not None and not replayed:
            # Derivative-free methods need f only: a residual of a million values is kept on disk only where it may be asked for.
            self._put(x, outcome, need_residual or improves)
        if self.hooks.on_evaluation is not None:
            self.hooks.on_evaluation(entry, outcome.residual)

    def _put(self, x: np.ndarray, outcome: Outcome, with_residual: bool) -> None:
        assert self.hooks.store is not None
        if outcome.reason:
            self.hooks.store.put(x, reason=np.array(outcome.reason))
        elif with_residual and outcome.residual is not None:
            self.hooks.store.put(x, f=np.array(outcome.f), residual=outcome.residual)
        else:
            self.hooks.store.put(x, f=np.array(outcome.f))

    def _check_size(self, residual: np.ndarray | None) -> None:
        if residual is None:
            return
        if self.size == 0:
            self.size = residual.size
        if residual.size != self.size:
            raise ValueError(f"residual has {residual.size} values, before it had {self.size}: masks must not change during a fit")
