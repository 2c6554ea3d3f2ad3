"""What a user says of native files and the files cannot say themselves, and the times of a series of files: never guessed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from thermofit.core.errors import DataError
from thermofit.read.formats.naming import lost_numbers, number_order
from thermofit.study.section import Number, Positive, Section, expected

Above0 = Annotated[Positive, expected("a number above 0")]


def _axes(value: Any) -> tuple[str, ...]:
    """Axis of the file, with sign, for each of x, y, z of the specimen, those that are left out as in the file."""
    if not isinstance(value, dict | tuple) or (isinstance(value, dict) and set(value) - set("xyz")):
        raise ValueError
    axes = tuple(str(axis) for axis in (value if isinstance(value, tuple) else (value.get(name, name) for name in "xyz")))
    if sorted(axis.lstrip("+-") for axis in axes) != ["x", "y", "z"] or any(len(axis) > 2 for axis in axes):
        raise ValueError
    return axes


class Rules(Section):
    """What experiment.yaml says of native files; without it nothing is said."""

    unit: Annotated[str, Field(min_length=1), expected("a text")] = ""
    """Of lengths or temperatures where the files have none."""
    mm_per_pixel: Above0 | None = None
    """For exports in pixels."""
    times: Annotated[tuple[Number, ...], Field(min_length=1), expected("a list of the numbers")] = ()
    """s, one for every file in the order of their numbers; replace times in the files."""
    rate: Above0 | None = None
    """Stages or frames per second; replaces times in the files."""
    time_offset_s: Number = 0.0
    """Added to all times."""
    axes: Annotated[tuple[str, str, str], BeforeValidator(_axes), expected("x, y and z of the file, each once, such as {x: y, y: -x}")] = (
        "x",
        "y",
        "z",
    )
    """Which axis of the file, with its sign, is x, y, z of the specimen."""
    origin_mm: Annotated[tuple[Number, Number, Number], expected("a list of 3 numbers")] = (0.0, 0.0, 0.0)
    """Where the file has the centre of the specimen, in its own axes."""
    coordinates_of: Annotated[Literal["reference", "deformed"], expected("reference or deformed")] | None = None
    """Where a format leaves it open."""


@dataclass(frozen=True)
class Member:
    """One stage or frame of a series: its file, number and time s (None where neither file nor name say it), as far as known."""

    path: Path
    number: int | None
    time: float | None


@dataclass(frozen=True)
class Clock:
    """`order` (n,) of the members in time and `time` s (n,) in that order, `remarks` on where the times come from."""

    order: np.ndarray
    time: np.ndarray
    remarks: tuple[str, ...]


def set_clock(members: Sequence[Member], rules: Rules, word: str) -> Clock:
    """Times and order of the members; `word` is "stage" or "frame". DataError where times are absent, too few, equal or not increasing."""
    numbered = all(member.number is not None for member in members)
    by_name = sorted(range(len(members)), key=lambda k: (members[k].number if numbered else 0, number_order(members[k].path)))
    order = np.array(by_name, dtype=int)
    named = f"{members[0].path.parent} ({len(members)} {word}s)"
    if rules.times:
        return _given(members, order, rules, named)
    if rules.rate is not None:
        return _from_rate(members, order, rules, word)
    without = [member for member in members if member.time is None]
    if without:
        many = f"{len(without)} of {len(members)} {word}s have no time, neither in the file nor in its name"
        raise DataError(f"{without[0].path}: {many}; give 'times' (s, one for each {word}) or 'rate' ({word}s per second)")
    time = np.array([np.nan if member.time is None else member.time for member in members])
    moved = np.argsort(time[order], kind="stable")
    remarks = []
    if (changed := int((moved != np.arange(len(moved))).sum())) > 0:
        remarks.append(f"{changed} {word}s sorted by time, their names or numbers give another order")
    if lost := lost_numbers([member.number for member in members if member.number is not None], word):
        remarks.append(lost)
    order = order[moved]
    same = np.flatnonzero(np.diff(time[order]) == 0.0)
    if len(same):
        first, second = members[order[same[0]]], members[order[same[0] + 1]]
        raise DataError(
            f"{second.path}: the time {second.time:g} s is also that of {first.path.name}; remove one of them, or give 'rate' or 'times'"
        )
    return Clock(order, time[order] + rules.time_offset_s, tuple(remarks))


def _given(members: Sequence[Member], order: np.ndarray, rules: Rules, named: str) -> Clock:
    """Times that the user lists."""
    time = np.array(rules.times, dtype=float)
    if len(time) != len(members):
        raise DataError(f"{named}: 'times' lists {len(time)} times, expected {len(members)}, one for each file; correct the list")
    if not np.isfinite(time).all() or (np.diff(time) <= 0.0).any():
        raise DataError(
            f"{named}: 'times' does not increase, expected one later time for each file in the order of their numbers; correct it"
        )
    return Clock(order, time + rules.time_offset_s, _replaced(members))


def _replaced(members: Sequence[Member]) -> tuple[str, ...]:
    """Remark where times of files are not used."""
    count = sum(member.time is not None for member in members)
    return (f"{count} times of the files replaced by those given",) if count else ()


def _from_rate(members: Sequence[Member], order: np.ndarray, rules: Rules, word: str) -> Clock:
    """Times from the rate and the numbers, so that a missing file leaves a gap; from the order alone where there are no numbers."""
    assert rules.rate is not None
    found = [members[k].number for k in order]
    known = [number for number in found if number is not None]
    if len(known) < len(found):
        remark = f"{word}s have no numbers: times from 'rate' and the order of the names"
        return Clock(order, np.arange(len(found)) / rules.rate + rules.time_offset_s, (*_replaced(members), remark))
    number = np.array(known)
    again = np.flatnonzero(np.diff(number) == 0)
    if len(again):
        first, second = members[order[again[0]]].path, members[order[again[0] + 1]].path
        raise DataError(f"{second}: the number {number[again[0]]} is also that of {first.name}; remove one of them")
    gaps = int(number[-1] - number[0]) + 1 - len(number)
    remarks = (f"{gaps} numbers of {word}s are missing: gaps in time",) if gaps else ()
    return Clock(order, (number - number[0]) / rules.rate + rules.time_offset_s, (*_replaced(members), *remarks))


def files_of(pattern: Path, what: str) -> list[Path]:
    """Files of a glob pattern, of a folder, or one file, in the order of the numbers in their names. DataError where there are none."""
    if pattern.is_dir():
        found = [path for path in pattern.iterdir() if path.is_file() and not path.name.startswith(".")]
    elif pattern.is_file():
        found = [pattern]
    else:
        root = Path(pattern.anchor) if pattern.is_absolute() else Path()
        relative = pattern.relative_to(pattern.anchor) if pattern.is_absolute() else pattern
        try:
            found = [path for path in root.glob(str(relative)) if path.is_file()]
        except (ValueError, NotImplementedError, OSError) as error:
            raise DataError(f"{pattern}: no pattern of file names ({error}), expected one such as exports/*.csv; correct it") from None
    if not found:
        raise DataError(f"{pattern}: no file found, expected {what}; put the files there or correct the pattern")
    return sorted(found, key=number_order)
