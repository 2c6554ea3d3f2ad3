"""What a virtual test of the operating figures is drawn from: programme, noise, and values of a planted effect off the scanned grid.

Everything follows from the seed of a run, each matter from a stream of its own: with another effect planted the noise stays the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thermofit.diagnose.case import columns_of
from thermofit.diagnose.planting import AWAY, off_grid, secondary
from thermofit.diagnose.score import scored_alone
from thermofit.diagnose.trace import Traced
from thermofit.effects.catalogue import effect
from thermofit.experiment.known_motion import acts_in_heat

__all__ = ["AWAY", "World", "off_grid", "secondary", "smallest", "stream_of", "worlds"]
STREAMS = ("world", "secondary", "noise", "truth")
FACTOR = 2.0
"""Noise is between the usual one over FACTOR and FACTOR times it, and so is a wrong declared one beside the true one."""
WRONG = 1.0 / 3.0
"""Share of the runs in which the declared noise is not the true one."""


@dataclass(frozen=True)
class World:
    """A virtual test before anything is planted: seed, programme, its noise over the usual one, declared over true standard deviation of
    each measured quantity."""

    seed: int
    programme: str
    noise: float
    declared: Mapping[str, float]

    def random(self, stream: str) -> np.random.Generator:
        """The random numbers of one matter."""
        return stream_of(self.seed, stream)


def stream_of(seed: int, stream: str) -> np.random.Generator:
    """Random numbers of one matter of a seed."""
    return np.random.default_rng([seed, STREAMS.index(stream)])


def worlds(seed: int, programmes: Sequence[str], quantities: Sequence[str]) -> tuple[World, ...]:
    """The tests of a seed, one for every programme, in the order in which they are asked whether they show an effect."""
    random = stream_of(seed, "world")
    order = random.permutation(len(programmes))
    noise = float(np.exp(random.uniform(-np.log(FACTOR), np.log(FACTOR))))
    wrong = random.random() < WRONG
    declared = {q: float(np.exp(random.uniform(-np.log(FACTOR), np.log(FACTOR)))) if wrong else 1.0 for q in quantities}
    return tuple(World(seed, programmes[k], noise, declared) for k in order)


def smallest(here: Traced, name: str, values: Mapping[str, float]) -> float:
    """`detectable` of a dormant effect whose other Params have these values; infinite where the test does not feel it."""
    one = effect(name)
    names, block = here.problem.dormant[name]
    if not values:
        pass
    elif here.case.scored is not None and acts_in_heat(one):
        block = here.case.scored(here.case.parameters, (), [(n, dict(values)) for n in names])[2]
    else:
        block = columns_of(here.case, one, dict(values))
    found = scored_alone(here.problem, name, names, block, here.ranking.threshold)
    return float("inf") if found is None else found.detectable
