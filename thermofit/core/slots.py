"""Which files stand in the slots of the base law, and what every such file has in common."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from types import ModuleType
from typing import NamedTuple, Protocol, TypeVar

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Param


class Slots(NamedTuple):
    """Hardening law (law.hardening) and yield surface (law.surface), each by name or number."""

    hardening: int | str = 2
    surface: int | str = "hill"


class Numbered(Protocol):
    """What a slot may hold."""

    @property
    def name(self) -> str:
        """Name in a study."""
        ...

    @property
    def number(self) -> int:
        """Number that kernels take."""
        ...


Held = TypeVar("Held", bound=Numbered)


def held_by(which: str | int, known: Iterable[Held], kind: str) -> Held:
    """The one of that name or number. StudyError where there is none; `kind` in words."""
    every = sorted(known, key=lambda one: one.number)
    for one in every:
        if which in (one.name, one.number):
            return one
    raise StudyError(f"{kind} '{which}' is not known; known are {', '.join(one.name for one in every)}")


def checked_file(file: ModuleType, name: str, kind: str, required: Sequence[str], of_base: Callable[[object], bool]) -> str:
    """Path of a file of a slot that gives all that is required, and whose PARAMS are of the base law (`of_base`) or called <name>.<param>.
    StudyError that says what is missing or wrong."""
    where = getattr(file, "__file__", None) or name
    if missing := [key for key in required if not hasattr(file, key)]:
        raise StudyError(f"{where}: {missing[0]} is missing; a file of a {kind} gives {', '.join(required)}")
    for p in file.PARAMS:
        if not of_base(p) and (not isinstance(p, Param) or p.name.partition(".")[0] != name):
            raise StudyError(f"{where}: PARAMS holds {p!r}; expected Param('{name}.<param>', unit, neutral, lower, upper, scale, meaning)")
    return where
