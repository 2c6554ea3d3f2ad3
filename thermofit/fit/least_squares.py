"""Bounded trust-region least squares of scipy (method "trf"), with failures and the limit of evaluations under control.

scipy's trf (M. A. Branch, T. F. Coleman, Y. Li, SIAM J. Sci. Comput. 21, 1999) is a Levenberg-Marquardt method whose damping follows
from a trust region and whose scaling keeps the iterates inside the bounds. Where the problem has exact derivatives, every trial is one
linearised run: an accepted trial, the usual case, then has its Jacobian already, and no point is run twice. The pace
of a search says whether the evaluations that are left are worth their time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.optimize

from thermofit.fit.evaluate import EvaluationLimit, Evaluations, Purpose
from thermofit.fit.gauss_newton import AT_EDGE, AT_NOISE, UNRESOLVED, full_step, pinned, reached, unresolved
from thermofit.fit.jacobian import jacobian_at
from thermofit.fit.linear_model import Step
from thermofit.fit.problem import from_scaled, scaled_bounds, to_scaled
from thermofit.fit.settings import Settings, relative_drop

PACE = 5
"""Steps whose mean fall of f is the pace of a search: in a bent valley single ones go far and near by turns."""


class Crawls(Exception):
    """The evaluations that are left are not worth their time; ends a search from inside, never reaches the user."""


@dataclass
class Pace:
    """f after the steps of a search so far, against `worth` and `to_beat` of its settings."""

    evaluations: Evaluations
    settings: Settings
    falls: list[float] = field(default_factory=list)

    def after(self, f: float) -> None:
        """One more step, after which the best point has that f. Crawls where the evaluations left would not lower it by what is worth
        them."""
        self.falls.append(f)
        settings = self.settings
        if settings.worth <= 0.0 or len(self.falls) <= PACE:
            return
        pace, left = (self.falls[-1 - PACE] - f) / PACE, settings.max_evaluations - len(self.evaluations.log)
        there = f - pace * left
        if pace * left < settings.worth * f:
            raise Crawls(
                f"not converged: at the pace of the last {PACE} steps the {left} evaluations left would lower f by "
                f"{pace * left / f:.1e} of itself, less than {settings.worth:g}"
            )
        if there > (1.0 - settings.worth) * settings.to_beat:
            raise Crawls(
                f"not converged: at the pace of the last {PACE} steps the {left} evaluations left would lower f to {there:.6g}, not below "
                f"{settings.to_beat:.6g} of another start by more than {settings.worth:g} of it"
            )


@dataclass(frozen=True)
class Ending:
    """How an optimiser ended; the point itself is `Evaluations.best`. `curvature`: what second derivatives add to J^T J (n_p, n_p) with
    respect to x, where the search has learnt it and it predicted the last trial better than J^T J alone."""

    converged: bool
    message: str
    curvature: np.ndarray | None = None


class Reached(Exception):
    """The linear model at an accepted point says that the search may end; ends scipy from inside, never reaches the user."""


def trust_region(evaluations: Evaluations, settings: Settings) -> Ending:
    """Minimise r.r with scipy's trf on scaled variables.

    A failed evaluation becomes a residual of norm sqrt(penalty): finite and worse than everything before, so that the step is
    rejected and the trust region shrinks to a quarter. The search ends where the full Gauss-Newton step within the bounds, not the
    last step made, is below the tolerances. Along directions in which the data say nothing it stays where it is. NumericsError if the
    start itself fails or a derivative cannot be had.
    """
    problem = evaluations.problem
    search = _Search(evaluations, settings)
    try:
        result = scipy.optimize.least_squares(
            search.residual,
            to_scaled(problem, problem.start),
            jac=search.jacobian,
            bounds=scaled_bounds(problem),
            method="trf",
            x_scale=1.0,
            xtol=settings.x_tolerance,
            ftol=None,
            gtol=None,
            max_nfev=2 * settings.max_evaluations,
        )
    except Reached as end:
        return Ending(True, str(end))
    except Crawls as end:
        return Ending(False, str(end))
    except EvaluationLimit as limit:
        return Ending(False, f"not converged: {limit}; raise max_evaluations or start closer")
    if search.at_edge:
        return Ending(False, AT_EDGE)
    if result.status > 0 and search.unresolved:
        return Ending(True, AT_NOISE)
    if result.status > 0:
        return Ending(
            False,
            "stopped: no step lowers the objective although its derivative says so; the residual is not smooth enough, or its "
            "derivative is wrong: use nelder-mead",
        )
    return Ending(False, f"not converged: scipy says '{result.message}'; raise max_evaluations or start closer")


class _Search:
    """What scipy sees: residual (n,) and Jacobian dr/dz (n, n_p) of the scaled variables."""

    def __init__(self, evaluations: Evaluations, settings: Settings) -> None:
        self._failed = [False, False]
        self._evaluations = evaluations
        self._settings = settings
        self._purpose: Purpose = "step" if evaluations.problem.linearise is None else "linearise"
        self._here: tuple[float, Step] | None = None
        self._pace = Pace(evaluations, settings)

    @property
    def at_edge(self) -> bool:
        """True if a trial from the last accepted point or from the one before it failed."""
        return any(self._failed)

    @property
    def unresolved(self) -> bool:
        """True where the linear model at the last accepted point promises no more than noise may."""
        return self._here is not None and unresolved(self._here[1], self._here[0], self._evaluations.size, self._settings)

    def residual(self, z: np.ndarray) -> np.ndarray:
        """Residual of a trial. NumericsError where the first one fails, Reached where one of no importance is rejected."""
        evaluations = self._evaluations
        x = from_scaled(evaluations.problem, z)
        outcome = evaluations.outcome(x, self._purpose)
        if evaluations.size == 0:
            return evaluations.residual(x)
        if outcome.residual is None:
            self._failed[1] = True
            return np.full(evaluations.size, np.sqrt(evaluations.penalty() / evaluations.size))
        if self._here is not None and self.unresolved:
            f, n = self._here[0], evaluations.size
            # A rise beyond that is no noise but curvature: a shorter step may still do better.
            if f <= outcome.f <= f * (1.0 + UNRESOLVED * relative_drop(self._settings, n, z.size)):
                raise Reached(AT_NOISE)
        return outcome.residual

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """Jacobian of an accepted point. Reached where the linear model there has converged."""
        evaluations = self._evaluations
        problem = evaluations.problem
        x = from_scaled(problem, z)
        residual = evaluations.residual(x)
        matrix = pinned(jacobian_at(evaluations, x, self._settings) * problem.scale, residual)
        f, step = float(residual @ residual), full_step(problem, to_scaled(problem, x), residual, matrix)
        self._here = f, step
        self._failed = [self._failed[1], False]
        if message := reached(step, f, residual.size, self._settings):
            raise Reached(message)
        self._pace.after(f)
        return np.asarray(matrix)
