"""dr/dx: the exact one of the problem, or finite differences that respect bounds and survive one failing side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.fit.evaluate import Evaluations
from thermofit.fit.problem import Problem
from thermofit.fit.settings import Settings


def jacobian_at(evaluations: Evaluations, x: np.ndarray, settings: Settings) -> np.ndarray:
    """dr/dx (n, n_p) in units 1/[x]: exact where the problem has it, else by differences of `settings.differences`."""
    if evaluations.problem.linearise is not None:
        return evaluations.linearised(x)[1]
    return difference_jacobian(evaluations, x, settings)


def derivative_error(problem: Problem, settings: Settings) -> float:
    """Expected relative error of a Jacobian column: what may be taken for a zero singular value."""
    if problem.linearise is not None:
        return 1e-8
    step = settings.difference_step
    return max(1e-6, step if settings.differences == "forward" else step**2)


def difference_jacobian(evaluations: Evaluations, x: np.ndarray, settings: Settings) -> np.ndarray:
    """Finite differences, order 1 ("forward") or 2 ("central"), (n, n_p); each point is one logged forward run.

    The step is difference_step * scale, turned inward at a bound (where "central" uses three points on one side and keeps
    order 2). A failing point is replaced by the other side; NumericsError if that is not possible.
    """
    problem = evaluations.problem
    base = evaluations.residual(x)
    plan = [_offsets(problem, x, i, settings) for i in range(x.size)]
    tried = _evaluate(evaluations, x, plan)
    second = [_other_side(problem, x, i, tried[i], plan[i]) for i in range(x.size)]
    if any(second):
        rescued = _evaluate(evaluations, x, second)
        tried = [first | more for first, more in zip(tried, rescued, strict=True)]
    columns = []
    for i, points in enumerate(tried):
        good = [(offset, value) for offset, value in points.items() if value is not None]
        if not good:
            raise NumericsError(
                f"no derivative with respect to '{problem.names[i]}': the forward model fails on both sides of "
                f"{evaluations.describe(x)}; narrow the bounds or change difference_step"
            )
        columns.append(_slope(base, good[:2]))
    return np.column_stack(columns)


def _offsets(problem: Problem, x: np.ndarray, i: int, settings: Settings) -> tuple[float, ...]:
    """Signed steps of parameter i that stay inside its bounds."""
    up, down = float(problem.upper[i] - x[i]), float(x[i] - problem.lower[i])
    h = min(settings.difference_step * float(problem.scale[i]), max(up, down) / 2.0)
    sign = 1.0 if up >= h else -1.0
    if settings.differences == "forward":
        return (sign * h,)
    if up >= h and down >= h:
        return (h, -h)
    return (sign * h, 2.0 * sign * h)


def _other_side(
    problem: Problem, x: np.ndarray, i: int, tried: dict[float, np.ndarray | None], plan: tuple[float, ...]
) -> tuple[float, ...]:
    """The opposite step if nothing that was tried succeeded and the bounds leave room for it."""
    if any(value is not None for value in tried.values()):
        return ()
    opposite = -plan[0]
    inside = problem.lower[i] <= x[i] + opposite <= problem.upper[i]
    return (opposite,) if inside and opposite not in tried else ()


def _evaluate(evaluations: Evaluations, x: np.ndarray, plan: Sequence[tuple[float, ...]]) -> list[dict[float, np.ndarray | None]]:
    """Residuals at x + offset e_i as {step really made: residual or None}; one batch, so that it can run in parallel."""
    points = []
    for i, offsets in enumerate(plan):
        for offset in offsets:
            shifted = x.copy()
            shifted[i] += offset
            points.append((i, offset, shifted))
    outcomes = evaluations.batch([p for _, _, p in points], "jacobian") if points else []
    result: list[dict[float, np.ndarray | None]] = [{} for _ in plan]
    for (i, offset, shifted), outcome in zip(points, outcomes, strict=True):
        # The step that the sum in floating point really made, not the one that was meant; a failure keeps the meant one.
        made = float(shifted[i] - x[i]) if outcome.residual is not None else offset
        result[i][made] = outcome.residual
    return result


def _slope(base: np.ndarray, points: Sequence[tuple[float, np.ndarray]]) -> np.ndarray:
    """Derivative at 0 of the line or the parabola through (0, base) and one or two points."""
    a, ra = points[0]
    if len(points) == 1:
        return np.asarray((ra - base) / a)
    b, rb = points[1]
    return np.asarray(ra * (b / (a * (b - a))) - rb * (a / (b * (b - a))) - base * ((a + b) / (a * b)))
