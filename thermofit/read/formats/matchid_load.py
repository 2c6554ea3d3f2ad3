"""Load file of the MatchID Grabber (`Image.csv`) or of DaVis: one row for each image with its time and the force; names have blanks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.units import known_unit, to_fixed
from thermofit.read.formats.contents import ChannelRecord, Column, Head, Traits
from thermofit.read.formats.table import NamedTable, read_named
from thermofit.read.formats.text import head_lines, name_and_unit, read_text, split_cells

NAME = "MatchID / DaVis load file (one row for each image)"
WHAT = "a load file: a header with an image or time stamp and a force such as 'File;TimeStamp; Force [N]', then one row for each image"
_IMAGES = ("file", "image", "index", "img", "imageindex", "image index", "image number")

_TIMES = ("timestamp", "time stamp", "time")


def _separator(line: str) -> str:
    return max((";", "\t", ","), key=line.count)


def _meaning(name: str, unit: str) -> str:
    """Meaning of a column: index of the image, time, force (in volts: none)."""
    word = name.strip().lower()
    if word in _TIMES:
        return "time"
    if word in _IMAGES:
        return "image"
    found = known_unit(unit) if unit else None
    return "force" if word.startswith(("force", "load")) and (not unit or (found is not None and found.quantity == "force")) else ""


def _is_header(line: str) -> bool:
    """Whether a line is the header of the Grabber (file and time stamp first), or holds images, times and forces and nothing else.

    A table with further columns is the record of a testing machine, for which other readers are.
    """
    named = [name_and_unit(cell) for cell in split_cells(line, _separator(line))]
    names = [name.strip().lower() for name, _ in named if name.strip()]
    forces = [name for name in names if name.startswith(("force", "load"))]
    if not forces or not names:
        return False
    return names[:2] == ["file", "timestamp"] or (names[0] in _IMAGES and all(n in (*_IMAGES, *_TIMES, *forces) for n in names))


def recognises(head: Head) -> bool:
    """The first line names an image or a time stamp, and a force."""
    lines = head_lines(head)
    return bool(lines) and _is_header(lines[0])


def read(path: Path) -> ChannelRecord:
    """Channels over the images: time s, forces N where a unit is written, else as in the file with unit "". DataError with line."""
    text = read_text(path, WHAT)
    if not _is_header(text.lines[0]):
        raise DataError(f"{path}, line 1: the header names no image and force, expected {WHAT}; export it again")
    taken: set[str] = set()

    def describe(name: str, written: str) -> Column:
        meaning = _meaning(name, written)
        # A second force or time is another channel, kept under its own name.
        meaning, used = ("" if meaning in taken else meaning), meaning in taken
        taken.add(meaning)
        if meaning == "time" and not written:
            return Column(name, meaning, "s", "format")
        return Column(name, meaning, "" if used else written, "file" if written else "unknown")

    named = read_named(text, path, 0, _separator(text.lines[0]), describe)
    if not any(column.meaning == "force" for column in named.columns):
        raise DataError(f"{path}, line 1: no force in N, kN or lbf among the columns, expected {WHAT}; export the force itself")
    return _record(named)


def _record(named: NamedTable) -> ChannelRecord:
    """Columns that hold numbers, by name; DataError where a name occurs twice."""
    channels: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    for k, column in enumerate(named.columns):
        if k in named.table.empty or not column.name:
            continue
        # Forces in V and in N have one name: the unit then tells them apart.
        alone = sum(other.name == column.name for other in named.columns) == 1
        name = column.name if alone else f"{column.name} [{column.unit}]"
        if name in channels:
            raise DataError(f"{named.path}, line 1: the column '{name}' is there twice, expected it once; rename one of them")
        values, unit = named.values[:, k], named.units[k]
        channels[name], units[name] = to_fixed(values, unit) if unit and known_unit(unit) is not None else (values, unit)
    wanting = [c.name for k, c in enumerate(named.columns) if c.meaning == "force" and k in named.table.empty]
    if wanting:
        raise DataError(f"{named.path}: the column '{wanting[0]}' holds no number, expected forces; export it again")
    remarks = [f"'{c.name}' has no unit in the file" for k, c in enumerate(named.columns) if c.meaning == "force" and not named.units[k]]
    old = named.traits
    traits = Traits(
        *(NAME, named.path, old.encoding, old.separator, old.decimal, named.columns, old.missing, (*old.remarks, *remarks), old.header)
    )
    return ChannelRecord(traits, channels, units)
