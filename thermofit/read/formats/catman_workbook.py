"""HBM catman workbooks: a comment, a row of names padded with blanks, a row of units, some 45 rows of channel settings, then numbers.

There may be several time columns with their own rates; a channel belongs to the time column of the same rate and length. Such a file
becomes several tests, named after their time columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import ChannelRecord, Column, Head, Records, Traits
from thermofit.read.formats.record_columns import ColumnBlock, column_of, make_record
from thermofit.read.formats.record_table import Row, words_of
from thermofit.read.formats.workbook import Sheet, is_workbook, numbers_of, read_sheets

NAME = "HBM catman workbook (XLSX)"
_SETTINGS = 200


@dataclass(frozen=True)
class Channel:
    """A column of the sheet: place, name and unit, sampling rate as written, values without the empty cells at its end."""

    place: int
    column: Column
    rate: str
    values: np.ndarray


def _is_catman(rows: list[list[object]]) -> bool:
    """A file comment, then names and units; the settings below name hardware channels."""
    if len(rows) < 4 or not (rows[0] and str(rows[0][0]).strip().lower().startswith("file comment")):
        return False
    return len([word for word in words_of(rows[1]) if word]) >= 2


def recognises(head: Head) -> bool:
    """True for a workbook whose first sheet begins with a file comment."""
    if not is_workbook(head):
        return False
    try:
        sheets = read_sheets(head.path)
    except DataError:
        return False
    return bool(sheets) and _is_catman(sheets[0].rows)


def read(path: Path) -> ChannelRecord | Records:
    """One record, or one for each time column. DataError for a channel that fits no or several time columns."""
    sheet = read_sheets(path)[0]
    if not _is_catman(sheet.rows):
        raise DataError(f"{path}, sheet '{sheet.name}': no file comment above names and units, expected a catman export; export it again")
    first = _first_numbers(sheet, path)
    channels = _channels(sheet, first)
    groups = _groups(channels, path)
    header = {f"{channel.column.name}: rate": channel.rate for channel in channels if channel.rate}
    tests = {}
    for clock, members in groups:
        block = ColumnBlock(tuple(c.column for c in members), np.stack([c.values for c in members], axis=1))
        remarks = (f"{sheet.padding} empty rows at the end dropped",) if sheet.padding else ()
        tests[clock.column.name] = make_record(Traits(NAME, path, header=header, remarks=remarks), block, {})
    if len(tests) == 1:
        return next(iter(tests.values()))
    columns = tuple(channel.column for channel in channels)
    return Records(Traits(NAME, path, columns=columns, header=header, remarks=(f"{len(tests)} time columns with their own rate",)), tests)


def _first_numbers(sheet: Sheet, path: Path) -> int:
    """Row (from 0) of the first numbers: below the settings."""
    named = len([word for word in words_of(sheet.rows[1]) if word])
    for k in range(3, min(len(sheet.rows), _SETTINGS)):
        if 2 * np.isfinite(numbers_of([sheet.rows[k]], len(sheet.rows[k]))).sum() > named:
            return k
    raise DataError(f"{path}, sheet '{sheet.name}': no row of numbers below the channel settings; export the test again")


def _channels(sheet: Sheet, first: int) -> list[Channel]:
    names, units = words_of(sheet.rows[1]), words_of(sheet.rows[2])
    values = numbers_of(sheet.rows[first:], len(names))
    settings: list[Row] = [words_of(row) for row in sheet.rows[3:first]]
    channels = []
    for k, name in enumerate(names):
        if not name:
            continue
        rate = next((str(row[k]) for row in settings if k < len(row) and "Hz" in str(row[k]) and "ms" in str(row[k])), "")
        held = np.flatnonzero(np.isfinite(values[:, k]))
        length = int(held[-1]) + 1 if held.size else 0
        channels.append(Channel(k, column_of(name, units[k] if k < len(units) else ""), rate, values[:length, k]))
    return channels


def _groups(channels: list[Channel], path: Path) -> list[tuple[Channel, list[Channel]]]:
    """Each time column with the channels of its rate and length, in the order of the file."""
    clocks = [c for c in channels if c.column.meaning == "time" and c.values.size]
    if not clocks:
        raise DataError(f"{path}: no column of time found, expected one with the unit s; export the test with its time channel")
    names = [clock.column.name for clock in clocks]
    if len(set(names)) < len(names):
        raise DataError(f"{path}: two time columns have the same name {_twice(names)!r}; rename one")
    groups: dict[int, list[Channel]] = {clock.place: [clock] for clock in clocks}
    for channel in channels:
        if channel.place in groups or not channel.values.size:
            continue
        fitting = [c for c in clocks if c.values.size == channel.values.size and (c.rate == channel.rate or not (c.rate and channel.rate))]
        if len(fitting) != 1:
            what = "several time columns fit" if fitting else "no time column has its rate and length"
            raise DataError(f"{path}: channel '{channel.column.name}' has {channel.values.size} values, and {what}; export it again")
        groups[fitting[0].place].append(channel)
    return [(clock, groups[clock.place]) for clock in clocks]


def _twice(names: list[str]) -> str:
    return next(a for a, b in pairwise(sorted(names)) if a == b)
