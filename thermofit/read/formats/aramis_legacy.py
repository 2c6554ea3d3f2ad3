"""ARAMIS v6 ASCII by a user's export template: comment lines, then points whose groups of numbers may span several lines.

The last comment lines list what a point holds ("Index_x, Index_y, Coordinate-undef (x,y,z), Displ(x,y,z), ..."). Coordinates may be in
a file of their own (`...-Stage-0-0`); `sequence` brings both together by the index.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.aramis_csv import header_pairs
from thermofit.read.formats.contents import Column, DicStage, Head, Traits
from thermofit.read.formats.naming import stage_time
from thermofit.read.formats.table import NamedTable, StageFacts, make_stage
from thermofit.read.formats.text import BLANKS, Layout, NumberTable, detect_layout, head_lines, parse_number, read_text, split_cells

NAME = "ARAMIS v6 ASCII (export template, one stage)"
WHAT = "an ARAMIS v6 export: '#' lines with 'Stage : 0 - 1' and 'Index_x, Index_y, ...', then the numbers of each point"
_GROUP = re.compile(r"([A-Za-z][A-Za-z_ -]*?)\s*(?:\(([^)]*)\))?\s*(?:,|$)")
_STAGE = re.compile(r"#\s*Stage\s*:\s*(\d{1,9})\s*-\s*(\d{1,9})\b", re.IGNORECASE)
_CHANNEL = re.compile(r"#\s*(AD-\d+)\s*:\s*(\S+)\s+(\S+)\s*(.*)$")
_TIMES = re.compile(r"(undeformt|deformt)\s*:\s*(\S+)")
_STRAIN = {"x": "exx", "y": "eyy", "xy": "exy", "major": "e1", "minor": "e2", "thicknessreduction": "e3"}
_INDEX_RANGE = 1_000_000
_LONGEST = 2000
"""Most letters of a line that lists columns."""
_FIXED = {"%": "1"}
_ASSUMED = "the file writes no units: lengths are taken as mm and strains as %, as in the export template of the software"


def _groups(lines: list[str]) -> list[Column]:
    """Columns of a point from the comment line that lists them; empty where there is none."""
    line = next((line for line in lines if re.match(r"#\s*Index_x\s*,\s*Index_y\s*,", line, re.IGNORECASE)), None)
    columns: list[Column] = []
    # Runs of blanks are one blank, and no list of columns is endless: the pattern tries every split of them.
    listed = " ".join(line.lstrip("# ").split()) if line else ""
    for match in _GROUP.finditer(listed if len(listed) <= _LONGEST else ""):
        name, parts = match.group(1).strip(), [part.strip().lower() for part in (match.group(2) or "").split(",")]
        word = name.lower()
        if word in ("index_x", "index_y"):
            columns.append(Column(name, "id"))
        elif word.startswith("coord"):
            kind = "" if "undef" in word else "deformed "
            columns += [Column(f"{name} {part}", kind + part, "mm", "format") for part in parts if part in ("x", "y", "z")]
        elif word.startswith("disp"):
            columns += [Column(f"{name} {part}", "uvw"["xyz".index(part)], "mm", "format") for part in parts if part in ("x", "y", "z")]
        elif word.startswith("strain"):
            columns += [Column(f"{name} {part}", _STRAIN.get(part, ""), "%", "format") for part in parts]
    return columns


def _confused(columns: list[Column]) -> bool:
    """Whether a meaning other than the two indices occurs twice, or the indices are not the first two."""
    rest = [column.meaning for column in columns[2:] if column.meaning]
    return len(set(rest)) != len(rest) or "id" in rest or [column.meaning for column in columns[:2]] != ["id", "id"]


def recognises(head: Head) -> bool:
    """A comment line that lists Index_x, Index_y and more."""
    return any(re.match(r"#\s*Index_x\s*,\s*Index_y\s*,", line, re.IGNORECASE) for line in head_lines(head))


def _points(body: list[tuple[int, str]], path: Path, layout: Layout, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (n, width) of the points and the first line (n,) of each. DataError where a point's lines are not like the first's."""
    rows = [split_cells(line, layout.separator) for _, line in body]
    counts = [len(cells) for cells in rows]
    per_point = int(np.searchsorted(np.cumsum(counts), width)) + 1
    if per_point > len(rows) or sum(counts[:per_point]) != width:
        raise DataError(
            f"{path}, line {body[0][0]}: the first lines hold {', '.join(map(str, counts[:per_point]))} numbers, expected {width} for a "
            f"point as the header lists; correct the comment line 'Index_x, Index_y, ...' or export it again"
        )
    pattern = counts[:per_point]
    for k, count in enumerate(counts):
        if count != pattern[k % per_point]:
            expected = f"expected {pattern[k % per_point]} as in the first point"
            raise DataError(f"{path}, line {body[k][0]}: found {count} numbers, {expected}; correct the line or export the file again")
    if len(rows) % per_point:
        raise DataError(f"{path}, line {body[-1][0]}: the file ends inside a point of {per_point} lines; export it again")
    values = np.array([parse_number(cell, layout.decimal) for cells in rows for cell in cells]).reshape(-1, width)
    return values, np.array([number for number, _ in body[::per_point]])


def _signals(lines: list[str]) -> dict[str, tuple[float, str]]:
    """Values of the analogue channels in the deformed stage, with the unit as written."""
    found = {}
    for line in lines:
        if match := _CHANNEL.match(line):
            value = _either(match.group(3))
            if not np.isnan(value):
                found[match.group(1)] = (value, match.group(4).strip())
    return found


def _either(word: str) -> float:
    """A number of the header, whose decimal sign need not be that of the data."""
    value = parse_number(word)
    return parse_number(word, ",") if np.isnan(value) else value


def _time(lines: list[str]) -> float | None:
    """Time of the stage in s since the undeformed one, from the two stamps in seconds since 1970; None where one is absent."""
    stamps = {match.group(1).lower(): _either(match.group(2)) for line in lines for match in _TIMES.finditer(line)}
    between = stamps.get("deformt", np.nan) - stamps.get("undeformt", np.nan)
    return None if np.isnan(between) else float(between)


def _one_id(columns: list[Column], values: np.ndarray, lines: np.ndarray, path: Path) -> tuple[list[Column], np.ndarray]:
    """The two indices as one number, strains without unit. DataError where an index is no whole number that fits."""
    index = values[:, :2]
    wrong = ~((index == np.floor(index)) & (index >= 0) & (index < _INDEX_RANGE)).all(axis=1)
    if wrong.any():
        raise DataError(f"{path}, line {lines[wrong][0]}: the indices of the point are no whole numbers from 0 on; correct the line")
    rest = values[:, 2:] * np.array([0.01 if column.unit == "%" else 1.0 for column in columns[2:]])
    both = Column(f"{columns[0].name}, {columns[1].name}", "id")
    return [both, *columns[2:]], np.column_stack([index[:, 0] + _INDEX_RANGE * index[:, 1], rest])


def read(path: Path) -> DicStage:
    """One stage, mm, strains from %; points that were not correlated are absent. DataError for every defect, with line."""
    text = read_text(path, WHAT)
    comments = [line.strip() for line in text.lines if line.lstrip().startswith("#")]
    columns = _groups(comments)
    meanings = {column.meaning for column in columns}
    if _confused(columns) or not ({"x", "y"} <= meanings or {"u", "v"} <= meanings or {"deformed x", "deformed y"} <= meanings):
        raise DataError(f"{path}: no comment line lists Index_x, Index_y and coordinates or displacements once, expected {WHAT}")
    body = [(k, line) for k, line in enumerate(text.lines, start=1) if line.strip() and not line.lstrip().startswith("#")]
    if not body:
        raise DataError(f"{path}: no points below the comment lines, expected {WHAT}; leave this stage out")
    layout = detect_layout([line for _, line in body], path, BLANKS)
    values, lines = _points(body, path, layout, len(columns))
    only_deformed = not any(column.meaning == "x" for column in columns)
    if only_deformed:
        columns = [replace(column, meaning=column.meaning.removeprefix("deformed ")) for column in columns]
    columns, values = _one_id(columns, values, lines, path)
    table = NumberTable(values, lines, int(np.isnan(values).sum()), 0, ())
    traits = Traits(NAME, path, text.encoding, BLANKS, layout.decimal, tuple(columns), table.missing, (), header_pairs(comments))
    named = NamedTable(path, tuple(columns), tuple(_FIXED.get(column.unit, column.unit) for column in columns), values, table, traits)
    stage = next((int(match.group(2)) for line in comments if (match := _STAGE.match(line))), stage_time(path)[0])
    return make_stage(named, NAME, StageFacts(only_deformed, _time(comments), stage, None, (_ASSUMED,), _signals(comments)))
