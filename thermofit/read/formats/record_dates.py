"""Dates and times of day in cells and header lines of records, as seconds: `2018-12-11 14:50:03.25`, `11.12.18 14:50`, `14:50:03`.

Absolute times count from 1970-01-01 00:00 of the clock of the file (no time zones); times of day from midnight, on past the next one.
"""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Mapping, Sequence

import numpy as np

from thermofit.read.formats.record_words import DATED

_CLOCK = r"(?P<h>\d{1,2}):(?P<min>\d{2})(?::(?P<s>\d{2}(?:[.,]\d+)?))?\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
_DAYS: tuple[tuple[str, str], ...] = (
    ("year first", r"(?P<y>\d{4})[-/.](?P<a>\d{1,2})[-/.](?P<b>\d{1,2})"),
    ("day first", r"(?P<b>\d{1,2})\.(?P<a>\d{1,2})\.(?P<y>\d{4}|\d{2})"),
    ("either", r"(?P<a>\d{1,2})[/-](?P<b>\d{1,2})[/-](?P<y>\d{4})"),
)
"""Ways to write a day: a is the month, b the day; `either` leaves open which of them comes first."""
_EPOCH = dt.datetime(1970, 1, 1)
_DAY = 86400.0
_SHARE = 0.9
DAY, CLOCK, BOTH = "day", "time of day", "date and time"


def _patterns() -> list[tuple[str, str, re.Pattern[str]]]:
    found = [(CLOCK, "", re.compile(_CLOCK, re.ASCII))]
    for order, day in _DAYS:
        found += [
            (DAY, order, re.compile(day, re.ASCII)),
            (BOTH, order, re.compile(rf"{day}[T ,]+{_CLOCK}(?:Z|[+-]\d\d:?\d\d)?", re.ASCII)),
        ]
    return found


_PATTERNS = _patterns()


def _seconds(match: re.Match[str], month_first: bool) -> float:
    """Seconds of one match, NaN where it is no date or time that exists."""
    parts = match.groupdict()
    total = 0.0
    if parts.get("y"):
        month, day = int(parts["a"]), int(parts["b"])
        year = int(parts["y"]) + (2000 if len(parts["y"]) == 2 else 0)
        month, day = (month, day) if month_first else (day, month)
        try:
            total = (dt.datetime(year, month, day) - _EPOCH).total_seconds()
        except ValueError:
            return np.nan
    if parts.get("h"):
        hour, minute = int(parts["h"]), int(parts["min"])
        if parts.get("half"):
            hour = hour % 12 + (12 if parts["half"][0] in "pP" else 0)
        second = float((parts.get("s") or "0").replace(",", "."))
        if hour > 23 or minute > 59 or second >= 61.0:
            return np.nan
        total += 3600.0 * hour + 60.0 * minute + second
    return total


def seconds_of(cells: Sequence[object]) -> tuple[np.ndarray, str] | None:
    """Seconds (n,), NaN for other cells, and what they are (DAY, CLOCK, BOTH); None where fewer than nine in ten filled cells are of one
    such form, or where day and month cannot be told apart."""
    texts = [_text(cell) for cell in cells]
    filled = sum(bool(text) for text in texts)
    sample = next((text for text in texts if text), "")
    for what, order, pattern in _PATTERNS:
        if not pattern.fullmatch(sample):
            continue
        matches = [pattern.fullmatch(text) if text else None for text in texts]
        if sum(match is not None for match in matches) < _SHARE * filled:
            continue
        month_first = order != "either" or _month_first([match for match in matches if match])
        if month_first is None:
            return None
        values = np.array([np.nan if match is None else _seconds(match, month_first) for match in matches])
        if np.isfinite(values).sum() < _SHARE * filled:
            continue
        return (_past_midnight(values) if what == CLOCK else values), what
    return None


def is_stamp(cell: object) -> bool:
    """Whether one cell is written as a date or a time of day."""
    text = _text(cell)
    return len(text) > 3 and text[0].isdigit() and any(pattern.fullmatch(text) for _, _, pattern in _PATTERNS)


def _month_first(matches: list[re.Match[str]]) -> bool | None:
    """Which of two numbers is the month: the one that is never above twelve; None where both never are."""
    first, second = (max(int(match.group(name)) for match in matches) for name in ("a", "b"))
    if first <= 12 and second <= 12:
        return None
    return first <= 12


def _past_midnight(values: np.ndarray) -> np.ndarray:
    """Times of day that go on counting where they fall by more than half a day."""
    known = np.isfinite(values)
    turned = np.concatenate([[0.0], np.cumsum(np.diff(values[known]) < -0.5 * _DAY)]) if known.any() else np.zeros(0)
    going = values.copy()
    going[known] = values[known] + _DAY * turned
    return going


def _text(cell: object) -> str:
    """A cell as text; those of workbooks may be dates and times already."""
    if isinstance(cell, dt.datetime):
        return cell.isoformat(sep=" ")
    if isinstance(cell, dt.date | dt.time):
        return cell.isoformat()
    if isinstance(cell, dt.timedelta):
        whole = cell.total_seconds()
        return f"{int(whole // 3600):02d}:{int(whole % 3600 // 60):02d}:{whole % 60:09.6f}" if 0.0 <= whole < _DAY else ""
    return cell.strip() if isinstance(cell, str) else ""


def start_in_header(header: Mapping[str, str]) -> float | None:
    """When the test began by the lines of a header, s since 1970: one line with date and time, or one of each; None for anything else."""
    found: dict[str, set[float]] = {DAY: set(), CLOCK: set(), BOTH: set()}
    for name, text in header.items():
        if re.fullmatch(DATED, name) and (read := seconds_of([text])) is not None:
            found[read[1]].add(float(read[0][0]))
    if len(found[BOTH]) == 1:
        return next(iter(found[BOTH]))
    if not found[BOTH] and len(found[DAY]) == 1 and len(found[CLOCK]) == 1:
        return next(iter(found[DAY])) + next(iter(found[CLOCK]))
    return None
