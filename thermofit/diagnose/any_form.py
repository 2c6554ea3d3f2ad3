"""The hardening of a body where no effect of the catalogue has its form: a curve over the plastic strain, added as an effect is.

A law that is wrong leaves displacements, and drives off everything else that is fitted. Temperatures on a wrong motion say little. So where
displacements or force are beyond their floor, and nothing listed was accepted, or it leaves more than it takes, or is a law of the flow
that leaves more than a tenth of what they held, the yield stress is fitted as a curve of any form beside the hardening law. It has to
predict held-out data better, as any other effect has to. It names nothing: the curve is told as unlisted, and what else is missing is
looked for beside it.

What of a law is stored is a part of its form as well, and is not known of one that a wrong form has driven off. So the law is fitted
beside the curve (`curve_and_law`), and how the dissipation changes with plastic strain where that is worth it. Else a heat that goes with
flow would be taken for another effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from thermofit.core.errors import NumericsError
from thermofit.diagnose.backward import Means
from thermofit.diagnose.case import tried_of
from thermofit.diagnose.curve_and_law import fitted_law, with_the_same_sum
from thermofit.diagnose.on_displacements import above_floor, beyond, on_their_own, worth_asking
from thermofit.diagnose.pairs import leaves_more_than_it_takes
from thermofit.diagnose.rescored import hidden
from thermofit.diagnose.trace import Traced
from thermofit.diagnose.trial import WORTH_AN_EXPONENT, Accepted, End, Trial, freed_refit, judged_trial, surely_better
from thermofit.diagnose.unlisted_field import BEHIND
from thermofit.effects.catalogue import Effect, effect
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.fit.result import FitResult
from thermofit.law.hardening.catalogue import LINEAR, hardening_laws

FURTHER = 5
"""Refits at most that go on from where the one before was cut off."""
GOES_ON = 0.02
"""Part by which the objective has to fall for another one."""
OF_FLOW = ("yield_stress", "yield_factor", "backstress")
"""Slots of effects on the flow stress, but for linear hardening, which is of the base law."""
STORED = "stored_energy"
"""The effect that says how the dissipation changes with plastic strain."""


Winner = tuple[Trial, Accepted]


def or_any_form(
    here: Traced, fit: FitResult, means: Means, before: Sequence[Trial], winner: Winner | None, first: Traced
) -> tuple[list[Trial], Winner | None]:
    """The trial of the curve after those of a round (`before`), and what the round accepts: its own `winner`, or the curve where there is
    none, or where the winner leaves more than it takes, or is a law of the flow of another form (`of_another_form`), and the curve predicts
    held-out data better by two standard errors. What has another form than any that is listed is taken in part by many; the parts would be
    accepted one after the other. Where effects that were accepted since the `first` trace have taken nine tenths of what displacements and
    force held, the hardening has the form that is listed."""
    if winner is not None and not leaves_more_than_it_takes(here, fit, before) and not of_another_form(here, winner):
        return [], winner
    if first is not here and beyond(here) <= BEHIND * beyond(first):
        return [], winner
    trials, curve = of_any_form(here, fit, means)
    better = curve is not None and (winner is None or surely_better(curve[1][0], winner[1][0]))
    return trials, curve if better else winner


def of_another_form(here: Traced, winner: Winner) -> bool:
    """Whether an effect on the flow stress leaves more than a tenth of what displacements and force held beyond their floor, and these are
    not at it: that which is the cause does not."""
    trial, (end, _) = winner
    flows = any(e.slot in OF_FLOW or LINEAR in e.names for e in map(effect, trial.effects))
    return flows and above_floor(end) and beyond(end) > BEHIND * beyond(here)


def of_any_form(here: Traced, fit: FitResult, means: Means) -> tuple[list[Trial], Winner | None]:
    """The trial of the curve, and where it ends if it is accepted; no trial where nothing asks for one. `fit` is the one without it."""
    own, unknown = _asked(here)
    if own is None:
        return [], None
    held = {LINEAR, *(name for law in hardening_laws() for name in law.fitted)}
    free = (*(n for n in here.case.parameters.free if n not in held), *(p.name for p in own.amplitudes))
    start, score = here.case.parameters.with_free(free), hidden(own.name)
    (reach,) = (p for p in own.params if p.scan)
    # What is missing may lie in a part of the strains: there the steps are wanted.
    tried: list[End] = []
    failures: list[str] = []
    for k, x in enumerate(tried_of(reach, here.case)):
        nearest = min(tried, key=lambda one: one[1].f)[0] if tried else start
        begin = with_the_same_sum(nearest, nearest.replace(**{reach.name: x}), own, here.case.largest_strain)
        try:
            tried.append(means.refit(begin, f"{own.name} {k}"))
        except NumericsError as error:
            failures.append(str(error))
    if not tried:
        return [Trial((score,), None, {}, {}, 0.0, f"the refit failed: {failures[0]}", unjudged=True)], None
    try:
        end = min(tried, key=lambda one: one[1].f)
        freed, said = freed_refit(end, (reach.name,), own.name, means.refit)
        end, settled = _settled(freed or end, own, means)
        end, law = fitted_law(end, own, here.case.model, here.case.largest_strain, lambda at, label: means.refit(at, label, exponents=True))
        end, stored = _with_stored(end, here, own, means)
        trial, found = judged_trial(here, fit, (score,), end, means)
    except NumericsError as error:
        return [Trial((score,), None, {}, {}, 0.0, f"the refit failed: {error}", unjudged=True)], None
    passed_over = f"{len(failures)} of {len(failures) + len(tried)} ranges of strain could not be run ({failures[0]})" if failures else ""
    words = (
        law or "the hardening law is held",
        stored,
        said,
        "" if settled else f"not settled after {FURTHER} further refits",
        passed_over,
        unknown,
    )
    trial = replace(trial, exponents="; ".join(w for w in words if w))
    return [trial], None if found is None else (trial, found)


def beside_any_form(here: Traced, accepted: Sequence[str]) -> Traced:
    """The trace with effects that temperatures alone show as its only candidates, where a curve of any form was accepted. It describes a
    law and is none: of what it leaves in displacements and force any other effect would take some."""
    if not any(effect(name).last for name in accepted):
        return here
    kept = tuple(s for s in here.ranking.scores if len(acting_on_temperatures(effect(s.effect).names)) == len(effect(s.effect).names))
    return replace(here, ranking=replace(here.ranking, scores=kept))


def _settled(end: End, own: Effect, means: Means) -> tuple[End, bool]:
    """The end of refits that go on as long as one is worth its time, and whether it is one: a curve that has not come to its end would
    leave something to any other effect, whose refit takes it the rest of the way. NumericsError where one fails."""
    for turn in range(FURTHER):
        then = means.refit(end[0], f"{own.name} further {turn}", exponents=True)
        fell = 1.0 - then[1].f / end[1].f
        end = then if fell > 0.0 else end
        if fell < GOES_ON:
            return end, True
    return end, False


def _with_stored(end: End, here: Traced, own: Effect, means: Means) -> tuple[End, str]:
    """The end with the change of the dissipation over plastic strain fitted as well, and words of it; as it is where temperatures are not
    fitted, the model knows of none, has it already, or where that is worth nothing. NumericsError where the refit fails."""
    dissipation = next((e for e in here.case.known if e.name == STORED and not e.is_on(end[0])), None)
    if dissipation is None or not acting_on_temperatures(end[0].free):
        return end, ""
    (slope,) = dissipation.amplitudes
    found = means.refit(end[0].with_free((*end[0].free, slope.name)), f"{own.name} {STORED}", exponents=True)
    if end[1].f - found[1].f <= WORTH_AN_EXPONENT:
        return end, ""
    return found, f"what of the hardening is stored is not known, and {slope.name} = {found[0][slope.name]:.3g} is fitted with it"


def _asked(here: Traced) -> tuple[Effect | None, str]:
    """The curve, where the driver is a body that knows it, it is off, and what is not temperature is beyond its floor: where displacements
    are compared, in a fit to them alone as well. What is missing from the balance of heat draws the law from where displacements want it.
    Where that fit fails, they are not known to ask for none, and why."""
    case = here.case
    own = next((e for e in case.known if e.last and not e.is_on(case.parameters)), None)
    if own is None or case.cheap or not above_floor(here):
        return None, ""
    if case.mechanics is None:
        return own, ""
    try:
        return (own if on_their_own(here)[1] > worth_asking(here) else None), ""
    except NumericsError as error:
        return own, f"whether displacements alone ask for it is not known: the fit to them failed ({error})"
