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
    "least-squares": secant_gauss_newton,
    "trust-region": trust_region,
}

METHODS: tuple[str, ...] = (*LEAST_SQUARES, *ALGORITHMS)


def minimise(problem: Problem, method: str = "least-squares", settings: Settings | None = None, hooks: Hooks | None = None) -> FitResult:
    """Minimise r(x).r(x) (2.24) within bounds by one of METHODS.

    A fit that stops early is returned with converged False and a message. NumericsError if the start cannot be evaluated,
    StudyError for a method that is not known.
    """
    settings = Settings() if settings is None else settings
    evaluations = Evaluations(problem, hooks, settings.max_evaluations)
    if method in LEAST_SQUARES:
        ending = LEAST_SQUARES[method](evaluations, settings)
    elif method in ALGORITHMS:
        ending = derivative_free(evaluations, settings, method)
    else:
        raise StudyError(f"fit method '{method}' is not known; known are {', '.join(METHODS)}")
    return conclude(evaluations, settings, method, ending)
