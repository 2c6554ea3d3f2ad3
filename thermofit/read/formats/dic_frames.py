"""A CSV table of many DIC frames, one row for each point of each frame, such as `frame,node,x_ref_px,y_ref_px,u_px,v_px`.

Own programs write such tables. Units are those in the names (`_px`, `_mm`) or in brackets; nothing says the time of a frame.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import Column, DicSequence, Head
from thermofit.read.formats.table import NamedTable, StageFacts, make_stage, read_named
from thermofit.read.formats.text import head_lines, name_and_unit, read_text, split_cells

NAME = "CSV table of many DIC frames"
WHAT = "a table whose header names frame, coordinates and displacements, such as 'frame,node,x_ref_px,y_ref_px,u_px,v_px'"
_FRAME = re.compile(r"frame|stage|image|step")
_ID = re.compile(r"node|point|id|(?:node|point|facet)[ _]id")
_COORDINATE = re.compile(r"([xyz])(?:[ _](?:ref[a-z]*|coord[a-z]*|pos[a-z]*))?(?:_(px|mm))?")
_MOVE = re.compile(r"(?:([uvw])|disp[a-z]*[ _]([xyz]))(?:_(px|mm))?")
_MOST_LINES = 30


def _describe(name: str, written: str) -> Column:
    """Meaning and unit of a column name."""
    plain = name.strip().lower()
    if _FRAME.fullmatch(plain):
        return Column(name, "frame")
    if _ID.fullmatch(plain):
        return Column(name, "id")
    if match := _COORDINATE.fullmatch(plain):
        unit = written or match.group(2) or ""
        return Column(name, match.group(1), unit, "file" if unit else "unknown")
    if match := _MOVE.fullmatch(plain):
        unit = written or match.group(3) or ""
        meaning = match.group(1) or "uvw"["xyz".index(match.group(2))]
        return Column(name, meaning, unit, "file" if unit else "unknown")
    return Column(name)


def _header_line(lines: list[str]) -> tuple[int, str] | None:
    """Index of the line of column names and its separator, None where there is none."""
    for k, line in enumerate(lines[:_MOST_LINES]):
        for separator in (",", ";", "\t"):
            meanings = {_describe(*name_and_unit(cell)).meaning for cell in split_cells(line.lstrip("#"), separator)}
            if {"frame", "x", "y", "u", "v"} <= meanings:
                return k, separator
    return None


def recognises(head: Head) -> bool:
    """A header line with a frame, two coordinates and two displacements."""
    return _header_line(head_lines(head)) is not None


def read(path: Path) -> DicSequence:
    """All frames in the order of their numbers, coordinates as reference. DataError for every defect, with line."""
    text = read_text(path, WHAT)
    found = _header_line(text.lines)
    if found is None:
        raise DataError(f"{path}: no header with frame, coordinates and displacements found, expected {WHAT}; rename the columns")
    named = read_named(text, path, *found, _describe)
    frame = named.values[:, _column(named, "frame")]
    wrong = np.flatnonzero(~(np.abs(frame) < 2**31) | (frame != np.round(frame)))
    if wrong.size:
        line = named.table.lines[wrong[0]]
        raise DataError(f"{path}, line {line}: the frame is {frame[wrong[0]]:g}, expected a whole number; correct or remove the row")
    stages = tuple(make_stage(_rows(named, frame == number), NAME, StageFacts(False, None, int(number))) for number in np.unique(frame))
    remarks = ["coordinates are taken as those of the reference", "the file has no times"]
    if stages[0].length_unit == "px":
        remarks.append("px: y of an image points down")
    told = dict.fromkeys(remark for stage in stages for remark in stage.traits.remarks)
    missing = sum(stage.traits.missing for stage in stages)
    header = {"comment": text.lines[0].lstrip("# ")[:200]} if found[0] > 0 else {}
    return DicSequence(replace(stages[0].traits, missing=missing, remarks=(*remarks, *told), header=header), stages)


def _column(named: NamedTable, meaning: str) -> int:
    k = named.index(meaning)
    assert k is not None  # the header was found by this column
    return k


def _rows(named: NamedTable, kept: np.ndarray) -> NamedTable:
    """The rows of one frame."""
    table = replace(named.table, values=named.table.values[kept], lines=named.table.lines[kept])
    return replace(named, values=named.values[kept], table=table)
