"""Bounded trust-region least squares of scipy (method "trf"), with failures and the limit of evaluations under control."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.optimize

from thermofit.fit.evaluate import EvaluationLimit, Evaluations
from thermofit.fit.jacobian import jacobian_at
from thermofit.fit.problem import from_scaled, scaled_bounds, to_scaled
from thermofit.fit.settings import Settings, relative_drop


@dataclass(frozen=True)
class Ending:
    """How an optimiser ended; the point itself is `Evaluations.best`."""

    converged: bool
    message: str


_REASONS = {
    1: "the gradient vanishes",
    2: "the objective no longer changes",
    3: "the parameters no longer change",
    4: "neither objective nor parameters change any more",
}


def trust_region(evaluations: Evaluations, settings: Settings) -> Ending:
    """Minimise r.r with scipy's trf on scaled variables.

    A failed evaluation becomes a residual of norm sqrt(penalty): finite and worse than everything before, so that the step is
    rejected and the trust region shrinks to a quarter. NumericsError if the start itself fails or a derivative cannot be had.
    """
    problem = evaluations.problem
    start = evaluations.residual(problem.start)
    start_z = to_scaled(problem, problem.start)
    last_failed = False

    def fun(z: np.ndarray) -> np.ndarray:
        nonlocal last_failed
        outcome = evaluations.outcome(from_scaled(problem, z))
        last_failed = outcome.residual is None
        if outcome.residual is None:
            return np.full(start.size, np.sqrt(evaluations.penalty() / start.size))
        return outcome.residual

    def jac(z: np.ndarray) -> np.ndarray:
        return np.asarray(jacobian_at(evaluations, from_scaled(problem, z), settings) * problem.scale)

    try:
        result = scipy.optimize.least_squares(
            fun,
            start_z,
            jac=jac,
            bounds=scaled_bounds(problem),
            method="trf",
            x_scale=1.0,
            xtol=settings.x_tolerance,
            ftol=max(relative_drop(settings, start.size, start_z.size), 1e-15),
            gtol=1e-14,
            max_nfev=settings.max_evaluations,
        )
    except EvaluationLimit as limit:
        return Ending(False, f"not converged: {limit}; raise max_evaluations or start closer")
    if last_failed:
        return Ending(False, "stopped at the edge of a region in which the forward model fails; narrow the bounds or move the start")
    if result.status in _REASONS:
        return Ending(True, _REASONS[result.status])
    return Ending(False, f"not converged: scipy says '{result.message}'; raise max_evaluations or start closer")
