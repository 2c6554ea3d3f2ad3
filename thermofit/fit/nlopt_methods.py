"""Derivative-free minimisation of f = r.r (2.24) by NLopt; Nelder-Mead with bounds is the method of the thesis."""

from __future__ import annotations

import nlopt
import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.fit.evaluate import EvaluationLimit, Evaluations
from thermofit.fit.least_squares import Ending
from thermofit.fit.problem import from_scaled, scaled_bounds, to_scaled
from thermofit.fit.settings import Settings, relative_drop

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
