"""What a virtual test of the operating figures is drawn from: programme, noise, and values of a planted effect off the scanned grid.

Everything follows from the seed of a run, each matter from a stream of its own: with another effect planted the noise stays the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from thermofit.core.errors import NumericsError
from thermofit.diagnose.case import columns_of, scans
from thermofit.diagnose.planting import off_grid, secondary
from thermofit.diagnose.score import ALIKE, likeness, ranked
from thermofit.diagnose.trace import Traced
from thermofit.effects.catalogue import Effect
from thermofit.experiment.known_motion import acts_in_heat

__all__ = ["World", "alike_to", "directions", "off_grid", "secondary", "smallest", "stream_of", "worlds"]
STREAMS = ("world", "secondary", "noise", "truth", "memory", "specimen")
FACTOR = 2.0
"""Noise is between the usual one over FACTOR and FACTOR times it, and so is a wrong declared one beside the true one."""
WRONG = 1.0 / 3.0
"""Share of the runs in which the declared noise is not the true one."""
LIKE = (0.3, 0.8)
"""Range of the correlation of the noise of neighbouring samples, in a share WRONG of the runs."""


@dataclass(frozen=True)
class World:
    """A virtual test before anything is planted: seed, programme, its noise over the usual one, declared over true standard deviation of
    each measured quantity, and correlation of the noise of neighbouring samples (autoregressive of first order)."""

    seed: int
    programme: str
    noise: float
    declared: Mapping[str, float]
    memory: float = 0.0

    def random(self, stream: str) -> np.random.Generator:
        """The random numbers of one matter."""
        return stream_of(self.seed, stream)

    def noisy(self, random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """Noise of unit variance; samples follow along the first axis."""
        drawn = random.normal(size=shape)
        if self.memory == 0.0:
            return drawn
        drawn[1:] *= np.sqrt(1.0 - self.memory**2)
        return np.asarray(lfilter([1.0], [1.0, -self.memory], drawn, axis=0))


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
    own = stream_of(seed, "memory")
    memory = float(own.uniform(*LIKE)) if own.random() < WRONG else 0.0
    return tuple(World(seed, programmes[k], noise, declared, memory) for k in order)


def directions(here: Traced, one: Effect, sets: Sequence[Mapping[str, float]]) -> list[np.ndarray]:
    """Columns (n, k) of an effect that the test knows, one block for each set of values of its other Params."""
    names, block = here.problem.dormant[one.name]
    sets = [values for values in sets if values]
    if not sets:
        return [block]
    if here.case.scored is not None and acts_in_heat(one):
        asked = [(n, dict(values)) for values in sets for n in names]
        found = here.case.scored(here.case.parameters, (), asked)[2]
        return np.split(found, len(sets), axis=1)
    return [columns_of(here.case, one, dict(values)) for values in sets]


def smallest(here: Traced, name: str, block: np.ndarray) -> float:
    """`detectable` of a dormant effect with these columns; infinite where the test does not feel it."""
    names, _ = here.problem.dormant[name]
    found = ranked(replace(here.problem, dormant={**here.problem.dormant, name: (names, block)}))
    return next((s.detectable for s in found.scores if s.effect == name), float("inf"))


def alike_to(here: Traced, name: str, block: np.ndarray) -> tuple[str, ...]:
    """The effects that a test cannot tell from one with these columns (|cos| above ALIKE beyond the fitted parameters), at any of the
    values that the loop tries for them; itself first. On a body, where a run costs more, laws of the motion are asked at their first
    values."""
    model = here.problem.model
    planted = {"": model.sensitive(block)}
    found = [name]
    for other in (e for e in here.case.known if e.name in here.problem.dormant and e.name != name):
        sets = scans(other, here.case)
        if here.case.scored is not None and not acts_in_heat(other):
            sets = sets[:1]
        try:
            blocks = [model.sensitive(b) for b in directions(here, other, sets)]
        except NumericsError:  # values with which it cannot run cannot be taken for it either
            continue
        felt = {str(k): s for k, s in enumerate(blocks) if s.shape[1]}
        if any(cos > ALIKE for (_, k), cos in likeness({**planted, **felt}, [""]).items() if k):
            found.append(other.name)
    return tuple(found)


def shown_in(here: Traced, block: np.ndarray) -> dict[str, float]:
    """Share of each channel in the squares of an effect's columns beyond the fitted parameters."""
    felt = here.problem.model.sensitive(block)
    size = np.linalg.norm(felt, axis=0)
    parts = (felt / np.where(size > 0.0, size, 1.0)) ** 2
    return {c: float(parts[here.rows.channel == k].sum() / max(parts.sum(), 1e-300)) for k, c in enumerate(here.case.channels)}
