"""ARAMIS section as text: length along a section and one quantity, blanks between, decimal comma; the stage is in the file name."""

from __future__ import annotations

from pathlib import Path

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import ChannelRecord, Column, Head, Traits
from thermofit.read.formats.naming import stage_time
from thermofit.read.formats.text import BLANKS, detect_layout, head_lines, read_block, read_text

NAME = "ARAMIS section text (length and one quantity)"
WHAT = "an ARAMIS section: one header line 'Sectionlength <quantity>', then two columns"
_LENGTHS = {"deltal": "elongation", "dl": "elongation"}


def _is_header(line: str) -> bool:
    words = line.split()
    return len(words) == 2 and words[0].lower() in ("sectionlength", "section_length")


def recognises(head: Head) -> bool:
    """The first line is `Sectionlength <quantity>`."""
    lines = head_lines(head)
    return bool(lines) and _is_header(lines[0])


def read(path: Path) -> ChannelRecord:
    """The section as channels over its points; lengths are in mm, which the format fixes and the file does not say. DataError with line."""
    text = read_text(path, WHAT)
    if not _is_header(text.lines[0]):
        raise DataError(f"{path}, line 1: found no header 'Sectionlength <quantity>', expected {WHAT}; export it again")
    length, quantity = text.lines[0].split()
    if text.lines[0] in text.lines[1:]:
        again = text.lines.index(text.lines[0], 1) + 1
        raise DataError(f"{path}, line {again}: the header occurs a second time, expected one section in a file; part the file")
    layout = detect_layout(text.lines[1:], path, BLANKS)
    table = read_block(text.lines[1:], path, 2, layout, 2)
    if quantity == length:
        raise DataError(f"{path}, line 1: both columns are called {length}, expected {WHAT}; export it again")
    meaning = _LENGTHS.get(quantity.lower(), "")
    units = {length: "mm", quantity: "mm" if meaning else ""}
    columns = (Column(length, "x", "mm", "format"), Column(quantity, meaning, units[quantity], "format" if meaning else "unknown"))
    stage, _ = stage_time(path)
    header = {} if stage is None else {"stage": str(stage)}
    remarks = ("the file writes no units: lengths are taken as mm",)
    missing = table.missing + sum(len(table.values) for _ in table.empty)
    traits = Traits(NAME, path, text.encoding, BLANKS, layout.decimal, columns, missing, remarks, header)
    return ChannelRecord(traits, {length: table.values[:, 0], quantity: table.values[:, 1]}, units)
