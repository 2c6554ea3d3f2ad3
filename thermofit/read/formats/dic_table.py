"""Any CSV table of points whose header names coordinates and displacements, such as `x-coordinate [mm],...,x-displacement [mm]`.

The general case after all particular formats: whether coordinates are those of the reference is not written; they are taken so, with a
remark.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import Column, DicStage, Head
from thermofit.read.formats.table import StageFacts, make_stage, read_named
from thermofit.read.formats.text import head_lines, name_and_unit, parse_number, read_text, split_cells

NAME = "CSV table of coordinates and displacements (one stage)"
WHAT = "a table whose header names coordinates and displacements, such as 'x-coordinate [mm],y-coordinate [mm],x-displacement [mm],...'"
_COORDINATE = re.compile(r"coord\w*|coor|position|pos|location")
_DISPLACEMENT = re.compile(r"displacement\w*|displ|disp")
_BELOW = 3
"""Lines below the header of which one must hold a number: there may be a line of units between."""
_IDS = ("id", "point id", "node", "node id", "point", "index", "facet id")


def _meaning(name: str) -> str:
    """Meaning of a column name: an axis beside a word for coordinates or displacements, or a number of points."""
    words = re.sub(r"[^a-z0-9]+", " ", name.lower()).strip()
    if words in _IDS:
        return "id"
    axes = [word for word in words.split() if word in ("x", "y", "z")]
    if len(axes) != 1:
        return ""
    for pattern, meanings in ((_DISPLACEMENT, "uvw"), (_COORDINATE, "xyz")):
        if any(pattern.fullmatch(word) for word in words.split()):
            return meanings["xyz".index(axes[0])]
    return ""


def _header_line(lines: list[str]) -> tuple[int, str] | None:
    """Index of the line of column names and its separator, None where there is none."""
    for k, line in enumerate(lines[:30]):
        for separator in (",", ";", "\t"):
            meanings = {_meaning(name_and_unit(cell)[0]) for cell in split_cells(line.lstrip("#"), separator)}
            if {"x", "y", "u", "v"} <= meanings:
                return k, separator
    return None


def recognises(head: Head) -> bool:
    """A header line with two coordinates and two displacements, and numbers (or nothing) below it: prose may name these columns too."""
    lines = head_lines(head)
    found = _header_line(lines)
    if found is None:
        return False
    below = [line for line in lines[found[0] + 1 :] if line.strip()][:_BELOW]
    cells = [cell for line in below for cell in split_cells(line, found[1])]
    return not below or any(not np.isnan(parse_number(cell, sign)) for cell in cells for sign in ".,")


def read(path: Path) -> DicStage:
    """One stage with coordinates as reference; the unit is "" where the header has none. DataError for every defect, with line."""
    text = read_text(path, WHAT)
    found = _header_line(text.lines)
    if found is None:
        raise DataError(f"{path}: no header with coordinates and displacements found, expected {WHAT}; rename the columns")
    header, separator = found

    def describe(name: str, written: str) -> Column:
        meaning = _meaning(name)
        return Column(name, meaning, "" if meaning == "id" else written, "file" if written else "unknown")

    named = read_named(text, path, header, separator, describe)
    remarks = ("the file does not say whether coordinates are those of the reference or of the stage: taken as reference",)
    return make_stage(named, NAME, StageFacts(False, None, None, None, remarks))
