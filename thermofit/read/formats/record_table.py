"""Where the table of a coupon record begins: the row of column names, perhaps a row of units, then rows of numbers.

A file may hold more above it: settings, sentences, a table of results (peak force, Rm, A). The record is the longest run of rows of
numbers; its names are the row above it that has one word for each column, most of them known.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from thermofit.core.units import known_unit
from thermofit.read.formats.record_columns import about_key, about_of, column_of
from thermofit.read.formats.record_dates import is_stamp
from thermofit.read.formats.record_words import meanings_of
from thermofit.read.formats.text import name_and_unit, parse_number

Cell = object
Row = Sequence[Cell]
Number = Callable[[Cell], float]
SEARCHED = 400
"""The names stand in one of the first rows; machine software writes some fifty rows of settings."""
LEAST_ROWS, MOST_COLUMNS = 10, 10
"""Of a table without names; a field or a thermal image without any has more columns."""
_LOOKED_AT = 100
"""Rows beyond the last possible names that tell a long table from a short one."""
_BETWEEN = 4
"""At most so many rows that are no numbers (units, remarks) between names and numbers."""
_STATED = re.compile(
    r"\W*(?P<name>[^\W\d][^:=]*?)\s*(?:[\[(](?P<before>[^\[\]()]*)[\])]\s*)?(?:[:=]+|\s)\s*"
    r"(?P<value>(?:\d+(?:[.,]\d+)?\s*[x*]\s*)?10\^[+-]?\d+|[+-]?(?:\d+(?:[.,]\d+)?|[.,]\d+)(?:[eE][+-]?\d+)?)"
    r"\s*[\[(]?(?P<unit>[^\d\W][^\s\[\]()]*|%\S*|\d?/\S+|deg\s?[A-Za-z]|\u00b0\s?[A-Za-z])?[\])]?\s*(?:\(.*\)|\.)?"
)
"""A statement such as `# strain rate = 1e-3 1/s`, `Temperature [K]: 293`, `T0 20 degC`."""
_THOUSANDS = re.compile(r"[+-]?\d{1,3}[.,]\d{3}")
_ENTRY = re.compile(r"([^\W\d][^:=\t;,]{0,60}?)\s*[:=]\s*(\S.*)")
"""A line `Start: 2018-12-11 14:50:03`."""
_PIECES = re.compile(r"[;\t|]|,(?=\s)")


@dataclass(frozen=True)
class Start:
    """Rows (from 0) of the names, of the units (None: no such row) and of the first numbers; `rows` of numbers seen from there on."""

    names: int
    units: int | None
    first: int
    rows: int = 0


@dataclass(frozen=True)
class Preamble:
    """Lines above a table: `header` (name: text as written), `about` the specimen in fixed units, `remarks` on what was not taken."""

    header: dict[str, str] = field(default_factory=dict)
    about: dict[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


def number_of(cell: Cell, decimal: str = ".") -> float:
    """Value of a cell of a workbook or of a text, NaN where it is not one finite number. Truth values and dates are none."""
    if isinstance(cell, bool):
        return np.nan
    if isinstance(cell, int | float):
        return float(cell) if np.isfinite(cell) else np.nan
    return parse_number(cell, decimal) if isinstance(cell, str) else np.nan


def words_of(row: Row) -> list[str]:
    """Cells as texts, empty ones at the end left out."""
    words = [cell.strip() if isinstance(cell, str) else "" if cell is None else str(cell) for cell in row]
    while words and not words[-1]:
        words.pop()
    return words


@dataclass(frozen=True)
class _Seen:
    """A row's `words`, and how many of them are `numbers`, `figures` (numbers with either decimal sign), `stamps` (dates)."""

    words: list[str]
    numbers: int
    figures: int
    stamps: int

    @property
    def filled(self) -> int:
        return sum(map(bool, self.words))

    @property
    def may_name(self) -> bool:
        """Texts only, two at least."""
        return self.filled >= 2 and self.numbers == self.figures == self.stamps == 0

    @property
    def is_data(self) -> bool:
        """At least two numbers or dates, and at least half of the cells that are not empty."""
        return self.numbers >= 1 and self.numbers + self.stamps >= 2 and 2 * (self.numbers + self.stamps) >= self.filled

    @property
    def is_units(self) -> bool:
        """Texts only, most of them known units or words in brackets."""
        words = [word for word in self.words if word]
        known = sum((known_unit(word) is not None and not meanings_of(word)) or (word[0] in "([" and word[-1] in ")]") for word in words)
        return bool(words) and self.numbers == self.figures == self.stamps == 0 and 2 * known >= len(words) and known >= 1


def _seen(rows: Sequence[Row], number: Number) -> list[_Seen]:
    found = []
    for row in rows:
        words = words_of(row)
        numbers = sum(bool(np.isfinite(number(cell))) for cell in row)
        figures = sum(bool(np.isfinite(parse_number(word, ".")) or np.isfinite(parse_number(word, ","))) for word in words)
        found.append(_Seen(words, numbers, figures, sum(map(is_stamp, row))))
    return found


def find_start(rows: Sequence[Row], number: Number) -> Start | None:
    """Where the table begins; None where no row of names is followed by rows of at least two numbers."""
    seen = _seen(rows[: SEARCHED + _LOOKED_AT], number)
    starts = [start for k in range(min(len(seen), SEARCHED)) if (start := _start_at(seen, k)) is not None]
    if not starts:
        return None
    longest = max(start.rows for start in starts)
    first = next(start.first for start in starts if start.rows == longest)
    return max((start for start in starts if start.first == first), key=lambda start: _fitness(seen, start))


def _start_at(seen: Sequence[_Seen], k: int) -> Start | None:
    """The table whose names are row k, None where no numbers follow."""
    if not seen[k].may_name:
        return None
    between: list[int] = []
    for j in range(k + 1, len(seen)):
        row = seen[j]
        if not row.words:
            continue
        if row.is_data or 0 < row.numbers == row.filled:
            if len(row.words) > len(seen[k].words):
                return None
            units = next((i for i in between if seen[i].is_units), None)
            return Start(k, units, j, _run(seen, j))
        between.append(j)
        if row.numbers or row.figures or row.stamps or len(between) > _BETWEEN:
            return None
    return None


def _run(seen: Sequence[_Seen], first: int) -> int:
    """Rows of numbers from `first` on, up to a row that may name the columns of another table."""
    rows = 0
    for row in seen[first:]:
        rows += row.is_data
        if row.may_name:
            break
    return rows


def _fitness(seen: Sequence[_Seen], start: Start) -> tuple[bool, bool, int, int]:
    """How well a row names the columns below it: no units, one word for each column, words that are known, nearness."""
    names = seen[start.names]
    width = len(seen[start.first].words)
    known = sum(bool(column_of(word).meaning) for word in names.words if word)
    return (not names.is_units, len(names.words) == width, known, start.names)


def stated(text: str, number: Number) -> list[tuple[str, float, str, str]]:
    """Statements (name, value, unit, value as written) in a line of text; the value is NaN where it is no plain number."""
    found = []
    for piece in _PIECES.split(text):
        match = _STATED.fullmatch(piece.strip())
        if match is None:
            continue
        if known_unit(piece.strip()[match.start("value") :]) is not None:
            continue  # `strain rate 1/s` is a name with its unit
        written = match["value"]
        unit = (match["unit"] or match["before"] or "").strip()
        found.append((match["name"].strip(), _value(written, number), unit, f"{written} {unit}".strip()))
    return found


def _value(text: str, number: Number) -> float:
    """A number, or a power of ten such as 10^-3 or 5x10^-3."""
    if "^" not in text:
        value = number(text)
        if np.isnan(value) and (text.startswith("0") or not _THOUSANDS.fullmatch(text)):
            value = parse_number(text, "," if "," in text else ".")
        return value
    factor, _, power = text.rpartition("10^")
    factor = factor.strip().rstrip("x*").strip()
    return (number(factor) if factor else 1.0) * 10.0 ** int(power) if abs(int(power)) < 300 else np.nan


def read_preamble(rows: Sequence[Row], number: Number, lines: Sequence[str] = ()) -> Preamble:
    """What stands above a table.

    Within a row every text cell followed by a number (and perhaps a unit) is one entry: `L0, 8.0, mm, , D, 5.98, mm`. In `lines`, the same
    rows as text, and in cells of text statements are read: `# Temperature: 293 K`. What speaks of specimen or test without a known
    unit is not taken, which a remark says.
    """
    header: dict[str, str] = {}
    about: dict[str, float] = {}
    silent: dict[str, str] = {}

    def take(name: str, value: float, unit: str, written: str) -> None:
        taken = about_of(name, value, unit)
        for key, converted in taken.items():
            about.setdefault(key, converted)
        known = about_key(name)
        if not taken and len(name) > 2 and known is not None:
            silent.setdefault(known, f"the header line '{name.strip(': =')}' ({written}) is not taken: expected a number with a known unit")

    for row in rows:
        words = words_of(row)
        for k, word in enumerate(words[:-1]):
            if not word or np.isfinite(number(row[k])) or (known_unit(word) is not None and k > 0):
                continue
            value, unit = number(row[k + 1]), words[k + 2] if k + 2 < len(words) else ""
            if np.isfinite(value):
                bare, inside = _name_with_unit(word)
                take(bare, value, inside or unit, f"{words[k + 1]} {inside or unit}".strip())
            if words[k + 1] and (k == 0 or np.isfinite(value)):
                header.setdefault(word.rstrip(": "), f"{words[k + 1]} {unit}".strip() if np.isfinite(value) else words[k + 1])
    for text in lines or [word for row in rows for word in words_of(row)]:
        for name, value, unit, written in stated(text.lstrip("#%/ "), number):
            take(name, value, unit, written)
            header.setdefault(name, written)
        if (entry := _ENTRY.fullmatch(text.strip("#%/ \t"))) is not None:
            if entry.group(1) not in header:
                take(entry.group(1), np.nan, "", entry.group(2))
            header.setdefault(entry.group(1), entry.group(2))
    return Preamble(header, about, tuple(text for key, text in silent.items() if key not in about))


def _name_with_unit(word: str) -> tuple[str, str]:
    """Name and unit of a header cell such as `Gauge length [mm]:`; the unit is empty where none is known."""
    name, unit = name_and_unit(word.rstrip(": ="))
    return (name, unit) if known_unit(unit) is not None else (word, "")
