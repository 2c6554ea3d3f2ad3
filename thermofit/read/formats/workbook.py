"""Container of XLSX workbooks: sheets as rows of cells, and the numbers of a table in a sheet."""

from __future__ import annotations

import re
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from python_calamine import CalamineError, CalamineWorkbook

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import Head
from thermofit.read.formats.record_table import Cell, Row, number_of, words_of

MAGIC = b"PK\x03\x04"
_DIMENSION = re.compile(rb'<dimension ref="[A-Z]+\d+:[A-Z]+(\d+)"')
_BROKEN = (CalamineError, OSError, ValueError, zipfile.BadZipFile, zlib.error, KeyError, EOFError, RuntimeError, NotImplementedError)


@dataclass(frozen=True)
class Sheet:
    """Rows of cells of one sheet: texts, numbers, dates, truth values; "" where empty. `declared` rows, empty ones at the end counted."""

    name: str
    rows: list[list[Cell]]
    declared: int

    @property
    def filled(self) -> int:
        """Number of rows up to the last one that is not empty."""
        n = len(self.rows)
        while n and not words_of(self.rows[n - 1]):
            n -= 1
        return n

    @property
    def padding(self) -> int:
        """Empty rows at the end."""
        return max(self.declared, len(self.rows)) - self.filled


def is_workbook(head: Head) -> bool:
    """True for a zip archive that holds a workbook."""
    if not head.first.startswith(MAGIC):
        return False
    try:
        with zipfile.ZipFile(head.path) as archive:
            return "xl/workbook.xml" in archive.namelist()
    except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError):
        return b"xl/" in head.first


def sheet_names(path: Path) -> list[str]:
    """Names of the sheets in their order. DataError for a damaged workbook."""
    try:
        with CalamineWorkbook.from_path(path) as book:
            return list(book.sheet_names)
    except _BROKEN as error:
        raise _damaged(path, error) from None


def read_sheets(path: Path, names: Sequence[str] | None = None) -> list[Sheet]:
    """The named sheets, all where `names` is None. DataError for a damaged workbook."""
    try:
        with CalamineWorkbook.from_path(path) as book:
            wanted = list(book.sheet_names) if names is None else list(names)
            rows = [book.get_sheet_by_name(name).to_python(skip_empty_area=False) for name in wanted]
            places = [list(book.sheet_names).index(name) for name in wanted]
        declared = [_declared(path, place) for place in places]
    except _BROKEN as error:
        raise _damaged(path, error) from None
    if not wanted:
        raise DataError(f"{path}: the workbook holds no sheet, expected a test; save it again from the spreadsheet program")
    return [Sheet(name, [list(row) for row in found], count) for name, found, count in zip(wanted, rows, declared, strict=True)]


def _declared(path: Path, place: int) -> int:
    """Number of the last row that sheet number `place` (from 0) declares; 0 where it does not say or is not found under its usual name."""
    with zipfile.ZipFile(path) as archive:
        name = f"xl/worksheets/sheet{place + 1}.xml"
        if name not in archive.namelist():
            return 0
        with archive.open(name) as file:
            match = _DIMENSION.search(file.read(4096))
    return int(match.group(1)) if match and len(match.group(1)) < 9 else 0


def _damaged(path: Path, error: BaseException) -> DataError:
    reason = " ".join(str(error).split())[:120] or type(error).__name__
    return DataError(f"{path}: the workbook cannot be opened ({reason}), expected an XLSX file; save it again from the spreadsheet program")


def cell_number(cell: Cell) -> float:
    """Value of a cell; a text counts where it is one number with a decimal point, or with a decimal comma."""
    if isinstance(cell, str) and "," in cell and "." not in cell:
        return number_of(cell, ",")
    return number_of(cell)


def numbers_of(rows: Sequence[Row], width: int) -> np.ndarray:
    """Cells as numbers (n_row, width), NaN where no number stands; rows are cut or padded to the width."""
    values = np.full((len(rows), width), np.nan)
    for k, row in enumerate(rows):
        values[k, : len(row)] = [cell_number(cell) for cell in row[:width]]
    return values
