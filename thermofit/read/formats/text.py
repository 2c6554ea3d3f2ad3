"""Text of native files: encoding, lines, column separator, decimal sign, header cells, and blocks of numbers with missing cells."""

from __future__ import annotations

import codecs
import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.files import check_regular
from thermofit.read.formats.contents import Head

BLANKS = " "
"""Separator of columns that any number of blanks part."""
SEPARATOR_WORDS = {";": "semicolon", ",": "comma", "\t": "tab", BLANKS: "blanks", "|": "bar"}
_MAX_WIDTH = 100_000
_LONGEST_NAME = 1000
"""Characters of a header cell that are looked at: the search for a unit in it takes a time that grows with the square."""
_DIGITS = {".": r"(?:\d+\.?\d*|\.\d+)", ",": r"(?:\d+,?\d*|,\d+)"}
_CELL = {sign: re.compile(rf"[+-]?{digits}(?:[eEdD][+-]?\d+)?", re.ASCII) for sign, digits in _DIGITS.items()}
_QUOTED_COMMA = re.compile(r'"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*"', re.ASCII)
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:\.\d{3})+,\d*|[+-]?\d{1,3}(?:[ '\u00a0]\d{3})+(?:[.,]\d*)?|[+-]?\d{1,3}(?:,\d{3})+\.\d*", re.ASCII)
_UNIT = re.compile(r"^(.*?)\s*[\[(<]([^\[\]()<>]*)[\])>]\s*$")
_BOMS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))


@dataclass(frozen=True)
class Text:
    """Lines of a file without line ends and without empty lines at its end, and the encoding found."""

    lines: list[str]
    encoding: str


@dataclass(frozen=True)
class Layout:
    """How cells are parted (`separator`; BLANKS for any number of blanks) and the decimal sign."""

    separator: str
    decimal: str


@dataclass(frozen=True)
class NumberTable:
    """A block of numbers: `values` (n_row, n_column), NaN where a cell holds no number.

    `lines` (n_row,) number of the line of every row, from 1; `missing` cells without a number in columns that hold some; `ragged` rows that
    were shorter than the others, padded with NaN; `empty` columns without any number (texts, dates, or all missing).
    """

    values: np.ndarray
    lines: np.ndarray
    missing: int
    ragged: int
    empty: tuple[int, ...]


def decode(data: bytes, whole: bool = True) -> tuple[str, str]:
    """Text and encoding of bytes: byte order mark, else UTF-16 by its zero bytes, else UTF-8, else Latin-1.

    `whole` is False for the beginning of a file, whose last character may be cut. ValueError where the bytes are no text.
    """
    for mark, name in _BOMS:
        if data.startswith(mark):
            return _decoded(data, name), "utf-8 with byte order mark" if name == "utf-8-sig" else "utf-16"
    sample = data[:4096]
    if len(sample) >= 4 and sample.count(0) > 0.3 * len(sample):
        for name, zeros in (("utf-16-le", sample[1::2]), ("utf-16-be", sample[::2])):
            if zeros.count(0) > 0.9 * len(zeros) and 2 * zeros.count(0) > 1.8 * sample.count(0):
                return _decoded(data, name), "utf-16"
    if 0 in data:
        raise ValueError("found zero bytes")
    try:
        return data.decode("utf-8"), "utf-8"
    except UnicodeDecodeError as error:
        if not whole and error.start >= len(data) - 3:
            return data[: error.start].decode("utf-8"), "utf-8"
    return data.decode("latin-1"), "latin-1"


def _decoded(data: bytes, name: str) -> str:
    """Text of bytes whose encoding is certain; a character that is cut or damaged becomes the replacement character."""
    return data.decode(name, errors="replace").lstrip("\ufeff")


def split_lines(text: str) -> list[str]:
    """Lines of a text whatever its line ends, without empty ones at the end."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    return lines


def read_text(path: Path, what: str) -> Text:
    """Lines of a text file; `what` says in words what it should hold. DataError where it is unreadable, empty or no text."""
    try:
        check_regular(path)
        data = path.read_bytes()
    except OSError as error:
        reason = (error.strerror or "cannot be read").lower()
        raise DataError(f"{path}: {reason}; expected {what}: put the file there or correct its name") from None
    try:
        text, encoding = decode(data)
    except ValueError as error:
        raise DataError(f"{path}: {error}, so it is no text, expected {what}; export it again as text") from None
    lines = split_lines(text)
    if not lines:
        raise DataError(f"{path}: the file is empty, expected {what}; export it again")
    return Text(lines, encoding)


def head_lines(head: Head) -> list[str]:
    """Lines of the beginning of a file for recognition, the last one possibly cut; none where it is no text."""
    try:
        text, _ = decode(head.first, whole=head.size <= len(head.first))
    except ValueError:
        return []
    return split_lines(text)


def split_cells(line: str, separator: str) -> list[str]:
    """Cells of a line without blanks and quotes around them; a separator inside quotes does not part."""
    if separator == BLANKS:
        return line.split()
    if '"' in line:
        try:
            return [cell.strip().strip('"').strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
        except (csv.Error, StopIteration):
            pass  # quotes that do not close: parted like any other line
    return [cell.strip().strip('"').strip() for cell in line.split(separator)]


def name_and_unit(cell: str) -> tuple[str, str]:
    """Name and unit of a header cell such as `Name [unit]`, `Name (unit)`; the unit is empty where none is written, "1" for `[ ]`."""
    match = _UNIT.match(cell.strip().strip('"')[:_LONGEST_NAME])
    if match is None or not match.group(1).strip():
        return cell.strip().strip('"').strip(), ""
    return match.group(1).strip(), match.group(2).strip() or "1"


def detect_separator(lines: list[str]) -> str:
    """Separator of a block of rows: semicolon, tab, bar, comma or blanks, by what parts most rows into numbers (first 200 rows)."""
    rows = [line for line in lines if line.strip()][:200]
    for separator in (";", "\t", "|"):
        if 2 * sum(separator in line for line in rows) > len(rows):
            return separator
    commas = sum("," in line for line in rows)
    # Blanks with decimal commas: every piece between blanks is one number, and there are blanks.
    pieces = [line.split() for line in rows]
    whole = sum(len(cells) > 1 and all(_CELL[","].fullmatch(cell) and cell[-1] != "," for cell in cells) for cells in pieces)
    return "," if 2 * commas > len(rows) and 2 * whole <= len(rows) else BLANKS


def detect_layout(lines: list[str], path: Path, separator: str | None = None) -> Layout:
    """Separator (unless given) and decimal sign of a block of rows. DataError where both decimal signs occur in numbers."""
    separator = detect_separator(lines) if separator is None else separator
    if separator == ",":
        # Cells in quotes may hold a decimal comma all the same.
        return Layout(separator, "," if any(_QUOTED_COMMA.search(line) for line in lines) else ".")
    edge = r"[ \t]" if separator == BLANKS else rf"[{re.escape(separator)}\n]"
    found = {}
    # One blank says what many say, and the pattern below would try every place in a long run of them.
    text = re.sub(" {2,}", " ", "\n" + "\n".join(lines) + "\n")
    for sign in (".", ","):
        mark = re.escape(sign)
        number = re.compile(rf'(?:{edge}|\n)[ "]*[+-]?\d*{mark}\d+(?:[eEdD][+-]?\d+)?[ "]*(?={edge}|\n)', re.ASCII)
        found[sign] = number.search(text)
    if found["."] and found[","]:
        point, comma = found["."].group().strip(), found[","].group().strip()
        raise DataError(
            f"{path}: found numbers with decimal points ({point}) and with decimal commas ({comma}) in one table, expected one decimal "
            f"sign; export it again with one"
        )
    return Layout(separator, "," if found[","] else ".")


def parse_number(cell: str, decimal: str = ".") -> float:
    """Value of a cell, NaN where it is not one finite number (empty, words for missing values, infinities)."""
    cell = cell.strip().strip('"').strip()
    if _CELL[decimal].fullmatch(cell) is None:
        return np.nan
    value = float(cell.replace(",", ".").replace("d", "e").replace("D", "e"))
    return value if np.isfinite(value) else np.nan


def whole_number(value: float | None) -> int | None:
    """A number of a stage or an image as an integer; None where it is none, or too large to be one."""
    return int(value) if value is not None and abs(value) < 1e9 and value == int(value) else None


def read_block(lines: list[str], path: Path, first: int, layout: Layout, width: int | None = None) -> NumberTable:
    """Numbers of the lines of a block, whose first line has the number `first`; empty lines are skipped.

    `width` is the number of named columns, None for that of the widest row. DataError where no row or no number is there, and where a
    row has more cells than `width` that are not empty (trailing separators are).
    """
    numbered = [(k, line) for k, line in enumerate(lines, start=first) if line.strip()]
    if not numbered:
        raise DataError(f"{path}: the file ends before line {first}, expected rows of numbers; export it again")
    if width is not None and (clean := _clean_block([line for _, line in numbered], layout, width)) is not None:
        return NumberTable(clean, np.array([k for k, _ in numbered]), 0, 0, ())
    rows = [split_cells(line, layout.separator) for _, line in numbered]
    widths = [_width(cells) for cells in rows]
    widest = max(widths)
    if width is not None and widest > width:
        k = widths.index(widest)
        where = f"{path}, line {numbered[k][0]}"
        raise DataError(f"{where}: found {widest} cells, expected {width} as in the header; correct the line or export the file again")
    n = widest if width is None else width
    if n < 1 or n > _MAX_WIDTH:
        raise DataError(f"{path}, line {first}: found {n} columns, expected a table of numbers; export it again")
    values = _numbers(rows, n, layout.decimal)
    if np.isnan(values).all():
        raise DataError(f"{path}, line {first}: no number found from here on, expected rows of numbers; export it again with values")
    void = np.isnan(values)
    _refuse_thousands(rows, void, numbered, path)
    empty = void.all(axis=0)
    ragged = sum(len(cells) < n for cells in rows)
    number = np.array([k for k, _ in numbered])
    return NumberTable(values, number, int(void[:, ~empty].sum()), ragged, tuple(int(k) for k in np.flatnonzero(empty)))


def _refuse_thousands(rows: list[list[str]], void: np.ndarray, numbered: list[tuple[int, str]], path: Path) -> None:
    """DataError where a cell that is no number is one with separators of thousands: it must not pass for a missing one."""
    for k in np.flatnonzero(void.any(axis=1)):
        for cell in rows[k]:
            if _THOUSANDS.fullmatch(cell):
                where = f"{path}, line {numbered[k][0]}"
                raise DataError(f"{where}: found {cell}, expected numbers without separators of thousands; export it again without them")


def _clean_block(lines: list[str], layout: Layout, width: int) -> np.ndarray | None:
    """Numbers (n_line, width) of lines that hold finite numbers only, read at once; None where they hold anything else."""
    if layout.decimal == "," or layout.separator == BLANKS:
        return None
    try:
        values = np.loadtxt(lines, delimiter=layout.separator, comments=None, ndmin=2)
    except ValueError:
        return None
    return values if values.shape == (len(lines), width) and np.isfinite(values).all() else None


def _width(cells: list[str]) -> int:
    """Number of cells without empty ones at the end that separators without a value leave."""
    n = len(cells)
    while n > 1 and not cells[n - 1]:
        n -= 1
    return n


def _numbers(rows: list[list[str]], width: int, decimal: str) -> np.ndarray:
    """Cells as numbers (n_row, width), NaN where there is none."""
    values = np.full((len(rows), width), np.nan)
    for row, cells in zip(values, rows, strict=True):
        cells = cells[:width]
        if all(map(_CELL[decimal].fullmatch, cells)):
            numbers = [float(cell) for cell in cells] if decimal == "." and not any("d" in c or "D" in c for c in cells) else None
            row[: len(cells)] = numbers if numbers is not None else [parse_number(cell, decimal) for cell in cells]
        else:
            row[: len(cells)] = [parse_number(cell, decimal) for cell in cells]
    values[~np.isfinite(values)] = np.nan
    return values
