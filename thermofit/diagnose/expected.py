"""What the loop will say of a planted effect, by linear algebra: nothing is fitted again.

With r the residual (n,) of the data as they are and d what planting changes of it, the planted data leave r + d. The columns of all fitted
parameters and effects are those of the data as they are, so that ranking, thresholds and held-out proofs are those of a first round of the
loop (`trace`). An effect is taken to be found where it, or one that the test cannot tell from it, passes all that an effect has to pass to
be refitted. Of other noise than that in the data, an effect of standard error sd that needs a score z0 is found with the chance
Phi(|a| / sd - z0) at an amplitude a off neutral.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

from thermofit.diagnose.planting import Planting
from thermofit.diagnose.score import scored_alone
from thermofit.diagnose.trace import Traced, with_residual
from thermofit.effects.catalogue import Effect
from thermofit.experiment.known_motion import acts_in_heat

MOST = 1e6
"""Times the usual size of an amplitude beyond which none is sought."""


@dataclass(frozen=True)
class Expected:
    """What is expected of one planting.

    `size`: amplitude off neutral over its standard error, the score z that it has on average; `needed`: the z from which it is named;
    `smallest`: the distance from neutral at which it is so with even odds; `z`: its score in these data (0: it is refused); `named`: what
    passes, the first first, and does not in the data as they are; `found`: whether it or its like is among these; `channel`: the one that
    it changes most, in units of the noise.
    """

    size: float
    needed: float
    smallest: float
    z: float
    named: tuple[str, ...]
    found: bool
    channel: str

    @property
    def chance(self) -> float:
        """Chance that it is found in other noise of the same size."""
        return float(norm.cdf(self.size - self.needed))


def expected(here: Traced, one: Effect, plantings: Sequence[Planting]) -> list[Expected]:
    """What is expected of each planting into the data of a trace, in which the effect is dormant. NumericsError where a run fails."""
    return [expected_of(here, one, planting, change) for planting, change in zip(plantings, changes(here, one, plantings), strict=True)]


def changes(here: Traced, one: Effect, plantings: Sequence[Planting]) -> Iterator[np.ndarray]:
    """What each planting changes of the residual (n,). Effects of the heat equation, which is linear in them, from one heat run along all
    of them; others from a run with each."""
    case, p = here.case, one.amplitude
    others = [{n: v for n, v in planting.values.items() if n != p.name} for planting in plantings]
    if case.scored is not None and acts_in_heat(one) and len(one.amplitudes) == 1:
        along = case.scored(case.parameters, (), [(p.name, values) for values in others])[2]
        for column, planting in zip(along.T, plantings, strict=True):
            yield -column * (planting.values[p.name] - p.neutral)
        return
    model = case.model
    before = model.errors(case.parameters)
    as_it_is = model.residual(case.parameters)
    for planting in plantings:
        after = model.errors(case.parameters.replace(**planting.values))
        left = model.assemble({name: 2.0 * before[name] - after[name] for name in before})
        yield np.append(left, model.departures(case.parameters)) - as_it_is


def expected_of(here: Traced, one: Effect, planting: Planting, change: np.ndarray) -> Expected:
    """What is expected of a planting that changes the residual by `change` (n,)."""
    p = one.amplitude
    off = planting.values[p.name] - p.neutral
    alone = scored_alone(here.problem, one.name, (p.name,), -change[:, None] / off, here.ranking.threshold)
    channel = _channel(here, change)
    if alone is None:
        return Expected(0.0, float("inf"), float("inf"), 0.0, (), False, channel)
    there = with_residual(here, here.columns.residual + change)
    held = {s.effect for s in here.promising()}
    named = [s for s in there.promising() if s.effect not in held]
    z = next((s.z for s in there.ranking.scores if s.effect == one.name and not s.vetoed), 0.0)
    found = any(one.name in (s.effect, *s.family) for s in named)
    sigma = alone.sigma[p.name]
    return Expected(abs(off) / sigma, alone.detectable / sigma, alone.detectable, z, tuple(s.effect for s in named), found, channel)


def _channel(here: Traced, change: np.ndarray) -> str:
    """The channel that holds most of the square sum of a vector (n,)."""
    square = [float(np.sum(change[here.rows.channel == k] ** 2)) for k in range(len(here.case.channels))]
    return here.case.channels[int(np.argmax(square))]


def amplitude_for(share: float, of: Sequence[Expected]) -> float:
    """Distance from neutral at which that share of plantings like these is expected to be found in other noise; infinite where it is beyond
    MOST times theirs."""
    slopes = [(1.0 / (e.smallest / e.needed), e.needed) for e in of if np.isfinite(e.smallest)]
    if not slopes:
        return float("inf")

    def missing(amplitude: float) -> float:
        return float(np.sum([norm.cdf(amplitude * per - needed) for per, needed in slopes])) / len(of) - share

    unit = float(np.median([needed / per for per, needed in slopes]))
    return float(brentq(missing, 0.0, MOST * unit)) if missing(MOST * unit) > 0.0 else float("inf")
