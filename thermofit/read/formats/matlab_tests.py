"""Tension tests in MATLAB 5 files: a cell array `data` of structs (t, F, dL, tag, w0, t0, A0, L0, T, F0), or flat variables t, F, u, utr.

Units are those of the evaluation scripts that write these files: s, N, mm, mm^2, degC. F0 is the force that was not tared: it is added.
Any other array of two to ten columns is a table without names.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.units import to_fixed
from thermofit.read.formats.contents import ChannelRecord, Column, Head, Records, Traits
from thermofit.read.formats.mat5 import MAGIC, Value, variables
from thermofit.read.formats.record_columns import ColumnBlock, make_record
from thermofit.read.formats.record_table import LEAST_ROWS, MOST_COLUMNS

NAME = "MATLAB 5 tests (MAT)"
_CHANNELS = {"t": ("time", "s"), "F": ("force", "N"), "dL": ("extension", "mm"), "u": ("extension", "mm"), "utr": ("displacement", "mm")}
_SIZES = {
    "A0": ("area", "mm^2"),
    "L0": ("gauge_length", "mm"),
    "w0": ("width", "mm"),
    "t0": ("thickness", "mm"),
    "T": ("temperature", "degC"),
}


def recognises(head: Head) -> bool:
    """True for a MATLAB 5 file with `data` as a cell array or with F beside t, u or utr; a damaged one too, whose defect `read` names."""
    if not head.first.startswith(MAGIC):
        return False
    try:
        found = dict(variables(head.path))
    except (ValueError, OSError):
        return True
    return isinstance(found.get("data"), list) or ("F" in found and bool({"t", "u", "utr"} & set(found))) or bool(_tables(found))


def read(path: Path) -> ChannelRecord | Records:
    """Tests by tag, or the one test of a flat file. DataError for a damaged file or one without tests."""
    try:
        found = dict(variables(path))
    except (ValueError, OSError) as error:
        raise DataError(f"{path}: the MAT file is damaged ({error}), expected a MATLAB 5 file with tests; save it again") from None
    cells = found.get("data")
    if not isinstance(cells, list) and "F" not in found and (tables := _tables(found)):
        arrays = {name: _numbered(values, path) for name, values in tables.items()}
        return next(iter(arrays.values())) if len(arrays) == 1 else Records(Traits(NAME, path, remarks=(f"{len(arrays)} arrays",)), arrays)
    if cells is None:
        if not isinstance(found.get("F"), np.ndarray):
            raise DataError(f"{path}: no cell array 'data' and no force 'F' found, expected one of them; save the tests under these names")
        return _record(found, path, "the file")
    if not isinstance(cells, list) or not cells:
        raise DataError(f"{path}: variable 'data' is no cell array with tests, expected structs with t, F and dL; save it again")
    tests: dict[str, ChannelRecord] = {}
    remarks = []
    for number, cell in enumerate(cells, start=1):
        fields = _fields(cell, path, number)
        tag = _text(fields.get("tag")) or f"test {number}"
        if tag in tests:
            remarks.append(f"tag '{tag}' occurs again: that test is called '{tag} ({number})'")
            tag = f"{tag} ({number})"
        tests[tag] = _record(fields, path, f"test '{tag}'")
    return Records(Traits(NAME, path, remarks=tuple(remarks)), tests)


def _tables(found: Mapping[str, Value]) -> dict[str, np.ndarray]:
    """Arrays of at least ten rows and two to ten columns of numbers, by name."""
    return {
        name: value
        for name, value in found.items()
        if isinstance(value, np.ndarray)
        and value.dtype.kind in "fiu"
        and value.ndim == 2
        and len(value) >= LEAST_ROWS
        and 2 <= value.shape[1] <= MOST_COLUMNS
    }


def _numbered(values: np.ndarray, path: Path) -> ChannelRecord:
    """The record of an array whose columns have no names."""
    said = f"the array has no names: its columns are called column 1 to column {values.shape[1]}"
    return make_record(
        Traits(NAME, path, remarks=(said,)), ColumnBlock((Column(""),) * values.shape[1], np.asarray(values, dtype=float)), {}
    )


def _fields(cell: object, path: Path, number: int) -> Mapping[str, Value]:
    """Fields of a struct of one element."""
    if not isinstance(cell, list) or len(cell) != 1 or not isinstance(cell[0], dict):
        raise DataError(f"{path}: entry {number} of 'data' is no struct of one test, expected the fields t, F and dL; save it again")
    return cell[0]


def _text(value: Value | None) -> str:
    return " ".join(value.split())[:80] if isinstance(value, str) else ""


def _number(value: Value | None) -> float | None:
    """A single finite number, None for anything else."""
    if not isinstance(value, np.ndarray) or value.size != 1 or value.dtype.kind not in "fiu":
        return None
    number = float(value.ravel()[0])
    return number if np.isfinite(number) else None


def _vector(value: Value, name: str, where: str) -> np.ndarray:
    """A column of numbers, infinities as NaN."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu" or value.size < 2 or value.size != max(value.shape):
        raise DataError(f"{where}: field '{name}' is no column of numbers, expected one; save it again")
    values = np.asarray(value, dtype=float).ravel()
    return np.where(np.isfinite(values), values, np.nan)


def _record(fields: Mapping[str, Value], path: Path, label: str) -> ChannelRecord:
    where = f"{path}, {label}"
    named = [name for name in _CHANNELS if isinstance(fields.get(name), np.ndarray)]
    if "F" not in named:
        raise DataError(f"{where}: the force 'F' is missing, expected fields t, F and dL; save it again")
    vectors = {name: _vector(fields[name], name, where) for name in named}
    lengths = {name: values.size for name, values in vectors.items()}
    if len(set(lengths.values())) != 1:
        said = ", ".join(f"{name} {n}" for name, n in lengths.items())
        raise DataError(f"{where}: the columns differ in length ({said}), expected one length; save it again")
    remarks = ["units are those of the format: t s, F N, dL, u and utr mm, A0 mm^2, T degC"]
    untared = _number(fields.get("F0"))
    if untared:
        vectors["F"] = vectors["F"] + untared
        remarks.append(f"F0 = {untared:g} N, which was not tared, added to F")
    about: dict[str, float] = {}
    for name, (key, unit) in _SIZES.items():
        value = _number(fields.get(name))
        if value is not None and (value > 0.0 or unit == "degC"):
            about[key] = float(to_fixed(value, unit)[0])
    columns = tuple(Column(name, *_CHANNELS[name], source="format") for name in named)
    header = {name: str(value) for name in ("Af", "TFS") if (value := _number(fields.get(name))) is not None}
    traits = Traits(NAME, path, remarks=tuple(remarks), header={**header, "tag": _text(fields.get("tag"))})
    return make_record(traits, ColumnBlock(columns, np.stack([vectors[name] for name in named], axis=1)), about)
