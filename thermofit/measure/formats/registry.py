"""All readers of native formats, and which of them a file is for: decided by content, the more particular format first."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

from thermofit.core.errors import DataError
from thermofit.measure.formats import (
    aramis_csv,
    aramis_legacy,
    aramis_section,
    catman_workbook,
    coupon_text,
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
from thermofit.measure.formats.contents import Content, Head

FORMATS: tuple[ModuleType, ...] = (
    *(irbis, flir_sequence, ncorr, vic_mat, vic, dice),
    *(dlr_nodemap, aramis_csv, gom_points, aramis_legacy, aramis_section),
    *(matchid_table, matchid_matrix, matchid_load),
    *(testxpert_workbook, catman_workbook, machine_workbook, matlab_tests),
    *(sandia_text, testxpert_text),
    *(dic_table, coupon_text),
    *(optris, flir_frame),
)
"""Reader modules, the more particular first: the first that recognises a file reads it."""
HEAD_BYTES = 65536


def head_of(path: Path) -> Head:
    """The beginning of a file. DataError where it cannot be read or is empty."""
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            first = file.read(HEAD_BYTES)
    except OSError as error:
        raise DataError(f"{path}: {(error.strerror or 'cannot be read').lower()}; put the file there or correct its name") from None
    if not first:
        raise DataError(f"{path}: the file is empty, expected an export of a camera, a DIC system or a testing machine; export it again")
    return Head(path, size, first)


def format_of(path: Path) -> ModuleType:
    """The reader that recognises a file. DataError where none does."""
    head = head_of(path)
    found = next((module for module in FORMATS if module.recognises(head)), None)
    if found is None:
        known = ", ".join(module.NAME for module in FORMATS)
        raise DataError(f"{path}: no known format recognised in its content, expected one of {known}; export it as one of these")
    return found


def read_native(path: Path) -> Content:
    """The content of a native file, whatever its format. DataError for every defect, with file and line."""
    content: Content = format_of(path).read(path)
    return content
