"""What the loop has accepted so far, judged again after each further effect: does every fitted parameter still have a value of its own?

An effect that was right when it was added may end at its bound, at nothing, or without a standard error once another one explains its part
better; and an effect may be bought with a parameter of the base model that it drives to its bound. Such an effect goes where the model
without it predicts held-out data as well. Where it is needed all the same, it stays, and the answer says so (`trust.undetermined`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import bare_name
from thermofit.diagnose.backward import Means, held_out_of, proof_against, without
from thermofit.diagnose.held_out import compared
from thermofit.diagnose.proof_other_tests import proof_of_refit
from thermofit.diagnose.trace import Traced
from thermofit.diagnose.trial import AWAY, freed_refit
from thermofit.effects.catalogue import effect
from thermofit.experiment.trust import undetermined
from thermofit.fit.result import FitResult


@dataclass(frozen=True)
class Rejudged:
    """The loop's state without the effects that were taken back, and why they were."""

    here: Traced
    fit: FitResult
    dropped: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def ends_of_fit(here: Traced, fit: FitResult) -> dict[str, str]:
    """Fitted parameters of a trace without a value of their own, and why; the pose of a camera is no part of an answer."""
    found = undetermined(here.case.parameters, fit, here.case.bounds)
    return {name: why for name, why in found.items() if name not in here.case.pose}


def rejudged(here: Traced, fit: FitResult, accepted: Sequence[str], before: Mapping[str, str], means: Means) -> Rejudged:
    """Without the accepted effects that have no value of their own any more, or that drive a parameter of the base model, which was not so
    `before`, to its bound, as far as held-out data do not need them; the latest first."""
    remarks: list[str] = []
    dropped: list[str] = []
    kept: set[str] = set()
    while True:
        asked = [
            (name, why) for name in reversed(accepted) if name not in (*dropped, *kept) and (why := suspicion(here, fit, name, before))
        ]
        if not asked:
            return Rejudged(here, fit, tuple(dropped), tuple(remarks))
        name, why = asked[0]
        kept.add(name)
        try:
            there, after = without(here, name, means)
        except NumericsError as error:
            remarks.append(f"{why}; {name} stays all the same: the fit without it failed ({error})")
            continue
        if len(ends_of_fit(there, after)) < len(ends_of_fit(here, fit)) or name in _not_away(here, fit, name):
            proof = proof_against(there, here, name)
            if not proof.convinces:
                remarks.append(f"{name} is taken back: {why}, and with it {proof.words}")
                dropped.append(name)
                kept.clear()
                here, fit = there, after


def exponents_again(here: Traced, fit: FitResult, earlier: Sequence[str], means: Means) -> Rejudged:
    """With exponents of effects of `earlier` rounds free that were held there, where held-out data are predicted better so.

    In its own round an effect stands in for all that is still missing, and its exponent is held where that is best; beside later effects it
    describes its own part. All together are tried, those of each effect, and each alone; what does not settle or leaves a parameter
    without a value of its own is not taken. On bodies, where a refit takes minutes, all together are tried, and taken as in a round of
    their own: where the objective falls by it.
    """
    free = here.case.parameters.free
    groups = [tuple(p.name for p in effect(name).exponents if p.name not in free) for name in earlier]
    every = tuple(n for group in groups for n in group)
    if not every:
        return Rejudged(here, fit)
    if not here.case.cheap:
        return _moved_on(here, fit, every, means)
    best: tuple[float, Traced, FitResult, tuple[str, ...]] | None = None
    for names in dict.fromkeys((every, *groups, *((n,) for n in every))):
        found = freed_refit((here.case.parameters, fit), names, " ".join(("again", *names)), means.refit)[0]
        if found is None or not found[1].converged:
            continue
        there = means.at_end(here, found)
        if _bought(here, fit, there, found[1]):
            continue
        inside = compared(
            held_out_of(here), held_out_of(there), here.rows, len(here.split.held_out), here.problem.model.noise, there.columns.residual
        )
        beyond = [proof for name in earlier if (proof := proof_of_refit(here, there, name)) is not None]
        proof = min(beyond, key=lambda p: p.gain) if beyond else inside
        if proof.convinces and (best is None or proof.gain > best[0]):
            best = proof.gain, there, found[1], names
    if best is None:
        return Rejudged(here, fit)
    gain, there, after, names = best
    said = f"{', '.join(f'{n} = {there.case.parameters[n]:.3g}' for n in names)}: fitted beside the later effects, by which held-out error "
    return Rejudged(there, after, (), (f"{said}falls by {100.0 * gain:.0f} %",))


def _moved_on(here: Traced, fit: FitResult, held: Sequence[str], means: Means) -> Rejudged:
    """The optimum of a body where held exponents are free as well; the same where it is no better, or leaves a parameter without a value of
    its own."""
    found, words = freed_refit((here.case.parameters, fit), tuple(held), " ".join(("again", *held)), means.refit)
    if found is None:
        return Rejudged(here, fit)
    there = means.at_end(here, found)
    if _bought(here, fit, there, found[1]):
        return Rejudged(here, fit)
    values = ", ".join(f"{n} = {there.case.parameters[n]:.3g}" for n in held)
    return Rejudged(there, found[1], (), (f"{values}: asked again beside the later effects; {words}",))


def _bought(here: Traced, fit: FitResult, there: Traced, after: FitResult) -> bool:
    """Whether a parameter that had a value of its own has none at the other end."""
    return bool(set(ends_of_fit(there, after)) - set(ends_of_fit(here, fit)))


def suspicion(here: Traced, fit: FitResult, name: str, before: Mapping[str, str]) -> str:
    """Why an accepted effect is doubted, empty where it is not: a value of its own, or one of the base model that was sound `before`."""
    found, own = ends_of_fit(here, fit), effect(name).names
    of_effects = {n for n in found if "." in bare_name(n)}
    words = [why for n, why in found.items() if n in own or (n not in of_effects and n not in before)]
    return "; ".join([*words, *_not_away(here, fit, name).values()][:1])


def _not_away(here: Traced, fit: FitResult, name: str) -> dict[str, str]:
    """The effect itself, and that in words, where all of its amplitudes lie within AWAY standard errors of neutral."""
    if fit.sigma is None:
        return {}
    sigma = dict(zip(fit.names, fit.sigma.tolist(), strict=True))
    own = [p for p in effect(name).amplitudes if p.name in sigma]
    if not own or any(abs(here.case.parameters[p.name] - p.neutral) > AWAY * sigma[p.name] for p in own):
        return {}
    p = own[0]
    return {name: f"{p.name} = {here.case.parameters[p.name]:.3g} +- {sigma[p.name]:.2g} is not away from {p.neutral:g} any more"}
