"""ZwickRoell testXpert text export: quoted lines `"name",value,"unit"`, a line of quoted names, a line of quoted units, numbers.

Separator comma or tab, usually Latin-1; names in the language of the operator. "Strain" may be an elongation in mm: the unit decides.
"""

from __future__ import annotations

from pathlib import Path

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import ChannelRecord, Head, Traits
from thermofit.read.formats.coupon_text import parts_of, read_lines_as_record
from thermofit.read.formats.text import head_lines, read_text

NAME = "ZwickRoell testXpert text"


def recognises(head: Head) -> bool:
    """True where the first lines, the names and the units are quoted and at least one header line stands above them."""
    lines = head_lines(head)
    if len(lines) < 4 or not lines[0].startswith('"'):
        return False
    try:
        parts = parts_of(lines[:-1] if head.size > len(head.first) else lines, head.path)
    except DataError:
        return False
    if parts is None or parts.start.units is None or parts.start.names == 0:
        return False
    return all(line.startswith('"') for line in lines[: parts.start.first] if line.strip())


def read(path: Path) -> ChannelRecord:
    """The record, with the specimen's sizes from its header. DataError as every text table."""
    text = read_text(path, "a testXpert export with quoted names and units")
    return read_lines_as_record(text.lines, Traits(NAME, path, text.encoding))
