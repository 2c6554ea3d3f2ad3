"""Coupon records as text: one row of column names, perhaps one of units, then rows of numbers; any separator and decimal sign.

Instron and BAM files (`Time;Load` above `(sec);(kN)`), MTS and Schenck files (units in brackets, -1000000 for channels that are not
connected), and whatever a script has written with the names in the first row.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import ChannelRecord, Column, Head, Traits
from thermofit.read.formats.record_columns import ColumnBlock, column_of, kind_remarks, make_record, texts_of, with_dates
from thermofit.read.formats.record_dates import is_stamp
from thermofit.read.formats.record_table import LEAST_ROWS, MOST_COLUMNS, Cell, Start, find_start, number_of, read_preamble, words_of
from thermofit.read.formats.record_words import plain
from thermofit.read.formats.text import (
    BLANKS,
    SEPARATOR_WORDS,
    Layout,
    NumberTable,
    detect_layout,
    detect_separator,
    head_lines,
    parse_number,
    read_block,
    read_text,
    split_cells,
)

NAME = "coupon record (text table)"
WHAT = "a table of a tension test with a row of column names"
_MOSTLY = 0.9
_LOAD = {"force", "stress", "true_stress"}
_MOTION = {"strain", "true_strain", "plastic_strain", "extension", "displacement", "temperature"}


@dataclass(frozen=True)
class Parts:
    """A text cut into `rows` of cells (of its beginning), with its layout and where its table starts."""

    rows: list[list[str]]
    layout: Layout
    start: Start


_BORDERS = (r"\t", ";", r"\|", ",", r"\s{2,}")
"""What may part names where it does not part numbers; the last one is two blanks or more."""


def _names(line: str, separator: str, sample: str) -> list[str]:
    """Cells of a line of words above columns, of which `sample` is a row: names may hold blanks, or be parted by another sign."""
    cells, width = split_cells(line, separator), len(words_of(split_cells(sample, separator)))
    if len(cells) == width or (separator != BLANKS and len(cells) > width):
        return cells
    tried = [[cell.strip().strip('"').strip() for cell in re.split(border, line)] for border in _BORDERS]
    joined: list[str] = []
    for word in line.split():
        if joined and (word[0] in "[(" or (joined[-1].count("[") + joined[-1].count("(") > joined[-1].count("]") + joined[-1].count(")"))):
            joined[-1] += f" {word}"
        else:
            joined.append(word)
    placed = _by_place(line, sample) if separator == BLANKS else []
    return next((found for found in (*tried, joined, placed, line.split()) if len(found) == width and sum(map(bool, found)) > 1), cells)


def _by_place(line: str, sample: str) -> list[str]:
    """Cells of a line that stand above those of a row: flush with their ends, or with their beginnings; no cells where neither holds."""
    above, below = ([(m.start(), m.end()) for m in re.finditer(r"\S+", text)] for text in (line, sample))
    for side in (1, 0):
        edges = [column[side] for column in below]
        # Flush right, a word belongs to the first column that does not end before it; flush left, to the last that begins before its end.
        owners = [
            next((k for k, edge in enumerate(edges) if edge >= word[1] - 1), None)
            if side
            else next((k for k in reversed(range(len(edges))) if edges[k] <= word[0] + 1), None)
            for word in above
        ]
        members = [[word for word, owner in zip(above, owners, strict=True) if owner == k] for k in range(len(edges))]
        held = [(k, words) for k, words in enumerate(members) if words]
        flush = all(abs((words[-1][1] if side else words[0][0]) - edges[k]) <= 1 for k, words in held)
        gaps = [after[0][0] - before[-1][1] for (_, before), (_, after) in pairwise(held)]
        if None not in owners and flush and 2 * sum(gap > 1 for gap in gaps) >= len(gaps) > 0:
            return [" ".join(line[a:b] for a, b in words) for words in members]
    return []


def _cells(lines: Sequence[str], separator: str, sample: str) -> list[list[str]]:
    """Cells of lines; a mark of a comment before the names is no part of them."""
    rows = []
    width = len(words_of(split_cells(sample, separator)))
    for line in lines:
        marked = line.startswith("#") or (line.startswith("%") and len(split_cells(line, separator)) != width)
        bare = re.sub(r"^[#%]+", lambda mark: " " * len(mark.group()), line) if marked else line
        cells = split_cells(bare, separator)
        rows.append(cells if any(map(_has_number, cells)) else _names(bare, separator, sample))
    return rows


def _has_number(cell: str) -> bool:
    return np.isfinite(parse_number(cell, ".")) or np.isfinite(parse_number(cell, ","))


def _sample(lines: Sequence[str], separator: str) -> str:
    """A line with as many cells as most of the lines have."""
    widths = [len(words_of(split_cells(line, separator))) for line in lines]
    usual = Counter(widths).most_common(1)[0][0]
    return lines[widths.index(usual)]


def parts_of(lines: list[str], path: Path, top: int = 0) -> Parts | None:
    """Cut lines from number `top` (from 0) on; None where no table begins in them. DataError for two decimal signs in one table."""
    tail = [line for line in lines[top:] if line.strip()]
    if len(tail) < 2:
        return None
    last = tail[-max(1, len(tail) // 2) :]
    separator = detect_separator(last)
    for decimal in (".", ",") if separator != "," else (".",):
        rows = _cells(lines[top : top + 500], separator, _sample(last, separator))

        def number(cell: Cell, sign: str = decimal) -> float:
            return number_of(cell, sign)

        start = find_start(rows, number)
        if start is not None and separator == BLANKS and len(rows[start.names]) > len(rows[start.first]):
            return None  # blanks inside names that cannot be told from those between them would shift every column
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
    if any(map(is_stamp, parts.rows[parts.start.first])):
        meanings.add("time")
    names = [plain(column.name) for column in columns]
    if {name.split(" ")[0] for name in names} >= {"x", "y"} or sum("coordinate" in name for name in names) > 1:
        return False  # points of a field
    return bool(meanings & _LOAD and meanings & (_MOTION | {"time"})) or ("time" in meanings and bool(meanings & _MOTION))


def read(path: Path) -> ChannelRecord:
    """The record of a text file; errors as `read_lines_as_record`."""
    text = read_text(path, WHAT)
    return read_lines_as_record(text.lines, Traits(NAME, path, text.encoding))


def read_lines_as_record(lines: list[str], traits: Traits, top: int = 0, about: dict[str, float] | None = None) -> ChannelRecord:
    """The record of lines from number `top` (from 0) on. `about` is what is known of the specimen already.

    DataError where neither a row of names nor a table of numbers without names is found, or a row is wider than the names.
    """
    path = traits.path
    parts = parts_of(lines, path, top)
    if parts is None:
        parts = numbered_parts(lines, path, top)
    if parts is None:
        raise DataError(f"{path}: no row of column names with rows of numbers below it was found, expected {WHAT}; export it again")
    start, layout = parts.start, parts.layout
    named = start.names < start.first
    columns = columns_of(parts) if named else [Column("")] * len(words_of(parts.rows[start.first]))
    first = top + start.first
    table = read_block(lines[first:], path, first + 1, layout, len(columns))
    cells = lru_cache(lambda k: _texts(lines, table, layout, k))
    columns, values, said = with_dates(columns, table.values, cells)
    above = [k for k in range(start.first) if k not in ((start.names, start.units) if named else ())]
    said_above = [lines[top + k] for k in above]
    rows = [split_cells(line.lstrip("#% "), layout.separator) for line in said_above]
    preamble = read_preamble(rows, lambda cell: number_of(cell, layout.decimal), said_above)
    if not named:
        said = (_without_names(parts, len(columns)), *said)
    filled = Traits(
        traits.format,
        path,
        traits.encoding,
        SEPARATOR_WORDS.get(layout.separator, layout.separator),
        "comma" if layout.decimal == "," else "point",
        remarks=(*traits.remarks, *preamble.remarks, *kind_remarks(columns, said_above)),
        header={**preamble.header, **traits.header},
    )
    return make_record(
        filled, ColumnBlock(tuple(columns), values, (*_remarks(table), *said), texts_of(values, cells)), {**preamble.about, **(about or {})}
    )


def _without_names(parts: Parts, width: int) -> str:
    """That the columns are numbered, and the words above them that could not be taken for names."""
    above = words_of(parts.rows[parts.start.first - 1]) if parts.start.first else []
    words = [word for word in above if word]
    tail = f" ({len(words)} words stand above {width} columns: {' '.join(words)[:80]})" if len(words) > 1 and len(words) != width else ""
    return f"the table has no names: its columns are called column 1 to column {width}{tail}"


def numbered_parts(lines: list[str], path: Path, top: int = 0) -> Parts | None:
    """A table without names: rows of two to ten numbers each, at least ten of them, below comments; None for anything else.

    The row of names of the answer is that of the first numbers.
    """
    tail = [line for line in lines[top:] if line.strip()]
    if len(tail) < LEAST_ROWS:
        return None
    last = tail[-(len(tail) // 2) :]
    separator = detect_separator(last)
    width = len(words_of(split_cells(_sample(last, separator), separator)))
    if not 2 <= width <= MOST_COLUMNS:
        return None
    rows = [words_of(split_cells(line, separator)) for line in lines[top:]]
    for decimal in (".", ",") if separator != "," else (".",):
        good = [len(row) == width and all(np.isfinite(number_of(cell, decimal)) for cell in row) for row in rows]
        if sum(good) < max(LEAST_ROWS, _MOSTLY * sum(map(bool, rows[good.index(True) :] if any(good) else rows))):
            continue
        first = good.index(True)
        return Parts(rows, detect_layout(lines[top + first :], path, separator), Start(first, None, first, sum(good)))
    return None


def _texts(lines: Sequence[str], table: NumberTable, layout: Layout, column: int) -> list[str]:
    """Cells of one column of the table as texts."""
    rows = (split_cells(lines[k - 1], layout.separator) for k in table.lines)
    return [row[column] if column < len(row) else "" for row in rows]


def _remarks(table: NumberTable) -> tuple[str, ...]:
    return (f"{table.ragged} rows are shorter than the names: their last cells count as missing",) if table.ragged else ()
