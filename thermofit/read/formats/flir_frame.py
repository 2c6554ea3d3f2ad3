"""FLIR ResearchIR, ExaminIR: one CSV for each frame, a bare matrix of values, in some exports below lines `name:,value`.

Neither unit nor time is in the bare matrix. The number at the end of the file name is that of the frame and is not padded: sort by it as a
number; frames may be missing.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.units import known_unit
from thermofit.read.formats.contents import Column, Head, ThermalFrames, Traits
from thermofit.read.formats.optris import is_paired
from thermofit.read.formats.text import Layout, head_lines, parse_number, read_text, split_cells
from thermofit.read.formats.thermal_rows import check_some, in_kelvin, matrix

NAME = "FLIR ResearchIR frame CSV"
MIN_COLUMNS = 11
"""A row with more than ten numbers is one of the image."""
_HEADER = re.compile(r'\s*"?[A-Za-z][^,]*:\s*"?\s*(,.*)?')
_NUMBER_OF_FRAME = re.compile(r"_(\d{1,9})\.[A-Za-z]+$", re.ASCII)
_LAYOUT = Layout(",", ".")
_WHAT = "a matrix of more than ten columns"


def recognises(head: Head) -> bool:
    """Whether a matrix of many columns follows nothing but lines `name:,value`, and is no table of Optris."""
    lines = head_lines(head)
    start = _first_row(lines)
    if start is None or not all(_HEADER.fullmatch(line) for line in lines[:start] if line.strip()):
        return False
    rows = [line for line in lines[start:] if line.strip()]
    # The last line may be cut where the beginning of the file ends.
    whole = rows[:-1] or rows
    return not is_paired(whole) and len({row.strip().rstrip(",").count(",") for row in whole}) == 1


def read(path: Path) -> ThermalFrames:
    """The frame, in K where its header names a unit of temperature, else as in the file. DataError for every defect."""
    text = read_text(path, _WHAT)
    start = _first_row(text.lines)
    if start is None:
        raise DataError(f"{path}: found no row of more than ten numbers, expected {_WHAT}; export it again")
    other = next((k for k, line in enumerate(text.lines[:start]) if line.strip() and not _HEADER.fullmatch(line)), None)
    if other is not None:
        raise DataError(
            f"{path}, line {other + 1}: found no row of more than ten numbers nor 'name:,value', expected {_WHAT}; export it again"
        )
    rows = [(number, line) for number, line in enumerate(text.lines[start:], start=start + 1) if line.strip()]
    values = matrix(rows, path, _LAYOUT)
    missing = check_some(values, path)
    header = _parameters(text.lines[:start])
    frame = _NUMBER_OF_FRAME.search(path.name)
    if frame:
        header["frame"] = frame.group(1)
    remarks = [f"{missing} pixels hold no number"] if missing else []
    unit_text = next((value for name, value in header.items() if "unit" in name.lower()), "")
    unit = known_unit(unit_text) if unit_text else None
    is_temperature = unit is not None and unit.quantity == "temperature"
    if is_temperature:
        values = in_kelvin(values, unit_text, path)
    else:
        remarks.append("the unit of the values is not in the file")
    column = Column("frame", "temperature" if is_temperature else "", unit_text, "file" if is_temperature else "unknown")
    traits = Traits(NAME, path, text.encoding, ",", ".", (column,), missing, tuple(remarks), header)
    return ThermalFrames(traits, values[np.newaxis], "K" if is_temperature else "")


def _first_row(lines: list[str]) -> int | None:
    """Index of the first line with more than ten numbers."""
    for k, line in enumerate(lines):
        if line.count(",") >= MIN_COLUMNS - 1:
            cells = split_cells(line, ",")[: 2 * MIN_COLUMNS]
            if sum(np.isfinite(parse_number(cell)) for cell in cells) >= MIN_COLUMNS:
                return k
    return None


def _parameters(lines: list[str]) -> dict[str, str]:
    found = {}
    for line in lines:
        cells = [cell for cell in split_cells(line, ",") if cell]
        if len(cells) > 1:
            found[cells[0].rstrip(": ")] = cells[1]
    return found
