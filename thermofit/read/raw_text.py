"""Text files of a raw experiment folder: lines, the time stamp, and tables of finite numbers; every defect has a file and a line."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.files import check_regular
from thermofit.core.units import Unit, known_unit

_TIME = re.compile(r"#\s*time_([^\s:]+)\s*:\s*(\S+)\s*")
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*", re.ASCII)

LARGEST = 1e15
"""Size of a number beyond which it was not measured, in any unit: squares of it and their sums are still finite."""


def shorten(text: object, length: int = 40) -> str:
    """A piece of a file as it is quoted in a message."""
    quoted = repr(text)
    return quoted if len(quoted) <= length else quoted[: length - 4] + "...'"


def read_lines(path: Path, what: str, largest: int | None = None) -> list[str]:
    """Lines of a text file without the empty ones at its end; `what` says in words what the file should hold.

    DataError where the file is missing, unreadable, no regular file, larger than `largest` bytes, empty or no UTF-8 text.
    """
    try:
        check_regular(path, largest)
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
    """Time in s of the first line `# time_s: <t>` of a stage or a frame, or in another unit that the line names (`# time_ms: <t>`);
    DataError where it is absent or not a number."""
    match = _TIME.fullmatch(line.strip())
    if match is None:
        raise DataError(f"{path}, line 1: found {shorten(line)}, expected the line '# time_s: <time in s>'; put it first")
    written, value = match.groups()
    unit = converted(written, "s")
    if unit is None:
        raise DataError(f"{path}, line 1: the time is in {shorten(written)}, which is no known unit of time; convert it to s")
    if not _NUMBER.fullmatch(value) or not np.isfinite(float(value)):
        raise DataError(f"{path}, line 1: the time is {shorten(value)}, expected a finite number of seconds; correct it")
    return float(value) * unit.factor


def converted(written: str, fixed: str) -> Unit | None:
    """The unit that a name states as `written`, where it measures the same as the `fixed` one; None where it does not."""
    unit = known_unit(written)
    return unit if unit is not None and unit.fixed == fixed else None


@dataclass(frozen=True)
class Header:
    """Columns of a table: `names` in the fixed units, `written` as in the file, `units` of those that are to be converted, by name."""

    names: list[str]
    written: list[str]
    units: dict[str, Unit]

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is converted."""
        return tuple(f"{w} is converted to {n}" for n, w in zip(self.names, self.written, strict=True) if n in self.units)

    def in_fixed(self, table: np.ndarray) -> np.ndarray:
        """A table (n_line, n_column) of the file in the fixed units."""
        out = table.copy()
        for name, unit in self.units.items():
            k = self.names.index(name)
            out[:, k] = (out[:, k] + unit.shift) * unit.factor
        return out


def read_header(line: str, path: Path, number: int, wanted: tuple[str, ...], may: tuple[str, ...] = ()) -> Header:
    """Columns in line `number`: `wanted` ones, those that `may` be there, and others, which mean nothing here.

    A name <quantity>_<unit> of another unit (force_kN) is taken for the same quantity, to be converted, where that in the fixed unit is not
    there. DataError where a wanted one is missing, one is named twice, or a unit is not known.
    """
    written = [name.strip() for name in line.split(",")]
    names, units = list(written), {}
    for k, name in enumerate(written):
        quantity, _, unit = name.rpartition("_")
        known = next((n for n in (*wanted, *may) if "_" in n and n.rpartition("_")[0] == quantity), None)
        if known is None or known in written:
            continue
        fixed = known.rpartition("_")[2]
        found = converted(unit, fixed)
        if found is None and known in may:
            continue
        if found is None:
            raise DataError(
                f"{path}, line {number}: column '{name}' is in '{unit}', which is no known unit of it; convert its values to {fixed} and "
                f"name it '{known}'"
            )
        names[k], units[known] = known, found
    for name in wanted:
        if name not in names:
            found_text = shorten(line, 80)
            raise DataError(
                f"{path}, line {number}: column '{name}' is missing from the header {found_text}, expected {','.join(wanted)}; name every "
                "column so, with the unit that its values are in"
            )
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        both = " and ".join(dict.fromkeys(w for w, n in zip(written, names, strict=True) if n == twice))
        what = f"column {shorten(twice)} is named twice" if twice == both else f"the columns {both} hold the same"
        raise DataError(f"{path}, line {number}: {what} in the header; give every column its own name")
    return Header(names, written, units)


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
    if table is None or table.shape != (len(lines), width) or not np.all(np.abs(table) <= LARGEST):
        raise _defect(lines, path, first, width, columns)
    return np.asarray(table)


def _defect(lines: list[str], path: Path, first: int, width: int, columns: list[str] | None) -> DataError:
    """The sentence for the first defect of a table that could not be read at once."""
    for number, line in enumerate(lines, start=first):
        cells = line.split(",")
        if not line.strip():
            return DataError(f"{path}, line {number}: the line is empty, expected {width} numbers; remove it or export the file again")
        for k, cell in enumerate(cells[:width]):
            if not _NUMBER.fullmatch(cell) or not abs(float(cell)) <= LARGEST:
                name = f"column {k + 1}" + (f" ({columns[k]})" if columns is not None else "")
                expected = f"a measured value of at most {LARGEST:g}" if _NUMBER.fullmatch(cell) else "a finite number"
                return DataError(f"{path}, line {number}, {name}: found {shorten(cell)}, expected {expected}; correct the cell")
        if len(cells) != width:
            above = "in the header" if columns is not None else f"in line {first}"
            return DataError(f"{path}, line {number}: found {len(cells)} cells, expected {width} as {above}; export the file again")
    return DataError(f"{path}: the rows from line {first} on cannot be read as numbers parted by commas; export the file again")
