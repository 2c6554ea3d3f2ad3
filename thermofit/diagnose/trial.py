"""One effect, or two together, added and refitted in earnest: where the refit starts, what it is worth, why it is refused."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Param, Parameters, param
from thermofit.diagnose.backward import Means, held_out_of, still_needed
from thermofit.diagnose.case import Refit, scans
from thermofit.diagnose.held_out import SURE, Proof, compared, far
from thermofit.diagnose.proof_other_tests import proof_of_refit
from thermofit.diagnose.refit import EXPONENTS, with_effect
from thermofit.diagnose.rescored import missed
from thermofit.diagnose.score import Score, scored_alone
from thermofit.diagnose.trace import Scan, Traced, best_scans, material_of
from thermofit.effects.catalogue import Effect, effect, effect_of_param, is_of_effect
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.experiment.priors import contradicted, in_words
from thermofit.experiment.trust import at_bound
from thermofit.fit.result import FitResult
from thermofit.law.page import law_of
from thermofit.records.progress import progress

WORTH_AN_EXPONENT = 10.0
"""Fall of the objective, in units of the noise, for which exponents that were scanned are fitted."""
OWN_GAIN = 0.5
"""Part of its gain that an effect must keep with declared readings held, where its refit drives them beyond their errors."""
AWAY = 2.0
"""Standard errors by which an accepted amplitude differs from neutral."""
NEARER = (1.0, 0.5, 0.25, 0.125, 0.0625, 0.015625)
"""Parts of its estimate from which a refit starts in turn, as long as the model cannot run there."""
OTHER_SCANS = 3
"""Further values of the exponents that are judged where no start can be run at the best ones, or an amplitude has no value of its own."""


@dataclass(frozen=True)
class Trial:
    """Effects added and refitted: their scores before, the proof by the refit, sigma of their Params, why they were refused (empty: kept),
    what became of their exponents, and the values that they ended at, with sigma where they were fitted; what their gain is without the
    declared readings that the refit drives off."""

    scores: tuple[Score, ...]
    proof: Proof | None
    estimate: Mapping[str, float]
    sigma: Mapping[str, float]
    achieved_drop: float
    refused: str
    exponents: str = ""
    ends: Mapping[str, tuple[float, float | None]] = field(default_factory=dict)
    readings: str = ""
    unjudged: bool = False
    """True where no run could judge it: the data may hold it or not."""
    adrift: tuple[str, ...] = ()
    """Exponents that are held where a fit which does not settle has brought them: the data have moved them, and not determined them."""

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects, one or two."""
        return tuple(s.effect for s in self.scores)

    @property
    def score(self) -> Score:
        """Score of the first one."""
        return self.scores[0]

    @property
    def gain(self) -> float:
        """Relative fall of the held-out mean square by the refit; minus infinity where there was none."""
        return -np.inf if self.proof is None else self.proof.gain


End = tuple[Parameters, FitResult]
Accepted = tuple[Traced, FitResult]


def tried(here: Traced, fit: FitResult, score: Score, means: Means) -> tuple[Trial, Accepted | None]:
    """Refit with one effect; accepted where the held-out error falls and the amplitude stands off neutral and off its bounds. `fit` is the
    one without it. A trial whose runs fail says so, and touches no other."""
    try:
        return _tried(here, fit, score, means)
    except NumericsError as error:
        return not_judged((score,), f"a run that judges it failed: {error}"), None


def _tried(here: Traced, fit: FitResult, score: Score, means: Means) -> tuple[Trial, Accepted | None]:
    own = effect(score.effect)
    scanned = here.scanned.get(score.effect, ())
    settings = here.settings.get(score.effect)
    begin = here.from_displacements.get(score.effect)
    if begin is not None:
        settings = {p.name: begin[p.name] for p in own.exponents}
    elif settings is None and (count := len(scans(own, here.case))) > 1:
        with progress(f"exponents of {own.name}", count) as advance:
            scanned = best_scans(here.case, here.problem, own, advance=partial(advance, 1))
        score, settings = at_settings(here, score, scanned[0]), scanned[0][0]
    starts = [(score, settings or {})]
    # The first values of the exponents are those of the score; at others the same run may be possible.
    others = [scan for scan in scanned if scan[0] != settings]
    starts += [(at_settings(here, score, scan), scan[0]) for scan in (others if here.case.cheap else others[:OTHER_SCANS])]
    failures: list[str] = []
    best: tuple[Trial, Accepted | None] | None = None
    first: Trial | None = None
    for score, end in islice(_begun(here, starts, means, failures), 1 + OTHER_SCANS):
        ended = ended_at(here, fit, (score,), end, means)
        first = ended[0] if first is None else first
        if best is None or (ended[1] is not None, ended[0].gain) > (best[1] is not None, best[0].gain):
            best = ended
        if not here.case.cheap or not _undetermined(here, own, ended[0]):
            break  # where an amplitude has no value of its own, the values of the exponents may be the wrong ones
    if best is None:
        return not_judged((starts[0][0],), f"the refit failed: {failures[0]}"), None
    trial, proof = best[0], first.proof if first is not None else None
    if best[1] is not None and proof is not None and trial.proof is not None and not trial.proof.not_less_than(proof):
        said = f"has no value of its own at other exponents, where {proof.words}; here {trial.proof.words} only"
        return replace(trial, refused=said), None
    return best


def _begun(
    here: Traced, starts: Sequence[tuple[Score, Mapping[str, float]]], means: Means, failures: list[str]
) -> Iterator[tuple[Score, End]]:
    """Refits with exponents held at the values of every start, of coupons the best fit first; words of those that failed go to `failures`.

    One step ranks the exponents near the optimum without the effect. Where the effect takes over a part of the base law (a fast term the
    knee, and that the slow rest), the least square sum lies in another valley, which only a refit begun at other exponents reaches.
    """
    found = ((score, nearer(here, (score,), chosen, means.refit)) for score, chosen in starts)
    ends = []
    for score, end in found:
        if isinstance(end, str):
            failures.append(end)
        elif here.case.cheap:
            ends.append((score, end))
        else:
            yield score, end
    yield from sorted(ends, key=lambda begun: begun[1][1].f)


def _undetermined(here: Traced, own: Effect, trial: Trial) -> bool:
    """Does an amplitude end at its bound, or all of them within AWAY of their standard errors of neutral?"""
    if any(_ends(here, p, trial.estimate[p.name]) for p in own.amplitudes):
        return True
    return all(abs(trial.estimate[p.name] - p.neutral) <= AWAY * trial.sigma.get(p.name, 0.0) for p in own.amplitudes)


def tried_together(
    here: Traced, fit: FitResult, scores: Sequence[Score], chosen: Mapping[str, float], means: Means
) -> tuple[Trial, Accepted | None]:
    """Refit with two effects at the given values of their exponents; accepted as one effect is, where each is needed beside the other."""
    try:
        begun = nearer(here, scores, chosen, means.refit)
        if isinstance(begun, str):
            return not_judged(tuple(scores), f"the refit failed: {begun}"), None
        return ended_at(here, fit, tuple(scores), begun, means)
    except NumericsError as error:
        return not_judged(tuple(scores), f"a run that judges it failed: {error}"), None


def not_judged(scores: tuple[Score, ...], why: str) -> Trial:
    """The trial of effects that no run could judge, and why."""
    estimate = {n: v for s in scores for n, v in s.estimate.items()}
    return Trial(scores, None, estimate, {}, 0.0, why, unjudged=True)


def at_settings(here: Traced, score: Score, scan: Scan) -> Score:
    """The score of an effect at other values of its exponents."""
    names = tuple(p.name for p in effect(score.effect).amplitudes)
    found = scored_alone(here.problem, score.effect, names, scan[1], here.ranking.threshold)
    return score if found is None else replace(found, family=score.family)


def nearer(here: Traced, scores: Sequence[Score], chosen: Mapping[str, float], refit: Refit) -> End | str:
    """Optimum from the first start that can be run: the one-step estimate of the amplitudes, or a part of it. In words why, where none.

    An effect that was refitted on the known motion begins where that refit has brought the parameters which temperatures feel."""
    why, early = "", freed_from_the_start(here, scores)
    for part in NEARER:
        start = warmed_start(here, scores) if part == 1.0 else here.case.parameters
        for score in scores:
            names = effect(score.effect).names
            estimate = {n: param(n).neutral + part * (v - param(n).neutral) for n, v in score.estimate.items()}
            begin = here.from_displacements.get(score.effect)
            if begin is not None and part == 1.0:
                moved = (n for n in start.free if n not in acting_on_temperatures(start.free))
                start, estimate = start.replace(**{n: begin[n] for n in moved}), {n: begin[n] for n in names}
            start = with_effect(start, score.effect, {**estimate, **{n: v for n, v in chosen.items() if n in names}})
        label = " ".join(s.effect for s in scores) + ("" if part == 1.0 else f" from {part:g}")
        try:
            return refit(start.with_free((*start.free, *early)), label + (EXPONENTS if early else ""), exponents=bool(early))
        except NumericsError as error:
            why = why or str(error)
    return f"{why} (nor can it be run from {NEARER[-1]:g} of the estimate)"


def warmed_start(here: Traced, scores: Sequence[Score]) -> Parameters:
    """The parameters of the trace, those that temperatures feel as the refit of these effects on the known motion has left them."""
    start = here.case.parameters
    end = here.shown.get(" ".join(s.effect for s in scores))
    return start if end is None else start.replace(**{n: end.parameters[n] for n in acting_on_temperatures(start.free)})


def freed_from_the_start(here: Traced, scores: Sequence[Score]) -> tuple[str, ...]:
    """Exponents that are fitted with the first refit of effects already: of a body those that displacements show, where a refit with them
    held first costs as much as the one with them free, and those that the refit on the known motion has fitted. What the data do not
    determine of them is held by that refit."""
    if here.case.cheap:
        return ()
    every = tuple(p.name for s in scores for p in effect(s.effect).exponents)
    shown = here.shown.get(" ".join(s.effect for s in scores))
    fitted = () if shown is None else shown.parameters.free
    return tuple(n for n in every if n in fitted or n not in acting_on_temperatures(every))


def ended_at(here: Traced, fit: FitResult, scores: tuple[Score, ...], end: End, means: Means) -> tuple[Trial, Accepted | None]:
    """The better of the refit with exponents held and with them free, judged."""
    parameters = end[0]
    names = [s.effect for s in scores]
    label = " ".join(names)
    groups = [tuple(p.name for p in effect(n).exponents) for n in names]
    scanned = tuple(n for group in groups for n in group)
    early = freed_from_the_start(here, scores)
    freed, said = freed_refit(end, tuple(n for n in scanned if n not in early), label, means.refit)
    if not here.case.cheap:
        trial, found = judged_trial(here, fit, scores, freed or end, means)
        return replace(trial, exponents="; ".join(w for w in (_of_early(end, early), said) if w)), found
    held = _held(parameters, scanned) if scanned else ""
    adrift: tuple[str, ...] = ()
    if freed is not None:
        said, of_freed = f"{held}: freeing them gains nothing on held-out data", said
        if not freed[1].converged:  # what does not settle is not determined, however well it interpolates: it is held where it has come to
            said = f"{held}: with them free the fit does not settle"
            freed, of_freed = _held_there(freed, scanned, label, means.refit)
            adrift = scanned
    none: tuple[str, ...] = ()
    ends = [(end, said, none)] + ([(freed, of_freed, adrift)] if freed is not None else [])
    if len(scanned) > 1:  # an amplitude that is nothing leaves its own exponent in the air, and that spoils the fit of the others
        parts = groups if len(names) > 1 else [(name,) for name in scanned]
        singly = [(freed_refit(end, part, label, means.refit), part) for part in parts if part]
        ends += [(one[0], f"{', '.join(part)} {one[1]}", none) for one, part in singly if one[0] is not None and one[0][1].converged]
    judged = [(*judged_trial(here, fit, scores, e, means), words, loose) for e, words, loose in ends]
    best = max(judged, key=_rank)
    earlier = held_exponents(
        here.case.parameters
    )  # held where they stood in for what is added now, they keep the others from their best fit
    for part in dict.fromkeys(((*scanned, *earlier), earlier)) if earlier else ():
        found_there, words = freed_refit(end, part, f"{label} beside", means.refit)
        if found_there is not None and found_there[1].converged:
            judged.append((*judged_trial(here, fit, scores, found_there, means), f"{', '.join(part)} {words}", none))
    other = max(judged, key=_rank)
    if other is not best and (best[1] is None or other[1] is None or asked_for(here, best[1][0], other[1][0])):
        best = other
    trial, found, said, loose = best
    return replace(trial, exponents=said, adrift=loose), found


def _rank(judged: tuple[Trial, Accepted | None, str, tuple[str, ...]]) -> tuple[bool, float]:
    """Order of ends of a trial: those that are not refused, then by what they predict."""
    return judged[0].refused == "", judged[0].gain


def asked_for(here: Traced, plain: Traced, freed: Traced) -> bool:
    """Do held-out data ask for the exponents of earlier effects that a trial has freed? As after a round (`rejudge.exponents_again`) a fall
    of their error within its uncertainty is none. It would take what belongs to the next effects."""
    ends = (held_out_of(plain), held_out_of(freed))
    return compared(*ends, here.rows, len(here.split.held_out), here.problem.model.noise, freed.columns.residual).convinces


def held_exponents(parameters: Parameters) -> tuple[str, ...]:
    """Exponents of effects that were accepted, whose amplitudes are fitted, and that a fit holds where they are."""
    free = parameters.free
    added = dict.fromkeys(effect_of_param(n) for n in free if is_of_effect(n))
    return tuple(p.name for e in added for p in e.exponents if p.name not in free)


def _of_early(end: End, early: tuple[str, ...]) -> str:
    """What became of exponents that were free from the start."""
    parameters, fit = end
    held = [n for n in early if n not in parameters.free]
    if held:
        return f"{_held(parameters, held)}, which the data do not determine further"
    return "" if not early else "fitted" if fit.converged else "fitted, but not settled"


def _held_there(end: End, scanned: Sequence[str], label: str, refit: Refit) -> tuple[End | None, str]:
    """The optimum of all others with exponents held where a fit that does not settle has brought them, and that in words; none where it
    does not settle either, or where they have run away from the values that are tried."""
    parameters = end[0]
    if not all(near_scan(param(n), parameters[n]) for n in scanned):
        return None, ""
    try:
        found = refit(parameters.with_free(tuple(n for n in parameters.free if n not in scanned)), f"{label} held there")
    except NumericsError:
        return None, ""
    return (found if found[1].converged else None), f"{_held(parameters, scanned)}, where a fit that does not settle has brought them"


def near_scan(p: Param, value: float) -> bool:
    """True where the value of an exponent lies between the values that are tried, or beyond them by no more than one of their distances;
    distances of positive values are factors. True where fewer than two are tried, or they are shares of the test."""
    tried = sorted(p.scan)
    if len(tried) < 2 or p.scan_of:
        return True
    if tried[0] > 0.0:
        return tried[0] ** 2 / tried[1] <= value <= tried[-1] ** 2 / tried[-2]
    return 2.0 * tried[0] - tried[1] <= value <= 2.0 * tried[-1] - tried[-2]


def _held(parameters: Parameters, names: Sequence[str]) -> str:
    return "held at " + ", ".join(f"{n} = {parameters[n]:.3g}" for n in names)


def freed_refit(start: End, scanned: tuple[str, ...], label: str, refit: Refit) -> tuple[End | None, str]:
    """A second refit with scanned Params of the effects free as well where the objective falls by it, and what became of them."""
    parameters, fit = start
    if not scanned:
        return None, ""
    try:
        found = refit(
            parameters.with_free((*parameters.free, *scanned)),
            f"{label} {' '.join(n.rpartition('.')[2] for n in scanned)}{EXPONENTS}",
            exponents=True,
        )
    except NumericsError as error:
        return None, f"{_held(parameters, scanned)}: the refit with them free failed ({error})"
    if fit.f - found[1].f <= WORTH_AN_EXPONENT:
        return None, f"{_held(parameters, scanned)}: freeing them gains nothing"
    if not set(scanned) <= set(found[0].free):
        return found, f"{_held(found[0], scanned)}, which the data do not determine further"
    return found, "fitted" if found[1].converged else "fitted, but not settled"


def judged_trial(here: Traced, fit: FitResult, scores: tuple[Score, ...], end: End, means: Means) -> tuple[Trial, Accepted | None]:
    """What a refit is worth on held-out data; `fit` is the one without the effects."""
    parameters, after = end
    there = means.at_end(here, end)
    worth = worth_of(here, there, scores, after)
    refused, readings = worth.refused, ""
    if not refused:
        refused, readings = on_readings(here, scores, parameters, worth.proof, means)
    ends = ends_of([s.effect for s in scores], parameters, after)
    trial = Trial(scores, worth.proof, worth.estimate, worth.sigma, fit.f - after.f, refused, ends=ends, readings=readings)
    return trial, None if refused else (there, after)


@dataclass(frozen=True)
class _Worth:
    """Proof of a refit, estimates of the Params with their standard errors, why it is refused (empty: it is not)."""

    proof: Proof
    estimate: Mapping[str, float]
    sigma: Mapping[str, float]
    refused: str


def worth_of(here: Traced, there: Traced, scores: Sequence[Score], after: FitResult) -> _Worth:
    """What a refit that ends `there` is worth. NumericsError where it cannot be run through a held-out test that was predicted before."""
    lost = {name: why for name, why in there.unpredicted.items() if name not in here.unpredicted}
    for name, why in lost.items():
        raise NumericsError(f"held-out {name}: {why}")
    own = [effect(s.effect) for s in scores]
    names = tuple(p.name for e in own for p in e.amplitudes)
    ends, folds = (held_out_of(here), held_out_of(there)), len(here.split.held_out)
    inside = compared(*ends, here.rows, folds, here.problem.model.noise, there.columns.residual)
    beyond = [proof for e in own if (proof := proof_of_refit(here, there, e.name)) is not None]
    inside = replace(inside, moves=moves_material(here, there, after))
    proof = min(beyond, key=lambda p: p.gain) if beyond else inside
    sigma = {n: float(after.sigma[after.names.index(n)]) if after.sigma is not None else float("inf") for n in names}
    estimate = {n: there.case.parameters[n] for n in names}
    refused = refusal(there, own, estimate, sigma, proof, after)
    if not refused and len(own) > 1:
        needless = [e.name for e in own if not still_needed(there, e.name)]
        refused = f"{' and '.join(needless)} not needed beside the other" if needless else ""
    return _Worth(proof, estimate, sigma, refused)


def moves_material(here: Traced, there: Traced, after: FitResult) -> bool:
    """Whether a refit has moved a parameter of the material far, where this is asked (`trace.material_of`)."""
    asked = material_of(here.case, here.answered)
    names = [here.case.parameters.free[k] for k in asked]
    if not names or after.sigma is None:
        return False
    sigma = dict(zip(after.names, after.sigma.tolist(), strict=True))
    by = np.array([there.case.parameters[n] - here.case.parameters[n] for n in names])
    return far(by, np.array(list(asked.values())), np.array([sigma.get(n, np.inf) for n in names]))


def refusal(
    there: Traced, added: Sequence[Effect], estimate: Mapping[str, float], sigma: Mapping[str, float], proof: Proof, fit: FitResult
) -> str:
    """Why refitted effects with these estimates and standard errors are not accepted, empty where they are."""
    if fit.sigma is None:
        return "the refit has no standard errors: the data do not determine all of its parameters"
    if not proof.convinces:
        return f"{proof.words} only" if proof.gain > 0.0 else proof.words
    for one in added:
        for p in one.amplitudes:
            if fit.at_bound[fit.names.index(p.name)] or _ends(there, p, estimate[p.name]):
                low, high = there.case.bounds(p.name)
                return f"{p.name} ends at its bound: {estimate[p.name]:.4g} {p.unit}, bounds {low:g} to {high:g}"
        strain = cools_from(there, one, sigma)
        if strain is not None:
            words = f"flow would take up heat from a plastic strain of {strain:.2g} on, more than all of its work being stored"
            return f"{p.name} = {estimate[p.name]:.3g}: {words}"
        near = all(abs(estimate[q.name] - q.neutral) <= AWAY * sigma[q.name] for q in one.amplitudes)
        if near and missed(there, one.name, fit) <= AWAY:
            return f"{p.name} = {estimate[p.name]:.3g} is not away from {p.neutral:g}"
    return ""


def _ends(here: Traced, p: Param, value: float) -> bool:
    """Is an amplitude at one of its bounds, those of the study."""
    return at_bound(value, here.case.bounds(p.name), p.neutral)


def cools_from(there: Traced, one: Effect, sigma: Mapping[str, float]) -> float | None:
    """Smallest plastic strain in any record at which flow would take up heat by an effect on the share of its work that becomes heat (slot
    dissipation), with its amplitudes AWAY standard errors nearer to neutral; None where it releases heat all the way."""
    if one.slot != "dissipation":
        return None
    case, values = there.case, []
    for p in one.params:
        off, doubt = case.parameters[p.name] - p.neutral, AWAY * sigma.get(p.name, 0.0)
        values.append(case.parameters[p.name] - float(np.clip(off, -doubt, doubt)))
    law = law_of(case.parameters)
    return min((strain for strain, *at in zip(*case.flow(), strict=True) if one.act(strain, *at, law, *values) < 0.0), default=None)


def on_readings(here: Traced, scores: Sequence[Score], end: Parameters, proof: Proof, means: Means) -> tuple[str, str]:
    """Why effects are refused whose refit drives declared readings beyond their errors (empty: they are not), and their gain without.

    A second refit holds these readings, and the exponents, where they were. What is missing besides may drive them as well, and they stand
    in for it (a lamp for warmer air): an effect that keeps OWN_GAIN of its gain does not rest on them.
    """
    gone = {prior.name: prior for prior in contradicted(here.case.model.priors, end, here.case.parameters)}
    if not gone:
        return "", ""
    said = "; ".join(in_words(prior, end[name]) for name, prior in gone.items())
    own = [effect(s.effect) for s in scores]
    if set(gone) & {n for e in own for n in e.names}:
        return said, ""
    fixed = {*gone, *(p.name for e in own for p in e.params if p.scan)}
    start = end.replace(**{n: here.case.parameters[n] for n in gone}).with_free(tuple(n for n in end.free if n not in fixed))
    try:
        end_held = means.refit(start, f"{' '.join(e.name for e in own)} readings")
    except NumericsError as error:
        return f"{said}; the refit with it held failed ({error})", ""
    alone = worth_of(here, means.at_end(here, end_held), scores, end_held[1])
    words = f"with {', '.join(gone)} held {alone.proof.words}"
    return (said, words) if alone.refused or alone.proof.gain < OWN_GAIN * proof.gain else ("", words)


def ends_of(names: Sequence[str], parameters: Parameters, fit: FitResult) -> dict[str, tuple[float, float | None]]:
    """Values of the exponents of effects, with their standard errors where the fit had them free."""
    sigma = {} if fit.sigma is None else dict(zip(fit.names, fit.sigma.tolist(), strict=True))
    return {p.name: (parameters[p.name], sigma.get(p.name)) for name in names for p in effect(name).params if p.scan}


def discriminated(one: Traced, other: Traced, sure: float = SURE) -> bool:
    """Whether one of two refits predicts held-out data surely better than the other (`surely_better`)."""
    return surely_better(one, other, sure) or surely_better(other, one, sure)


def surely_better(one: Traced, other: Traced, sure: float = SURE) -> bool:
    """Whether the first of two refits predicts held-out data better than the other by more than `sure` standard errors. A channel counts by
    what the better of the two leaves there, at least its noise: where both leave what neither explains, it tells nothing of which is
    right."""
    weight = _told_by(one, other)
    left = one.columns.residual * weight
    ends = (held_out_of(other) * weight, held_out_of(one) * weight)
    found = compared(*ends, one.rows, len(one.split.held_out), one.problem.model.noise, left)
    return found.gain > sure * found.sigma


def _told_by(one: Traced, other: Traced) -> np.ndarray:
    """Noise of every row (n,) over the larger of it and the rms that the better of two refits leaves in its channel."""
    channel = one.rows.channel
    out = np.ones(len(channel))
    for k in np.unique(channel):
        square = min(float(np.mean(t.columns.residual[channel == k] ** 2)) for t in (one, other))
        out[channel == k] /= max(square, 1.0) ** 0.5
    return out
