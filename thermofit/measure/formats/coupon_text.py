"""Coupon records as text: one row of column names, perhaps one of units, then rows of numbers; any separator and decimal sign.

Instron and BAM files (`Time;Load` above `(sec);(kN)`), MTS and Schenck files (units in brackets, -1000000 for channels that are not
connected), and whatever a script has written with the names in the first row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from thermofit.core.errors import DataError
from thermofit.measure.formats.contents import Column, Head, Record, Traits
from thermofit.measure.formats.record_columns import Block, column_of, make_record, plain
from thermofit.measure.formats.record_table import Cell, Start, find_start, number_of, read_preamble, words_of
from thermofit.measure.formats.text import (
    SEPARATOR_WORDS,
    Layout,
    Table,
    detect_layout,
    detect_separator,
    head_lines,
    read_block,
    read_text,
    split_cells,
)

NAME = "coupon record (text table)"
WHAT = "a table of a tension test with a row of column names"
_LOAD = {"force", "stress", "true_stress"}
_MOTION = {"strain", "true_strain", "extension", "displacement", "temperature"}


@dataclass(frozen=True)
class Parts:
    """A text cut into `rows` of cells (of its beginning), with its layout and where its table starts."""

    rows: list[list[str]]
    layout: Layout
    start: Start


def _cells(lines: Sequence[str], separator: str) -> list[list[str]]:
    """Cells of lines; a mark of a comment before the names is no part of them."""
    return [split_cells(line.lstrip("#").lstrip() if line.startswith("#") else line, separator) for line in lines]


def parts_of(lines: list[str], path: Path, top: int = 0) -> Parts | None:
    """Cut lines from number `top` (from 0) on; None where no table begins in them. DataError for two decimal signs in one table."""
    tail = [line for line in lines[top:] if line.strip()]
    if len(tail) < 2:
        return None
    separator = detect_separator(tail[-max(1, len(tail) // 2) :])
    for decimal in (".", ",") if separator != "," else (".",):
        rows = _cells(lines[top : top + 500], separator)

        def number(cell: Cell, sign: str = decimal) -> float:
            return number_of(cell, sign)

        start = find_start(rows, number)
        if start is not None:
            block = lines[top + start.first :]
            return Parts(rows, detect_layout(block, path, separator), start)
    return None


def columns_of(parts: Parts) -> list[Column]:
    """Named columns with their units."""
    names = words_of(parts.rows[parts.start.names])
    units = [] if parts.start.units is None else words_of(parts.rows[parts.start.units])
    width = max(len(names), len(units))
    names, units = [names + [""] * (width - len(names)), units + [""] * (width - len(units))]
    return [column_of(name, unit) for name, unit in zip(names, units, strict=True)]


def recognises(head: Head) -> bool:
    """True where a row of names with a force, a stress, or a time beside a motion is followed by rows of numbers."""
    lines = head_lines(head)
    if head.size > len(head.first):
        lines = lines[:-1]
    try:
        parts = parts_of(lines, head.path)
    except DataError:
        return False
    if parts is None:
        return False
    columns = columns_of(parts)
    meanings = {column.meaning for column in columns}
    names = [plain(column.name) for column in columns]
    if {name.split(" ")[0] for name in names} >= {"x", "y"} or sum("coordinate" in name for name in names) > 1:
        return False  # points of a field
    return bool(meanings & _LOAD and meanings & (_MOTION | {"time"})) or ("time" in meanings and bool(meanings & _MOTION))


def read(path: Path) -> Record:
    """The record of a text file; errors as `read_lines_as_record`."""
    text = read_text(path, WHAT)
    return read_lines_as_record(text.lines, Traits(NAME, path, text.encoding))


def read_lines_as_record(lines: list[str], traits: Traits, top: int = 0, about: dict[str, float] | None = None) -> Record:
    """The record of lines from number `top` (from 0) on. `about` is what is known of the specimen already.

    DataError where no row of names is found, a row is wider than the names, or no number is there.
    """
    path = traits.path
    parts = parts_of(lines, path, top)
    if parts is None:
        raise DataError(f"{path}: no row of column names with rows of numbers below it was found, expected {WHAT}; export it again")
    columns = columns_of(parts)
    first = top + parts.start.first
    table = read_block(lines[first:], path, first + 1, parts.layout, len(columns))
    header, found = read_preamble(parts.rows[: parts.start.names], lambda cell: number_of(cell, parts.layout.decimal))
    filled = Traits(
        traits.format,
        path,
        traits.encoding,
        SEPARATOR_WORDS.get(parts.layout.separator, parts.layout.separator),
        "comma" if parts.layout.decimal == "," else "point",
        remarks=traits.remarks,
        header={**header, **traits.header},
    )
    return make_record(filled, Block(tuple(columns), table.values, _remarks(table)), {**found, **(about or {})})


def _remarks(table: Table) -> tuple[str, ...]:
    return (f"{table.ragged} rows are shorter than the names: their last cells count as missing",) if table.ragged else ()
