"""Optris PIX Connect: snapshot CSV of a locale with decimal commas, in which the comma also parts the columns: `27,6,27,8` is two values.

There are twice as many cells as pixels. The cells are paired where that is unambiguous: every second cell has one digit and all others at
least two; or every second cell has two digits, some with a leading zero, which no whole number has. Else the width must be given.
The unit is not in the file.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import Column, Head, ThermalFrames, Traits
from thermofit.read.formats.text import Layout, head_lines, read_text
from thermofit.read.formats.thermal_rows import check_some, matrix

NAME = "Optris PIX Connect CSV (decimal comma)"
MIN_PIXELS = 6
_ROW = re.compile(r"\s*-?\d{1,4},\d{1,2}(,-?\d{1,4},\d{1,2})*\s*,?\s*", re.ASCII)
_WHAT = "rows of whole numbers parted by commas, two for each pixel"
_MEND = "export with another separator or with decimal points, or give the width of the image"


def recognises(head: Head) -> bool:
    """Whether all rows hold an even number of whole numbers parted by commas, every second with one or all with two digits."""
    lines = [line for line in head_lines(head) if line.strip()]
    return is_paired(lines[:-1] or lines)


def is_paired(lines: list[str]) -> bool:
    """Whether rows could be of decimal commas parted by commas; true for some matrices of whole numbers too."""
    rows = [line.strip().rstrip(",") for line in lines if line.strip()]
    if not rows or not all(_ROW.fullmatch(row) for row in rows) or rows[0].count(",") < 2 * MIN_PIXELS - 1:
        return False
    decimals = {len(cell) for row in rows for cell in row.split(",")[1::2]}
    return len({row.count(",") for row in rows}) == 1 and rows[0].count(",") % 2 == 1 and len(decimals) == 1


def read(path: Path, image_width: int | None = None) -> ThermalFrames:
    """The image; `image_width` px settles what the cells leave open. DataError for every defect and where pairing is ambiguous."""
    text = read_text(path, _WHAT)
    numbered = [(number, line) for number, line in enumerate(text.lines, start=1) if line.strip()]
    wrong = next((number for number, line in numbered if not _ROW.fullmatch(line.strip())), None)
    if wrong is not None:
        raise DataError(f"{path}, line {wrong}: found other than pairs of whole numbers, expected {_WHAT}; export the image again")
    rows = [line.strip().rstrip(",").split(",") for _, line in numbered]
    odd = next((number for (number, _), cells in zip(numbered, rows, strict=True) if len(cells) != len(rows[0])), None)
    if odd is not None:
        raise DataError(f"{path}, line {odd}: found another number of cells than in line {numbered[0][0]}, expected as many; export again")
    decimals = {len(cell) for cells in rows for cell in cells[1::2]}
    if image_width is not None and len(rows[0]) != 2 * image_width:
        raise DataError(f"{path}: found {len(rows[0])} cells in a row, expected {2 * image_width} for {image_width} px; give another width")
    if len(decimals) != 1 or (image_width is None and not _is_unambiguous(rows, decimals == {1})):
        raise DataError(f"{path}: commas part columns and may be decimal signs too, expected an unambiguous pairing of cells; {_MEND}")
    pairs = [
        (number, ";".join(map(".".join, zip(cells[::2], cells[1::2], strict=True))))
        for (number, _), cells in zip(numbered, rows, strict=True)
    ]
    values = matrix(pairs, path, Layout(";", "."))
    remarks = ("two cells make one value: the comma is separator and decimal sign", "the unit of the values is not in the file")
    traits = Traits(NAME, path, text.encoding, ",", ",", (Column("pixel"),), check_some(values, path), remarks)
    return ThermalFrames(traits, values[np.newaxis], "")


def _is_unambiguous(rows: list[list[str]], has_one_decimal: bool) -> bool:
    """Whether the cells can only be pairs of a whole number and its decimals."""
    wholes = [cell.lstrip("-") for cells in rows for cell in cells[::2]]
    if any(len(cell) > 1 and cell.startswith("0") for cell in wholes):
        return False
    if has_one_decimal:
        return all(len(cell) > 1 for cell in wholes)
    return any(cell.startswith("0") for cells in rows for cell in cells[1::2])
