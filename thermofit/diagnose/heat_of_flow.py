"""What an added heat of plastic flow leaves open: that it may have another form over plastic strain.

A heat that goes with flow (a latent heat, or a share of plastic work that changes with plastic strain) is told by temperatures alone. Its
form over plastic strain is one of many. What the true one has beside it looks like a share of plastic work, and that like a heat capacity
or an expansion: capacity, beta and expansion then end many of their standard errors off, at the noise. So before its data speak, at
every plastic strain the heat may be off by up to half of what the effect has at most: evenly, with a variance of a twelfth of the
square of that range (JCGM 100, 4.3.7). Over which stretch of plastic strain it is off by the same is not known either. Windows of plastic
strain are taken as they are, in twos, and so on up to all of them together, each length as likely as another. With the columns S of the
windows and the square root L of that covariance, S L enters as held exponents do (`held_exponents.in_doubt`): as much of it as the data
leave.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case
from thermofit.diagnose.combined import with_wider
from thermofit.diagnose.held_exponents import in_doubt
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.slowest_rate import EITHER_WAY
from thermofit.diagnose.widened import most_widened
from thermofit.effects.catalogue import Effect, effect
from thermofit.experiment.known_motion import Direction
from thermofit.fit.budget import FORM_OF_HEAT
from thermofit.fit.linear_model import LinearModel
from thermofit.law.composition import hardening_along
from thermofit.law.page import law_of

WINDOW = "latent_heat"
"""The effect that is a heat in a window of plastic strain."""
WINDOWS = 20
"""Windows of plastic strain, side by side: the shortest stretches in which the heat may be off on its own."""
_STRAINS = 201


def with_form_of_heat(closed: Closed) -> Closed:
    """The loop's result with standard errors that know how little of the form of an added heat of flow is known, and a remark on what that
    does; the same where none was added. Where the heat run for it fails, or the model has none, a remark says so."""
    here, fit = closed.last, closed.fit
    heats = [e for e in map(effect, closed.accepted) if e.is_on(here.case.parameters) and goes_with_flow(e, here.case)]
    windows = windows_of(here.case)
    if not heats or fit.covariance is None or fit.jacobian is None:
        return closed
    names = " and ".join(e.name for e in heats)
    exact = f"the form of {names} over plastic strain counts as exact"
    if not windows or here.case.scored is None:
        return replace(
            closed, remarks=(*closed.remarks, f"{exact}: this model does not tell what a heat in a window of plastic strain would change")
        )
    try:
        columns = here.case.scored(here.case.parameters, (), windows)[2]
    except NumericsError as error:
        words = f"{exact}: the run of what another would change failed ({error})"
        return replace(closed, remarks=(*closed.remarks, words))
    most = max(float(np.abs(heat_along(e, here.case)).max()) for e in heats)
    model = LinearModel(fit.residual, fit.jacobian, here.problem.model.noise)
    wider = in_doubt(fit, model, columns @ of_any_length(len(windows)) * EITHER_WAY * most / np.sqrt(3.0))
    told = most_widened(fit, wider)
    words = f"the form of {names} over plastic strain is one of many"
    closed = with_wider(closed, FORM_OF_HEAT, wider)
    return replace(closed, remarks=(*closed.remarks, f"{words}; intervals hold half of its heat, most of all {told}")) if told else closed


def goes_with_flow(one: Effect, case: Case) -> bool:
    """True for an effect that makes heat of plastic flow: a factor on the dissipation, or a source that is none where nothing flows."""
    if one.slot == "dissipation":
        return True
    return one.slot == "heat_source" and not np.any(_source(one, case, 0.0)) and bool(np.any(_source(one, case, 1.0)))


def heat_along(one: Effect, case: Case) -> np.ndarray:
    """Heat in mJ/mm^3 per unit of plastic strain (n,) that an effect of `goes_with_flow` adds, from no plastic strain to the largest."""
    at = case.parameters
    if one.slot != "dissipation":
        return _source(one, case, 1.0)
    strain, law = _strains(case), law_of(at)
    factor = one.act(strain, 1.0, at["theta_ref"], law, *_values(one, at))
    stress = np.asarray(hardening_along(strain, law)[0])
    return np.asarray((factor - 1.0) * at["beta"] * stress)


def windows_of(case: Case) -> tuple[Direction, ...]:
    """A unit of heat in each of WINDOWS equal windows of plastic strain up to the largest; none where the model knows no heat of flow in a
    window."""
    if WINDOW not in {e.name for e in case.known}:
        return ()
    heat, centre, width = (f"{WINDOW}.{name}" for name in ("heat", "centre", "width"))
    each = case.largest_strain / WINDOWS
    return tuple((heat, {centre: (k + 0.5) * each, width: each}) for k in range(WINDOWS))


def of_any_length(count: int) -> np.ndarray:
    """Lower triangle L (count, count) of the covariance L L^T between windows side by side, of variance one each, that are off by the same
    over stretches of 1 to `count` windows: the mean of the covariances for every length that divides `count`."""
    lengths = [n for n in range(1, count + 1) if count % n == 0]
    return np.linalg.cholesky(np.mean([np.kron(np.eye(count // n), np.ones((n, n))) for n in lengths], axis=0))


def _source(one: Effect, case: Case, rate: float) -> np.ndarray:
    """Power of a heat source (n,) in mW/mm^3 over plastic strain, at a rate in 1/s."""
    at, strain = case.parameters, _strains(case)
    nothing = np.zeros_like(strain)
    power = one.act(nothing + at["theta_ref"], strain, nothing + rate, 0.0, nothing, nothing, *_values(one, at))
    return np.asarray(power * np.ones_like(strain))


def _strains(case: Case) -> np.ndarray:
    return np.linspace(0.0, case.largest_strain, _STRAINS)


def _values(one: Effect, at: Parameters) -> list[float]:
    return [at[p.name] for p in one.params]
