"""Rows of thermal images: strict matrices (a row that is cut is an error, never padded), units of temperature, time stamps."""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.units import known_unit, to_fixed
from thermofit.read.formats.text import SEPARATOR_WORDS, Layout, parse_number, split_cells

MAX_VALUES = 1_000_000_000
_PLAIN = re.compile(r"[0-9.eE+\-; ]+")


def matrix(lines: list[tuple[int, str]], path: Path, layout: Layout, width: int | None = None, skip: int = 0) -> np.ndarray:
    """Matrix (n_row, width) of the numbered `lines`, NaN where a cell holds no number; `width` None takes that of the first row.

    One empty cell at the end (a trailing separator) is dropped, `skip` cells at the beginning are no values. DataError where no line is
    there and where a row has another number of cells, so that a cut file is never padded.
    """
    if not lines:
        raise DataError(f"{path}: no row of values found, expected an image; export it again")
    rows = [_cells(line, layout)[skip:] for _, line in lines]
    n = len(rows[0]) if width is None else width
    wrong = next((k for k, cells in enumerate(rows) if len(cells) != n), None)
    if wrong is not None:
        word = SEPARATOR_WORDS.get(layout.separator, repr(layout.separator))
        raise DataError(
            f"{path}, line {lines[wrong][0]}: found {len(rows[wrong])} values parted by {word}, expected {n} in every row of the image; "
            "export it again"
        )
    if n == 0 or n * len(rows) > MAX_VALUES:
        raise DataError(f"{path}, line {lines[0][0]}: found {len(rows)} rows of {n} values, expected an image; export it again")
    return _numbers(rows, layout.decimal)


def _cells(line: str, layout: Layout) -> list[str]:
    """Cells of a row without the empty one that a trailing separator leaves."""
    cells = split_cells(line, layout.separator) if '"' in line else line.split(layout.separator.strip(" ") or None)
    return cells[:-1] if cells and not cells[-1].strip() else cells


def _numbers(rows: list[list[str]], decimal: str) -> np.ndarray:
    """Cells as numbers; words, empty cells and infinities are NaN."""
    values = np.empty((len(rows), len(rows[0])))
    for row, cells in zip(values, rows, strict=True):
        text = ";".join(cells)
        if decimal == ",":
            text = "" if "." in text else text.replace(",", ".")
        try:
            # Numbers in plain characters at once; words, 1_000, mixed decimal signs and damage cell by cell.
            row[:] = np.loadtxt([text], delimiter=";", comments=None, ndmin=1) if _PLAIN.fullmatch(text) else np.inf
        except ValueError:
            row[:] = np.inf
        if not np.isfinite(row).all():
            row[:] = [parse_number(cell, decimal) for cell in cells]
    return values


def check_some(values: np.ndarray, path: Path) -> int:
    """Number of pixels without value; DataError where all are."""
    missing = int(np.isnan(values).sum())
    if missing == values.size:
        raise DataError(f"{path}: none of the {values.size} pixels holds a number, expected an image; export it again with values")
    return missing


def in_kelvin(values: np.ndarray, unit: str, path: Path) -> np.ndarray:
    """Temperatures in K. DataError where `unit` is no unit of temperature or where they lie below absolute zero."""
    found = known_unit(unit)
    if found is None or found.quantity != "temperature":
        raise DataError(f"{path}: the unit of temperature is {unit[:20]!r}, expected K, C, F or mK; export it again with one of these")
    kelvin, _ = to_fixed(values, unit)
    lowest = np.nanmin(kelvin)
    if lowest < 0:
        raise DataError(
            f"{path}: the lowest value is {np.nanmin(values):g} {unit}, below absolute zero, expected temperatures in the unit named; "
            "check the unit and export again"
        )
    return kelvin


def stamp(date: str, time: str) -> str:
    """Date and time of day as ISO text, from yyyy-mm-dd or dd.mm.yyyy and hh:mm:ss with or without decimals; empty where they are none."""
    for form in ("%Y-%m-%d", "%d.%m.%Y"):
        for clock in ("%H:%M:%S.%f", "%H:%M:%S"):
            try:
                found = datetime.strptime(f"{date.strip()} {time.strip().replace(',', '.')}", f"{form} {clock}")
            except ValueError:
                continue
            return found.isoformat(timespec="milliseconds")
    return ""
