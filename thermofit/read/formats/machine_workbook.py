"""Workbooks of testing machines: a few lines on the specimen (L0, D, A), a row of column names with units in brackets, numbers below.

The sheets may be padded with tens of thousands of empty rows, and text and date cells may mix in one column. Several sheets with
tables become several tests, named after the sheets.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import ChannelRecord, Head, Records, Traits
from thermofit.read.formats.record_columns import ColumnBlock, column_of, kind_remarks, make_record, texts_of, with_dates
from thermofit.read.formats.record_table import LEAST_ROWS, MOST_COLUMNS, Cell, Start, find_start, read_preamble, words_of
from thermofit.read.formats.workbook import Sheet, cell_number, is_workbook, numbers_of, read_sheets

NAME = "machine workbook (XLSX)"


def recognises(head: Head) -> bool:
    """True for a workbook in which at least one sheet holds a table; a damaged one too, whose defect `read` names."""
    if not is_workbook(head):
        return False
    try:
        return any(_start_of(sheet) for sheet in read_sheets(head.path))
    except DataError:
        return True


def read(path: Path) -> ChannelRecord | Records:
    """The record of the only sheet that holds a table, else records by sheet. DataError where none does."""
    tests = {sheet.name: sheet_record(sheet, path) for sheet in read_sheets(path) if _start_of(sheet)}
    if not tests:
        raise DataError(f"{path}: no sheet holds a row of column names with rows of numbers below it; export the test again")
    if len(tests) == 1:
        return next(iter(tests.values()))
    return Records(Traits(NAME, path, remarks=(f"{len(tests)} sheets hold a table: {', '.join(tests)}",)), tests)


def _start_of(sheet: Sheet) -> Start | None:
    """Where the table of a sheet begins; that of one without names is its first row of numbers. None where there is none."""
    found = find_start(sheet.rows, cell_number)
    if found is not None:
        return found
    rows = sheet.rows[: sheet.filled]
    good = [
        2 <= len(words_of(row)) <= MOST_COLUMNS and all(np.isfinite(cell_number(cell)) for cell in row if words_of([cell])) for row in rows
    ]
    return Start(good.index(True), None, good.index(True), sum(good)) if sum(good) >= LEAST_ROWS and sum(good) > 0.9 * len(rows) else None


def sheet_record(sheet: Sheet, path: Path, about: Mapping[str, float] | None = None, form: str = NAME) -> ChannelRecord:
    """The record of a sheet; `about` is known of the specimen besides what the rows above the table say; `form` names the format."""
    start = _start_of(sheet)
    if start is None:
        raise DataError(f"{path}, sheet '{sheet.name}': no row of column names with rows of numbers below it; export the test again")
    named = start.names < start.first
    names = words_of(sheet.rows[start.names]) if named else [""] * max(len(words_of(row)) for row in sheet.rows[start.first :])
    units = [] if start.units is None else words_of(sheet.rows[start.units])
    # Cells beside the table (a note, a result typed in later) have neither a name nor a unit.
    width = len(names)
    units = [*units[:width], *[""] * (width - len(units))]
    rows, empty = sheet.rows[start.first : sheet.filled], sheet.padding
    above = [sheet.rows[k] for k in range(start.first) if not named or k not in (start.names, start.units)]
    preamble = read_preamble(above, cell_number)
    written = [column_of(name, unit) for name, unit in zip(names, units, strict=True)]

    def cells(k: int) -> list[Cell]:
        return [row[k] if k < len(row) else "" for row in rows]

    columns, values, said = with_dates(written, numbers_of(rows, width), cells)
    told = kind_remarks(columns, [" ".join(words_of(row)) for row in above])
    if not named:
        said = (f"the table has no names: its columns are called column 1 to column {width}", *said)
    remarks = (*((f"{empty} empty rows at the end dropped",) if empty else ()), *preamble.remarks, *told)
    traits = Traits(form, path, header={"sheet": sheet.name, **preamble.header}, remarks=remarks)
    return make_record(traits, ColumnBlock(tuple(columns), values, said, texts_of(values, cells)), {**preamble.about, **(about or {})})
