"""Families that a test leaves undecided, and what a test programme tells of one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from thermofit.diagnose.score import CONVINCING, likeness


class CandidateProgramme(Protocol):
    """A test programme of a coupon or of a specimen."""

    @property
    def name(self) -> str: ...

    @property
    def words(self) -> str: ...


@dataclass(frozen=True)
class Family:
    """Effects that a test leaves undecided: the one that the loop has added (empty: none of them is in the model) and the values of
    exponents at which the others were scored."""

    members: tuple[str, ...]
    added: str = ""
    settings: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Discrimination:
    """What one programme tells of a family: largest |cos| between the members that are asked for (1 where it does not show one of them),
    smallest amplitudes."""

    programme: CandidateProgramme
    cosine: float
    detectable: dict[str, float]

    def apart(self, name: str) -> float:
        """Amplitude from which a member is told from the others, which take |cos| of its column: detectable / sqrt(1 - cos^2)."""
        left = 1.0 - self.cosine**2
        return self.detectable.get(name, np.inf) / float(np.sqrt(left)) if left > 0.0 else np.inf


def discrimination_of(programme: CandidateProgramme, own: Mapping[str, np.ndarray], members: Sequence[str]) -> Discrimination | None:
    """Told by columns (n, k) of effects beyond what the parameters can do; None where the programme shows none of the members."""
    there = {n: own[n] for n in members if n in own}
    if not there:
        return None
    alike = likeness(there)
    largest = max((cos for (a, b), cos in alike.items() if a != b), default=0.0)
    shown = {n: float(CONVINCING / np.linalg.norm(s[:, 0])) for n, s in there.items()}
    return Discrimination(programme, 1.0 if len(there) < len(members) else largest, shown)
