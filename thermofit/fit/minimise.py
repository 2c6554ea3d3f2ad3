"""One door to all optimisers; derivative-free ones are those of NLopt. Nelder-Mead with bounds is the method of the thesis."""

from __future__ import annotations

from collections.abc import Callable

import nlopt
import numpy as np

from thermofit.core.errors import NumericsError, StudyError
from thermofit.fit.evaluate import EvaluationLimit, Evaluations
from thermofit.fit.least_squares import Ending, trust_region
from thermofit.fit.problem import Problem, from_scaled, scaled_bounds, to_scaled
from thermofit.fit.result import FitResult, conclude
from thermofit.fit.secant import secant_gauss_newton
from thermofit.fit.settings import Hooks, Settings, relative_drop

ALGORITHMS: dict[str, int] = {
    "nelder-mead": nlopt.LN_NELDERMEAD,
    "sbplx": nlopt.LN_SBPLX,
    "bobyqa": nlopt.LN_BOBYQA,
    "cobyla": nlopt.LN_COBYLA,
}

_SUCCESS = {
    nlopt.SUCCESS: "NLopt reports success",
    nlopt.STOPVAL_REACHED: "the objective is zero",
    nlopt.FTOL_REACHED: "the objective no longer changes",
    nlopt.XTOL_REACHED: "the parameters no longer change",
}


def derivative_free(evaluations: Evaluations, settings: Settings, method: str) -> Ending:
    """Minimise with one of ALGORITHMS on scaled variables; failed evaluations count as `Evaluations.penalty`.

    NumericsError if the start fails, because nothing then tells the optimiser where to go.
    """
    problem = evaluations.problem
    start = evaluations.outcome(problem.start)
    if start.reason:
        raise NumericsError(f"the forward model fails at the start {evaluations.describe(problem.start)}: {start.reason}; start elsewhere")
    optimiser = _optimiser(evaluations, settings, method)
    if method != "bobyqa":  # one poor step of its quadratic model changes f little, far from any minimum: its radius alone tells the end
        optimiser.set_ftol_rel(relative_drop(settings, evaluations.size, len(problem.names)))
    try:
        optimiser.optimize(to_scaled(problem, problem.start))
    except EvaluationLimit as limit:
        return Ending(False, f"not converged: {limit}; raise max_evaluations or start closer")
    except nlopt.RoundoffLimited:
        # Progress is below the rounding of f: the point is good, whether it is a minimum the caller checks with derivatives.
        return Ending(True, "rounding stops further progress")
    except nlopt.ForcedStop:
        return Ending(False, "not converged: the optimisation was stopped from outside; run it again to resume")
    except (nlopt.runtime_error, RuntimeError, ValueError, MemoryError) as error:
        raise NumericsError(f"NLopt's {method} gives up: {error}; use another method or initial_step") from error
    code = optimiser.last_optimize_result()
    if code in _SUCCESS:
        return Ending(True, _SUCCESS[code])
    return Ending(False, f"not converged: NLopt ends with code {code}; raise max_evaluations or start closer")


def _optimiser(evaluations: Evaluations, settings: Settings, method: str) -> nlopt.opt:
    problem = evaluations.problem
    size = len(problem.names)
    optimiser = nlopt.opt(ALGORITHMS[method], size)
    lower, upper = scaled_bounds(problem)
    optimiser.set_lower_bounds(lower)
    optimiser.set_upper_bounds(upper)

    def objective(z: np.ndarray, _gradient: np.ndarray) -> float:
        return evaluations.objective(from_scaled(problem, z))

    optimiser.set_min_objective(objective)
    optimiser.set_initial_step(np.minimum(settings.initial_step, (upper - lower) / 4.0))
    optimiser.set_xtol_abs(settings.x_tolerance)
    optimiser.set_stopval(0.0)
    # Points answered from memory do not count against the limit; a simplex that has collapsed onto such points must end too.
    optimiser.set_maxeval(2 * settings.max_evaluations)
    return optimiser


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
    return conclude(evaluations, settings, method, detail, ending)
