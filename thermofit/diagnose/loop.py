"""Close the loop: find, trace, add, prove, round after round, and the check that what was added is still needed (design section 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.any_form import beside_any_form, or_any_form
from thermofit.diagnose.backward import Means, compensated, held_out_of, proof_against, still_needed, without
from thermofit.diagnose.case import Case, Refit
from thermofit.diagnose.earlier_form import families_of, in_another_form
from thermofit.diagnose.held_out import SURE, compared
from thermofit.diagnose.on_displacements import by_displacements
from thermofit.diagnose.pairs import best_pair, leaves_more_than_it_takes
from thermofit.diagnose.pose import released
from thermofit.diagnose.proof_other_tests import proof_of_refit
from thermofit.diagnose.refit import has_size
from thermofit.diagnose.rejudge import ends_of_fit, exponents_again, rejudged
from thermofit.diagnose.rescored import rescored
from thermofit.diagnose.score import OVER_NUMERICAL, Score
from thermofit.diagnose.trace import Traced, at_end, traced
from thermofit.diagnose.trial import Accepted, Trial, discriminated, moves_material, surely_better, tried
from thermofit.effects.catalogue import effect
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.fit.budget import Budget
from thermofit.fit.result import FitResult

NEAR = 1.0
"""Standard errors of a difference in held-out error within which the simpler of two refits is taken."""
OF_A_FAMILY = 2
"""Most members of the family of a body's winner that are refitted beside it."""
TRIED_WHERE_CHEAP = 8
"""Most effects that are refitted in a round where a run costs next to nothing; the best of them is accepted."""
MOST_TRIED = 4
"""Most effects of a body that are refitted in a round."""


@dataclass(frozen=True)
class RoundEnd:
    """Where a round begins or ends: parameters, those of its fit free, and the objective f = r.r there."""

    parameters: Parameters
    f: float


@dataclass(frozen=True)
class Round:
    """One turn of the loop: what was traced before, what was tried, what was accepted (one effect, two together, or none), and where its
    refit ends.

    The next round may begin elsewhere: at the optimum of the problem that knows the error of the force."""

    traced: Traced
    trials: tuple[Trial, ...]
    accepted: tuple[str, ...]
    after: RoundEnd | None = None


@dataclass(frozen=True)
class Closed:
    """Result of the loop: the rounds, the traces at the first and at the last optimum, the accepted effects, those dropped again, how the
    last problem is fitted, and the error of its discretisation.

    `unjudged`: effects that no run of the last round could judge, and why. `open_ones`: effects that were worth a refit when the most
    effects had been added."""

    rounds: tuple[Round, ...]
    first: Traced
    last: Traced
    fit: FitResult
    accepted: tuple[str, ...]
    dropped: tuple[str, ...]
    refit: Refit
    numerical: np.ndarray | None
    remarks: tuple[str, ...] = ()
    unjudged: Mapping[str, str] = field(default_factory=dict)
    open_ones: tuple[str, ...] = ()
    base: FitResult | None = None
    """The fit that ends at `first`; None where `first` is no optimum of the last problem."""
    stand_ins: Mapping[str, tuple[str, ...]] | None = None
    """Effects that the data do not tell from an accepted one at the end, by its name; None where that was not asked."""
    budget: Budget | None = None
    """What the standard errors of `fit` are made of; None where they hold the noise alone."""
    by_noise: np.ndarray | None = None
    """The standard errors of `fit` (n_p,) by the noise of the data alone, where there is a budget."""

    def as_base(self) -> Closed:
        """The base model at its optimum where nothing is added in the end: a refit without what was taken back may stop short of it."""
        if self.accepted or self.base is None or self.fit.f < self.base.f:
            return self
        return replace(self, last=self.first, fit=self.base)


def close_loop(case: Case, fit: FitResult, refit: Refit, max_effects: int, numerical: np.ndarray | None, how: str = "auto") -> Closed:
    """Rounds until nothing is accepted, at most `max_effects` effects; `case` is at its optimum `fit`."""
    rounds: list[Round] = []
    accepted: list[str] = []
    dropped: list[str] = []
    remarks: list[str] = []
    here = first = traced(case, numerical, how, fit=fit)
    base: FitResult | None = fit
    unasked: dict[str, str] = {}
    while True:
        try:
            sharp = _with_refined(here, first, how)
        except NumericsError as error:
            sharp, here = None, replace(here, case=replace(here.case, refined_at=None))
            remarks.append(f"the force is taken as exact to the end: a run of the problem that knows its error failed ({error})")
        if sharp is None and not here.whole:
            try:
                here = Means(refit, numerical, how).traced(here, fit)
            except NumericsError as error:
                unasked = {"any further effect": str(error)}
                rounds.append(Round(here, (), ()))
                break
        if sharp is not None:
            asked = (*here.case.parameters.free, *vague_exponents(here.case))
            held = tuple(n for n in asked if n not in sharp[1].case.parameters.free)
            if held:
                values = ", ".join(f"{n} = {sharp[1].case.parameters[n]:.3g}" for n in held)
                remarks.append(f"held at {values}: free beside the error of the force, it does not settle")
            first, here, fit, refit, numerical = sharp
            base = fit if here is first else None
        try:
            here = rescored(here)
        except NumericsError as error:
            remarks.append(f"no effect was judged on the known motion, because the run of that motion failed ({error})")
        first = first if rounds else here
        here = beside_any_form(_without_scores(here, dropped), accepted)
        trials, winner = next_round(here, fit, Means(refit, numerical, how), max_effects - len(accepted))
        if winner is None and len(accepted) < max_effects:
            moved = released(here, fit, Means(refit, numerical, how))
            trials += moved.trials
            if moved.accepted is not None:
                winner, refit = (moved.trials[-1], moved.accepted), moved.refit
        if len(accepted) < max_effects and (winner is None or leaves_more_than_it_takes(here, fit, trials)):
            of_displacements, winner = by_displacements(here, fit, Means(refit, numerical, how), trials, winner)
            trials += of_displacements
        if len(accepted) < max_effects:
            last_resort, winner = or_any_form(here, fit, Means(refit, numerical, how), trials, winner, first)
            trials += last_resort
        if winner is None:
            rounds.append(Round(here, tuple(trials), ()))
            break
        trial, (end, end_fit) = winner
        families = {n: f for n, f in families_of(accepted_trials(rounds)).items() if n in accepted and not is_held(here, n)}
        instead, words = in_another_form(here, fit, families, end, Means(refit, numerical, how), dropped)
        remarks += words
        if instead is not None:
            needless = f"needless where {instead.other} stands for {instead.name}"
            tried_ones = (*(replace(t, refused=needless) if t is trial else t for t in trials), instead.trial)
            rounds.append(Round(here, tried_ones, (instead.other,), place_of(instead.here)))
            accepted = [instead.other if n == instead.name else n for n in accepted]
            dropped.append(instead.name)
            remarks.append(f"{instead.other} stands for {instead.name}: beside it {' and '.join(trial.effects)} would be needless")
            here, fit = instead.here, instead.fit
            continue
        rounds.append(Round(here, tuple(trials), trial.effects, place_of(end)))
        again = rejudged(end, end_fit, (*accepted, *trial.effects), ends_of_fit(here, fit), Means(refit, numerical, how))
        here, fit = again.here, again.fit
        dropped += again.dropped
        remarks += again.remarks
        earlier = [n for n in accepted if n not in dropped]
        accepted = [*earlier, *(n for n in trial.effects if n not in dropped)]
        again = exponents_again(here, fit, earlier, Means(refit, numerical, how))
        here, fit = again.here, again.fit
        remarks += again.remarks
    untried = {n: t.refused for t in rounds[-1].trials if t.unjudged for n in t.effects if len(t.effects) == 1}
    unjudged = unasked | dict(here.unjudged) | untried
    full = len(accepted) >= max_effects
    still = tuple(s.effect for s in here.promising()) if full else ()
    names = tuple(accepted)
    closed = Closed(tuple(rounds), first, here, fit, names, tuple(dropped), refit, numerical, tuple(remarks), unjudged, still, base)
    return whole(against_base(backward_check(closed, how), how).as_base(), how)


def whole(closed: Closed, how: str) -> Closed:
    """The result with the dormant effects asked at its end as well; where that run fails, it says that nothing further was judged."""
    if closed.last.whole:
        return closed
    try:
        return replace(closed, last=Means(closed.refit, closed.numerical, how).traced(closed.last, closed.fit))
    except NumericsError as error:
        return replace(closed, unjudged={**closed.unjudged, "any further effect": str(error)})


def _without_scores(here: Traced, names: Sequence[str]) -> Traced:
    """A trace that does not ask for effects that were taken back: they would come and go without end."""
    scores = tuple(s for s in here.ranking.scores if s.effect not in names)
    return replace(here, ranking=replace(here.ranking, scores=scores)) if names else here


def next_round(here: Traced, fit: FitResult, means: Means, room: int) -> tuple[list[Trial], tuple[Trial, Accepted] | None]:
    """All trials of a round, and the accepted one that predicts held-out data best; none where there is no room for one more effect.

    Of a body none is refitted that could not gain more than the best one has: one that could and is left out leaves its place to whatever
    stands in for it.

    Of coupons, of which all are refitted: of those that predict about as well one of which every parameter is determined, and of these the
    simplest."""
    trials: list[Trial] = []
    ends: dict[str, Traced] = {}
    passed: list[tuple[Trial, Accepted]] = []
    winner: tuple[Trial, Accepted] | None = None
    for score in candidates(here) if room > 0 else ():
        if winner is not None and not here.case.cheap and not rivals(here, score.effect, winner[0].gain):
            continue
        trial, found = tried(here, fit, score, means)
        trials.append(trial)
        if found is not None:
            ends[score.effect] = found[0]
            passed.append((trial, found))
            if winner is None or trial.gain > winner[0].gain:
                winner = trial, found
    if winner is not None and here.case.cheap:
        winner = _simplest(winner, passed, ends_of_fit(here, fit))
    elif winner is not None:
        of_family, winner = _of_its_family(here, fit, winner, [t.score.effect for t in trials], ends, means)
        trials += of_family
    if room > 1 and leaves_more_than_it_takes(here, fit, trials):
        of_pairs, best = best_pair(here, fit, ends, means)
        trials += of_pairs
        if best is not None and (winner is None or best[0].gain > winner[0].gain):
            winner = best
    if winner is not None and len(winner[0].effects) == 1:
        named = _with_its_like(winner[0], winner[1][0], ends)
        trials = [named if t is winner[0] else t for t in trials]
        winner = named, winner[1]
    return trials, winner


def _of_its_family(
    here: Traced, fit: FitResult, winner: tuple[Trial, Accepted], before: Sequence[str], ends: dict[str, Traced], means: Means
) -> tuple[list[Trial], tuple[Trial, Accepted]]:
    """Trials of those of the family of a body's winner that were not tried `before`, and the best of all; none where the winner leaves no
    more than noise.

    One angle at the optimum without any of them makes a family (a logarithmic and a power law of the rate). What its first member leaves
    may be what another explains by itself, and would be taken for a further effect. Another one wins where it predicts held-out data better
    by more than a standard error, as of coupons.
    """
    trials: list[Trial] = []
    family = [s for s in here.ranking.scores if s.effect in winner[0].score.family and not s.vetoed and s.effect not in before]
    for score in family[:OF_A_FAMILY]:
        end, end_fit = winner[1]
        if end.excess(end_fit.f) == 0.0:
            break
        trial, found = tried(here, fit, score, means)
        trials.append(trial)
        if found is not None:
            ends[score.effect] = found[0]
            if surely_better(found[0], end, NEAR):
                winner = trial, found
    return trials, winner


def _simplest(best: tuple[Trial, Accepted], passed: Sequence[tuple[Trial, Accepted]], before: Mapping[str, str]) -> tuple[Trial, Accepted]:
    """Of the refits that the best one does not beat by more than a standard error, the one with the fewest parameters that have no value of
    their own and were not so `before` (at a bound, or an exponent adrift), of these the one with the fewest fitted ones (the rule of one
    standard error, Breiman et al. 1984), of these the one with the largest gain.

    A best one whose exponents are adrift has to be told apart for SURE: all of the data have brought them there, the held-out ones too.
    """
    by = SURE if best[0].adrift else NEAR
    near = [one for one in passed if one[0] is best[0] or not discriminated(best[1][0], one[1][0], by)]

    def loose(one: tuple[Trial, Accepted]) -> int:
        return len(set(ends_of_fit(*one[1])) - set(before)) + len(one[0].adrift)

    return min(near, key=lambda one: (loose(one), len(one[1][0].case.parameters.free), -one[0].gain))


def _with_its_like(trial: Trial, end: Traced, ends: Mapping[str, Traced]) -> Trial:
    """The accepted trial with the effects whose own refits predict held-out data as well in its family: this test does not tell them."""
    (score,) = trial.scores
    alike = [n for n, other in ends.items() if n not in score.family and not discriminated(end, other)]
    return replace(trial, scores=(replace(score, family=(*score.family, *alike)),))


def backward_check(closed: Closed, how: str) -> Closed:
    """Without the effects that those of later rounds have made needless: where one step says so, and the refit without them does not say
    otherwise. One that is held is a part of the law beside which a curve of any form was fitted: nothing can be asked of it alone."""
    here, fit, means, remarks = closed.last, closed.fit, Means(closed.refit, closed.numerical, how), list(closed.remarks)
    dropped = list(closed.dropped)
    latest = closed.rounds[-2].accepted if len(closed.rounds) > 1 else ()
    for name in (n for n in closed.accepted if n not in latest and not is_held(closed.last, n)):
        needed, others = still_needed(here, name), [n for n in closed.accepted if n != name and n not in dropped]
        try:
            found = compensated(here, name, others, means) if needed else without(here, name, means)
        except NumericsError as error:
            remarks.append(f"{name} {'may not be' if needed else 'is no longer'} needed, but stays in: the fit without it failed ({error})")
            continue
        if found is not None and (needed or not proof_against(found[0], here, name).convinces):
            here, fit = found
            dropped.append(name)
    names = tuple(n for n in closed.accepted if n not in dropped)
    return replace(closed, last=here, fit=fit, accepted=names, dropped=tuple(dropped), remarks=tuple(remarks))


def is_held(here: Traced, name: str) -> bool:
    """Whether no amplitude of an effect is fitted."""
    return not any(p.name in here.case.parameters.free for p in effect(name).amplitudes)


def against_base(closed: Closed, how: str) -> Closed:
    """The result without what, all together, does not predict held-out data better than the base model: the latest effects go first."""
    means = Means(closed.refit, closed.numerical, how)
    while closed.accepted:
        ends = (held_out_of(closed.first), held_out_of(closed.last))
        folds = len(closed.last.split.held_out)
        inside = compared(*ends, closed.last.rows, folds, closed.last.problem.model.noise, closed.last.columns.residual)
        inside = replace(inside, moves=moves_material(closed.first, closed.last, closed.fit))
        beyond = [p for n in closed.accepted if (p := proof_of_refit(closed.first, closed.last, n)) is not None]
        proof = min(beyond, key=lambda p: p.gain) if beyond else inside
        if proof.convinces:
            break
        name = closed.accepted[-1]
        why = f"{name} is taken back: with {', '.join(closed.accepted)} together {proof.words} beside the base model"
        try:
            here, fit = without(closed.last, name, means)
        except NumericsError as error:
            unjudged = {**closed.unjudged, name: f"together {proof.words}, but the fit without it failed: {error}"}
            return replace(closed, unjudged=unjudged)
        left = closed.accepted[:-1]
        closed = replace(closed, last=here, fit=fit, accepted=left, dropped=(*closed.dropped, name), remarks=(*closed.remarks, why))
    return closed


def accepted_trials(rounds: Sequence[Round]) -> list[Trial]:
    """The trials of what every round has accepted."""
    return [t for r in rounds for t in r.trials if t.effects == r.accepted]


def like_of(closed: Closed) -> dict[str, tuple[str, ...]]:
    """Effects that the data do not tell from each accepted one, without what was accepted besides, which is needed at the end: as the end
    tells them, or else the rounds that accepted them."""
    found = families_of(accepted_trials(closed.rounds))
    families = found if closed.stand_ins is None else closed.stand_ins
    return {name: tuple(n for n in families.get(name, ()) if n != name and n not in closed.accepted) for name in closed.accepted}


def place_of(here: Traced) -> RoundEnd:
    """Parameters of a trace and their objective."""
    return RoundEnd(here.case.parameters, float(here.columns.residual @ here.columns.residual))


def _with_refined(here: Traced, first: Traced, how: str) -> tuple[Traced, Traced, FitResult, Refit, np.ndarray] | None:
    """First and present trace by the problem that knows its errors as they are here, its fit, how to fit it and its numerical error; None
    where these are known, or the model still misses more than the error of the force could explain: its noise would then hide what is
    missing."""
    sharp = None if here.case.refined_at is None else here.case.refined_at(here.case.parameters)
    if sharp is None:
        return None
    case = replace(
        here.case,
        model=sharp.model,
        scored=sharp.scored,
        heated=sharp.heated,
        moved=sharp.moved,
        mechanics=sharp.mechanics,
        doubts=sharp.doubts,
        refined_at=sharp.again,
    )
    # An exponent that was not told beside a force taken as exact may be told now, and elsewhere: that force was wrong in its favour.
    again = (*case.parameters.free, *vague_exponents(case))
    parameters, fit = sharp.nearby(case.parameters.with_free(again), "errors told anew")
    now = traced(replace(case, parameters=parameters), sharp.numerical, how, here.split, fit)
    if here is first:
        return now, now, fit, sharp.refit, sharp.numerical
    begin = at_end(replace(case, parameters=first.case.parameters), None, here.split, now)
    # What was found first was found where nothing was hidden: only the error there is told again.
    begin = replace(begin, ranking=first.ranking, proofs=first.proofs, settings=first.settings, warmed=first.warmed)
    return begin, now, fit, sharp.refit, sharp.numerical


def vague_exponents(case: Case) -> tuple[str, ...]:
    """Exponents of effects with a free amplitude that were fitted and are held, because they were known to no better than their size."""
    free = set(case.parameters.free)
    added = [e for e in case.known if free & {p.name for p in e.amplitudes}]
    held = tuple(p.name for e in added for p in e.exponents if has_size(p) and p.name not in free)
    return tuple(n for n in held if n not in acting_on_temperatures(held))


def rivals(here: Traced, name: str, gain: float) -> bool:
    """Whether an effect could gain more on held-out data, by its linearised gain, than another one has gained by its refit."""
    proved = here.proofs[name]
    return proved.gain + SURE * proved.sigma > gain


def candidates(here: Traced) -> tuple[Score, ...]:
    """Effects that a round may refit, as `promising` orders them: the first, and of the others those with the largest held-out gain.

    Where a run costs next to nothing all of them, those of their families that pass the threshold, and what else passes it: a refit can
    tell apart what one step cannot, and can go where that step fails.
    """
    promising = here.promising()
    if not here.case.cheap:
        others = sorted(promising[1:], key=lambda s: -here.proofs[s.effect].gain)
        return (*promising[:1], *others[: MOST_TRIED - 1])
    alike = {member for s in promising for member in s.family}
    others = [s for s in here.ranking.scores if not s.vetoed and s.z > here.ranking.threshold and s not in promising]
    visible = [s for s in others if s.effect in alike or s.predicted_drop > OVER_NUMERICAL * s.numerical_drop]
    visible.sort(key=lambda s: s.effect not in alike)  # families first; within both the largest z first, as they are ranked
    return (*promising, *visible)[:TRIED_WHERE_CHEAP]


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
