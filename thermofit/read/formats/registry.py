"""All readers of native formats, and which of them a file is for: decided by content, the more particular format first."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

from thermofit.core.errors import DataError
from thermofit.core.files import check_regular
from thermofit.read.formats import (
    aramis_csv,
    aramis_legacy,
    aramis_section,
    bare_table,
    catman_workbook,
    coupon_text,
    dic_frames,
    dic_table,
    dice,
    dlr_nodemap,
    flir_frame,
    flir_sequence,
    gom_points,
    irbis,
    machine_workbook,
    matchid_load,
    matchid_matrix,
    matchid_table,
    matlab_tests,
    ncorr,
    optris,
    sandia_text,
    testxpert_text,
    testxpert_workbook,
    vic,
    vic_mat,
)
from thermofit.read.formats.contents import Content, Head
from thermofit.read.formats.text import decode

FORMATS: tuple[ModuleType, ...] = (
    *(irbis, flir_sequence, ncorr, vic_mat),
    *(dlr_nodemap, aramis_csv, gom_points, aramis_legacy, aramis_section),
    *(matchid_table, matchid_matrix, matchid_load),
    *(vic, dice),
    *(testxpert_workbook, catman_workbook, machine_workbook, matlab_tests),
    *(sandia_text, testxpert_text),
    *(dic_frames, dic_table, coupon_text),
    *(optris, flir_frame),
    bare_table,
)
"""Reader modules, the more particular first: the first that recognises a file reads it."""
HEAD_BYTES = 65536
_QUOTED = 60


def head_of(path: Path) -> Head:
    """The beginning of a file. DataError where it cannot be read or is empty."""
    try:
        check_regular(path)
        size = path.stat().st_size
        with path.open("rb") as file:
            first = file.read(HEAD_BYTES)
    except OSError as error:
        raise DataError(f"{path}: {(error.strerror or 'cannot be read').lower()}; put the file there or correct its name") from None
    if not first:
        raise DataError(f"{path}: the file is empty, expected an export of a camera, a DIC system or a testing machine; export it again")
    return Head(path, size, first)


def first_line(head: Head) -> str:
    """The beginning of a file in words: its first line in quotes, or that it is no text."""
    try:
        text, _ = decode(head.first, whole=head.size <= len(head.first))
    except ValueError:
        return f"it is no text and begins with the bytes {head.first[:8].hex(' ')}"
    line = next((line.strip() for line in text.splitlines() if line.strip()), "")
    shown = "".join(c if c.isprintable() else "?" for c in line[:_QUOTED])
    return f"its first line is '{shown}{'...' if len(line) > _QUOTED else ''}'"


def recogniser(head: Head) -> ModuleType | None:
    """The reader that recognises the beginning of a file, None where none does."""
    return next((module for module in FORMATS if module.recognises(head)), None)


def format_of(path: Path) -> ModuleType:
    """The reader that recognises a file. DataError, with its first line quoted, where none does."""
    head = head_of(path)
    found = recogniser(head)
    if found is None:
        raise DataError(
            f"{path}: no known format recognised in its content ({first_line(head)}), expected an export of a DIC system, an infrared "
            f"camera or a testing machine; docs/formats.md lists the formats, export it as one of them"
        )
    return found


def read_native(path: Path) -> Content:
    """The content of a native file, whatever its format. DataError for every defect, with file and line."""
    content: Content = format_of(path).read(path)
    return content
