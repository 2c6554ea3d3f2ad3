"""One door to all optimisers."""

from __future__ import annotations

from collections.abc import Callable

from thermofit.core.errors import StudyError
from thermofit.fit.evaluate import Evaluations
from thermofit.fit.least_squares import Ending, trust_region
from thermofit.fit.nlopt_methods import ALGORITHMS, derivative_free
from thermofit.fit.problem import Problem
from thermofit.fit.result import FitResult, conclude
from thermofit.fit.secant import secant_gauss_newton
from thermofit.fit.settings import Hooks, Settings

LEAST_SQUARES: dict[str, Callable[[Evaluations, Settings], Ending]] = {
    "trust-region": trust_region,
    "gauss-newton": secant_gauss_newton,
}

METHODS: tuple[str, ...] = ("least-squares", *LEAST_SQUARES, *ALGORITHMS)


def algorithm_of(method: str) -> str:
    """The algorithm behind a method: "least-squares" is Gauss-Newton in a box. With exact derivatives its steps, which are exact within
    the bounds, take a third of the runs of the trust region of scipy, whose scaling by the distance to the bounds bends them."""
    return "gauss-newton" if method == "least-squares" else method


def minimise(problem: Problem, method: str = "least-squares", settings: Settings | None = None, hooks: Hooks | None = None) -> FitResult:
    """Minimise r(x).r(x) (2.24) within bounds by one of METHODS.

    A fit that stops early is returned with converged False and a message. NumericsError if the start cannot be evaluated,
    StudyError for a method that is not known.
    """
    settings = Settings() if settings is None else settings
    evaluations = Evaluations(problem, hooks, settings.max_evaluations)
    algorithm = algorithm_of(method)
    if algorithm in LEAST_SQUARES:
        ending = LEAST_SQUARES[algorithm](evaluations, settings)
        derivatives = "exact derivatives" if problem.linearise is not None else f"{settings.differences} differences"
        detail = f"{algorithm}, {derivatives}"
    elif algorithm in ALGORITHMS:
        ending, detail = derivative_free(evaluations, settings, algorithm), f"{algorithm}, no derivatives"
    else:
        raise StudyError(f"fit method '{method}' is not known; known are {', '.join(METHODS)}")
    return conclude(evaluations, settings, (method, detail), ending)
