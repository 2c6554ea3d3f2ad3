"""MatchID matrix: one field on its grid without header; quantity and unit are in the file name (`patD107_0.tif_U[mm].csv`).

Every cell that is no number is a missing point: the word for it is that of the system's language ("Non un numero reale").
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.units import known_unit, to_fixed
from thermofit.read.formats.contents import Column, Head, ScalarField, Traits
from thermofit.read.formats.naming import stage_time
from thermofit.read.formats.text import detect_layout, head_lines, read_block, read_text, split_cells

NAME = "MatchID matrix CSV (one field)"
WHAT = "a MatchID matrix: rows of numbers parted by semicolons, no header"
_FIELD = re.compile(r"_([A-Za-z][A-Za-z0-9 ]*)\s*\[([^\]]*)\]$")


def recognises(head: Head) -> bool:
    """Rows of numbers and at most one word for missing points, parted by semicolons, and the quantity in the name of the file."""
    lines = head_lines(head)
    if not lines or _FIELD.search(head.path.stem) is None or ";" not in lines[0]:
        return False
    return all(_is_row(line) for line in lines[: max(1, min(20, len(lines) - 1))])


def _is_row(line: str) -> bool:
    words = {cell for cell in split_cells(line, ";") if cell and not re.fullmatch(r"[+-]?[\d.,]+([eE][+-]?\d+)?", cell)}
    return len(words) <= 1


def read(path: Path) -> ScalarField:
    """One field in mm, px or without unit; rows shorter than others are padded. DataError for every defect, with line."""
    text = read_text(path, WHAT)
    named = _FIELD.search(path.stem)
    if named is None:
        raise DataError(f"{path}: the name says no quantity and unit, expected a name such as 'image_0.tif_U[mm].csv'; rename the file")
    quantity, written = named.group(1).strip(), named.group(2).strip() or "1"
    layout = detect_layout(text.lines, path, ";")
    # The separator at the end of every row leaves one empty cell that is no point.
    lines = [line.rstrip().removesuffix(";") for line in text.lines]
    cells = [len(split_cells(line, ";")) for line in lines if line.strip()]
    table = read_block(lines, path, 1, layout)
    if (unit := known_unit(written)) is None:
        raise DataError(f"{path}: the unit [{written}] in the file's name is not known, expected mm, px or none; correct the name")
    values, fixed = to_fixed(table.values, written)
    widest = max(cells)
    if widest > values.shape[1]:
        values = np.hstack([values, np.full((len(values), widest - values.shape[1]), np.nan)])
    missing = int(np.isnan(values).sum())
    remarks = (f"{table.ragged} rows shorter than the others, padded",) if table.ragged else ()
    columns = (Column(quantity, unit.quantity, written, "file"),)
    stage, _ = stage_time(path)
    header = {} if stage is None else {"stage": str(stage)}
    return ScalarField(Traits(NAME, path, text.encoding, ";", layout.decimal, columns, missing, remarks, header), quantity, values, fixed)
