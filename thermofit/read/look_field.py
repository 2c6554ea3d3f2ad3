"""What `inspect` finds in full fields: stages of DIC, infrared frames, bare matrices of one quantity."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import InfraredSequence
from thermofit.observe.noise import spatial_noise, temperature_noise
from thermofit.observe.triangles import point_spacing
from thermofit.read.findings import ColumnFinding, Fact, Part, column_finding
from thermofit.read.formats.contents import Column, DicSequence, DicStage, ScalarField, ThermalFrames

_LEAST_POINTS = 30
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
