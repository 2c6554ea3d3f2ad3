"""The linear least-squares step inside bounds: the core of every Gauss-Newton method and the test of a minimum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from thermofit.fit.problem import Problem, scaled_bounds
from thermofit.fit.settings import Settings, relative_drop

TINY_DAMPING = 1e-12
"""Relative damping of an undamped step: keeps exactly dependent columns from giving a wild one."""

DEPENDENT = 1e-10
"""Share of the largest eigenvalue of J^T J with columns of length one below which the columns are dependent: beyond what derivatives
resolve. Of merely correlated parameters it is 1e-6 and more."""

UNRESOLVED = 25.0
"""Predicted drop, in units of the tolerance, that noise of the residual or of its derivatives may promise wrongly at the optimum: a
trial step that then raises f ends the search. With f_tolerance = 0.01 this is half a standard error."""

AT_NOISE = "the objective no longer changes by more than it is resolved"
"""Message of a search that ends so."""


@dataclass(frozen=True)
class Reduced:
    """Triangular form with the same |J d + r|^2 for all d: `R` (m, n_p), `c` (m,), m <= n_p + 1; `norms` (n_p,) of columns."""

    R: np.ndarray
    c: np.ndarray
    norms: np.ndarray


@dataclass(frozen=True)
class Step:
    """Step d (n_p,) in scaled variables and the drop of f that the linear model predicts for it."""

    d: np.ndarray
    drop: float


def reduce(jacobian: np.ndarray, residual: np.ndarray) -> Reduced:
    """QR of [J r]; jacobian (n, n_p) with respect to the scaled variables, residual (n,)."""
    triangle = np.asarray(np.linalg.qr(np.column_stack([jacobian, residual]), mode="r"))
    R, c = triangle[:, :-1], triangle[:, -1]
    return Reduced(R, c, np.linalg.norm(R, axis=0))


def bounded_step(reduced: Reduced, room: tuple[np.ndarray, np.ndarray]) -> Step:
    """Minimise |J d + r|^2 within room = (lowest d, highest d), each (n_p,), which must hold 0; d in scaled variables.

    Bounded-variable least squares is exact for the few parameters at hand, so that a step ends on a bound, not near it.
    """
    # A column of zeros says nothing about its parameter: any positive weight makes it stay where it is.
    weights = np.where(reduced.norms > 0.0, reduced.norms, 1.0)
    matrix = np.vstack([reduced.R, np.sqrt(TINY_DAMPING) * np.diag(weights)]) / weights
    right = -np.concatenate([reduced.c, np.zeros(weights.size)])
    lower, upper = np.minimum(room[0], 0.0) * weights, np.maximum(room[1], 0.0) * weights
    solution = lsq_linear(matrix, right, bounds=(lower, upper), method="bvls", tol=1e-14, max_iter=20 * weights.size)
    d = np.clip(solution.x / weights, room[0], room[1])
    # Exactly on the bound, which the division by the weights may miss by one bit.
    d = np.where(solution.active_mask < 0, room[0], np.where(solution.active_mask > 0, room[1], d))
    model = reduced.R @ d + reduced.c
    return Step(d, max(0.0, float(reduced.c @ reduced.c - model @ model)))


def full_step(problem: Problem, z: np.ndarray, residual: np.ndarray, jacobian: np.ndarray) -> Step:
    """The Gauss-Newton step from z within the bounds; `jacobian` dr/dz (n, n_p) with respect to the scaled variables."""
    lower, upper = scaled_bounds(problem)
    return bounded_step(reduce(jacobian, residual), (lower - z, upper - z))


def reached(step: Step, f: float, n: int, settings: Settings) -> str:
    """Why a search of n residuals may end at a point with that f and that full Gauss-Newton step, or "" where it may not."""
    if float(np.max(np.abs(step.d))) <= settings.x_tolerance:
        return "the parameters no longer change"
    if step.drop <= f * relative_drop(settings, n, step.d.size):
        return "the objective no longer changes"
    return ""


def unresolved(step: Step, f: float, n: int, settings: Settings) -> bool:
    """True where the full Gauss-Newton step promises so little that a trial which raises f ends the search."""
    return step.drop <= UNRESOLVED * f * relative_drop(settings, n, step.d.size)


def pinned(jacobian: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """A Jacobian (n, n_p) whose least-squares steps stay put along directions in which the data say nothing.

    Where columns are dependent (a valley), the null directions are taken out and given a column space of their own, orthogonal to the
    residual (n,) and to all other columns: f and its gradient are untouched, but a step along them promises nothing. The same matrix
    where nothing is dependent. A search from another start then ends elsewhere in the valley, instead of at a bound.
    """
    norms = np.linalg.norm(jacobian, axis=0)
    columns = jacobian / np.where(norms > 0.0, norms, 1.0)
    values, vectors = np.linalg.eigh(columns.T @ columns)
    null = vectors[:, values <= DEPENDENT * values[-1]]
    if null.shape[1] == 0 or jacobian.shape[0] < 2 * (jacobian.shape[1] + 1):
        return jacobian
    rest = columns - (columns @ null) @ null.T
    span = np.linalg.qr(np.column_stack([rest, residual]))[0]
    # Unit vectors of the first data, less what the span holds of them: more than it can swallow.
    outside = np.eye(jacobian.shape[0], span.shape[1] + null.shape[1])
    outside = outside - span @ (span.T @ outside)
    fresh = np.linalg.svd(outside, full_matrices=False)[0][:, : null.shape[1]]
    return np.asarray((rest + np.sqrt(values[-1]) * fresh @ null.T) * np.where(norms > 0.0, norms, 1.0))
