"""Reader of a raw experiment folder: `experiment.yaml`, `force.csv`, `dic/stage_*.csv`, `ir/frame_*.csv` (mm, N, s, degC).

Every defect is a DataError with file and line. What is mended or lost without harm is counted in `repairs`.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TypeVar

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import CELSIUS, DicField, ForceRecord, InfraredSequence, MeasuredTest
from thermofit.read.formats.frames import read_frame_files
from thermofit.read.formats.naming import lost_numbers, stage_time
from thermofit.read.formats.sequence import read_dic_files
from thermofit.read.raw_description import DESCRIPTION, Description, FieldSource, read_description
from thermofit.read.raw_text import read_header, read_lines, read_table, read_time

__all__ = ["read_description", "read_dic", "read_experiment", "read_force", "read_infrared"]

Field = TypeVar("Field", DicField, InfraredSequence)
_DIC_COLUMNS = ("id", "x_mm", "y_mm", "z_mm", "ux_mm", "uy_mm", "uz_mm")
_FORCE_COLUMNS = ("time_s", "force_N")
_REFERENCE_TOLERANCE = 1e-3
"""mm by which the reference position of a point may differ between stages: rounding of the export, not another point."""
_LARGEST_ID = 2**53
MOST_POINTS = 500_000
"""DIC points of a test: more than facets 5 pixels apart on 12 megapixels."""


def read_force(description: Description) -> ForceRecord:
    """Force record over strictly increasing times; the crosshead is None where its column is absent."""
    path = description.force.file
    lines = read_lines(path, "the force record with the header time_s,force_N,crosshead_mm")
    header = read_header(lines[0], path, 1, _FORCE_COLUMNS, ("crosshead_mm",))
    table, names = header.in_fixed(read_table(lines[1:], path, 2, header.written)), header.names
    time = table[:, names.index("time_s")]
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if len(back):
        k = int(back[0])
        raise DataError(
            f"{path}, line {k + 3}: the time is {time[k + 1]:g} s after {time[k]:g} s, expected increasing times; remove or correct the row"
        )
    if len(time) < 2:
        raise DataError(f"{path}: found one row, expected at least two times; export the whole record")
    crosshead = table[:, names.index("crosshead_mm")].copy() if "crosshead_mm" in names else None
    said = tuple(f"{path.name}: {remark}" for remark in header.remarks)
    return ForceRecord(time.copy(), table[:, names.index("force_N")].copy(), crosshead, said)


def _files(source: FieldSource, declared: int | None, word: str) -> tuple[list[Path], list[str]]:
    """Files of a field, sorted by name, and remarks on what else lies there or is not there."""
    if not source.folder.is_dir():
        raise DataError(f"{source.folder}: the folder does not exist, but {DESCRIPTION} declares it; put it there or remove the section")
    paths = sorted(source.folder.glob(f"{word}_*.csv"))
    if not paths:
        raise DataError(f"{source.folder}: no file {word}_NNNN.csv found; put the {word}s there or remove the section from {DESCRIPTION}")
    others = sum(1 for _ in source.folder.iterdir()) - len(paths)
    remarks = [f"{source.folder.name}: {others} other files left unread"] if others else []
    if declared not in (None, len(paths)):
        remarks.append(f"{source.folder.name}: {len(paths)} {word}s found, {declared} declared in {DESCRIPTION}")
    if lost := lost_numbers([n for n, _ in map(stage_time, paths) if n is not None], word):
        remarks.append(f"{source.folder.name}: {lost}")
    return paths, remarks


def _order(time: np.ndarray, paths: list[Path]) -> np.ndarray:
    """Order of the files by time; DataError where two have the same."""
    order = np.argsort(time, kind="stable")
    same = np.flatnonzero(np.diff(time[order]) == 0.0)
    if len(same):
        first, second = paths[order[same[0]]], paths[order[same[0] + 1]]
        at = time[order[same[0]]]
        raise DataError(f"{second}, line 1: the time {at:g} s is also that of {first.name}; correct or remove one of them")
    return order


def _resorted(order: np.ndarray, folder: Path, word: str) -> list[str]:
    """Remark where the order by name was not the order in time."""
    moved = int((order != np.arange(len(order))).sum())
    return [f"{folder.name}: {moved} {word}s sorted by time, their names give another order"] if moved else []


def _read_stage(path: Path) -> tuple[float, np.ndarray, tuple[str, ...]]:
    """Time in s and the table (n, 7) of one stage with the columns id, x, y, z, ux, uy, uz, and what was converted."""
    lines = read_lines(path, "a stage: '# time_s: <t>', a header, one line for each point")
    time = read_time(lines[0], path)
    if len(lines) < 2:
        raise DataError(f"{path}: the file ends after line 1, expected the header {','.join(_DIC_COLUMNS)} and points; export it again")
    header = read_header(lines[1], path, 2, _DIC_COLUMNS)
    table = header.in_fixed(read_table(lines[2:], path, 3, header.written))[:, [header.names.index(name) for name in _DIC_COLUMNS]]
    ids = table[:, 0]
    wrong = np.flatnonzero((ids != np.floor(ids)) | (np.abs(ids) >= _LARGEST_ID))
    if len(wrong):
        raise DataError(f"{path}, line {wrong[0] + 3}: the id is {ids[wrong[0]]:g}, expected a whole number; correct it")
    if len(np.unique(ids)) != len(ids):
        _, first = np.unique(ids, return_index=True)
        k = int(np.setdiff1d(np.arange(len(ids)), first)[0])
        raise DataError(f"{path}, line {k + 3}: the id {ids[k]:.0f} occurs a second time in this stage; remove one of the rows")
    return time, table, header.remarks


def read_dic(description: Description) -> tuple[DicField, tuple[str, ...]]:
    """All stages in the order of time, and remarks. Points are the union of all ids; NaN where one is missing in a stage.

    DataError for defects of a file, for equal times, and for a point whose reference position differs between stages.
    """
    source = description.dic
    if source is None:
        raise DataError(f"{description.folder / DESCRIPTION}: key 'dic' is missing; add it to read displacements")
    if source.files is not None:
        field, said_of = read_dic_files(source.files, source, source.side)
        _check_number(len(field.point_id), source.files)
        return _counted(field, said_of, source, source.stages, "stage")
    paths, remarks = _files(source, source.stages, "stage")
    read = [_read_stage(path) for path in paths]
    stages, said = [one[:2] for one in read], [text for one in read for text in one[2]]
    remarks += [f"{source.folder.name}: {text} in {said.count(text)} stages" for text in dict.fromkeys(said)]
    order = _order(np.array([time for time, _ in stages]), paths)
    remarks += _resorted(order, source.folder, "stage")
    stages, paths = [stages[k] for k in order], [paths[k] for k in order]
    point_id = np.unique(np.concatenate([table[:, 0] for _, table in stages]))
    _check_number(len(point_id), source.folder)
    reference = np.full((len(point_id), 3), np.nan)
    displacement = np.full((len(stages), len(point_id), 3), np.nan)
    for k, (_, table) in enumerate(stages):
        place = np.searchsorted(point_id, table[:, 0])
        known = reference[place]
        apart = np.abs(table[:, 1:4] - known).max(axis=1)
        far = np.flatnonzero(apart > _REFERENCE_TOLERANCE)
        if len(far):
            raise DataError(
                f"{paths[k]}, line {far[0] + 3}: the reference position of point {table[far[0], 0]:.0f} is {apart[far[0]]:.4g} mm away "
                f"from that in earlier stages, expected the same; export all stages with one reference"
            )
        reference[place] = np.where(np.isnan(known), table[:, 1:4], known)
        displacement[k, place] = table[:, 4:7]
    lost = int(np.isnan(displacement[:, :, 0]).sum())
    if lost:
        hit = int(np.isnan(displacement[:, :, 0]).any(axis=0).sum())
        rows, points = len(stages) * len(point_id), len(point_id)
        remarks.append(f"{source.folder.name}: {lost} of {rows} rows missing, {hit} of {points} points concerned")
    time = np.array([t for t, _ in stages])
    return DicField(time, point_id.astype(np.int64), reference, displacement, source.side), tuple(remarks)


def _check_number(n: int, where: object) -> None:
    """DataError for more points than MOST_POINTS."""
    if n > MOST_POINTS:
        raise DataError(f"{where}: found {n} DIC points, expected at most {MOST_POINTS}; export points that lie farther apart")


def _counted(field: Field, remarks: tuple[str, ...], source: FieldSource, declared: int | None, word: str) -> tuple[Field, tuple[str, ...]]:
    """A field of native exports; a remark where their number is not the declared one."""
    if declared in (None, len(field.time)):
        return field, remarks
    return field, (*remarks, f"{source.files}: {len(field.time)} {word}s found, {declared} declared in {DESCRIPTION}")


def _read_frame(path: Path, shape: tuple[int, int] | None, origin: str) -> tuple[float, np.ndarray]:
    """Time in s and temperatures K (n_row, n_col) float32 of one frame; `shape` is what `origin` makes us expect."""
    lines = read_lines(path, "a frame: '# time_s: <t>', one line of temperatures for each pixel row")
    time = read_time(lines[0], path)
    table = read_table(lines[1:], path, 2)
    if shape is not None and table.shape != shape:
        found, wanted = (f"{n[0]} rows x {n[1]} columns" for n in (table.shape, shape))
        raise DataError(f"{path}: the frame has {found}, expected {wanted} as in {origin}; export all frames with one window")
    if table.min() <= -CELSIUS:
        k, column = np.argwhere(table <= -CELSIUS)[0]
        raise DataError(f"{path}, line {k + 2}, column {column + 1}: {table[k, column]:g} degC is below absolute zero; correct the export")
    return time, (table + CELSIUS).astype(np.float32)


def _check_landmarks(description: Description, n: int) -> None:
    """DataError where the landmarks are those of a frame that is not among the `n`."""
    landmarks = description.landmarks
    if landmarks is not None and landmarks.frame >= n:
        raise DataError(
            f"{description.folder / DESCRIPTION}: key 'ir.landmarks_frame' is {landmarks.frame}, but there are only "
            f"{n} frames, counted from 0; correct it"
        )


def read_infrared(description: Description) -> tuple[InfraredSequence, tuple[str, ...]]:
    """All frames in the order of time, as float32 K, and remarks; DataError for defects of a file and for unequal sizes."""
    source = description.ir
    if source is None:
        raise DataError(f"{description.folder / DESCRIPTION}: key 'ir' is missing; add it to read temperatures")
    if source.files is not None:
        infrared, said = _counted(*read_frame_files(source.files, source, source.side), source, source.frames, "frame")
        if source.image_shape not in (None, infrared.frames.shape[1:]):
            found = "{} x {}".format(*infrared.frames.shape[1:])
            raise DataError(f"{source.files}: the frames have {found} pixels, expected ir.image_shape of {DESCRIPTION}; correct it")
        _check_landmarks(description, len(infrared.time))
        return infrared, said
    paths, remarks = _files(source, source.frames, "frame")
    time = np.empty(len(paths))
    time[0], first = _read_frame(paths[0], source.image_shape, f"{DESCRIPTION} (ir.image_shape)")
    frames = np.empty((len(paths), *first.shape), dtype=np.float32)
    frames[0] = first
    for k, path in enumerate(paths[1:], start=1):
        time[k], frames[k] = _read_frame(path, (first.shape[0], first.shape[1]), paths[0].name)
    order = _order(time, paths)
    if moved := _resorted(order, source.folder, "frame"):
        remarks, time, frames = remarks + moved, time[order], frames[order]
    _check_landmarks(description, len(frames))
    return InfraredSequence(time, frames, source.side), tuple(remarks)


def _check_span(force: ForceRecord, time: np.ndarray, path: Path, what: str) -> list[str]:
    """The force record must cover the times of a field; less than one of its samples is let pass with a remark."""
    start, end = float(force.time[0] - time[0]), float(time[-1] - force.time[-1])
    worst, side = max((start, "begins {:.3f} s after the first"), (end, "ends {:.3f} s before the last"))
    if worst <= 0.0:
        return []
    text = f"the force record {side.format(worst)} {what}"
    if worst > np.median(np.diff(force.time)):
        raise DataError(f"{path}: {text}, expected a record that spans all of them; export a longer one or check the trigger")
    return [f"{path.name}: {text}, which is less than one sample"]


def read_experiment(folder: Path, parts: Collection[str] = ("force", "dic", "ir")) -> MeasuredTest:
    """Read a raw experiment folder. The force record is always read; of "dic" and "ir" only what `parts` names.

    A field that `experiment.yaml` does not declare is None. DataError for every defect, see the functions above, and where
    the force record does not span the times of the fields.
    """
    if unknown := set(parts) - {"force", "dic", "ir"}:
        raise ValueError(f"unknown parts {sorted(unknown)}, expected force, dic, ir")
    description = read_description(folder)
    force = read_force(description)
    repairs: list[str] = [*force.remarks]
    dic, ir = None, None
    for name, source in (("dic", description.dic), ("ir", description.ir)):
        if source is None and (description.folder / name).is_dir():
            repairs.append(f"{name}: the folder is there but {DESCRIPTION} has no section '{name}', not read")
    if "dic" in parts and description.dic is not None:
        dic, remarks = read_dic(description)
        repairs += [*remarks, *_check_span(force, dic.time, description.force.file, "DIC stage")]
    if "ir" in parts and description.ir is not None:
        ir, remarks = read_infrared(description)
        repairs += [*remarks, *_check_span(force, ir.time, description.force.file, "infrared frame")]
    return MeasuredTest(
        description.folder,
        description.specimen.lengths(),
        description.temperatures.theta_air_degC + CELSIUS,
        description.temperatures.theta_clamp_degC + CELSIUS,
        force,
        dic,
        ir,
        description.landmarks,
        description.programme,
        tuple(repairs),
        description.confirmed,
    )
