"""MatchID table: one row for each point, one file for each image; columns by names that change between versions, `;` or `,`.

3-D exports (with a displacement W) hold current world coordinates, 2-D ones the reference. Points not correlated are rows of zeros.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import Column, DicStage, Head
from thermofit.read.formats.table import NamedTable, StageFacts, make_stage, read_named
from thermofit.read.formats.text import head_lines, name_and_unit, read_text, split_cells

NAME = "MatchID table CSV (one stage)"
WHAT = "a MatchID table: a header with columns such as 'coor.X [mm]', 'disp.Horizontal Displacement U [mm]', then rows of points"
_PATTERNS = (
    ("u", r"horizontal displacement|^u$"),
    ("v", r"vertical displacement|^v$"),
    ("w", r"out-of-plane|^w$"),
    ("exx", r"strain.*\bexx$|^exx$"),
    ("eyy", r"strain.*\beyy$|^eyy$"),
    ("exy", r"strain.*\bexy$|^exy$"),
    ("image x", r"image x$|^x_pic$"),
    ("image y", r"image y$|^y_pic$"),
    ("x", r"coor\w*\.\s*x$|^x$"),
    ("y", r"coor\w*\.\s*y$|^y$"),
    ("z", r"coor\w*\.\s*z$|^z$"),
)


def _meaning(name: str) -> str:
    return next((meaning for meaning, pattern in _PATTERNS if re.search(pattern, name.strip().lower())), "")


def _separator(line: str) -> str:
    return max((";", ",", "\t"), key=line.count)


def _is_header(line: str) -> bool:
    """Whether a line names columns as MatchID does: its own words and displacements."""
    meanings = {_meaning(name_and_unit(cell)[0]) for cell in split_cells(line, _separator(line))}
    own = re.search(r"\bcoor\w*\.|\bdisp\.|x_pic", line, re.IGNORECASE) is not None
    return own and {"u", "v"} <= meanings and bool({"x", "image x"} & meanings)


def recognises(head: Head) -> bool:
    """The first line names MatchID columns."""
    lines = head_lines(head)
    return bool(lines) and _is_header(lines[0])


def read(path: Path) -> DicStage:
    """One stage; world coordinates where there are some, else those in the image. DataError for every defect, with line."""
    text = read_text(path, WHAT)
    if not _is_header(text.lines[0]):
        raise DataError(f"{path}, line 1: the header names no displacements of MatchID, expected {WHAT}; export it again")
    separator = _separator(text.lines[0])
    meanings = {_meaning(name_and_unit(cell)[0]) for cell in split_cells(text.lines[0], separator)}
    world = {"x", "y"} <= meanings

    def describe(name: str, written: str) -> Column:
        meaning = _meaning(name)
        if meaning.startswith("image"):
            meaning = "" if world else meaning[-1]
        return Column(name, meaning, written, "file" if written else "unknown")

    named = read_named(text, path, 0, separator, describe)
    spatial = "w" in meanings and world
    remarks = ["world coordinates are current ones: reference = coordinates - displacements"] if spatial else []
    if not world:
        remarks.append("coordinates are those in the image, whose y points down")
    lost = _lost(named)
    if lost.any():
        remarks.append(f"{int(lost.sum())} points not correlated (rows of zeros)")
    return make_stage(named, NAME, StageFacts(spatial, None, None, lost, tuple(remarks)))


def _zero(vector: np.ndarray) -> np.ndarray:
    """Rows (n_row,) that hold zeros and nothing else."""
    known = ~np.isnan(vector)
    return np.asarray((np.nan_to_num(vector) == 0.0).all(axis=1) & known.any(axis=1))


def _lost(named: NamedTable) -> np.ndarray:
    """Rows (n_row,) that are not correlated: no displacement at all where others have some, or several points at the origin."""
    lost = np.zeros(len(named.values), dtype=bool)
    moved, place = named.vector(("u", "v", "w")), named.vector(("x", "y", "z"))
    # In the reference stage nothing moves: its zeros are values. One point may well lie at the origin, two cannot.
    if moved is not None and np.nan_to_num(moved).any():
        lost |= _zero(moved)
    if place is not None and _zero(place).sum() > 1:
        lost |= _zero(place)
    return lost
