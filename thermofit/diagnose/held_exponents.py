"""What exponents that a fit holds add to the uncertainty of everything else: held is not known.

An exponent of an added effect is held where the data do not determine it further, or where a fit with it free does not settle. Taken as
exact it would make parameters beside it look far better known than they are. The yield stress at no rate is what a law of the rate
extrapolates to, and hangs on the exponent by which it does. So before its data speak, a held exponent may be anywhere among the values
that the loop tries: evenly, with a variance of a twelfth of the square of their range (JCGM 100, 4.3.7). With S its column, J those of the
fitted parameters, and s what of S is beyond J,

    G = -(J^T J)^+ J^T S,   L L^T = G (s^T s (s^T C s)^-1 s^T s + u^-2)^-1 G^T,

with C the correlation of the noise: to the first order it is as if the exponent were fitted beside a prior of standard error u.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.any_form import curve_at
from thermofit.diagnose.case import Case, tried_of
from thermofit.diagnose.combined import with_wider
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.refit import VAGUE
from thermofit.diagnose.trial import held_exponents
from thermofit.diagnose.widened import most_widened, widened
from thermofit.effects.catalogue import effect
from thermofit.fit.budget import EXPONENTS, HELD_LAW, moves
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult
from thermofit.law.composition import hardening_along
from thermofit.law.hardening.catalogue import LINEAR, hardening_laws
from thermofit.law.page import law_of


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


def with_held_law(closed: Closed) -> Closed:
    """The loop's result with standard errors that know of a hardening law which is held beside a curve of any form; the same where there is
    no curve. Where the run of its columns fails, a remark says so.

    Only the sum of both is seen by displacements, but not by temperatures: what the law hardens by is stored, what the curve adds becomes
    heat. How the sum is shared out nobody knows, and a law that is wrong may end with far more, or less, stored than the material does. So
    the yield stress at no plastic strain may be off by as much as the curve adds at most, and any other number of the law by itself
    (uniform, JCGM 100, 4.3.7). Temperatures alone tell ratios; what capacity, conductivity, films, expansion and beta are hangs on it. What
    the data would tell of the law counts for nothing: it is held, and not where they would have it.
    """
    here, fit = closed.last, closed.fit
    curve = next((e for e in map(effect, closed.accepted) if e.last and e.is_on(here.case.parameters)), None)
    names = () if curve is None else tuple(n for n in held_law(here.case.parameters) if n not in fit.names)
    if curve is None or not names or fit.covariance is None or fit.jacobian is None:
        return closed
    at = here.case.parameters
    try:
        columns = here.case.model.linearised(at, names)[1]
    except NumericsError as error:
        words = f"{', '.join(names)} count as exact: the run of their derivatives failed ({error})"
        return replace(closed, remarks=(*closed.remarks, words))
    most = float(np.abs(curve_at(at, curve, here.case.largest_strain)).max())
    spread = np.array([most if n in first_yield(at) else abs(at[n]) for n in names]) / np.sqrt(3.0)
    gone = moves(LinearModel(fit.residual, fit.jacobian, here.problem.model.noise), columns * spread, fit.at_bound)
    wider = widened(fit, gone @ gone.T)
    told = most_widened(fit, wider)
    words = f"{', '.join(names)} are held beside the curve, and what of both is stored is not known"
    closed = with_wider(closed, HELD_LAW, wider)
    return replace(closed, remarks=(*closed.remarks, f"{words}; intervals hold that, most of all {told}")) if told else closed


def first_yield(parameters: Parameters) -> tuple[str, ...]:
    """Numbers of the hardening laws that the yield stress at no plastic strain hangs on."""
    nothing = float(hardening_along(0.0, law_of(parameters))[0])
    names = held_law(parameters)
    moved = {n: hardening_along(0.0, law_of(parameters.replace(**{n: 1.01 * parameters[n] + 1e-3 * param(n).scale})))[0] for n in names}
    return tuple(n for n in names if float(moved[n]) != nothing)


def held_law(parameters: Parameters) -> tuple[str, ...]:
    """Numbers of the hardening laws that say something of this material."""
    given = set(parameters.given())
    return tuple(dict.fromkeys(n for law in hardening_laws() for n in law.fitted if n in given and n != LINEAR))


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
    assert fit.covariance is not None
    gone = moves(model, columns, fit.at_bound)
    s = model.only(np.flatnonzero(~fit.at_bound)).projected(columns)
    gram = s.T @ s
    told = gram @ np.linalg.pinv(model.meat(s), rcond=1e-12, hermitian=True) @ gram
    added = gone @ np.linalg.solve(told + np.eye(len(told)), gone.T)
    return widened(fit, added)


def _in_words(held: Sequence[str], case: Case, before: FitResult, after: FitResult) -> tuple[str, ...]:
    """Which intervals hang most on exponents that are held; nothing where none does in the two digits that are shown."""
    most = most_widened(before, after)
    if not most:
        return ()
    values = ", ".join(f"{n} = {case.parameters[n]:.3g}" for n in held)
    return (f"{values}: held, for the data do not determine it; intervals hold what another value would change, most of all {most}",)
