"""Workbooks of testing machines: a few lines on the specimen (L0, D, A), a row of column names with units in brackets, numbers below.

The sheets may be padded with tens of thousands of empty rows, and text and date cells may mix in one column. Several sheets with
tables become several tests, named after the sheets.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from thermofit.core.errors import DataError
from thermofit.measure.formats.contents import Head, Record, Records, Traits
from thermofit.measure.formats.record_columns import Block, column_of, make_record
from thermofit.measure.formats.record_table import find_start, read_preamble, words_of
from thermofit.measure.formats.workbook import Sheet, cell_number, is_workbook, numbers_of, read_sheets

NAME = "machine workbook (XLSX)"


def recognises(head: Head) -> bool:
    """True for a workbook in which at least one sheet holds a table; a damaged one too, whose defect `read` names."""
    if not is_workbook(head):
        return False
    try:
        return any(find_start(sheet.rows, cell_number) for sheet in read_sheets(head.path))
    except DataError:
        return True


def read(path: Path) -> Record | Records:
    """The record of the only sheet that holds a table, else records by sheet. DataError where none does."""
    tests = {sheet.name: sheet_record(sheet, path) for sheet in read_sheets(path) if find_start(sheet.rows, cell_number)}
    if not tests:
        raise DataError(f"{path}: no sheet holds a row of column names with rows of numbers below it; export the test again")
    if len(tests) == 1:
        return next(iter(tests.values()))
    return Records(Traits(NAME, path, remarks=(f"{len(tests)} sheets hold a table: {', '.join(tests)}",)), tests)


def sheet_record(sheet: Sheet, path: Path, about: Mapping[str, float] | None = None, form: str = NAME) -> Record:
    """The record of a sheet; `about` is known of the specimen besides what the rows above the table say; `form` names the format."""
    start = find_start(sheet.rows, cell_number)
    if start is None:
        raise DataError(f"{path}, sheet '{sheet.name}': no row of column names with rows of numbers below it; export the test again")
    names = words_of(sheet.rows[start.names])
    units = [] if start.units is None else words_of(sheet.rows[start.units])
    # Cells beside the table (a note, a result typed in later) have neither a name nor a unit.
    width = len(names)
    units = [*units[:width], *[""] * (width - len(units))]
    rows, empty = sheet.rows[start.first : sheet.filled], sheet.padding
    header, found = read_preamble(sheet.rows[: start.names], cell_number)
    remarks = (f"{empty} empty rows at the end dropped",) if empty else ()
    columns = tuple(column_of(name, unit) for name, unit in zip(names, units, strict=True))
    traits = Traits(form, path, header={"sheet": sheet.name, **header}, remarks=remarks)
    return make_record(traits, Block(columns, numbers_of(rows, width)), {**found, **(about or {})})
