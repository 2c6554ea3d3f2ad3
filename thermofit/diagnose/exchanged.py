"""An added effect and a part of the base model that are of one form say the same with their values exchanged.

Two lags of first order in series, or two terms of Voce, have two optima that are one and the same model: the values of the one in the
other, and the other way round. A fit ends at one of them, and its standard errors are those of that alone. Which of the two is which only
something else can tell, such as a reading of one of them. With r_1 and r_2 the residuals at both, priors among them, and s^2 the variance
that r_1 shows (at least one), the other one is as likely as

    p = 1 / (1 + exp((|r_2|^2 - |r_1|^2) / (2 s^2))),

and parameters d away there are off by p d d^T, mean square. Nothing that the model predicts is less known for it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import expit

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case
from thermofit.diagnose.combined import with_wider
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.trace import room_of
from thermofit.diagnose.widened import most_widened, widened
from thermofit.effects.catalogue import Effect, effect
from thermofit.fit.budget import EXCHANGED
from thermofit.fit.result import FitResult


def with_exchanged(closed: Closed) -> Closed:
    """The loop's result with standard errors that know of the same model with the values of an added effect and of what is of its form
    exchanged, and a remark; the same where there is none. Where its run fails, a remark says so."""
    for e in map(effect, closed.accepted):
        fit, case = closed.fit, closed.last.case
        there = exchanged(case, e, fit)
        if there is None or fit.covariance is None:
            continue
        try:
            p = likelihood(fit, case.model.residual(there))
        except NumericsError as error:
            words = f"whether {e.name} may be exchanged with what is of its form is not known: the run for it failed ({error})"
            closed = replace(closed, remarks=(*closed.remarks, words))
            continue
        apart = np.sqrt(p) * (there.with_free(fit.names).vector() - case.parameters.with_free(fit.names).vector())
        wider = widened(fit, np.outer(apart, apart))
        if most := most_widened(fit, wider):
            values = ", ".join(f"{n} = {there[n]:.3g}" for n in there.values if there[n] != case.parameters[n])
            words = f"{e.name} and what is of its form may be exchanged: {values} says the same; intervals hold both, most of all {most}"
            closed = replace(with_wider(closed, EXCHANGED, wider), remarks=(*closed.remarks, words))
    return closed


def exchanged(case: Case, one: Effect, fit: FitResult) -> Parameters | None:
    """The parameters with the values of an effect and of what is of its form exchanged; None where nothing is, where that is not fitted
    and so known, or where a bound rules the exchange out."""
    if one.twin is None:
        return None
    there = case.parameters.replace(**one.twin(case.parameters))
    own = tuple(n for n in there.values if there[n] != case.parameters[n])
    if not own or not all(n in fit.names or n in one.names for n in own):
        return None
    low, high = room_of(case.parameters, own, case.bounds)
    step = np.array([there[n] - case.parameters[n] for n in own])
    return there if np.all((step >= low) & (step <= high)) else None


def likelihood(fit: FitResult, residual: np.ndarray) -> float:
    """How likely the exchanged model with that residual (n,) is beside the fitted one."""
    here = float(fit.residual @ fit.residual)
    variance = max(1.0, here / max(len(fit.residual) - len(fit.names), 1))
    return float(expit(-(float(residual @ residual) - here) / (2.0 * variance)))
