"""Two effects that help only together: which pairs are worth a refit, and the refits themselves.

A plateau needs the hardening after it, a fast backstress the modulus that it hides: each alone takes little, or is refused. Where the best
single effect leaves more than it takes, pairs of all that stands above the threshold, and of the families, are fitted together. Their
order is the fall of the square sum by one joint step of both and of all fitted parameters, at the best values of the exponents.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any

import numpy as np
from scipy.stats import chi2

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import param
from thermofit.diagnose.backward import Means, held_out_of
from thermofit.diagnose.held_out import compared
from thermofit.diagnose.rescored import shown_alone, shown_together
from thermofit.diagnose.score import LEVEL, Score
from thermofit.diagnose.trace import Scan, Traced
from thermofit.diagnose.trial import Accepted, Trial, tried_together
from thermofit.effects.catalogue import effect
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult

PARTNERS = 8
"""Effects of which pairs are made, the strongest."""
REFITTED = 6
"""Pairs that are refitted in a round, those with the largest predicted fall."""
ON_KNOWN_MOTION = 3
"""The same of a body, on the known motion; the best of them is refitted in full."""


@dataclass(frozen=True)
class Pair:
    """Scores of two effects with the estimates of a joint step, the values of their exponents, and the predicted fall of r.r."""

    scores: tuple[Score, Score]
    settings: dict[str, float]
    drop: float
    looked_at: int = 1
    """Values of the exponents at which it was looked at."""


def leaves_more_than_it_takes(here: Traced, fit: FitResult, trials: Sequence[Trial]) -> bool:
    """Whether the best single refit takes less than half of what the residual holds beyond its floor, and that is more than chance."""
    beyond = here.excess(fit.f)
    if beyond == 0.0:
        return False
    return max((t.achieved_drop for t in trials if not t.refused), default=0.0) < 0.5 * beyond


def partners(here: Traced) -> tuple[Score, ...]:
    """Effects of which pairs are made: above the threshold and above what the error of mesh and steps alone would take, and those of their
    families; the strongest first."""
    above = [s for s in here.ranking.scores if s.z > here.ranking.threshold and s.predicted_drop >= s.numerical_drop]
    alike = {member for s in above for member in s.family}
    found = [s for s in here.ranking.scores if s in above or s.effect in alike]
    return tuple(sorted(found, key=lambda s: -s.z)[:PARTNERS])


def pairs_of(here: Traced) -> list[Pair]:
    """Pairs by the fall of r.r that a joint step predicts, the largest first, each at the best values of its exponents."""
    scores = partners(here)
    scans = {s.effect: here.scanned.get(s.effect) or (({}, here.problem.dormant[s.effect][1]),) for s in scores if s.effect in _known(here)}
    own = {(name, k): here.problem.model.projected(block) for name, tried in scans.items() for k, (_, block) in enumerate(tried)}
    left, found = here.problem.model.left, []
    for one, other in combinations([s for s in scores if s.effect in scans], 2):
        best: Pair | None = None
        for i, j in product(range(len(scans[one.effect])), range(len(scans[other.effect]))):
            pair = stepped((one, other), (scans[one.effect][i], scans[other.effect][j]), (own[one.effect, i], own[other.effect, j]), left)
            if pair is not None and (best is None or pair.drop > best.drop):
                best = pair
        if best is not None:
            found.append(replace(best, looked_at=len(scans[one.effect]) * len(scans[other.effect])))
    return sorted(found, key=lambda p: -p.drop)


def _known(here: Traced) -> set[str]:
    return set(here.problem.dormant)


def stepped(scores: tuple[Score, Score], at: tuple[Scan, Scan], s: tuple[np.ndarray, np.ndarray], left: np.ndarray) -> Pair | None:
    """A pair after one joint step; None where both act alike, or an estimate is outside its physical bounds."""
    both = LinearModel(left, np.concatenate(s, axis=1)).triangular
    if both.condition > 1e4:
        return None
    step = both.free_step
    names = [tuple(p.name for p in effect(score.effect).amplitudes) for score in scores]
    moved = {n: param(n).neutral + float(a) for n, a in zip((*names[0], *names[1]), step, strict=True)}
    if any(not param(n).lower <= v <= param(n).upper for n, v in moved.items()):
        return None
    told = tuple(replace(score, estimate={n: moved[n] for n in own}) for score, own in zip(scores, names, strict=True))
    return Pair((told[0], told[1]), {**at[0][0], **at[1][0]}, float(-both.residual @ both.columns @ step))


def best_pair(here: Traced, fit: FitResult, singles: dict[str, Traced], means: Means) -> tuple[list[Trial], tuple[Trial, Accepted] | None]:
    """All trials of pairs, and the accepted one that predicts held-out data best.

    `singles` are the ends of effects that were refitted alone and not refused: a pair has to predict better than each of its own. And so
    many pairs at so many values of their exponents were looked at that chance alone would find one: its fall of the square sum has to be
    more.
    """
    trials: list[Trial] = []
    best: tuple[Trial, Accepted] | None = None
    found_pairs = pairs_of(here)
    protected = from_protected(here)
    plain = [] if here.against_source else worth_a_refit(here, found_pairs)
    for pair, ends in [protected] if protected is not None else [(p, {}) for p in plain]:
        there = replace(here, shown={**here.shown, **ends}) if ends else here
        trial, found = tried_together(there, fit, pair.scores, pair.settings, means)
        if found is not None and trial.achieved_drop <= by_chance(found_pairs, found[1], fit):
            trial, found = replace(trial, refused="of all pairs that were looked at, one reaches as much by chance"), None
        if found is not None:
            alone = [name for name in trial.effects if name in singles and not _better(here, singles[name], found[0])]
            if alone:
                trial, found = replace(trial, refused=f"predicts held-out data no better than {alone[0]} alone"), None
        trials.append(trial)
        if found is not None and (best is None or trial.gain > best[0].gain):
            best = (trial, found)
    return trials, best


def from_protected(here: Traced) -> tuple[Pair, dict[str, Any]] | None:
    """Of pairs that explain on the known motion what a broad source explains the one that predicts best, and where its refit there ends, by
    both names; None where there are none."""
    if not here.together:
        return None
    scores, end = max(here.together, key=lambda found: found[1].proof.gain)
    names = [s.effect for s in scores]
    settings = {p.name: end.parameters[p.name] for name in names for p in effect(name).exponents}
    return Pair((scores[0], scores[1]), settings, 0.0), {" ".join(names): end}


def by_chance(pairs: Sequence[Pair], after: FitResult, before: FitResult) -> float:
    """Fall of r.r that the best of all pairs reaches by chance with probability LEVEL, in units of what the refit leaves of its noise."""
    looked_at = sum(pair.looked_at for pair in pairs)
    left = max(after.f / max(len(after.residual) - len(after.x), 1), 1.0)
    return left * float(chi2.isf(LEVEL / max(looked_at, 1), max(len(after.x) - len(before.x), 2)))


def _better(here: Traced, one: Traced, other: Traced) -> bool:
    ends = (held_out_of(one), held_out_of(other))
    return compared(*ends, here.rows, len(here.split.held_out), here.problem.model.noise, other.columns.residual).convinces


def worth_a_refit(here: Traced, pairs: Sequence[Pair]) -> list[Pair]:
    """The pairs that are refitted: of coupons those with the largest predicted fall, of a body the one that temperatures on the known
    motion show to predict better than every single effect there; none where that cannot be asked."""
    if here.case.cheap:
        return list(pairs[:REFITTED])
    if here.case.heated is None:
        return []
    heat = here.case.heated(here.case.parameters)
    if heat is None:
        return []
    try:
        alone = shown_alone(here, heat)
    except NumericsError:
        return []
    if not alone:
        return []
    ends = []
    for pair in [p for p in pairs if {s.effect for s in p.scores} <= set(alone)][:ON_KNOWN_MOTION]:
        found = shown_together(here, heat, pair.scores, pair.settings)
        if found is not None:
            ends.append((pair, found))
    if not ends:
        return []
    pair, end = max(ends, key=lambda e: e[1].proof.gain)
    most = max(alone.values(), key=lambda e: e.proof.gain)
    better = compared(most.held_out, end.held_out, here.rows, len(here.split.held_out), here.problem.model.noise, end.left)
    return [pair] if better.convinces else []
