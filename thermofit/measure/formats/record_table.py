"""Where the table of a coupon record begins: the row of column names, perhaps a row of units, then rows of numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from thermofit.core.units import known_unit
from thermofit.measure.formats.record_columns import about_of
from thermofit.measure.formats.text import parse_number

Cell = object
Row = Sequence[Cell]
SEARCHED = 400
"""The names stand in one of the first rows; machine software writes some fifty rows of settings."""
_FOLLOWING = 5


@dataclass(frozen=True)
class Start:
    """Rows (from 0) of the names, of the units (None: no such row) and of the first numbers."""

    names: int
    units: int | None
    first: int


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


def find_start(rows: Sequence[Row], number: Callable[[Cell], float]) -> Start | None:
    """Where the table begins; None where no row of names is followed by rows of at least two numbers."""
    for k, row in enumerate(rows[:SEARCHED]):
        words = words_of(row)
        if sum(map(bool, words)) < 2 or _count(row, number) > 0:
            continue
        if _is_units(row, number) and k > 0 and sum(map(bool, words_of(rows[k - 1]))) >= 2 and _count(rows[k - 1], number) == 0:
            continue  # the units of the row above, whose names no numbers follow; a lone `s` or `F` may be a name
        ahead = [j for j in range(k + 1, min(len(rows), k + 2 + _FOLLOWING)) if words_of(rows[j])]
        units = next(iter(ahead), None)
        if units is None:
            continue
        has_units = _is_units(rows[units], number)
        data = [rows[j] for j in (ahead[1:] if has_units else ahead)][:_FOLLOWING]
        good = sum(_is_data(row, number, len(words)) for row in data)
        if data and 2 * good >= len(data):
            first = ahead[1] if has_units else ahead[0]
            return Start(k, units if has_units else None, first)
    return None


def _count(row: Row, number: Callable[[Cell], float]) -> int:
    return int(np.sum([np.isfinite(number(cell)) for cell in row])) if len(row) else 0


def _is_data(row: Row, number: Callable[[Cell], float], width: int) -> bool:
    """At least two numbers, and at least half of the cells that are not empty, no wider than the names (but for an empty end)."""
    filled = len([word for word in words_of(row) if word])
    found = _count(row, number)
    return found >= 2 and 2 * found >= filled and len(words_of(row)) <= width


def _is_units(row: Row, number: Callable[[Cell], float]) -> bool:
    """Texts only, most of them known units or words in brackets."""
    words = [word for word in words_of(row) if word]
    known = sum(known_unit(word) is not None or (word[0] in "([" and word[-1] in ")]") for word in words)
    return bool(words) and _count(row, number) == 0 and 2 * known >= len(words) and known >= 1


def read_preamble(rows: Sequence[Row], number: Callable[[Cell], float]) -> tuple[dict[str, str], dict[str, float]]:
    """Header lines (name: text) above a table, and what they say of the specimen.

    Within a row every text cell followed by a number (and perhaps a unit) is one entry: `L0, 8.0, mm, , D, 5.98, mm`.
    """
    header: dict[str, str] = {}
    about: dict[str, float] = {}
    for row in rows:
        words = words_of(row)
        for k, word in enumerate(words[:-1]):
            if not word or np.isfinite(number(row[k])) or (known_unit(word) is not None and k > 0):
                continue
            value, unit = number(row[k + 1]), words[k + 2] if k + 2 < len(words) else ""
            if np.isfinite(value):
                for key, converted in about_of(word, value, unit).items():
                    about.setdefault(key, converted)
            if words[k + 1] and (k == 0 or np.isfinite(value)):
                header.setdefault(word.rstrip(": "), f"{words[k + 1]} {unit}".strip() if np.isfinite(value) else words[k + 1])
    return header, about
