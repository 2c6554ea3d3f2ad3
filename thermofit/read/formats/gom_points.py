"""GOM Inspect / ARAMIS point cloud as CSV, one file for each stage: id and coordinates of the stage, no displacements."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from thermofit.core.errors import DataError
from thermofit.read.formats.aramis_csv import header_pairs, unit_of
from thermofit.read.formats.contents import Column, DicStage, Head
from thermofit.read.formats.table import StageFacts, make_stage, read_named
from thermofit.read.formats.text import head_lines, read_text, split_cells

NAME = "GOM point cloud CSV (coordinates of one stage)"
WHAT = "a GOM point cloud: '# Stage: ...', '# Units: ...', then id, x, y, z"
_STAGE = re.compile(r"#\s*Stage\s*:\D*(\d{1,9})\s*$", re.IGNORECASE)


def _header_line(lines: list[str]) -> tuple[int, str] | None:
    """Index of the line of column names and its separator, None where there is none."""
    for k, line in enumerate(lines[:60]):
        for separator in (",", ";", "\t"):
            if [cell.lower() for cell in split_cells(line, separator) if cell] == ["id", "x", "y", "z"]:
                return k, separator
    return None


def recognises(head: Head) -> bool:
    """The columns id, x, y, z below comment lines."""
    lines = head_lines(head)
    found = _header_line(lines)
    return found is not None and any(line.lstrip().startswith("#") for line in lines[: found[0]])


def read(path: Path) -> DicStage:
    """Coordinates of one stage as `deformed`; displacements are differences to the first stage (`sequence`). DataError with line."""
    text = read_text(path, WHAT)
    found = _header_line(text.lines)
    if found is None:
        raise DataError(f"{path}: no line with the columns id, x, y, z found, expected {WHAT}; export it again")
    header, separator = found
    unit = unit_of(text.lines[:header], "length")

    def describe(name: str, written: str) -> Column:
        if name.lower() == "id":
            return Column(name, "id")
        return Column(name, name.lower(), written or unit, "file" if written or unit else "unknown")

    named = read_named(text, path, header, separator, describe)
    named = replace(named, traits=replace(named.traits, header=header_pairs(text.lines[:header])))
    stage = next((int(match.group(1)) for line in text.lines[:header] if (match := _STAGE.match(line.strip()))), None)
    return make_stage(named, NAME, StageFacts(True, None, stage))
