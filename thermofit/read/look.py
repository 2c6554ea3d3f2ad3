"""What `inspect` finds: the content of a file part by part, a raw experiment folder, a group of files in one line."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import CELSIUS, InfraredSequence, MeasuredTest
from thermofit.observe.noise import displacement_noise, spatial_noise, temperature_noise
from thermofit.observe.phases import force_noise
from thermofit.observe.triangles import point_spacing
from thermofit.read.file_groups import FileGroup
from thermofit.read.formats.contents import ChannelRecord, Column, Content, DicSequence, DicStage, Records, ScalarField, ThermalFrames
from thermofit.read.formats.naming import lost_numbers, stage_time
from thermofit.read.formats.registry import read_native
from thermofit.read.look_record import (
    ColumnFinding,
    Fact,
    Finding,
    Part,
    clock_facts,
    column_finding,
    look_at_record,
    look_at_records,
    units_of,
)
from thermofit.read.plausible import Question, pose_of, questions_of_test
from thermofit.read.raw import read_experiment
from thermofit.read.study_lines import field_lines, series_lines


def look_at(content: Content) -> Finding:
    """Everything that can be said of a content."""
    parts = _parts(content)
    tests = content.tests.values() if isinstance(content, Records) else ()
    columns = [*content.traits.columns, *(column for test in tests for column in test.traits.columns)]
    kind = parts[0].kind if len(parts) == 1 else f"{len(parts)} records"
    return Finding(content.traits, kind, parts, units_of(columns))


def _parts(content: Content) -> tuple[Part, ...]:
    if isinstance(content, DicStage):
        return (look_at_stage(content),)
    if isinstance(content, DicSequence):
        return (look_at_sequence(content),)
    if isinstance(content, ThermalFrames):
        return (look_at_frames(content),)
    if isinstance(content, ScalarField):
        return (look_at_matrix(content),)
    return (look_at_record(content),) if isinstance(content, ChannelRecord) else look_at_records(content)


_LEAST_POINTS = 30
"""Points of which the noise of a field can be taken."""
_PATCH = 64
_PLACES, _MOVES = ("x", "y", "z"), ("u", "v", "w")


def look_at_stage(stage: DicStage, name: str = "") -> Part:
    """Points, extent, spacing and noise of one DIC stage."""
    place = stage.reference if stage.reference is not None else stage.deformed
    facts: dict[str, Fact] = {"points": len(stage.point_id), "without value": stage.traits.missing}
    if stage.stage is not None:
        facts["stage"] = stage.stage
    if stage.time is not None:
        facts["time s"] = stage.time
    facts["coordinates"] = _coordinates(stage)
    if place is not None:
        facts |= _extent(place, stage.length_unit)
    facts |= {f"signal {key}": f"{value:g} {unit}".strip() for key, (value, unit) in stage.signals.items()}
    remarks = () if stage.displacement is not None else ("coordinates only: displacements are differences to the first stage",)
    return Part(
        name,
        "DIC stage",
        len(stage.point_id),
        stage.traits.missing,
        facts,
        tuple(_stage_column(stage, column, place) for column in stage.traits.columns),
        (*stage.traits.remarks, *remarks),
    )


def _coordinates(stage: DicStage) -> str:
    both = stage.reference is not None and stage.deformed is not None
    return "reference and deformed" if both else "reference" if stage.reference is not None else "deformed"


def _extent(place: np.ndarray, unit: str) -> Mapping[str, Fact]:
    """Size of the field and the spacing of its points."""
    plane = place[np.isfinite(place[:, :2]).all(axis=1), :2]
    if len(plane) < 2:
        return {}
    size = np.ptp(plane, axis=0)
    distinct = np.unique(plane, axis=0)
    return {
        "field": f"{size[0]:.4g} x {size[1]:.4g} {unit}",
        "spacing": f"{point_spacing(distinct):.4g} {unit}" if len(distinct) > 1 else "all points at one place",
    }


def _stage_column(stage: DicStage, column: Column, place: np.ndarray | None) -> ColumnFinding:
    if column.meaning in _PLACES and place is not None:
        return column_finding(column, place[:, _PLACES.index(column.meaning)], stage.length_unit)
    if column.meaning in _MOVES and stage.displacement is not None:
        values = stage.displacement[:, _MOVES.index(column.meaning)]
        return column_finding(column, values, stage.length_unit, field_noise(place, values))
    keys = (column.meaning, column.meaning.removeprefix("strain_"), column.meaning.removeprefix("e"), column.name)
    strain = next((stage.strain[key] for key in keys if key in stage.strain), None)
    return column_finding(column, strain, "1", None if strain is None else field_noise(place, strain))


def field_noise(place: np.ndarray | None, values: np.ndarray) -> float | None:
    """Noise of one value of a field (n,) at places (n, 2 or 3), from planes through neighbours; None for too few points."""
    if place is None:
        return None
    known = np.isfinite(place[:, :2]).all(axis=1) & np.isfinite(values)
    if known.sum() < _LEAST_POINTS:
        return None
    try:
        return spatial_noise(place[known, :2], values[known][None], np.ones((1, int(known.sum())), dtype=bool)).sigma
    except DataError:
        return None


def look_at_sequence(sequence: DicSequence) -> Part:
    """All stages of one file; the columns are those of the last stage, where the specimen has moved most."""
    last = look_at_stage(sequence.stages[-1])
    points, n = len(sequence.stages[-1].point_id), len(sequence.stages)
    times = [stage.time for stage in sequence.stages if stage.time is not None]
    facts: dict[str, Fact] = {"stages": n, "points of a stage": points, "without value": sequence.traits.missing}
    if times:
        facts["times s"] = f"{min(times):g} to {max(times):g}"
    kept = {key: value for key, value in last.facts.items() if key in ("coordinates", "field", "spacing")}
    return Part("", "DIC sequence", n * points, sequence.traits.missing, facts | kept, last.columns, sequence.traits.remarks)


def look_at_frames(frames: ThermalFrames) -> Part:
    """Size, range and noise of infrared frames."""
    n, rows, columns = frames.values.shape
    facts: dict[str, Fact] = {"frames": n, "rows": rows, "columns": columns, "without value": frames.traits.missing}
    if frames.date:
        facts["recorded"] = frames.date
    if frames.time is not None and n > 1:
        facts["times s"] = f"{frames.time[0]:g} to {frames.time[-1]:g}"
    noise = _frame_noise(frames)
    found = frames.traits.columns or (Column("pixel", "temperature", frames.unit, "file"),)
    listed = tuple(column_finding(column, frames.values, frames.unit, noise) for column in found[:1])
    return Part("", "infrared frames", frames.values.size, frames.traits.missing, facts, listed, frames.traits.remarks)


def _frame_noise(frames: ThermalFrames) -> float | None:
    """Noise of a pixel: over time where there are at least three frames with times, else of one frame in space."""
    if frames.time is not None and len(frames.values) >= 3 and np.all(np.diff(frames.time) > 0):
        try:
            return temperature_noise(InfraredSequence(frames.time, frames.values)).sigma
        except DataError:
            return None
    return _matrix_noise(frames.values[len(frames.values) // 2])


def _matrix_noise(values: np.ndarray) -> float | None:
    """Noise of one value of a matrix, from its middle."""
    rows, columns = (slice(max(0, n // 2 - _PATCH // 2), n // 2 + _PATCH // 2) for n in values.shape)
    patch = np.asarray(values[rows, columns], dtype=float)
    return field_noise(np.argwhere(np.ones(patch.shape, dtype=bool)).astype(float), patch.ravel())


def look_at_matrix(field: ScalarField) -> Part:
    """A matrix of one quantity without coordinates."""
    rows, columns = field.values.shape
    facts: dict[str, Fact] = {"rows": rows, "columns": columns, "without value": field.traits.missing, "quantity": field.quantity}
    found = field.traits.columns or (Column(field.quantity, field.quantity, field.unit),)
    listed = tuple(column_finding(column, field.values, field.unit, _matrix_noise(field.values)) for column in found[:1])
    remark = "the file has no coordinates: place and size of a point must come from another field of the same export"
    return Part("", "matrix of one field", field.values.size, field.traits.missing, facts, listed, (*field.traits.remarks, remark))


_T = TypeVar("_T")


def look_at_raw(folder: Path) -> tuple[tuple[Part, ...], tuple[Question, ...]]:
    """Force record, DIC stages, infrared frames, and what is to be asked about them. DataError for every defect of the folder."""
    experiment = read_experiment(folder)
    parts = [_force(experiment)]
    if experiment.dic is not None:
        parts.append(_dic(experiment))
    if experiment.ir is not None:
        parts.append(_ir(experiment))
    questions = questions_of_test(experiment, pose_of(experiment))
    return tuple(parts), tuple(q for q in questions if q.name not in experiment.confirmed)


def _clock(time: np.ndarray) -> dict[str, Fact]:
    return {key: value for key, value in clock_facts(time)[0].items() if key not in ("repeated times", "backward times")}


def _force(experiment: MeasuredTest) -> Part:
    record = experiment.force
    facts: dict[str, Fact] = {"rows": len(record.time), **_clock(record.time)}
    facts |= {"air degC": experiment.theta_air - CELSIUS, "jaws degC": experiment.theta_clamp - CELSIUS}
    columns = [_column("force", "N", record.force, _or_none(lambda: force_noise(record)))]
    if record.crosshead is not None:
        columns.append(_column("crosshead", "mm", record.crosshead, None))
    return Part("force", "record", len(record.time), 0, facts, tuple(columns), experiment.repairs)


def _dic(experiment: MeasuredTest) -> Part:
    dic = experiment.dic
    assert dic is not None
    lost = int(np.isnan(dic.displacement[:, :, 0]).sum())
    facts: dict[str, Fact] = {
        "stages": len(dic.time),
        "points": len(dic.point_id),
        "without value": lost,
        **_clock(dic.time),
        "side": dic.side,
    }
    noise = _or_none(lambda: displacement_noise(dic))
    columns = []
    for k, name in enumerate(("u", "v", "w")):
        found = noise[k] if noise else None
        columns.append(_column(name, "mm", dic.displacement[:, :, k], found.sigma if found else None))
    return Part("dic", "DIC sequence", dic.displacement[:, :, 0].size, lost, facts, tuple(columns))


def _ir(experiment: MeasuredTest) -> Part:
    ir = experiment.ir
    assert ir is not None
    n, rows, columns = ir.frames.shape
    facts: dict[str, Fact] = {"frames": n, "rows": rows, "columns": columns, **_clock(ir.time), "side": ir.side}
    facts["landmarks"] = "given" if experiment.landmarks else "absent"
    noise = _or_none(lambda: temperature_noise(ir))
    return Part(
        "ir", "infrared frames", ir.frames.size, 0, facts, (_column("temperature", "K", ir.frames, noise.sigma if noise else None),)
    )


def _or_none(estimate: Callable[[], _T]) -> _T | None:
    """An estimate of noise, None where the data are too few for it."""
    try:
        return estimate()
    except DataError:
        return None


def _column(name: str, unit: str, values: np.ndarray, noise: float | None) -> ColumnFinding:
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (None, None)
    return ColumnFinding(name, name, unit, "format", unit, low, high, int(values.size - known.size), noise)


MOST_BYTES = 200_000_000
"""Of a group with more than this only some files are read."""
_SAMPLE = 20


@dataclass(frozen=True)
class GroupFinding:
    """A group: `points` and `missing` over the files that were read, `units` as written, `remarks`, counted where they repeat."""

    kind: str
    points: int
    missing: int
    read: int
    units: tuple[str, ...]
    facts: Mapping[str, Any]
    remarks: tuple[str, ...]
    lines: str = ""


def look_at_group(group: FileGroup) -> GroupFinding:
    """Read the files of a native group (all, or some of very many bytes) and say what they hold together."""
    findings, stages, broken = [], [], []
    lines = ""
    chosen = _chosen(group)
    for path in chosen:
        try:
            content = read_native(path)
        except DataError as error:
            broken.append(str(error))
            continue
        findings.append(look_at(content))
        lines = lines or field_lines(content, group.folder, group.pattern)
        if not lines and isinstance(content, ChannelRecord) and len(chosen) > 1:
            lines = series_lines(content, group.folder, group.pattern)
        if isinstance(content, DicStage):
            stages.append(content)
    remarks = _counted([remark for finding in findings for part in finding.parts for remark in part.remarks], len(findings))
    if broken:
        remarks.append(f"{len(broken)} of {len(chosen)} files cannot be read; the first: {broken[0]}")
    if len(chosen) < len(group.paths):
        remarks.append(f"{len(chosen)} of {len(group.paths)} files were read, evenly taken: all are more than {MOST_BYTES / 1e6:.0f} MB")
    facts, more = _sequence(stages) if len(stages) > 1 else ({}, [])
    return GroupFinding(
        findings[0].kind if findings else "",
        sum(part.points for finding in findings for part in finding.parts),
        sum(part.missing for finding in findings for part in finding.parts),
        len(findings),
        tuple(dict.fromkeys(unit for finding in findings for unit in finding.units)),
        _shared(findings) | facts,
        (*remarks, *more),
        lines,
    )


def _chosen(group: FileGroup) -> list[Any]:
    size = sum(path.stat().st_size for path in group.paths)
    if size <= MOST_BYTES or len(group.paths) <= _SAMPLE:
        return list(group.paths)
    return [group.paths[k] for k in np.unique(np.linspace(0, len(group.paths) - 1, _SAMPLE).astype(int))]


def _shared(findings: Sequence[Finding]) -> dict[str, Any]:
    """Facts of the first part that all files agree upon, and the range of their points."""
    if not findings:
        return {}
    counts = [part.points for finding in findings for part in finding.parts]
    low, high = min(counts), max(counts)
    return {"points of each": f"{low}" if low == high else f"{low} to {high}"}


def _counted(remarks: Sequence[str], files: int) -> list[str]:
    """Each remark once, with the number of files where it was made by some only."""
    found = []
    for remark in dict.fromkeys(remarks):
        n = remarks.count(remark)
        found.append(remark if n == files else f"{remark} ({n} of {files} files)")
    return found


def _sequence(stages: Sequence[DicStage]) -> tuple[dict[str, Any], list[str]]:
    """Numbers and times of the stages: range, numbers left out, repeated times."""
    facts: dict[str, Any] = {}
    remarks = []
    numbers = [stage.stage if stage.stage is not None else stage_time(stage.traits.path)[0] for stage in stages]
    known = sorted(n for n in numbers if n is not None)
    if known:
        facts["stages"] = f"{known[0]} to {known[-1]}"
        if lost := lost_numbers(known, "stage"):
            remarks.append(lost)
        if len(set(known)) < len(known):
            remarks.append("two files have the same stage number: exports of different tests in one folder?")
    times = np.array([stage.time for stage in stages if stage.time is not None], dtype=float)
    if len(times) == len(stages):
        clock, found = clock_facts(times)
        facts["times s"] = clock.get("time s", "")
        remarks += found
    elif not len(times):
        remarks.append("the files have no times: experiment.yaml must give them")
    ids = {stage.point_id.tobytes() for stage in stages}
    if len(ids) > 1:
        remarks.append("the stages do not hold the same points; they are joined by their ids")
    return facts, remarks
