"""The Gauss-Newton step of a problem, when a search by such steps may end, and what it does where columns are dependent."""

from __future__ import annotations

import numpy as np

from thermofit.fit.linear_model import LinearModel, Step
from thermofit.fit.problem import Problem, scaled_bounds
from thermofit.fit.settings import Settings, relative_drop

DEPENDENT = 1e-10
"""Share of the largest eigenvalue of J^T J with columns of length one below which the columns are dependent: beyond what derivatives
resolve. Of merely correlated parameters it is 1e-6 and more."""

UNRESOLVED = 25.0
"""Predicted drop, in units of the tolerance, that noise of the residual or of its derivatives may promise wrongly at the optimum: a
trial step that then raises f ends the search. With f_tolerance = 0.01 this is half a standard error."""

AT_EDGE = "stopped at the edge of a region in which the forward model fails; narrow the bounds or move the start"
"""Message of a search whose last trials failed."""

AT_NOISE = "the objective no longer changes by more than it is resolved"
"""Message of a search that ends so."""


def full_step(problem: Problem, z: np.ndarray, residual: np.ndarray, jacobian: np.ndarray) -> Step:
    """The Gauss-Newton step from z within the bounds; `jacobian` dr/dz (n, n_p) with respect to the scaled variables."""
    lower, upper = scaled_bounds(problem)
    return LinearModel(residual, jacobian, bounds=(lower - z, upper - z)).step


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
    model = LinearModel(residual, jacobian)
    columns = model.unit
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
    return np.asarray((rest + np.sqrt(values[-1]) * fresh @ null.T) * model.size)
