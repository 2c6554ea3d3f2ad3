"""Profile likelihood: how far one parameter can go, all others following, before the objective rises by what noise allows.

For every value of one variable the others are fitted anew, from where the linear model expects them, within their bounds. With
q = sqrt(f - f_min), which is nearly linear in the value, the end of the interval is where q reaches its target; a bound reached before
that leaves the interval open there. The rise that noise allows is t^2 times `variance`, which is s2 for independent errors and larger where
errors are correlated: then the profile of a linear model is the interval of the honest covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.fit.evaluate import Counts
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.fit.settings import Hooks, Settings, Store

NEAR = 0.02
"""The end of an interval is found where q is this close to its target."""
_ROUNDS = 8
_BEHIND = 1e-3
"""A drop of f below the optimum, in units of the allowed rise, from which on the optimum was none."""


@dataclass(frozen=True)
class Optimum:
    """Where the profile starts: `x` (n_p,), its f = r.r, and dr/dx (n, n_p)."""

    x: np.ndarray
    f: float
    jacobian: np.ndarray


@dataclass(frozen=True)
class Side:
    """One side of a profile: `value` (m,), `f` (m,), the fitted `x` (m, n_p) at every value tried, nearest first; the `end` of the
    interval, and whether it is `open`: the bound lies there, or a value beyond which the model fails (`remark` says which)."""

    value: np.ndarray
    f: np.ndarray
    x: np.ndarray
    end: float
    open: bool
    remark: str
    forward: int
    replayed: int


@dataclass(frozen=True)
class _HeldStore:
    """Store of a fit with one variable held: its evaluations are kept under all variables and the number of the held one."""

    store: Store
    held: int
    value: float

    def _key(self, x: np.ndarray) -> np.ndarray:
        return np.append(np.insert(x, self.held, self.value), float(self.held))

    def get(self, x: np.ndarray) -> dict[str, np.ndarray] | None:
        return self.store.get(self._key(x))

    def put(self, x: np.ndarray, **arrays: np.ndarray) -> Any:
        return self.store.put(self._key(x), **arrays)


@dataclass(frozen=True)
class _Point:
    value: float
    x: np.ndarray
    f: float
    counts: Counts | None


def profile_side(
    problem: Problem, optimum: Optimum, at: tuple[int, int], rise: float, settings: Settings, store: Store | None = None
) -> Side:
    """One side of the profile of variable `at` = (place, -1 or 1); `rise` of f at the end of the interval.

    A value for which the model fails is approached by halves, and ends the interval open. NumericsError never: it is a remark.
    """
    i, sign = at
    bound = float(problem.upper[i] if sign > 0 else problem.lower[i])
    room = abs(bound - optimum.x[i])
    tried: list[_Point] = []
    forward = replayed = 0
    remark, reach, low = "", room, 0.0
    step = min(_first_step(optimum, i, rise), room)
    for _ in range(_ROUNDS):
        if not step > 0.0:
            break
        try:
            point = _point(problem, optimum, i, optimum.x[i] + sign * step, settings, store)
        except NumericsError as error:
            reach, remark = step, str(error)
            step = 0.5 * (low + step)
            continue
        tried.append(point)
        if point.counts is not None:
            forward, replayed = forward + point.counts.forward, replayed + point.counts.replayed
        q = np.sqrt(max(point.f - optimum.f, 0.0) / rise)
        if abs(q - 1.0) <= NEAR or (q < 1.0 and step >= room * (1.0 - 1e-12)):
            break
        low = max(low, step) if q < 1.0 else low
        step = _next_step(tried, optimum, i, rise, reach if remark else room)
    return _side(tried, optimum, i, sign, rise, bound, remark, (forward, replayed))


def _first_step(optimum: Optimum, i: int, rise: float) -> float:
    """Distance at which the linear model expects the rise: sqrt(rise) times the standard error for unit variance."""
    column = optimum.jacobian[:, i]
    left = LinearModel(column, np.delete(optimum.jacobian, i, axis=1)).left
    size, whole = float(np.linalg.norm(left)), float(np.linalg.norm(column))
    return float(np.sqrt(rise)) / size if size > 1e-9 * whole else float("inf")


def _next_step(tried: list[_Point], optimum: Optimum, i: int, rise: float, reach: float) -> float:
    """Where q reaches one by the chord between the nearest points on both sides of it; twice as far at most where it has not yet."""
    points = [(0.0, 0.0), *sorted((abs(p.value - optimum.x[i]), float(np.sqrt(max(p.f - optimum.f, 0.0) / rise))) for p in tried)]
    below = [p for p in points if p[1] < 1.0][-1]
    above = next((p for p in points if p[1] >= 1.0 and p[0] > below[0]), None)
    if above is None:
        ahead = below[0] / below[1] if below[1] > 0.25 else 4.0 * below[0]
        return float(min(ahead, reach))
    return float(below[0] + (1.0 - below[1]) * (above[0] - below[0]) / (above[1] - below[1]))


def _side(tried: list[_Point], optimum: Optimum, i: int, sign: int, rise: float, bound: float, remark: str, runs: tuple[int, int]) -> Side:
    """One side (`sign`) of the profile of parameter i from the points that were tried: where the objective has risen by `rise`, else where
    the search ended, with the remark why, or the bound; `runs`: forward, replayed."""
    tried = sorted(tried, key=lambda p: abs(p.value - optimum.x[i]))
    away = np.array([0.0] + [abs(p.value - optimum.x[i]) for p in tried])
    q = np.array([0.0] + [float(np.sqrt(max(p.f - optimum.f, 0.0) / rise)) for p in tried])
    reached = np.flatnonzero(q >= 1.0 - NEAR)
    if len(reached):
        k = int(reached[0])
        share = (1.0 - q[k - 1]) / (q[k] - q[k - 1]) if q[k] > 1.0 else 1.0
        end, is_open = optimum.x[i] + sign * (away[k - 1] + share * (away[k] - away[k - 1])), False
    elif remark:
        end, is_open = optimum.x[i] + sign * away[-1], True
    else:
        end, is_open = bound, True
        remark = "the bound is reached first"
    if tried and min(p.f for p in tried) < optimum.f - _BEHIND * rise:
        remark = "; ".join(part for part in (remark, "a lower objective was found on the way: the optimum was none") if part)
    x = np.array([p.x for p in tried]).reshape(len(tried), optimum.x.size)
    return Side(
        np.array([p.value for p in tried]), np.array([p.f for p in tried]), x, float(end), is_open, remark, runs[0], runs[1]
    )  # fmt: skip


def _point(problem: Problem, optimum: Optimum, i: int, value: float, settings: Settings, store: Store | None) -> _Point:
    """The fit with variable i held at a value."""
    value = float(np.clip(value, problem.lower[i], problem.upper[i]))
    guess = _followed(problem, optimum, i, value)
    if problem.start.size == 1:
        residual = problem.residual(guess)
        return _Point(value, guess, float(residual @ residual), None)
    fit = minimise(
        held(problem, i, value, guess), "least-squares", settings, Hooks(store=None if store is None else _HeldStore(store, i, value))
    )
    return _Point(value, np.insert(fit.x, i, value), fit.f, fit.counts)


def _followed(problem: Problem, optimum: Optimum, i: int, value: float) -> np.ndarray:
    """Where the linear model expects the optimum with variable i at a value, within the bounds."""
    x = optimum.x.copy()
    others = [k for k in range(x.size) if k != i]
    x[i] = value
    if others:
        step = LinearModel(optimum.jacobian[:, i] * (value - optimum.x[i]), optimum.jacobian[:, others]).free_step
        x[others] = np.clip(x[others] + step, problem.lower[others], problem.upper[others])
    return x


def held(problem: Problem, i: int, value: float, guess: np.ndarray) -> Problem:
    """The problem with variable i held at a value, its search starting from the other entries of `guess` (n_p,)."""
    others = [k for k in range(problem.start.size) if k != i]
    exact = problem.linearise

    def linearise(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        assert exact is not None
        residual, jacobian = exact(np.insert(x, i, value))
        return residual, jacobian[:, others]

    return replace(
        problem,
        residual=lambda x: problem.residual(np.insert(x, i, value)),
        start=guess[others],
        lower=problem.lower[others],
        upper=problem.upper[others],
        scale=problem.scale[others],
        names=tuple(problem.names[k] for k in others),
        linearise=None if exact is None else linearise,
        first_jacobian=None,
        first_curvature=None,
    )
