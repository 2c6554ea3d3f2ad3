"""Close the loop: find, trace, add, prove, round after round, and the check that what was added is still needed (design section 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.backward import Means, Refit, held_out_of, made_up_for, still_needed, without
from thermofit.diagnose.case import Case, scans
from thermofit.diagnose.elsewhere import proof_of_refit
from thermofit.diagnose.held_out import SURE, Proof, compared
from thermofit.diagnose.refit import EXPONENTS, with_effect
from thermofit.diagnose.retraced import missed, retraced
from thermofit.diagnose.score import OVER_NUMERICAL, Score, ranked
from thermofit.diagnose.trace import Traced, best_scan, traced
from thermofit.effects.catalogue import effect
from thermofit.fit.result import FitResult
from thermofit.identify.priors import beyond_error, in_words

TRIED_PER_ROUND = 2
TRIED_WHERE_CHEAP = 6
"""Most effects that are refitted in a round where a run costs next to nothing; the best of them is accepted."""
WORTH_AN_EXPONENT = 10.0
"""Fall of the objective, in units of the noise, for which exponents that were scanned are fitted."""
OWN_GAIN = 0.5
"""Part of its gain that an effect must keep with declared readings held, where its refit drives them beyond their errors."""
AWAY = 2.0
"""Standard errors by which an accepted amplitude differs from neutral."""


@dataclass(frozen=True)
class Trial:
    """One effect added and refitted: its score before, the proof by the refit, sigma of its Params, why it was refused (empty: kept), what
    became of its exponents, and the values that they ended at, with sigma where they were fitted; what its gain is without the declared
    readings that its refit drives off."""

    score: Score
    proof: Proof | None
    estimate: Mapping[str, float]
    sigma: Mapping[str, float]
    achieved_drop: float
    refused: str
    exponents: str = ""
    ends: Mapping[str, tuple[float, float | None]] = field(default_factory=dict)
    readings: str = ""

    @property
    def gain(self) -> float:
        """Relative fall of the held-out mean square by the refit; minus infinity where there was none."""
        return -np.inf if self.proof is None else self.proof.gain


@dataclass(frozen=True)
class Place:
    """Where a round begins or ends: parameters, those of its fit free, and the objective f = r.r there."""

    parameters: Parameters
    f: float


@dataclass(frozen=True)
class Round:
    """One turn of the loop: what was traced before, what was tried, what was accepted (None: nothing), and where its refit ends.

    The next round may begin elsewhere: at the optimum of the problem that knows the error of the force."""

    traced: Traced
    trials: tuple[Trial, ...]
    accepted: str | None
    after: Place | None = None


@dataclass(frozen=True)
class Closed:
    """Result of the loop: the rounds, the traces at the first and at the last optimum, the accepted effects, those dropped again, how the
    last problem is fitted, and the error of its discretisation."""

    rounds: tuple[Round, ...]
    first: Traced
    last: Traced
    fit: FitResult
    accepted: tuple[str, ...]
    dropped: tuple[str, ...]
    refit: Refit
    numerical: np.ndarray | None
    remarks: tuple[str, ...] = ()


def close_loop(case: Case, fit: FitResult, refit: Refit, max_effects: int, numerical: np.ndarray | None, how: str = "auto") -> Closed:
    """Rounds until nothing is accepted, at most `max_effects` effects; `case` is at its optimum `fit`."""
    rounds: list[Round] = []
    accepted: list[str] = []
    remarks: list[str] = []
    here = first = traced(case, numerical, how)
    while True:
        try:
            sharp = _sharpened(here, first, how)
        except NumericsError as error:
            sharp, here = None, replace(here, case=replace(here.case, sharper=None))
            remarks.append(f"the force is taken as exact to the end: a run of the problem that knows its error failed ({error})")
        if sharp is not None:
            held = tuple(n for n in here.case.parameters.free if n not in sharp[1].case.parameters.free)
            if held:
                remarks.append(f"{_held(sharp[1].case.parameters, held)}: free beside the error of the force, it does not settle")
            first, here, fit, refit, numerical = sharp
        try:
            here = retraced(here)
        except NumericsError as error:
            remarks.append(f"no effect was judged on the known motion, because the run of that motion failed ({error})")
        first = first if accepted else here
        trials: list[Trial] = []
        winner: tuple[Traced, FitResult, str] | None = None
        best = 0.0
        if len(accepted) < max_effects:
            for score in candidates(here):
                if winner is not None and not case.cheap and not _rivals(here, score.effect, best):
                    continue
                try:
                    trial, found = _tried(here, fit, score, Means(refit, numerical, how))
                except NumericsError as error:
                    trial, found = Trial(score, None, score.estimate, {}, 0.0, f"a run that judges it failed: {error}"), None
                trials.append(trial)
                if found is not None and (winner is None or trial.gain > best):
                    winner, best = (*found, score.effect), trial.gain
        if winner is None:
            rounds.append(Round(here, tuple(trials), None))
            break
        rounds.append(Round(here, tuple(trials), winner[2], place_of(winner[0])))
        here, fit, name = winner
        accepted.append(name)
    dropped = []
    means = Means(refit, numerical, how)
    for name in accepted[:-1]:
        needed, others = still_needed(here, name), [n for n in accepted if n != name and n not in dropped]
        try:
            found = made_up_for(here, name, others, means) if needed else without(here, name, means)
        except NumericsError as error:
            remarks.append(f"{name} {'may not be' if needed else 'is no longer'} needed, but stays in: the fit without it failed ({error})")
            continue
        if found is not None:
            here, fit = found
            dropped.append(name)
    return Closed(
        tuple(rounds), first, here, fit, tuple(n for n in accepted if n not in dropped), tuple(dropped), refit, numerical, tuple(remarks)
    )


def place_of(here: Traced) -> Place:
    """Parameters of a trace and their objective."""
    return Place(here.case.parameters, float(here.columns.residual @ here.columns.residual))


def _sharpened(here: Traced, first: Traced, how: str) -> tuple[Traced, Traced, FitResult, Refit, np.ndarray] | None:
    """First and present trace by the problem that knows the error of the force, its fit, how to fit it and its numerical error; None where
    the model still misses more than that error could explain: its noise would then hide what is missing."""
    sharp = None if here.case.sharper is None else here.case.sharper(here.case.parameters)
    if sharp is None:
        return None
    case = replace(here.case, model=sharp.model, scored=sharp.scored, heated=sharp.heated, sharper=None)
    parameters, fit = sharp.nearby(case.parameters, "error of the force")
    now = traced(replace(case, parameters=parameters), sharp.numerical, how, here.split)
    if here is first:
        return now, now, fit, sharp.refit, sharp.numerical
    begin = traced(replace(case, parameters=first.case.parameters), sharp.numerical, how, here.split)
    # What was found first was found where nothing was hidden: only the error there is told again.
    begin = replace(begin, ranking=first.ranking, proofs=first.proofs, settings=first.settings, warmed=first.warmed)
    return begin, now, fit, sharp.refit, sharp.numerical


def _rivals(here: Traced, name: str, gain: float) -> bool:
    """Whether an effect could gain more on held-out data, by its linearised gain, than another one has gained by its refit."""
    proved = here.proofs[name]
    return proved.gain + SURE * proved.sigma > gain


def candidates(here: Traced) -> tuple[Score, ...]:
    """Effects that a round refits, as `promising` orders them: the first, and of the others those with the largest held-out gain. Where a
    run costs next to nothing all of them, those of their families that pass the threshold, and what else passes it: a refit can tell apart
    what one step cannot, and can go where that step fails."""
    promising = here.promising()
    if not here.case.cheap:
        others = sorted(promising[1:], key=lambda s: -here.proofs[s.effect].gain)
        return (*promising[:1], *others[: TRIED_PER_ROUND - 1])
    alike = {member for s in promising for member in s.family}
    others = [s for s in here.ranking.scores if not s.vetoed and s.z > here.ranking.threshold and s not in promising]
    visible = [s for s in others if s.effect in alike or s.predicted_drop > OVER_NUMERICAL * s.numerical_drop]
    visible.sort(key=lambda s: s.effect not in alike)  # families first; within both the largest z first, as they are ranked
    return (*promising, *visible)[:TRIED_WHERE_CHEAP]


def _tried(here: Traced, fit: FitResult, score: Score, means: Means) -> tuple[Trial, tuple[Traced, FitResult] | None]:
    """Refit with one effect; accepted where the held-out error falls and the amplitude stands off neutral and off its bounds."""
    chosen = here.settings.get(score.effect)
    if chosen is None and len(scans(effect(score.effect), here.case)) > 1:
        chosen, block = best_scan(here.case, here.problem, effect(score.effect))
        alone = replace(here.problem, dormant={score.effect: (here.problem.dormant[score.effect][0], block)})
        score = replace(ranked(alone).scores[0], family=score.family)
    start = with_effect(here.case.parameters, score.effect, {**score.estimate, **(chosen or {})})
    try:
        parameters, after = means.refit(start, score.effect)
    except NumericsError as error:
        return Trial(score, None, score.estimate, {}, 0.0, f"the refit failed: {error}", ends=_ends(score.effect, start, fit)), None
    scanned = tuple(p.name for p in effect(score.effect).exponents)
    freed, said = _freed((parameters, after), scanned, score.effect, means.refit)
    if not here.case.cheap:
        trial, found = _judged(here, fit, score, freed or (parameters, after), means)
        return replace(trial, exponents=said), found
    held = _held(parameters, scanned)
    if freed is not None:
        said, of_freed = f"{held}: freeing them gains nothing on held-out data", said
        if not freed[1].converged:  # what does not settle is not determined, however well it interpolates
            said, freed = f"{held}: with them free the fit does not settle", None
    ends = [((parameters, after), said)] + ([(freed, of_freed)] if freed is not None else [])
    if len(scanned) > 1:  # an amplitude that is nothing leaves its own exponent in the air, and that spoils the fit of the others
        singly = [(_freed((parameters, after), (name,), score.effect, means.refit), name) for name in scanned]
        ends += [(one[0], f"{name} {one[1]}") for one, name in singly if one[0] is not None and one[0][1].converged]
    judged = [(*_judged(here, fit, score, end, means), words) for end, words in ends]
    trial, found, said = max(judged, key=lambda j: (j[0].refused == "", j[0].gain))
    return replace(trial, exponents=said), found


def _held(parameters: Parameters, names: Sequence[str]) -> str:
    return "held at " + ", ".join(f"{n} = {parameters[n]:.3g}" for n in names)


def _judged(
    here: Traced, fit: FitResult, score: Score, refitted: tuple[Parameters, FitResult], means: Means
) -> tuple[Trial, tuple[Traced, FitResult] | None]:
    """What a refit is worth on held-out data; `fit` is the one without the effect."""
    parameters, after = refitted
    there = means.traced(here, parameters)
    proof, estimate, sigma, refused = _worth(here, there, score, after)
    readings = ""
    if not refused:
        refused, readings = _on_readings(here, score, parameters, proof, means)
    ends = _ends(score.effect, parameters, after)
    trial = Trial(score, proof, estimate, sigma, fit.f - after.f, refused, ends=ends, readings=readings)
    return trial, None if refused else (there, after)


def _worth(here: Traced, there: Traced, score: Score, after: FitResult) -> tuple[Proof, Mapping[str, float], Mapping[str, float], str]:
    """Proof of a refit that ends `there`, estimates of the effect's Params with their standard errors, why it is refused (empty: not)."""
    names = tuple(p.name for p in effect(score.effect).params if not p.scan)
    ends, folds = (held_out_of(here), held_out_of(there)), len(here.split.held_out)
    inside = compared(*ends, here.rows, folds, here.problem.noise, there.columns.residual)
    proof = proof_of_refit(here, there, score.effect) or inside
    sigma = {n: float(after.sigma[after.names.index(n)]) if after.sigma is not None else float("inf") for n in names}
    estimate = {n: there.case.parameters[n] for n in names}
    return proof, estimate, sigma, _refusal(there, score.effect, (estimate, sigma), proof, after)


def _on_readings(here: Traced, score: Score, end: Parameters, proof: Proof, means: Means) -> tuple[str, str]:
    """Why an effect is refused whose refit drives declared readings beyond their errors (empty: it is not), and what its gain is without.

    A second refit holds these readings, and the exponents, where they were. What is missing besides may drive them as well, and they stand
    in for it (a lamp for warmer air): an effect that keeps OWN_GAIN of its gain does not rest on them.
    """
    priors = here.case.model.priors
    gone = {prior.name: prior for prior in beyond_error(priors, end, here.case.parameters)}
    if not gone:
        return "", ""
    said = "; ".join(in_words(prior, end[name]) for name, prior in gone.items())
    own = effect(score.effect)
    if set(gone) & set(own.names):
        return said, ""
    fixed = {*gone, *(p.name for p in own.params if p.scan)}
    start = end.replace(**{n: here.case.parameters[n] for n in gone}).with_free(tuple(n for n in end.free if n not in fixed))
    try:
        parameters, after = means.refit(start, f"{score.effect} readings")
    except NumericsError as error:
        return f"{said}; the refit with it held failed ({error})", ""
    there = means.traced(here, parameters)
    alone, _, _, refused = _worth(here, there, score, after)
    words = f"with {', '.join(gone)} held {alone.words}"
    return (said, words) if refused or alone.gain < OWN_GAIN * proof.gain else ("", words)


def _ends(name: str, parameters: Parameters, fit: FitResult) -> dict[str, tuple[float, float | None]]:
    """Values of the exponents of an effect, with their standard errors where the fit had them free."""
    sigma = {} if fit.sigma is None else dict(zip(fit.names, fit.sigma.tolist(), strict=True))
    return {p.name: (parameters[p.name], sigma.get(p.name)) for p in effect(name).params if p.scan}


def _freed(
    start: tuple[Parameters, FitResult], scanned: tuple[str, ...], name: str, refit: Refit
) -> tuple[tuple[Parameters, FitResult] | None, str]:
    """A second refit with scanned Params of an effect free as well where the objective falls by it, and what became of them."""
    parameters, fit = start
    if not scanned:
        return None, ""
    try:
        found = refit(
            parameters.with_free((*parameters.free, *scanned)), f"{name} {' '.join(n.rpartition('.')[2] for n in scanned)}{EXPONENTS}"
        )
    except NumericsError as error:
        return None, f"{_held(parameters, scanned)}: the refit with them free failed ({error})"
    if fit.f - found[1].f <= WORTH_AN_EXPONENT:
        return None, f"{_held(parameters, scanned)}: freeing them gains nothing"
    if not set(scanned) <= set(found[0].free):
        return found, f"{_held(found[0], scanned)}, which the data do not determine further"
    return found, "fitted" if found[1].converged else "fitted, but not settled"


def _refusal(there: Traced, name: str, found: tuple[Mapping[str, float], Mapping[str, float]], proof: Proof, fit: FitResult) -> str:
    """Why a refitted effect with `found` = (estimates, their standard errors) is not accepted, empty where it is."""
    estimate, sigma = found
    if fit.sigma is None:
        return "the refit has no standard errors: the data do not determine all of its parameters"
    if not proof.convinces:
        return f"{proof.words} only" if proof.gain > 0.0 else proof.words
    amplitude = effect(name).amplitude
    own = [p for p in effect(name).params if not p.scan]
    if fit.at_bound[fit.names.index(amplitude.name)]:
        return f"{amplitude.name} ends at its bound {estimate[amplitude.name]:.3g} {amplitude.unit}"
    near = all(abs(estimate[p.name] - p.neutral) <= AWAY * sigma[p.name] for p in own)
    if near and missed(there, name, fit) <= AWAY:
        return f"{amplitude.name} = {estimate[amplitude.name]:.3g} is not away from {amplitude.neutral:g}"
    return ""


def ranking_rows(here: Traced, accepted: Sequence[str] = ()) -> list[dict[str, Any]]:
    """The ranking as plain rows for JSON and tables."""
    rows = []
    for s in here.ranking.scores:
        proved = here.proofs.get(s.effect)
        rows.append(
            {
                "effect": s.effect,
                "family": list(s.family),
                "z": s.z,
                "predicted_drop": s.predicted_drop,
                "numerical_drop": s.numerical_drop,
                "estimate": {name: {"value": v, "sigma": s.sigma[name], "unit": param(name).unit} for name, v in s.estimate.items()},
                "detectability": s.detectability,
                "detectable": s.detectable,
                "held_out_gain": None if proved is None else proved.gain,
                "held_out_sigma": None if proved is None else proved.sigma,
                "held_out_on": None if proved is None else proved.on or "rows of the fitted data",
                "accepted": s.effect in accepted,
                "remark": here.why_not(s),
            }
        )
    return rows
