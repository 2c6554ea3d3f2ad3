"""What exponents that a fit holds add to the uncertainty of everything else: held is not known.

An exponent of an added effect is held where the data do not determine it further, or where a fit with it free does not settle. Taken as
exact it would make parameters beside it look far better known than they are. The yield stress at no rate is what a law of the rate
extrapolates to, and hangs on the exponent by which it does. So before its data speak, a held exponent may be anywhere among the values
that the loop tries: evenly, with a variance of a twelfth of the square of their range (JCGM 100, 4.3.7). What the data leave of that, and
by how much they would move it, is in `widened.known_to`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import param
from thermofit.diagnose.case import Case, tried_of
from thermofit.diagnose.combined import with_wider
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.refit import VAGUE
from thermofit.diagnose.trial import held_exponents
from thermofit.diagnose.widened import known_to, most_widened, widened
from thermofit.fit.budget import EXPONENTS, moves
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult


def with_held_exponents(closed: Closed) -> Closed:
    """The loop's result with standard errors that know of exponents which are held, and a remark on what they do; the same where none is.
    Where the run of their columns fails, a remark says so."""
    here, fit = closed.last, closed.fit
    held = held_exponents(here) if closed.accepted else ()
    if not held or fit.covariance is None or fit.jacobian is None:
        return closed
    try:
        columns = here.case.model.linearised(here.case.parameters, held)[1]
    except NumericsError as error:
        return replace(
            closed, remarks=(*closed.remarks, f"{', '.join(held)} count as exact: the run of their derivatives failed ({error})")
        )
    model = LinearModel(fit.residual, fit.jacobian, here.problem.model.noise)
    doubtful = in_doubt(fit, model, columns * np.array([spread_of(name, here.case) for name in held]))
    closed = with_wider(closed, EXPONENTS, doubtful)
    return replace(closed, remarks=(*closed.remarks, *_in_words(held, here.case, fit, doubtful)))


def spread_of(name: str, case: Case) -> float:
    """Standard error, in its unit, of an exponent that may be anywhere among the values that are tried for it; of one of which a single
    value is tried, VAGUE of its size."""
    p, value = param(name), case.parameters[name]
    to, slope = (np.log, value) if p.logarithmic else (np.asarray, 1.0)
    spread = float(np.ptp(to(np.array(tried_of(p, case))))) / np.sqrt(12.0)
    return slope * spread if spread > 0.0 else VAGUE * max(abs(value), p.scale)


def in_doubt(fit: FitResult, model: LinearModel, columns: np.ndarray) -> FitResult:
    """The fit with what errors of unit variance, which make columns (n, k) of the residual, add to its covariance: as much of them as the
    data leave."""
    gone = moves(model, columns, fit.at_bound)
    known = known_to(model.only(np.flatnonzero(~fit.at_bound)), columns, np.ones(columns.shape[1]))
    return widened(fit, gone @ known @ gone.T)


def _in_words(held: Sequence[str], case: Case, before: FitResult, after: FitResult) -> tuple[str, ...]:
    """Which intervals hang most on exponents that are held; nothing where none does in the two digits that are shown."""
    most = most_widened(before, after)
    if not most:
        return ()
    values = ", ".join(f"{n} = {case.parameters[n]:.3g}" for n in held)
    return (f"{values}: held, for the data do not determine it; intervals hold what another value would change, most of all {most}",)
