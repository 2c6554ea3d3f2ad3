"""Text files of a raw experiment folder: lines, the time stamp, and tables of finite numbers; every defect has a file and a line."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError

_TIME = re.compile(r"#\s*time_s\s*:\s*(\S+)\s*")
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*", re.ASCII)


def shorten(text: object, length: int = 40) -> str:
    """A piece of a file as it is quoted in a message."""
    quoted = repr(text)
    return quoted if len(quoted) <= length else quoted[: length - 4] + "...'"


def read_lines(path: Path, what: str) -> list[str]:
    """Lines of a text file without the empty ones at its end; `what` says in words what the file should hold.

    DataError where the file is missing, unreadable, empty or no UTF-8 text.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise DataError(f"{path}: found bytes that are no UTF-8 text, expected {what}; export the file again as text") from None
    except OSError as error:
        reason = (error.strerror or "cannot be read").lower()
        raise DataError(f"{path}: {reason}; expected {what}: put the file there or correct its name") from None
    # Only line feeds part lines (read_text has turned CR LF into LF); str.splitlines would also part at form feeds.
    lines = text.split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise DataError(f"{path}: the file is empty, expected {what}; export it again")
    return lines


def read_time(line: str, path: Path) -> float:
    """Time in s of the first line `# time_s: <t>` of a stage or a frame; DataError where it is absent or not a number."""
    match = _TIME.fullmatch(line.strip())
    if match is None:
        raise DataError(f"{path}, line 1: found {shorten(line)}, expected the line '# time_s: <time in s>'; put it first")
    value = match.group(1)
    if not _NUMBER.fullmatch(value) or not np.isfinite(float(value)):
        raise DataError(f"{path}, line 1: the time is {shorten(value)}, expected a finite number of seconds; correct it")
    return float(value)


def read_header(line: str, path: Path, number: int, wanted: tuple[str, ...]) -> list[str]:
    """Names of the columns in line `number`; DataError where a wanted one is missing or one is named twice."""
    names = [name.strip() for name in line.split(",")]
    for name in wanted:
        if name not in names:
            found = shorten(line, 80)
            raise DataError(
                f"{path}, line {number}: column '{name}' is missing from the header {found}, expected {','.join(wanted)}; correct it"
            )
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise DataError(f"{path}, line {number}: column {shorten(twice)} is named twice in the header; give every column its own name")
    return names


def read_table(lines: list[str], path: Path, first: int, columns: list[str] | None = None) -> np.ndarray:
    """Table (n_line, n_column) of finite numbers from comma separated lines; `first` is the number of their first line.

    With `columns` their number is checked and they are named in messages. DataError with line and column of the first
    cell that is not a finite number, and for a line that is empty or has another number of cells.
    """
    if not lines:
        raise DataError(f"{path}: the file ends before line {first}, expected rows of numbers; export it again")
    width = len(columns) if columns is not None else lines[0].count(",") + 1
    try:
        table = np.loadtxt(lines, delimiter=",", comments=None, ndmin=2)
    except ValueError:
        table = None
    if table is None or table.shape != (len(lines), width) or not np.isfinite(table).all():
        raise _defect(lines, path, first, width, columns)
    return np.asarray(table)


def _defect(lines: list[str], path: Path, first: int, width: int, columns: list[str] | None) -> DataError:
    """The sentence for the first defect of a table that could not be read at once."""
    for number, line in enumerate(lines, start=first):
        cells = line.split(",")
        if not line.strip():
            return DataError(f"{path}, line {number}: the line is empty, expected {width} numbers; remove it or export the file again")
        for k, cell in enumerate(cells[:width]):
            if not _NUMBER.fullmatch(cell) or not np.isfinite(float(cell)):
                name = f"column {k + 1}" + (f" ({columns[k]})" if columns is not None else "")
                return DataError(f"{path}, line {number}, {name}: found {shorten(cell)}, expected a finite number; correct the cell")
        if len(cells) != width:
            above = "in the header" if columns is not None else f"in line {first}"
            return DataError(f"{path}, line {number}: found {len(cells)} cells, expected {width} as {above}; export the file again")
    return DataError(f"{path}: the rows from line {first} on cannot be read as numbers parted by commas; export the file again")
