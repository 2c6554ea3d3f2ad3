"""Effects of the law that displacements alone show, where what is missing has driven the mechanical parameters far off.

From there a linear step names impostors, and the cause may not even look significant: its column is that of another material. So where a
round accepts nothing, or what it accepts leaves more than it takes, and displacements or force are beyond their floor, every effect that
acts on them and was not tried is fitted to them alone, with its exponents held. That costs a few mechanical runs each. Those that take
nearly as much as the best of them are refitted in full from there, and judged as any other effect is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.backward import Means
from thermofit.diagnose.case import scans
from thermofit.diagnose.held_out import PRACTICAL
from thermofit.diagnose.refit import with_effect
from thermofit.diagnose.score import Score
from thermofit.diagnose.trace import Traced
from thermofit.diagnose.trial import Accepted, Trial, not_judged, tried
from thermofit.diagnose.unlisted_field import BEHIND
from thermofit.effects.catalogue import effect
from thermofit.experiment.channels import field_of
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.experiment.trust import level
from thermofit.fit.result import FitResult

HALF = 0.5
"""Part of what displacements and force hold beyond their floor that an effect has to take to be refitted in full."""
OF_THE_BEST = 0.9
"""The same, of what the best one takes: a power law and a logarithm of the rate both take nearly all."""
MOST = 2
"""Most effects that are refitted in full; no further one is fitted to displacements alone once as many leave hardly anything."""

Winner = tuple[Trial, Accepted]


def by_displacements(
    here: Traced, fit: FitResult, means: Means, before: Sequence[Trial], winner: Winner | None = None
) -> tuple[list[Trial], Winner | None]:
    """Trials of effects that take most where they are fitted to the displacements alone, and what the round accepts: its own `winner`, or
    the one of these that predicts held-out data best. None of those that were tried `before`, and none where the displacements hold no more
    than their floor, or the winner has taken nine tenths of that. `fit`: the one that ends here.

    What an effect takes is told beside the same fit without it: temperatures may have drawn the parameters from where displacements want
    them. Where that leaves less than an effect has to take to be believed, none is asked."""
    case = here.case
    if case.cheap or case.mechanics is None or not above_floor(here):
        return [], winner
    if winner is not None and beyond(winner[1][0]) <= BEHIND * beyond(here):
        return [], winner
    taken: dict[str, tuple[float, Parameters]] = {}
    asked = _asked(here, before)
    try:
        square, left = on_their_own(here)
    except NumericsError as error:
        return [not_judged((score,), f"the fit to the displacements alone without it failed: {error}") for score in asked], winner
    if left <= worth_asking(here):
        return [], winner
    trials: list[Trial] = []
    for score in asked:
        to_beat = min((f for f, _ in taken.values()), default=np.inf)
        try:
            end, alone = case.mechanics(_begin(here, score), f"{score.effect} on displacements", to_beat)
        except NumericsError as error:
            trials.append(not_judged((score,), f"its fit to the displacements alone failed: {error}"))
            continue
        taken[score.effect] = alone.f, end
        if sum(square - f >= (1.0 - BEHIND) * left for f, _ in taken.values()) >= MOST:
            break
    best = max((square - f for f, _ in taken.values()), default=0.0)
    worth = [n for n, (f, _) in taken.items() if square - f >= max(HALF * left, OF_THE_BEST * best)]
    for name in sorted(worth, key=lambda n: taken[n][0])[:MOST]:
        score = next(s for s in here.ranking.scores if s.effect == name)
        trial, found = tried(replace(here, from_displacements={name: taken[name][1]}), fit, score, means)
        trials.append(trial)
        if found is not None and (winner is None or trial.gain > winner[0].gain):
            winner = trial, found
    return trials, winner


def on_their_own(here: Traced) -> tuple[float, float]:
    """What a fit of the parameters at hand to the displacements alone leaves: its square sum, and what that holds beyond the floor.
    NumericsError where it cannot be run."""
    assert here.case.mechanics is not None, "asked where displacements are compared"
    square = here.case.mechanics(here.case.parameters, "nothing added on displacements", np.inf)[1].f
    return square, square - sum((1.0 + error) * n for _, error, n, _ in mechanical(here))


def worth_asking(here: Traced) -> float:
    """What displacements have to hold beyond their floor for an effect to take as much as it has to, to be believed."""
    return PRACTICAL * float(here.columns.residual @ here.columns.residual)


def _asked(here: Traced, before: Sequence[Trial]) -> list[Score]:
    """Effects that act on what is not temperature and were not tried, those first that take most by a linear step. That its estimate cannot
    be says nothing: it is that of parameters which were driven off."""
    done = {n for t in before for n in t.effects if not t.unjudged}
    known = {e.name for e in here.case.known}
    scores = [s for s in here.ranking.scores if s.effect in known - done and not effect(s.effect).last]
    scores = [s for s in scores if len(acting_on_temperatures(effect(s.effect).names)) < len(effect(s.effect).names)]
    return sorted(scores, key=lambda s: -s.predicted_drop)


def _begin(here: Traced, score: Score) -> Parameters:
    """Where the fit begins: the amplitude of the linear step, of its probe where that cannot be; exponents at the first values tried."""
    own = effect(score.effect)
    chosen = here.settings.get(own.name) or next(iter(scans(own, here.case)), {})
    probes = {p.name: p.neutral + (p.scale if p.probe is None else p.probe) for p in own.amplitudes}
    amounts = probes if score.vetoed else {p.name: score.estimate.get(p.name, p.neutral) for p in own.amplitudes}
    start = with_effect(here.case.parameters, own.name, {**amounts, **chosen})
    return start.with_free(tuple(n for n in start.free if not param(n).scan or n in here.case.parameters.free))


def beyond(here: Traced) -> float:
    """Square sum of what is not temperature beyond its noise and the error of mesh and steps."""
    return sum(max((square - error - 1.0) * n, 0.0) for square, error, n, _ in mechanical(here))


def above_floor(here: Traced) -> bool:
    """Whether a channel that is not temperature holds more than its floor."""
    return any(level(channel, square, error, n).above for square, error, n, channel in mechanical(here))


def mechanical(here: Traced) -> list[tuple[float, float, int, str]]:
    """Mean square of the residual and of the error of mesh and steps in it, number, and name of every channel that is not temperature."""
    may_be_left = here.problem.may_be_left
    numerical = np.zeros(len(here.columns.residual)) if may_be_left is None else may_be_left
    found = []
    for k, c in enumerate(here.case.model.comparisons):
        rows = here.rows.channel == k
        square, error = (float(np.mean(v[rows] ** 2)) for v in (here.columns.residual, numerical))
        if field_of(c.channel) != "theta":
            found.append((square, error, c.n, c.channel))
    return found
