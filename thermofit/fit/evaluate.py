"""Every evaluation of the residual goes through here: counted, timed, logged, remembered, replayed."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, TypeVar

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.fit.problem import LineariseFunction, Problem, ResidualFunction
from thermofit.fit.settings import Hooks

Purpose = Literal["step", "linearise", "jacobian"]
"""A point of the search; one whose run gives the exact Jacobian too; a point of finite differences."""
_T = TypeVar("_T")

PENALTY = 10.0
"""A failed evaluation counts as this multiple of the largest f seen: worse than all, but finite and not so large that it
spoils the quadratic model of BOBYQA."""


class EvaluationLimit(Exception):
    """The allowed number of evaluations is used up; ends an optimiser from inside, never reaches the user."""


@dataclass(frozen=True)
class EvaluatedResidual:
    """One residual (n,) with f = r.r (2.24), or None with the reason of the failure (f is then infinite).

    `jacobian`: dr/dx (n, n_p) where the run gave it.
    """

    f: float
    residual: np.ndarray | None
    reason: str
    seconds: float
    jacobian: np.ndarray | None = None


@dataclass(frozen=True)
class LoggedEvaluation:
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
    """Forward runs that were computed, of these with exact derivatives, of these failed; replayed from the store; asked again and
    answered from memory; wall time of the forward runs in s (sum over parallel runs)."""

    forward: int
    linearised: int
    failed: int
    replayed: int
    repeated: int
    wall_s: float


def attempt(residual: ResidualFunction, x: np.ndarray) -> EvaluatedResidual:
    """One evaluation with its failure caught; at module level, so that a process pool can pickle it."""
    value, reason, seconds = _run(residual, x)
    if value is None:
        return EvaluatedResidual(float("inf"), None, reason, seconds)
    return _checked(np.asarray(value, dtype=float).ravel(), None, seconds)


def attempt_linearised(linearise: LineariseFunction, x: np.ndarray) -> EvaluatedResidual:
    """One evaluation with its Jacobian from the same run; a Jacobian that is not finite is a failure too."""
    pair, reason, seconds = _run(linearise, x)
    if pair is None:
        return EvaluatedResidual(float("inf"), None, reason, seconds)
    residual, jacobian = (np.asarray(part, dtype=float) for part in pair)
    if jacobian.shape != (residual.size, x.size):
        raise ValueError(f"Jacobian has shape {jacobian.shape}, expected {(residual.size, x.size)}")
    return _checked(residual.ravel(), jacobian, seconds)


def _run(function: Callable[[np.ndarray], _T], x: np.ndarray) -> tuple[_T | None, str, float]:
    """What the function returns, or None with the reason; and the seconds that it took."""
    begin = time.perf_counter()
    try:
        return function(x.copy()), "", time.perf_counter() - begin
    except NumericsError as error:
        return None, str(error) or "numerical failure without a text", time.perf_counter() - begin


def _checked(residual: np.ndarray, jacobian: np.ndarray | None, seconds: float) -> EvaluatedResidual:
    """The outcome of a run that ended, a failure where its numbers are not finite."""
    # A sum of squares is finite only if every entry is: one pass instead of two over a long vector.
    with np.errstate(over="ignore", invalid="ignore"):
        f = float(residual @ residual)
    if not np.isfinite(f):
        bad = int(np.count_nonzero(~np.isfinite(residual)))
        return EvaluatedResidual(float("inf"), None, f"residual has {bad} of {residual.size} values that are not finite (f = {f})", seconds)
    if jacobian is not None and not np.isfinite(jacobian).all():
        bad = int(np.count_nonzero(~np.isfinite(jacobian)))
        return EvaluatedResidual(float("inf"), None, f"Jacobian has {bad} of {jacobian.size} values that are not finite", seconds)
    return EvaluatedResidual(f, residual, "", seconds, jacobian)


class Evaluations:
    """Log and memory of one fit; the only thing in `fit` that changes while a fit runs.

    f of every x stays in memory, the residuals of the last few x and of the best step do too, and the exact Jacobian of the best
    step. `best` is the step (never a point of finite differences) with the lowest f.
    """

    def __init__(self, problem: Problem, hooks: Hooks | None = None, limit: int | None = None) -> None:
        self.problem = problem
        self.hooks = Hooks() if hooks is None else hooks
        self.limit = limit
        self.log: list[LoggedEvaluation] = []
        self.best: tuple[np.ndarray, EvaluatedResidual] | None = None
        self._known: dict[bytes, EvaluatedResidual] = {}
        self._recent: OrderedDict[bytes, np.ndarray] = OrderedDict()
        self._keep = 2 * len(problem.names) + 4
        self._repeated = 0
        self.size = 0
        self._worst = 0.0

    def counts(self) -> Counts:
        """What the fit has cost so far."""
        computed = [e for e in self.log if not e.replayed]
        return Counts(
            forward=len(computed),
            linearised=sum(e.purpose == "linearise" for e in computed),
            failed=sum(e.failed for e in computed),
            replayed=len(self.log) - len(computed),
            repeated=self._repeated,
            wall_s=sum(e.seconds for e in computed),
        )

    def outcome(self, x: np.ndarray, purpose: Purpose = "step", need_residual: bool = True) -> EvaluatedResidual:
        """Outcome at x, with its Jacobian for "linearise"; with need_residual=False its residual may be None although it did not fail."""
        return self.batch([x], purpose, need_residual)[0]

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Residual (n,) at x; NumericsError with the reason where the forward model fails."""
        residual, _ = self._successful(x, self.outcome(x))
        return residual

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual (n,) and exact dr/dx (n, n_p) at x from one run; NumericsError with the reason where it fails."""
        residual, jacobian = self._successful(x, self.outcome(x, "linearise"))
        assert jacobian is not None
        return residual, jacobian

    def _successful(self, x: np.ndarray, outcome: EvaluatedResidual) -> tuple[np.ndarray, np.ndarray | None]:
        if outcome.residual is None:
            raise NumericsError(f"the forward model fails at {self.describe(x)}: {outcome.reason}; start from parameters for which it runs")
        return outcome.residual, outcome.jacobian

    def objective(self, x: np.ndarray) -> float:
        """f(x), finite: a failed evaluation counts as PENALTY times the largest f so far."""
        outcome = self.outcome(x, need_residual=False)
        return outcome.f if not outcome.reason else self.penalty()

    def penalty(self) -> float:
        """The finite objective that stands for a failed evaluation."""
        return PENALTY * max(self._worst, np.finfo(float).tiny)

    def batch(self, xs: Sequence[np.ndarray], purpose: Purpose, need_residual: bool = True) -> list[EvaluatedResidual]:
        """Outcomes at all xs, in order; what is neither in memory nor in the store goes through the map function."""
        found = [self._recall(x, purpose, need_residual) for x in xs]
        new = [x for x, (outcome, _) in zip(xs, found, strict=True) if outcome is None]
        fresh = sum(1 for _, origin in found if origin != "memory")
        if self.limit is not None and len(self.log) + fresh > self.limit:
            raise EvaluationLimit(f"the limit of {self.limit} evaluations is reached")
        computed = iter(self.hooks.map_function(self._function(purpose), new))
        results = []
        for x, (outcome, origin) in zip(xs, found, strict=True):
            if outcome is None:
                outcome = next(computed)
            if origin == "memory":
                self._repeated += 1
            else:
                self._record(x, outcome, purpose, replayed=origin == "store", need_residual=need_residual)
            results.append(outcome)
        return results

    def describe(self, x: np.ndarray) -> str:
        """The parameters in words, for messages."""
        return ", ".join(f"{name} = {value:.6g}" for name, value in zip(self.problem.names, x, strict=True))

    def _function(self, purpose: Purpose) -> Callable[[np.ndarray], EvaluatedResidual]:
        """What computes one outcome."""
        if purpose != "linearise":
            return partial(attempt, self.problem.residual)
        if self.problem.linearise is None:
            raise ValueError("the problem has no exact derivatives to linearise with")
        return partial(attempt_linearised, self.problem.linearise)

    def _recall(self, x: np.ndarray, purpose: Purpose, need_residual: bool) -> tuple[EvaluatedResidual | None, str]:
        key = x.tobytes()
        known = self._known.get(key)
        if known is not None:
            residual, jacobian = self._held(key)
            complete = jacobian is not None if purpose == "linearise" else residual is not None or not need_residual
            if known.reason or complete:
                return replace(known, residual=residual, jacobian=jacobian), "memory"
        kept = self.hooks.store.get(x) if self.hooks.store is not None else None
        if kept is None:
            return None, "new"
        if "reason" in kept:
            return EvaluatedResidual(float("inf"), None, str(kept["reason"]), 0.0), "store"
        wanted = "jacobian" if purpose == "linearise" else "residual" if need_residual else "f"
        if wanted not in kept:
            return None, "new"
        residual = np.asarray(kept["residual"], dtype=float) if "residual" in kept else None
        # A plain run replays as one, so that a resumed fit counts as the whole one did.
        jacobian = np.asarray(kept["jacobian"], dtype=float) if purpose == "linearise" else None
        return EvaluatedResidual(float(kept["f"]), residual, "", 0.0, jacobian), "store"

    def _held(self, key: bytes) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Residual and Jacobian of an evaluated point as far as they are still in memory."""
        if self.best is not None and self.best[0].tobytes() == key:
            return self.best[1].residual, self.best[1].jacobian
        return self._recent.get(key), None

    def _record(self, x: np.ndarray, outcome: EvaluatedResidual, purpose: Purpose, *, replayed: bool, need_residual: bool) -> None:
        x = x.copy()
        x.setflags(write=False)
        self._check_size(outcome.residual)
        entry = LoggedEvaluation(len(self.log), x, outcome.f, bool(outcome.reason), outcome.reason, outcome.seconds, purpose, replayed)
        self.log.append(entry)
        key = x.tobytes()
        known = self._known.get(key)
        # Where only the derivatives of a point failed, what is known of the point itself stays.
        if not outcome.reason or known is None:
            self._known[key] = EvaluatedResidual(outcome.f, None, outcome.reason, outcome.seconds)
            improves = self._keep_results(x, outcome, purpose)
            if self.hooks.store is not None and not replayed:
                # Derivative-free methods need f only: a residual of a million values is kept on disk only where it may be asked for.
                self._put(x, outcome, need_residual or improves)
        if self.hooks.on_evaluation is not None:
            self.hooks.on_evaluation(entry, outcome.residual)

    def _keep_results(self, x: np.ndarray, outcome: EvaluatedResidual, purpose: Purpose) -> bool:
        """Remember the residual; True if this is the best step so far."""
        if outcome.reason:
            return False
        key = x.tobytes()
        self._worst = max(self._worst, outcome.f)
        if outcome.residual is not None:
            self._recent[key] = outcome.residual
            if len(self._recent) > self._keep:
                self._recent.popitem(last=False)
        improves = purpose != "jacobian" and (self.best is None or outcome.f < self.best[1].f)
        if improves:
            self.best = (x, outcome)
        return improves

    def _put(self, x: np.ndarray, outcome: EvaluatedResidual, with_residual: bool) -> None:
        assert self.hooks.store is not None
        if outcome.reason:
            self.hooks.store.put(x, reason=np.array(outcome.reason))
            return
        arrays = {"f": np.array(outcome.f)}
        if with_residual and outcome.residual is not None:
            arrays["residual"] = outcome.residual
        if outcome.jacobian is not None:
            arrays["jacobian"] = outcome.jacobian
        self.hooks.store.put(x, **arrays)

    def _check_size(self, residual: np.ndarray | None) -> None:
        if residual is None:
            return
        if self.size == 0:
            self.size = residual.size
        if residual.size != self.size:
            raise ValueError(f"residual has {residual.size} values, before it had {self.size}: masks must not change during a fit")
