"""A case of the loop at the optimum of its model, without files and tasks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Case
from thermofit.experiment.model import StageModel
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.fit.result import FitResult
from thermofit.fit.settings import Settings

PLAINLY = Settings(f_tolerance=0.01)


def refitting(
    model: StageModel, method: str = "least-squares", settings: Settings = PLAINLY
) -> Callable[[Parameters, str], tuple[Parameters, FitResult]]:
    """The optimum of the model."""

    def refit(start: Parameters, label: str, **_: Any) -> tuple[Parameters, FitResult]:
        names = start.free
        limits = [np.array([getattr(param(n), word) for n in names]) for word in ("lower", "upper", "scale")]
        problem = Problem(
            lambda x: model.residual(start.with_vector(x)),
            start.vector(),
            *limits,
            names,
            lambda x: model.linearised(start.with_vector(x), names),
        )
        fit = minimise(problem, method, settings)
        spread = LinearModel(fit.residual, fit.jacobian).covariance(names, fit.at_bound)
        return start.with_vector(fit.x), replace(fit, covariance=spread, sigma=spread.sigma)

    return refit


def fitted(case: Case) -> tuple[Case, FitResult]:
    """The case at its optimum."""
    parameters, fit = refitting(case.model)(case.parameters, "joint")
    return replace(case, parameters=parameters), fit
