"""What can be planted into a test, and with which values: the amplitude as asked, all else off the grid that the loop scans."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Param
from thermofit.diagnose.case import Case, scans
from thermofit.effects.catalogue import Effect, effect

AWAY = 0.1
"""Least distance of a planted value to a scanned one, as a part of the gap between scanned values."""


@dataclass(frozen=True)
class Planting:
    """One effect as it is planted: number of the draw, and values of its Params by name."""

    number: int
    values: Mapping[str, float]


def asked(name: str, amplitude: float, given: Mapping[str, float]) -> tuple[Effect, dict[str, float]]:
    """The effect of that name and its given Params by their full names; a bare one (place) is that of the effect (local_source.place).

    StudyError where there is no such effect or Param, a value lies beyond its physical bounds, or the amplitude is neutral.
    """
    one = effect(name)
    p = one.amplitude
    values = {}
    for key, value in {p.name: amplitude, **given}.items():
        full = _full(one, key)
        if full is None or (full.name == p.name and key != p.name):
            others = ", ".join(q.name.rpartition(".")[2] for q in one.params[1:]) or "none"
            raise StudyError(f"--secondary {key}: {name} has no such parameter beside its amplitude {p.name}; it has {others}")
        if not full.lower <= value <= full.upper:
            raise StudyError(f"{full.name} = {value:g} {full.unit} lies beyond its physical bounds {full.lower:g} to {full.upper:g}")
        values[full.name] = float(value)
    if values[p.name] == p.neutral:
        raise StudyError(f"--amplitude {amplitude:g}: at {p.name} = {p.neutral:g} {name} is off; expected another value, such as {p.probe}")
    return one, values


def _full(one: Effect, key: str) -> Param | None:
    return next((p for p in one.params if key in (p.name, p.name.partition(".")[2], p.name.partition(".")[2].partition("@")[0])), None)


def plantable(case: Case, one: Effect) -> None:
    """StudyError where an effect cannot be planted into a test: the test does not know it, or its model holds it already."""
    dormant = [e.name for e in case.dormant()]
    if one.name in dormant:
        return
    if one.name in {e.name for e in case.known}:
        why = "is fitted in it already, or the study gives it a value; take that out of the study first"
    else:
        why = "is none that these data could show"
    raise StudyError(f"--effect {one.name} {why}; can be planted: {', '.join(sorted(dormant))}")


def plantings(case: Case, one: Effect, given: Mapping[str, float], count: int, seed: int) -> tuple[Planting, ...]:
    """At most `count` different ways to plant an effect; `given`: values of its amplitude and of what is not drawn.

    Exponents, places and times are drawn off the grid that is scanned. From the second on the sign is drawn as well, where the bounds of
    the amplitude leave room on both sides of neutral. Each draw has random numbers of its own: more of them change none of the earlier
    ones. Fewer than `count` come where nothing else can be drawn.
    """
    p = one.amplitude
    found: list[Planting] = []
    mirrored = 2.0 * p.neutral - given[p.name]
    for number in range(count):
        random = np.random.default_rng([seed, number])
        values = {**secondary(one, case, random), **given}
        if number and p.lower <= mirrored <= p.upper and random.random() < 0.5:
            values[p.name] = mirrored
        if all(values != other.values for other in found):
            found.append(Planting(number, values))
    return tuple(found)


def secondary(one: Effect, case: Case, random: np.random.Generator) -> dict[str, float]:
    """Values of an effect's Params besides its amplitude, off the grid that the loop scans for this test."""
    sets = scans(one, case)
    found = {}
    for p in (p for p in one.params if p.scan):
        tried = {values[p.name] for values in sets[1:]} or {p.neutral}
        inside = {p.neutral} if min(tried) < p.neutral < max(tried) else set()
        found[p.name] = off_grid(p, sorted(tried | inside), random)
    return found


def off_grid(p: Param, tried: Sequence[float], random: np.random.Generator) -> float:
    """A value between two neighbouring values that are tried, every gap as likely, not nearer to either than AWAY of the gap; by logarithms
    where the order of magnitude is what counts.

    Where one value alone is tried: within a scale of it if it is fitted later (`follows`), that value if it never is.
    """
    grid = np.unique(np.log(tried) if p.logarithmic else tried)
    if len(grid) > 1:
        k = int(random.integers(len(grid) - 1))
        x = float(grid[k] + random.uniform(AWAY, 1.0 - AWAY) * (grid[k + 1] - grid[k]))
        return float(np.exp(x)) if p.logarithmic else x
    if not p.follows:
        return p.neutral
    side = 1.0 if random.random() < 0.5 else -1.0
    room = min(p.scale, p.upper - p.neutral if side > 0.0 else p.neutral - p.lower)
    return float(p.neutral + side * random.uniform(AWAY, 1.0) * room)
