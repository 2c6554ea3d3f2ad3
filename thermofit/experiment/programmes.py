"""Test programmes of a specimen by name, for the comparison of what each of them can tell: sequences of crosshead, force and time.

All of them are made from the study's own virtual programme: its largest crosshead position and the rate with which it goes there. A sheet
buckles in compression, so that a cycle goes back to no force at most.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from thermofit.core.errors import StudyError
from thermofit.study.virtual import Simulate
from thermofit.virtual.machine import CrossheadStep, programme_of

OWN = "own"
"""The programme that the study itself describes."""
REST = 3.0
"""s before loading: the reference of temperatures."""
COOLING = 245.0
"""s without load after unloading, where the study's own programme does not cool (experiments 2 and 3 of the thesis: 245 s)."""
FASTER = 10.0
"""Jump of the crosshead rate in stepped rates."""


@dataclass(frozen=True)
class CrossheadUsual:
    """What programmes have in common: largest crosshead position in mm, its rate in mm/s, seconds of cooling at the end."""

    peak: float
    rate: float
    cooling: float


@dataclass(frozen=True)
class CrossheadProgramme:
    """A programme by name, what it is in words, and its steps after the first rest."""

    name: str
    words: str
    steps: Callable[[CrossheadUsual], tuple[CrossheadStep, ...]]


def _pull(usual: CrossheadUsual, share: float = 1.0, faster: float = 1.0) -> CrossheadStep:
    return CrossheadStep("crosshead_to", share * usual.peak, faster * usual.rate)


def _unload(usual: CrossheadUsual) -> CrossheadStep:
    return CrossheadStep("force_to", 0.0, -usual.rate)


def _stepped(usual: CrossheadUsual) -> tuple[CrossheadStep, ...]:
    return tuple(_pull(usual, (n + 1) / 4.0, FASTER if n % 2 else 1.0) for n in range(4))


def _cycles(usual: CrossheadUsual) -> tuple[CrossheadStep, ...]:
    return tuple(step for n in range(3) for step in (_pull(usual, (n + 1) / 3.0), _unload(usual)))


PROGRAMMES: tuple[CrossheadProgramme, ...] = (
    CrossheadProgramme("monotonic", "pull at one rate", lambda u: (_pull(u),)),
    CrossheadProgramme("load-unload", "pull and unload", lambda u: (_pull(u), _unload(u))),
    CrossheadProgramme(
        "load-unload-cool", "pull, unload, and cool without load", lambda u: (_pull(u), _unload(u), CrossheadStep("hold", u.cooling))
    ),
    CrossheadProgramme("stepped-rates", f"pull, the rate {FASTER:g} times larger in every second quarter", _stepped),
    CrossheadProgramme("cycles", "pull in three parts, unloaded after each", _cycles),
)
"""All programmes, the simplest first."""
NAMES: tuple[str, ...] = tuple(p.name for p in PROGRAMMES)


def usual_of(settings: Simulate) -> CrossheadUsual:
    """Peak, rate and cooling of the study's own programme. StudyError where it never moves the crosshead to a position."""
    steps = programme_of(settings.programme)
    pulls = [step for step in steps if step.kind == "crosshead_to"]
    if not pulls:
        raise StudyError("simulate.programme: no item crosshead_to is found; programmes by name are made from the largest of them: add one")
    last = max(pulls, key=lambda step: step.target)
    return CrossheadUsual(last.target, abs(last.rate), COOLING)


def programme_named(name: str, settings: Simulate) -> tuple[CrossheadStep, ...]:
    """Steps of the programme of that name, `own` being that of the study. StudyError for an unknown name."""
    if name == OWN:
        return programme_of(settings.programme)
    for known in PROGRAMMES:
        if known.name == name:
            return (CrossheadStep("hold", REST), *known.steps(usual_of(settings)))
    raise StudyError(f"test programme '{name}' is not known; expected some of {', '.join((OWN, *NAMES))}")


def words_of(name: str) -> str:
    """What a programme is."""
    return next((known.words for known in PROGRAMMES if known.name == name), "the programme of the study")
