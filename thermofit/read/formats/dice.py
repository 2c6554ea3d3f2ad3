"""DICe (Sandia): text, one file for each image, with or without a block of lines that begin with `***`.

Everything is in px, the origin is the upper left corner of the image, y points DOWN. Failed points have `SIGMA` = -1 or, in another
choice of columns, `MATCH` = -1; `STATUS_FLAG` says why. Strains `VSG_STRAIN_*` are Green-Lagrange of a virtual strain gauge.
Sources: dicengine/dice, marcoalopez/Jupyter4DICe.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import Column, DicStage, Head
from thermofit.read.formats.naming import stage_time
from thermofit.read.formats.table import NamedTable, check_unique, header_cells, read_named
from thermofit.read.formats.text import head_lines, read_text

NAME = "DICe text"
PLACE = {"COORDINATE_X": "x", "COORDINATE_Y": "y", "DISPLACEMENT_X": "u", "DISPLACEMENT_Y": "v"}
STRAINS = {"VSG_STRAIN_XX": "exx", "VSG_STRAIN_YY": "eyy", "VSG_STRAIN_XY": "exy"}
_FAILURES = {5: "initialisation failed", 11: "iterations exhausted"}
_WHAT = "a DICe solution with a line of column names"


def recognises(head: Head) -> bool:
    """Whether the first line that does not begin with `***` names the columns of DICe."""
    line = next((line for line in head_lines(head) if line.strip() and not line.startswith("***")), "")
    return set(PLACE) <= set(header_cells(line, ","))


def read(path: Path) -> DicStage:
    """Points of the image, displacements and strains NaN where the correlation failed. DataError for every defect."""
    text = read_text(path, _WHAT)
    header = next((k for k, line in enumerate(text.lines) if line.strip() and not line.startswith("***")), None)
    if header is None:
        raise DataError(f"{path}: the file ends within its header, expected {_WHAT}; run the correlation again")
    absent = [name for name in PLACE if name not in header_cells(text.lines[header], ",")]
    if absent:
        raise DataError(f"{path}, line {header + 1}: no column {absent[0]}, expected {_WHAT}; add it to the output of DICe")
    named = read_named(text, path, header, ",", lambda name, unit: _column(name))
    columns = {column.name: named.values[:, k] for k, column in enumerate(named.columns)}
    reference, displacement = np.full((2, len(named.values), 3), np.nan)
    for k, name in enumerate(PLACE):
        (reference, displacement)[k // 2][:, k % 2] = columns[name]
    failed = np.zeros(len(reference), dtype=bool)
    for name in ("SIGMA", "MATCH"):
        if name in columns:
            failed |= ~(columns[name] >= 0)
    missing = failed | np.isnan(displacement[:, :2]).any(axis=1) | np.isnan(reference[:, :2]).any(axis=1)
    if missing.all():
        raise DataError(f"{path}: none of the {len(missing)} points was correlated, expected some; take another image or correlate again")
    displacement[missing] = np.nan
    about = _header(text.lines[:header])
    remarks = (*named.traits.remarks, *_remarks(columns, failed, "y positive down" in about.get("Coordinates", "")))
    return DicStage(
        traits=replace(named.traits, format=NAME, missing=int(missing.sum()), remarks=remarks, header=about),
        point_id=_ids(named, path),
        reference=reference,
        displacement=displacement,
        length_unit="px",
        strain={key: np.where(missing, np.nan, columns[name]) for name, key in STRAINS.items() if name in columns},
        stage=stage_time(path)[0],
    )


def _ids(named: NamedTable, path: Path) -> np.ndarray:
    """Numbers of the points: SUBSET_ID, else the row. DataError where an id is none or occurs twice."""
    k = named.index("id")
    if k is None:
        return np.arange(len(named.values))
    ids = named.values[:, k]
    wrong = np.flatnonzero(~(np.abs(ids) < 2**53) | (ids != np.round(ids)))
    if wrong.size:
        line = named.table.lines[wrong[0]]
        raise DataError(f"{path}, line {line}: SUBSET_ID is {ids[wrong[0]]:g}, expected a whole number; correct it or correlate again")
    check_unique(ids, named.table.lines, path, "SUBSET_ID")
    return ids.astype(np.int64)


def _column(name: str) -> Column:
    if name in PLACE:
        return Column(name, PLACE[name], "px", "format")
    if name in STRAINS:
        return Column(name, STRAINS[name], "1", "format")
    return Column(name, "id" if name == "SUBSET_ID" else "")


def _header(lines: list[str]) -> dict[str, str]:
    """`*** key: value` lines; the sentence on coordinates has no colon."""
    found = {}
    for line in lines:
        text = line.strip("* \t")
        key, colon, value = text.partition(": ")
        if text.startswith("Coordinates given"):
            found["Coordinates"] = text
        elif colon and len(key) < 60:
            found[key.strip()] = value.strip()
    return found


def _remarks(columns: Mapping[str, np.ndarray], failed: np.ndarray, is_stated: bool) -> list[str]:
    remarks = [f"y points down ({'stated in the header' if is_stated else 'fixed by the format'}), px"]
    if "SIGMA" not in columns and "MATCH" not in columns:
        remarks.append("neither SIGMA nor MATCH is in the file: failed points cannot be told")
    if "STATUS_FLAG" in columns and failed.any():
        flags = columns["STATUS_FLAG"][failed]
        counts = Counter(flags[np.isfinite(flags)].tolist())
        words = [f"{flag:g}{_words(flag)}: {n}" for flag, n in sorted(counts.items())[:10]]
        remarks.append(f"STATUS_FLAG of failed points: {', '.join(words) or 'none'}")
    if any(name.startswith("MODEL_") for name in columns):
        remarks.append("columns MODEL_* (stereo, calibrated) are not used")
    return remarks


def _words(flag: float) -> str:
    return f" ({_FAILURES[int(flag)]})" if flag in _FAILURES else ""
