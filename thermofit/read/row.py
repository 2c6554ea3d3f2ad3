"""Strain along the axis of a strip over time: the table of a workbook or a text file, and means over sections and intervals of time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError, StudyError
from thermofit.observe.noise import robust_sigma, second_differences
from thermofit.read.formats.record_table import Row
from thermofit.read.formats.text import detect_separator, read_text, split_cells
from thermofit.read.formats.workbook import cell_number, read_sheets, sheet_names
from thermofit.study.coupon import RowSettings
from thermofit.study.errors import near_miss
from thermofit.study.paths import path_from

MOST_LOST = 0.2
"""Share of the values of a section that may be lost."""
_WORKBOOKS = (".xlsx", ".xlsm")


@dataclass(frozen=True)
class AxialTable:
    """Places mm (n_e,) in increasing order, times s (n_t,), strains (n_t, n_e) as the table holds them, NaN where a value was lost."""

    place: np.ndarray
    time: np.ndarray
    strain: np.ndarray

    @property
    def lost(self) -> int:
        """Number of lost values."""
        return int(np.isnan(self.strain).sum())


@dataclass(frozen=True)
class RowRecord:
    """Nominal strain (n_t, n_s) of sections at `place` mm over time s, its standard deviation, and what was done, in words."""

    name: str
    time: np.ndarray
    place: np.ndarray
    strain: np.ndarray
    noise: float
    remarks: tuple[str, ...]


def read_axial_table(path: Path, sheet: str | None = None) -> AxialTable:
    """The table of a file: places in its first row, times in its first column, in any order of the places.

    StudyError for a sheet that is not there; DataError names row and column of a place or time that is no number, places that stand twice,
    and times that do not increase.
    """
    rows = _rows(path, sheet)
    if len(rows) < 3 or len(rows[0]) < 4:
        raise DataError(
            f"{path}: found {len(rows)} rows; expected places in the first row, times in the first column, three of each at least"
        )
    width = len(rows[0])
    while width > 1 and str(rows[0][width - 1]).strip() == "":
        width -= 1
    place = np.array([cell_number(cell) for cell in rows[0][1:width]])
    if len(wrong := np.flatnonzero(~np.isfinite(place))):
        k = int(wrong[0])
        raise DataError(f"{path}, row 1, column {k + 2}: '{rows[0][k + 1]}' is no place; expected a number in mm")
    values = np.full((len(rows) - 1, width), np.nan)
    for n, row in enumerate(rows[1:]):
        cells = [cell_number(cell) for cell in row[:width]]
        values[n, : len(cells)] = cells
    time = values[:, 0]
    if len(wrong := np.flatnonzero(~np.isfinite(time))):
        k = int(wrong[0])
        raise DataError(f"{path}, row {k + 2}: '{rows[k + 1][0] if rows[k + 1] else ''}' is no time; expected a number in s")
    if len(wrong := np.flatnonzero(~(np.diff(time) > 0.0))):
        k = int(wrong[0]) + 1
        raise DataError(f"{path}, row {k + 2}: time {time[k]:g} s follows {time[k - 1]:g} s; expected increasing times")
    order = np.argsort(place, kind="stable")
    if len(twice := np.flatnonzero(np.diff(place[order]) == 0.0)):
        raise DataError(f"{path}, row 1: place {place[order][twice[0]]:g} mm stands twice; expected each once")
    return AxialTable(place[order], time, values[:, 1:][:, order])


def _rows(path: Path, sheet: str | None) -> list[Row]:
    if path.suffix.lower() in _WORKBOOKS:
        if not path.is_file():
            raise DataError(f"{path}: no such file; correct the key 'file' or put it there")
        names = sheet_names(path)
        if sheet is None and len(names) > 1:
            raise StudyError(f"{path}: holds the sheets {', '.join(names)}; name one under 'sheet'")
        if sheet is not None and sheet not in names:
            raise StudyError(f"{path}: holds no sheet '{sheet}'{near_miss(sheet, names)}")
        found = read_sheets(path, [names[0] if sheet is None else sheet])[0]
        return list(found.rows[: found.filled])
    if sheet is not None:
        raise StudyError(f"{path}: is no workbook and has no sheet '{sheet}'; leave 'sheet' out")
    lines = read_text(path, "a table with places in its first row and times in its first column").lines
    separator = detect_separator(lines[1:])
    return [list(split_cells(line, separator)) for line in lines]


def row_record(settings: RowSettings, folder: Path, key: str) -> RowRecord:
    """The strip of one entry of the study; `folder` is that of the study file, `key` its place there. Errors as `read_axial_table`;
    DataError for a section without points or with too many lost values."""
    path = path_from(folder, settings.file, f"key '{key}.file'")
    table = read_axial_table(path, settings.sheet)
    strain = table.strain if settings.strain == "nominal" else np.expm1(table.strain)
    places, half = np.array(settings.places.y), 0.5 * settings.places.every
    means = np.full((len(table.time), len(places)), np.nan)
    said = [f"{table.lost} of {table.strain.size} values are lost in the table"] if table.lost else []
    for k, y in enumerate(places):
        near = (table.place >= y - half - 1e-9) & (table.place < y + half - 1e-9)
        if not near.any():
            ends = f"{table.place[0]:g} to {table.place[-1]:g} mm"
            raise DataError(f"{path}: no point lies within {half:g} mm of the section at {y:g} mm; places are {ends}")
        means[:, k] = _mean(strain[:, near])
    used = _used(settings, table, means, path)
    time, means = table.time[used], means[used]
    whole = np.isfinite(means)
    if np.any(bad := whole.mean(axis=0) < 1.0 - MOST_LOST):
        k = int(np.flatnonzero(bad)[0])
        raise DataError(
            f"{path}: the section at {places[k]:g} mm has {int(whole[:, k].sum())} of {len(time)} values; expected {1.0 - MOST_LOST:.0%} "
            "at least: end the record earlier (window, strain_max), or leave the place out"
        )
    means = np.stack([_bridged(time, means[:, k]) for k in range(len(places))], axis=1)
    if gaps := int((~whole).sum()):
        said.append(f"{gaps} lost values of sections were bridged by straight lines over time")
    if settings.points is not None and settings.points < len(time):
        said.append(f"{len(time)} rows became {settings.points} means over time, without the interval in which the strip begins to flow")
        # A mean over the kink of yielding is no value of the curve at the mean time.
        index = np.array_split(np.arange(len(time)), settings.points + 1)[1:]
        means = np.stack([means[i].mean(axis=0) for i in index])
        time = np.array([time[i].mean() for i in index])
    if len(time) < 10:
        raise DataError(f"{path}: {len(time)} times are left; expected ten at least")
    noise = settings.noise
    if noise is None:
        noise = float(np.median([robust_sigma(second_differences(time, means[:, k : k + 1]))[0] for k in range(len(places))]))
        said.append(f"noise of a section {noise:.2g}, as its second differences over time show it")
    return RowRecord(settings.label, time, places, means, noise, tuple(f"{settings.label}: {text}" for text in said))


def _mean(strain: np.ndarray) -> np.ndarray:
    """Mean (n_t,) of the values that are there, NaN where none is."""
    known = np.isfinite(strain)
    count = known.sum(axis=1)
    return np.where(count > 0, np.where(known, strain, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)


def _bridged(time: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Values (n_t,) with gaps filled by straight lines, at the ends by that through the two values next to the gap: a strain that grows
    would stand still otherwise."""
    known = np.flatnonzero(np.isfinite(value))
    out = np.interp(time, time[known], value[known])
    for two, beyond in ((known[:2], time < time[known[0]]), (known[-2:], time > time[known[-1]])):
        (t0, t1), (v0, v1) = time[two], value[two]
        out[beyond] = v0 + (v1 - v0) / (t1 - t0) * (time[beyond] - t0)
    return out


def _used(settings: RowSettings, table: AxialTable, means: np.ndarray, path: Path) -> np.ndarray:
    """Rows (n_t,) within the window and before the largest strain."""
    used = np.ones(len(table.time), dtype=bool)
    if settings.window is not None:
        used &= (table.time >= settings.window[0]) & (table.time <= settings.window[1])
    if settings.strain_max is not None:
        limit = settings.strain_max if settings.strain == "nominal" else np.expm1(settings.strain_max)
        beyond = np.flatnonzero(np.nanmax(np.where(np.isfinite(means), means, -np.inf), axis=1) > limit)
        if len(beyond):
            used[beyond[0] :] = False
    if used.sum() < 10:
        raise DataError(f"{path}: {int(used.sum())} rows lie within 'window' and 'strain_max'; expected ten at least")
    return used
