"""Container of XLSX workbooks: sheets as rows of cells, and the numbers of a table in a sheet."""

from __future__ import annotations

import re
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from python_calamine import CalamineError, CalamineWorkbook

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import Head
from thermofit.read.formats.record_table import Cell, Row, number_of, words_of

MAGIC = b"PK\x03\x04"
_DIMENSION = re.compile(rb'<dimension ref="[A-Z]+\d+:[A-Z]+(\d+)"')
MAX_UNPACKED = 256 << 20
"""Bytes that all parts of a workbook may have when they are unpacked."""
MAX_PARTS = 10_000
MAX_CELLS = 12_000_000
"""Cells of one sheet, empty ones counted: a table of 11 columns as long as a sheet can be."""
_BLOCK = 1 << 20
_PLACE = re.compile(rb'\br="([A-Z]{1,4})([0-9]{1,9})"')
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
        _check_size(path)
        with CalamineWorkbook.from_path(path) as book:
            return list(book.sheet_names)
    except _BROKEN as error:
        raise _damaged(path, error) from None


def read_sheets(path: Path, names: Sequence[str] | None = None) -> list[Sheet]:
    """The named sheets, all where `names` is None. DataError for a damaged workbook."""
    try:
        _check_size(path)
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


def _check_size(path: Path) -> None:
    """DataError for a workbook that is small as a file and fills the memory when it is opened.

    Every part is unpacked once, a block at a time, by a reader that stops at the declared size and checks the sum of it. The sheets are
    opened as full rectangles: one cell far out is a rectangle as large as one that is full.
    """
    with zipfile.ZipFile(path) as archive:
        parts = archive.infolist()
        if len(parts) > MAX_PARTS or sum(part.file_size for part in parts) > MAX_UNPACKED:
            raise _too_large(path, f"unpacks to more than {MAX_UNPACKED >> 20} MB or {MAX_PARTS} parts")
        for part in parts:
            with archive.open(part) as stream:
                cells = _area(stream) if part.filename.startswith("xl/worksheets/") else _passed(stream)
            if cells > MAX_CELLS:
                raise _too_large(path, f"has a sheet of {cells} cells from first to last")


def _passed(stream: IO[bytes]) -> int:
    while stream.read(_BLOCK):
        pass
    return 0


def _area(stream: IO[bytes]) -> int:
    """Cells of the rectangle from A1 to the last row and column of a sheet; those that do not say where they are follow one another."""
    rows = columns = unnamed = 0
    rest = b""
    while block := stream.read(_BLOCK):
        text = rest + block
        for letters, digits in _PLACE.findall(text):
            column = 0
            for letter in letters:
                column = 26 * column + letter - 64
            columns, rows = max(columns, column), max(rows, int(digits))
        unnamed += text.count(b"<c>")
        rest = text[-40:]
    return max(rows * columns, unnamed)


def _too_large(path: Path, what: str) -> DataError:
    return DataError(f"{path}: the workbook {what}, expected a test of at most {MAX_CELLS} cells; save the sheet meant alone, as CSV")


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
