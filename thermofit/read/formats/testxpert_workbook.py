"""ZwickRoell testXpert workbooks: sheets `Parameters`, `Results <name>` (sizes) and `Values <name>` for every specimen.

A sheet of values holds the specimen in row 1, names in row 2, units in row 3. "Strain" may be an elongation in mm: the unit decides.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import ChannelRecord, Head, Records, Traits
from thermofit.read.formats.machine_workbook import sheet_record
from thermofit.read.formats.record_columns import about_of
from thermofit.read.formats.record_table import words_of
from thermofit.read.formats.workbook import Sheet, cell_number, is_workbook, read_sheets, sheet_names

NAME = "ZwickRoell testXpert workbook (XLSX)"
_VALUES = ("Values ", "Werte ", "Valeurs ")
_RESULTS = ("Results", "Ergebnisse", "R\u00e9sultats")
_SPECIMEN = ("Specimen designation", "Probenbezeichnung")


def _values_of(names: list[str]) -> list[str]:
    return [name for name in names if name.startswith(_VALUES)]


def recognises(head: Head) -> bool:
    """True for a workbook with a sheet of results and one of values."""
    if not is_workbook(head):
        return False
    try:
        names = sheet_names(head.path)
    except DataError:
        return False
    return bool(_values_of(names)) and any(name.startswith(_RESULTS) for name in names)


def read(path: Path) -> ChannelRecord | Records:
    """The record of the only sheet of values, else records by specimen. DataError where there is none."""
    sheets = {sheet.name: sheet for sheet in read_sheets(path)}
    values = _values_of(list(sheets))
    if not values:
        raise DataError(f"{path}: no sheet of values ('Values <specimen>') found; export the test again with its values")
    tests = {}
    for name in values:
        label = name.split(" ", 1)[1].strip() or name
        results = _results_for(sheets, label)
        record = sheet_record(_without_title(sheets[name]), path, _about(results, label), NAME)
        tests[label] = replace(record, traits=replace(record.traits, header={**record.traits.header, **_texts(results)}))
    if len(tests) == 1:
        return next(iter(tests.values()))
    return Records(Traits(NAME, path, remarks=(f"{len(tests)} specimens: {', '.join(tests)}",)), tests)


def _without_title(sheet: Sheet) -> Sheet:
    """The sheet without its first row, which repeats the specimen's name (and may hold numbers typed in later)."""
    return replace(sheet, rows=sheet.rows[1:], declared=max(0, sheet.declared - 1))


def _results_for(sheets: Mapping[str, Sheet], label: str) -> Sheet | None:
    """The sheet of results of the specimen, else the only one."""
    found = [sheet for name, sheet in sheets.items() if name.startswith(_RESULTS)]
    named = [sheet for sheet in found if sheet.name.split(" ", 1)[-1].strip() == label]
    return named[0] if named else found[0] if len(found) == 1 else None


def _row_of(results: Sheet, label: str) -> int | None:
    """Row of the specimen below names and units: the one that names it, else the only one."""
    names = words_of(results.rows[0])
    place = next((k for k, name in enumerate(names) if name in _SPECIMEN), None)
    rows = [k for k in range(2, len(results.rows)) if words_of(results.rows[k])]
    named = [k for k in rows if place is not None and place < len(results.rows[k]) and str(results.rows[k][place]).strip() == label]
    return named[0] if named else rows[0] if len(rows) == 1 else None


def _about(results: Sheet | None, label: str) -> dict[str, float]:
    """Sizes of the specimen from its sheet of results (a0, b0, L0, d0, S0), with their units."""
    if results is None or len(results.rows) < 3 or (k := _row_of(results, label)) is None:
        return {}
    about: dict[str, float] = {}
    units = words_of(results.rows[1])
    for place, name in enumerate(words_of(results.rows[0])):
        if place < len(results.rows[k]):
            about |= about_of(name, cell_number(results.rows[k][place]), units[place] if place < len(units) else "")
    return about


def _texts(results: Sheet | None) -> dict[str, str]:
    """Names and first values of the results, as written."""
    if results is None or len(results.rows) < 3:
        return {}
    return {name: word for name, word in zip(words_of(results.rows[0]), words_of(results.rows[2]), strict=False) if name and word}
