"""What a fit leaves behind, and the checks at its end: is it a minimum, what is at a bound, how sure are the parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import NumericsError, UntrustworthyError
from thermofit.fit.covariance import Covariance
from thermofit.fit.evaluate import Counts, Evaluations, LoggedEvaluation
from thermofit.fit.gauss_newton import full_step
from thermofit.fit.jacobian import derivative_error, jacobian_at
from thermofit.fit.least_squares import Ending
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.problem import Problem, scaled_bounds, to_scaled
from thermofit.fit.settings import Settings

ON_BOUND = 1e-6
"""Distance to a bound, in units of the scale, below which a parameter is on it."""


@dataclass(frozen=True)
class Optimality:
    """One more Gauss-Newton step from the result: largest `step` in units of the scale, predicted `drop` of f in units of s2.

    The drop is the squared distance to the predicted minimum in standard errors: 1 means about one sigma away.
    """

    step: float
    drop: float


@dataclass(frozen=True)
class FitResult:
    """Result of one fit: `x` (n_p,), `f` = r.r (2.24), `residual` (n,), `jacobian` dr/dx (n, n_p) at x.

    `jacobian`, `covariance`, `sigma` (n_p,) and `optimality` are None where the settings ask for none, or where `message` says
    why there are none. `converged` False always comes with a `message`. `log` holds every evaluation. `method` is what was asked
    for, `algorithm` what ran and with which derivatives.
    """

    names: tuple[str, ...]
    method: str
    algorithm: str
    x: np.ndarray
    f: float
    residual: np.ndarray
    jacobian: np.ndarray | None
    covariance: Covariance | None
    sigma: np.ndarray | None
    optimality: Optimality | None
    at_bound: np.ndarray
    converged: bool
    message: str
    counts: Counts
    log: tuple[LoggedEvaluation, ...]
    curvature: np.ndarray | None = None
    """What second derivatives add to J^T J (n_p, n_p) with respect to x, where a search has learnt it and it predicted the last trial
    better than J^T J alone."""

    @property
    def at_edge(self) -> bool:
        """True where the search found no minimum and met parameters for which the forward model fails."""
        return not self.converged and any(evaluation.failed for evaluation in self.log)


def conclude(evaluations: Evaluations, settings: Settings, method: str, algorithm: str, ending: Ending) -> FitResult:
    """FitResult at the best step of a method, `algorithm` in its own words.

    A result more than one sigma and ten tolerances from its predicted minimum is not converged.
    NumericsError if nothing was evaluated successfully.
    """
    problem = evaluations.problem
    evaluations.limit = None  # the end of a fit is not part of the search
    if evaluations.best is None:
        raise NumericsError("no evaluation of the forward model succeeded; start from parameters for which it runs")
    x = evaluations.best[0]
    residual = evaluations.residual(x)
    f = float(residual @ residual)
    jacobian, error = _jacobian(evaluations, x, settings)
    at_bound = _distance(problem, x) <= ON_BOUND
    optimality, spread = None, None
    converged, message = ending.converged, ending.message
    if jacobian is not None:
        optimality, at_bound = _optimality(problem, x, jacobian, residual, settings, at_bound)
        if optimality.step > 10.0 * settings.x_tolerance and optimality.drop > 1.0:
            converged = False
            message = (
                f"{message}, but one more Gauss-Newton step would move the parameters by {optimality.step:.2g} of their scale and "
                f"lower f by {optimality.drop:.3g} variances: continue from here with least-squares"
            )
        try:
            spread = LinearModel(residual, jacobian).covariance(problem.names, at_bound, derivative_error(problem, settings))
        except UntrustworthyError as untrustworthy:
            error = str(untrustworthy)
    return FitResult(
        names=problem.names,
        method=method,
        algorithm=algorithm,
        x=x.copy(),
        f=f,
        residual=residual,
        jacobian=jacobian,
        covariance=spread,
        sigma=None if spread is None else spread.sigma,
        optimality=optimality,
        at_bound=at_bound,
        converged=converged,
        message=message if not error else f"{message}; no standard errors: {error}",
        counts=evaluations.counts(),
        log=tuple(evaluations.log),
        curvature=ending.curvature,
    )


def _jacobian(evaluations: Evaluations, x: np.ndarray, settings: Settings) -> tuple[np.ndarray | None, str]:
    if not settings.covariance:
        return None, ""
    try:
        return jacobian_at(evaluations, x, settings), ""
    except NumericsError as error:
        return None, str(error)


def _distance(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Distance (n_p,) to the nearer bound in units of the scale."""
    return np.asarray(np.minimum(x - problem.lower, problem.upper - x) / problem.scale)


def _optimality(
    problem: Problem, x: np.ndarray, jacobian: np.ndarray, residual: np.ndarray, settings: Settings, on_bound: np.ndarray
) -> tuple[Optimality, np.ndarray]:
    """The remaining step, and at_bound including parameters that an interior method left a little short of their bound."""
    lower, upper = scaled_bounds(problem)
    z = to_scaled(problem, x)
    step = full_step(problem, z, residual, jacobian * problem.scale)
    landing = np.minimum(z + step.d - lower, upper - z - step.d) <= ON_BOUND
    near = _distance(problem, x) <= max(10.0 * settings.x_tolerance, ON_BOUND)
    s2 = float(residual @ residual) / max(residual.size - x.size, 1)
    drop = step.drop / s2 if s2 > 0.0 else 0.0
    return Optimality(float(np.max(np.abs(step.d))), drop), on_bound | (landing & near)
