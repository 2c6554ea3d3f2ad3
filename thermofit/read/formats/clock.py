"""What a user says of native files and the files cannot say themselves, and the times of a series of files: never guessed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.naming import number_order


@dataclass(frozen=True)
class Rules:
    """`unit` of lengths or temperatures where the files have none; `mm_per_pixel` for exports in pixels.

    `times` s for every file in the order of their numbers, or `rate` 1/s of the stages or frames; both replace times in the files.
    `time_offset` s is added. `axes`: which axis of the file, with its sign, is x, y, z of the specimen; `origin` mm: where the file has the
    centre of the specimen, in its own axes. `coordinates`: "reference" or "deformed" where a format leaves it open.
    """

    unit: str = ""
    mm_per_pixel: float | None = None
    times: tuple[float, ...] = ()
    rate: float | None = None
    time_offset: float = 0.0
    axes: tuple[str, str, str] = ("x", "y", "z")
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    coordinates: str = ""


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
    order = order[moved]
    same = np.flatnonzero(np.diff(time[order]) == 0.0)
    if len(same):
        first, second = members[order[same[0]]], members[order[same[0] + 1]]
        raise DataError(
            f"{second.path}: the time {second.time:g} s is also that of {first.path.name}; remove one of them, or give 'rate' or 'times'"
        )
    return Clock(order, time[order] + rules.time_offset, tuple(remarks))


def _given(members: Sequence[Member], order: np.ndarray, rules: Rules, named: str) -> Clock:
    """Times that the user lists."""
    time = np.array(rules.times, dtype=float)
    if len(time) != len(members):
        raise DataError(f"{named}: 'times' lists {len(time)} times, expected {len(members)}, one for each file; correct the list")
    if not np.isfinite(time).all() or (np.diff(time) <= 0.0).any():
        raise DataError(
            f"{named}: 'times' does not increase, expected one later time for each file in the order of their numbers; correct it"
        )
    return Clock(order, time + rules.time_offset, _replaced(members))


def _replaced(members: Sequence[Member]) -> tuple[str, ...]:
    """Remark where times of files are not used."""
    count = sum(member.time is not None for member in members)
    return (f"{count} times of the files replaced by those given",) if count else ()


def _from_rate(members: Sequence[Member], order: np.ndarray, rules: Rules, word: str) -> Clock:
    """Times from the rate and the numbers, so that a missing file leaves a gap; from the order alone where there are no numbers."""
    if rules.rate is None or not rules.rate > 0.0:
        raise DataError(f"{members[0].path}: 'rate' is {rules.rate}, expected {word}s per second above 0; correct it")
    found = [members[k].number for k in order]
    known = [number for number in found if number is not None]
    if len(known) < len(found):
        remark = f"{word}s have no numbers: times from 'rate' and the order of the names"
        return Clock(order, np.arange(len(found)) / rules.rate + rules.time_offset, (*_replaced(members), remark))
    number = np.array(known)
    again = np.flatnonzero(np.diff(number) == 0)
    if len(again):
        first, second = members[order[again[0]]].path, members[order[again[0] + 1]].path
        raise DataError(f"{second}: the number {number[again[0]]} is also that of {first.name}; remove one of them")
    gaps = int(number[-1] - number[0]) + 1 - len(number)
    remarks = (f"{gaps} numbers of {word}s are missing: gaps in time",) if gaps else ()
    return Clock(order, (number - number[0]) / rules.rate + rules.time_offset, (*_replaced(members), *remarks))


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
