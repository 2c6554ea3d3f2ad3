"""ARAMIS Professional / ZEISS Inspect Correlate: surface component as CSV, one file for each stage.

Six header lines (units, stage, its time, component), then id, coordinates of the DEFORMED stage, displacements and technical strains. A
variant parts cells by commas and holds the coordinates twice.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.units import to_fixed
from thermofit.read.formats.contents import Column, DicStage, Head
from thermofit.read.formats.table import STRAINS, NamedTable, StageFacts, make_stage, read_named
from thermofit.read.formats.text import head_lines, parse_number, read_text, split_cells, whole_number

NAME = "ARAMIS / ZEISS CSV (surface component, one stage)"
WHAT = "an ARAMIS stage: '# Units: ...', stage, time, then id, coordinates and displacements"
_MEANINGS = {
    **{"id": "id", "x": "x", "y": "y", "z": "z", "displacement_x": "u", "displacement_y": "v", "displacement_z": "w"},
    **{"epsilon_x": "exx", "epsilon_y": "eyy", "epsilon_xy": "exy", "major_strain": "e1", "minor_strain": "e2", "mises_strain": "mises"},
    **{"thickness_strain": "e3"},
}
_SAME = 2e-3
"""mm by which two blocks of coordinates may differ from a constant shift: their rounding, 1e-4 mm, and room."""


def header_line(lines: list[str]) -> tuple[int, str] | None:
    """Index of the line of column names and its separator, None where there is none."""
    for k, line in enumerate(lines[:60]):
        for separator in (";", ",", "\t"):
            names = {cell.lower() for cell in split_cells(line, separator)}
            if {"x", "y", "displacement_x", "displacement_y"} <= names:
                return k, separator
    return None


def recognises(head: Head) -> bool:
    """Column names of ARAMIS below comment lines."""
    lines = head_lines(head)
    found = header_line(lines)
    return found is not None and any(line.lstrip().startswith("#") for line in lines[: found[0]])


def unit_of(lines: list[str], quantity: str) -> str:
    """Unit of a quantity ("length", "time") of the line `# Units: length:mm angle:deg time:s`, "" where it is not said."""
    for line in lines:
        if line.lower().replace(" ", "").startswith("#units:"):
            words = line.replace(",", " ").split()
            return next((word.split(":", 1)[1] for word in words if word.lower().startswith(f"{quantity}:")), "")
    return ""


def _stage_line(lines: list[str], path: Path) -> tuple[int | None, float | None]:
    """Stage number and time in s of the pair of lines `stage;index;relative_time;date`."""
    for k, line in enumerate(lines[:-1]):
        for separator in (";", ","):
            names = [cell.lower() for cell in split_cells(line, separator)]
            if "relative_time" in names:
                cells = dict(zip(names, split_cells(lines[k + 1], separator), strict=False))
                time = parse_number(cells["relative_time"]) if "relative_time" in cells else np.nan
                if np.isnan(time):
                    time = parse_number(cells.get("relative_time", ""), ",")
                if np.isnan(time):
                    raise DataError(f"{path}, line {k + 2}: relative_time is no number, expected seconds; export the stage again")
                number = parse_number(cells.get("index", ""))
                return whole_number(number), _seconds(time, unit_of(lines, "time") or "s", path)
    return None, None


def _seconds(time: float, unit: str, path: Path) -> float:
    """The time of a stage in s. DataError where the file gives it in something that is no unit of time."""
    try:
        converted, fixed = to_fixed(time, unit)
    except ValueError as error:
        raise DataError(f"{path}: time of the stage: {error}; correct the line '# Units:'") from None
    if fixed != "s":
        raise DataError(f"{path}: the time of the stage is in {unit}, expected the unit of a time; correct the line '# Units:'")
    return float(converted)


def read(path: Path) -> DicStage:
    """One stage; reference positions are coordinates minus displacements. DataError for every defect, with line."""
    text = read_text(path, WHAT)
    found = header_line(text.lines)
    if found is None:
        raise DataError(f"{path}: no line with the columns x, y, displacement_x, displacement_y found, expected {WHAT}; export it again")
    header, separator = found
    unit = unit_of(text.lines[:header], "length")
    seen: set[str] = set()

    def describe(name: str, written: str) -> Column:
        meaning = _MEANINGS.get(name.lower(), "")
        if meaning in seen and meaning in ("x", "y", "z"):
            meaning = f"other {meaning}"
        seen.add(meaning)
        if meaning in STRAINS:
            return Column(name, meaning, written or "1", "file" if written else "format")
        return Column(name, meaning, "" if meaning in ("", "id") else written or unit, "file" if written or unit else "unknown")

    named = read_named(text, path, header, separator, describe)
    named = replace(named, traits=replace(named.traits, header=header_pairs(text.lines[:header])))
    number, time = _stage_line(text.lines[:header], path)
    return make_stage(named, NAME, StageFacts(True, time, number, None, _second_block(named)))


def header_pairs(lines: list[str]) -> dict[str, str]:
    """Comment lines `# key: value` of the header."""
    pairs = (line.lstrip("# ").split(":", 1) for line in lines if line.lstrip().startswith("#") and ":" in line)
    return {key.strip(): value.strip() for key, value in pairs}


def _second_block(named: NamedTable) -> tuple[str, ...]:
    """Remark on coordinates that occur twice; DataError where the two are not the same points but for a shift of the origin."""
    first, second = named.vector(("x", "y", "z")), named.vector(("other x", "other y", "other z"))
    if first is None or second is None:
        return ()
    apart = second - first
    both = ~np.isnan(apart).all(axis=1)
    if not both.any():
        return ()
    shift = np.array([np.median(column[~np.isnan(column)]) if not np.isnan(column).all() else 0.0 for column in apart.T])
    if np.nanmax(np.abs(apart[both] - shift)) > _SAME:
        raise DataError(
            f"{named.path}: the two blocks of coordinates are not the same points in the same axes, expected a shift of the origin at "
            f"most; export the coordinates once"
        )
    moved = f", shifted by {shift[0]:.4g}, {shift[1]:.4g}, {shift[2]:.4g}" if np.abs(shift).max() > _SAME else ""
    return (f"coordinates are there twice{moved}; the first are used",)
