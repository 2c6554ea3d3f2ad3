"""What a law of the rate says below the slowest rate of a test rests on its form alone.

Data tell how the yield stress changes between the slowest and the fastest rate at which the material flows. The yield stress at no rate,
from which the base law counts, is what the form of the law extrapolates to. A power, a logarithm and an arsinh that agree within the noise
wherever there are data part below them by as much as they say there. So the overstress s at the slowest rate may be anywhere between half
of what the form says and one and a half times that: evenly, with a standard error u = s / (2 sqrt 3) (JCGM 100, 4.3.7). That is a shift of
the overstress at all rates of the test. A law of the rate makes one where its reference rate r_0 moves and its amplitude a keeps what the
data tell: ds/d(r_0) = b + c ds/da wherever it flows, by least squares. With S = dr/d(r_0) u / |b|, and J the columns of the parameters,
exponents of the law left out,

    G = -(J^T J)^+ J^T S,   C += G G^T.

Of a law that has become a straight line over the rate, r_0 does what a does and shifts nothing: then another exponent tells the shift.
No datum makes it smaller, only a test with slower flow does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Param
from thermofit.diagnose.case import Case, feels_rate
from thermofit.diagnose.combined import with_wider
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.widened import most_widened, widened
from thermofit.effects.catalogue import Effect, effect
from thermofit.fit.budget import SLOWER_RATES, moves
from thermofit.fit.linear_model import LinearModel
from thermofit.law.page import law_of

SLOWER = 0.05
"""Share of the plastic strain that flows more slowly than what counts as the slowest rate of a test."""
EITHER_WAY = 0.5
"""Part of the overstress at the slowest rate by which another form may have more or less of it."""
_SHIFTS = 1e-2
"""Part of what an exponent does to the overstress that has to be a shift of it: less is what is left of a difference of equal numbers."""
_STEP = 1e-30


def with_slowest_rate(closed: Closed) -> Closed:
    """The loop's result with standard errors that know how little a law of the rate tells below the slowest rate of the test, and a remark
    on what that does; the same where none was added. Where a run for it fails, or a law has no reference rate, a remark says so."""
    here = closed.last
    for e in laws_of_rate(here.case, closed.accepted):
        fit = closed.fit
        if fit.covariance is None or fit.jacobian is None:
            break
        try:
            told = told_at(here.case, e)
        except NumericsError as error:
            words = f"what {e.name} says below the slowest rate of the test counts as exact: a run for it failed ({error})"
            closed = replace(closed, remarks=(*closed.remarks, words))
            continue
        if isinstance(told, str):
            closed = replace(closed, remarks=(*closed.remarks, told))
            continue
        model = LinearModel(fit.residual, fit.jacobian, here.problem.model.noise)
        held = fit.at_bound | np.isin(fit.names, [p.name for p in e.exponents])
        gone = moves(model, told.column, held)
        wider = widened(fit, gone @ gone.T)
        most = most_widened(fit, wider)
        words = f"no rate below {told.slowest:.2g} 1/s is in the data, and what {e.name} says there rests on its form"
        remarks = (*closed.remarks, f"{words}; intervals hold half of it, most of all {most}") if most else closed.remarks
        closed = replace(with_wider(closed, SLOWER_RATES, wider), remarks=remarks)
    return closed


@dataclass(frozen=True)
class SlowestRate:
    """The slowest rate of a test in 1/s, and what one standard error of the overstress there, the same at all rates, makes of the residual
    (n, 1)."""

    slowest: float
    column: np.ndarray


def laws_of_rate(case: Case, accepted: Sequence[str]) -> list[Effect]:
    """The laws of the rate among accepted effects that are on where the parameters of a case are."""
    return [e for e in map(effect, accepted) if e.is_on(case.parameters) and feels_rate(e, case.parameters)]


def told_at(case: Case, law: Effect) -> SlowestRate | str:
    """What a law of the rate leaves unknown below the slowest rate, where the parameters of a case are; in words why that is not told.
    NumericsError where a run fails."""
    of_rate = reference_of(law)
    if of_rate is None:
        return f"{law.name} has no reference rate: intervals hold nothing of what its form says below the slowest rate of the test"
    told = [(p, *doubt_of(case, law, p)) for p in (of_rate, *(q for q in law.exponents if q is not of_rate))]
    by, slowest, doubt = next((one for one in told if np.isfinite(one[2])), (None, told[0][1], 0.0))
    if by is None:
        return f"what {law.name} says below {slowest:.2g} 1/s counts as exact: no exponent of it shifts the stress at all rates"
    return SlowestRate(slowest, doubt * case.model.linearised(case.parameters, (by.name,))[1])


def reference_of(law: Effect) -> Param | None:
    """The reference rate of a law of the rate; None where it has none."""
    return next((p for p in law.params if p.unit == "1/s" and p.logarithmic), None)


def doubt_of(case: Case, law: Effect, by: Param) -> tuple[float, float]:
    """The slowest rate in 1/s, and the standard error of an exponent, of the reference rate as a rule and in its unit, that shifts the
    overstress there by its doubt; infinite where it shifts nothing."""
    accumulated, rate, theta, grown = case.flows()
    order = np.argsort(rate)
    share = np.cumsum(grown[order]) / grown.sum()
    slowest = float(rate[order][int(np.searchsorted(share, SLOWER))])

    page, here = law_of(case.parameters), [case.parameters[n] for n in law.names]

    def slope(name: str) -> np.ndarray:
        values = [v + 1j * _STEP * (n == name) for n, v in zip(law.names, here, strict=True)]
        return np.imag(law.act(accumulated, rate, theta, page, *values)) / _STEP * np.ones(len(rate))

    off = [law.amplitude.neutral if n == law.amplitude.name else v for n, v in zip(law.names, here, strict=True)]
    at_slowest = (float(np.median(accumulated)), slowest, float(np.median(theta)), page)
    overstress = abs(law.act(*at_slowest, *here) - law.act(*at_slowest, *off))
    weight = np.sqrt(grown)
    both = weight[:, None] * np.column_stack([np.ones(len(rate)), slope(law.amplitude.name)])
    done = weight * slope(by.name)
    shift = abs(float(np.linalg.lstsq(both, done, rcond=None)[0][0]))
    if shift * float(np.linalg.norm(weight)) <= _SHIFTS * float(np.linalg.norm(done)):
        return slowest, float("inf")
    return slowest, EITHER_WAY * overstress / np.sqrt(3.0) / shift
