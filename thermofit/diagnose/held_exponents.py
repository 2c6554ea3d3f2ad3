"""What exponents that a fit holds add to the uncertainty of everything else: held is not known.

An exponent of an added effect is held where the data do not determine it further, or where a fit with it free does not settle. Taken as
exact it would make parameters beside it look far better known than they are. The yield stress at no rate is what a law of the rate
extrapolates to, and hangs on the exponent by which it does. So before its data speak, a held exponent may be anywhere among the values
that the loop tries: evenly, with a variance of a twelfth of the square of their range (JCGM 100, 4.3.7). What the data leave of that, and
by how much they would move it, is in `widened.known_to`.

A law without an exponent may be one with an exponent that is held as well. A softening in proportion to the temperature is a power of it
with exponent one, and of some kelvins no other is asked for (`case.not_identifiable`). The yield stress beside it hangs on that too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Case, tried_of
from thermofit.diagnose.combined import with_wider
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.refit import VAGUE
from thermofit.diagnose.trial import held_exponents
from thermofit.diagnose.widened import known_to, most_widened, widened
from thermofit.effects.catalogue import Effect, effect, effects
from thermofit.fit.budget import EXPONENTS, moves
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult
from thermofit.law.page import law_of
from thermofit.law.page_rates import STEP

_OF_YIELD = ("yield_stress", "yield_factor")
"""Slots whose laws are asked by plastic strain, its rate and temperature."""
_FLOWS = ((0.01, 1e-3), (0.1, 1e-2))
"""Plastic strain and its rate in 1/s at which two laws are compared."""
_WARMER = (-7.0, 11.0, 40.0)
"""K above the reference, away from round temperatures."""
_SAME = 1e-9
"""Relative difference of two laws that say the same."""


def with_held_exponents(closed: Closed) -> Closed:
    """The loop's result with standard errors that know of exponents which are held, and a remark on what they do; the same where none is.
    Where the run of their columns fails, a remark says so."""
    here, fit = closed.last, closed.fit
    if fit.covariance is None or fit.jacobian is None:
        return closed
    held = held_at(here.case, closed.accepted)
    every = {name: case for case, names in held for name in names}
    if not held:
        return closed
    try:
        columns = columns_of(held)
    except NumericsError as error:
        return replace(
            closed, remarks=(*closed.remarks, f"{', '.join(every)} count as exact: the run of their derivatives failed ({error})")
        )
    model = LinearModel(fit.residual, fit.jacobian, here.problem.model.noise)
    doubtful = in_doubt(fit, model, columns)
    closed = with_wider(closed, EXPONENTS, doubtful)
    return replace(closed, remarks=(*closed.remarks, *_in_words(every, fit, doubtful)))


Held = list[tuple[Case, tuple[str, ...]]]
"""Exponents that are held, each group with the case in which it is moved."""


def held_at(case: Case, accepted: Sequence[str]) -> Held:
    """The exponents that are held where the parameters of a case are, beside accepted effects, and those of laws that are more general than
    one of these."""
    held = held_exponents(case.parameters) if accepted else ()
    general = [(replace(case, parameters=there), names) for there, names in more_general(case, accepted)]
    return [*([(case, held)] if held else []), *general]


def columns_of(held: Held) -> np.ndarray:
    """What one standard error of each exponent, before its data speak, makes of the residual (n, k). NumericsError where a run fails."""
    groups = [case.model.linearised(case.parameters, names)[1] * [spread_of(n, case) for n in names] for case, names in held]
    return np.concatenate(groups, axis=1)


def more_general(case: Case, accepted: Sequence[str]) -> list[tuple[Parameters, tuple[str, ...]]]:
    """Laws of a slot that are those of an accepted effect at neutral exponents, and that a test is not asked for, since it spans too few
    kelvins: the parameters with each in the stead of the effect, and its exponents."""
    found = []
    for name in accepted:
        own = effect(name)
        narrow = [e for e in effects((own.slot,)) if e.span > 0.0 and e not in case.known] if own.slot in _OF_YIELD else []
        for other in narrow:
            if ratio := _in_proportion(own, other, case):
                exponents = {q.name: q.neutral for q in other.exponents}
                instead = {other.amplitude.name: ratio * case.parameters[own.amplitude.name], own.amplitude.name: own.amplitude.neutral}
                found.append((case.parameters.replace(**exponents, **instead), tuple(exponents)))
    return found


def _in_proportion(own: Effect, other: Effect, case: Case) -> float:
    """Amplitude of the other law over that of the accepted one where they say the same at neutral exponents; zero where they do not."""
    parameters, law = case.parameters, law_of(case.parameters)

    def slopes(one: Effect) -> np.ndarray:
        values = [parameters[q.name] if one is own else q.neutral for q in one.params]
        moved = [complex(v, STEP) if q == one.amplitude else v for v, q in zip(values, one.params, strict=True)]
        return np.array([np.imag(one.act(*flow, parameters["theta_ref"] + warmer, law, *moved)) for flow in _FLOWS for warmer in _WARMER])

    of_own, of_other = slopes(own), slopes(other)
    ratio = float(of_other @ of_own) / max(float(of_other @ of_other), 1e-300)
    return ratio if np.allclose(of_own, ratio * of_other, rtol=_SAME, atol=0.0) else 0.0


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


def _in_words(held: Mapping[str, Case], before: FitResult, after: FitResult) -> tuple[str, ...]:
    """Which intervals hang most on exponents that are held; nothing where none does in the two digits that are shown."""
    most = most_widened(before, after)
    if not most:
        return ()
    values = ", ".join(f"{n} = {case.parameters[n]:.3g}" for n, case in held.items())
    return (f"{values}: held, for the data do not determine it; intervals hold what another value would change, most of all {most}",)
