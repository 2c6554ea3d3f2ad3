"""Tables of numbers without names, or with names such as `x, y` that say nothing, as scripts and digitised curves leave them."""

from __future__ import annotations

from pathlib import Path

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import ChannelRecord, Head, Traits
from thermofit.read.formats.coupon_text import numbered_parts, read_lines_as_record
from thermofit.read.formats.text import head_lines, read_text

NAME = "table of numbers without known names"


def recognises(head: Head) -> bool:
    """True where at least ten rows of two to ten numbers each follow comments or nothing."""
    lines = head_lines(head)
    try:
        return numbered_parts(lines[:-1] if head.size > len(head.first) else lines, head.path) is not None
    except DataError:
        return False


def read(path: Path) -> ChannelRecord:
    """The record, its columns called `column 1` and so on. DataError as every text table."""
    text = read_text(path, "rows of numbers without names")
    return read_lines_as_record(text.lines, Traits(NAME, path, text.encoding))
