"""Many files of one DIC export -> one DicField: joined by point number or reference position, sorted by time, checked, repairs counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField
from thermofit.core.units import known_unit, to_fixed
from thermofit.read.formats.clock import Member, Rules, files_of, set_clock
from thermofit.read.formats.contents import Content, DicSequence, DicStage
from thermofit.read.formats.fracture import after_fracture
from thermofit.read.formats.joining import Joined, join
from thermofit.read.formats.registry import format_of

Remarks = tuple[str, ...]


def read_dic_files(pattern: Path, rules: Rules, side: str = "front") -> tuple[DicField, Remarks]:
    """The field of all files of a pattern, a folder or one file, and remarks on all that was mended, left out or assumed.

    DataError for every defect of a file, for files of several formats, units or references, and for times that are not known.
    """
    paths = files_of(pattern, "exports of a DIC system")
    stages, seen = _stages(paths)
    stages = [_in_millimetres(stage, rules) for stage in stages]
    remarks = list(seen)
    if rules.mm_per_pixel is not None and rules.axes[1] == "y":
        remarks.append("image y points down in most exports in pixels: is 'axes: {y: -y}' meant?")
    stages = _with_coordinates(stages, rules)
    members = [Member(stage.traits.path, stage.stage, stage.time) for stage in stages]
    clock = set_clock(members, rules, "stage")
    stages = [stages[k] for k in clock.order]
    joined = join(stages)
    remarks += [*clock.remarks, *joined.remarks]
    field, more = _clean(clock.time, joined, [stage.traits.path for stage in stages])
    return replace(_turned(field, rules), side=side), (*remarks, *more)


def _stages(paths: Sequence[Path]) -> tuple[list[DicStage], list[str]]:
    """Stages of all files, which must be of one format, and the remarks of their readers, each once with its count."""
    first = format_of(paths[0])
    stages: list[DicStage] = []
    said: dict[str, int] = {}
    for path in paths:
        module = format_of(path)
        if module is not first:
            raise DataError(f"{path}: this is {module.NAME}, but {paths[0].name} is {first.NAME}, expected files of one format; part them")
        found = _dic(module.read(path), path, module.NAME)
        if len(found) > 1 and len(paths) > 1:
            raise DataError(
                f"{path}: the file holds {len(found)} stages and {len(paths)} files are given, expected one such file; choose it"
            )
        for stage in found:
            for remark in stage.traits.remarks:
                said[remark] = said.get(remark, 0) + 1
        stages += found
    texts = [remark if count == len(stages) else f"{remark} ({count} of {len(stages)} stages)" for remark, count in said.items()]
    shown = texts if len(texts) <= 12 else [*texts[:12], f"{len(texts) - 12} further remarks of the reader on single stages"]
    return stages, [f"{first.NAME}: {len(stages)} stages", *shown]


def _dic(content: Content, path: Path, name: str) -> list[DicStage]:
    """Stages of a content. DataError where it is none of a DIC system, or a field without coordinates."""
    if isinstance(content, DicStage):
        return [content]
    if isinstance(content, DicSequence):
        return list(content.stages)
    raise DataError(f"{path}: this is {name}, expected points with coordinates and displacements; export a table of points")


def _in_millimetres(stage: DicStage, rules: Rules) -> DicStage:
    """Lengths in mm. DataError where the unit is not known, contradicts `unit`, or pixels have no scale."""
    path, unit = stage.traits.path, stage.length_unit or rules.unit
    if not unit:
        raise DataError(f"{path}: the file does not say its unit of length; give 'unit: mm' (or px, um, in)")
    try:
        factor, fixed = to_fixed(1.0, unit)
    except ValueError as error:
        raise DataError(f"{path}: key 'unit': {error}; correct it") from None
    if fixed not in ("mm", "px"):
        raise DataError(f"{path}: 'unit' is {unit}, expected the unit of a length such as mm, um, in, px; correct it")
    written = next((column.unit for column in stage.traits.columns if column.meaning in ("x", "u") and column.unit), "")
    if rules.unit and written and known_unit(rules.unit) != known_unit(written):
        raise DataError(f"{path}: the file is in {written}, but 'unit' is {rules.unit}; correct or remove the key")
    scale = float(factor)
    if fixed == "px":
        if rules.mm_per_pixel is None:
            raise DataError(f"{path}: the file is in pixels; give 'mm_per_pixel'")
        scale *= rules.mm_per_pixel
    elif rules.mm_per_pixel is not None:
        raise DataError(f"{path}: 'mm_per_pixel' is given, but the file is in {unit}; remove the key")
    return replace(
        stage,
        length_unit="mm",
        reference=None if stage.reference is None else stage.reference * scale,
        displacement=None if stage.displacement is None else stage.displacement * scale,
        deformed=None if stage.deformed is None else stage.deformed * scale,
    )


def _with_coordinates(stages: list[DicStage], rules: Rules) -> list[DicStage]:
    """Stages that all have displacements and reference positions, or all have coordinates only.

    A file of reference coordinates beside files of displacements is brought to them by point number. DataError for other mixtures.
    """
    if rules.coordinates_of == "deformed":
        stages = [_taken_as_deformed(stage) for stage in stages]
    moving = [stage for stage in stages if stage.displacement is not None]
    resting = [stage for stage in stages if stage.displacement is None]
    if not resting or not moving:
        wrong = next((stage for stage in moving if stage.reference is None), None)
        if wrong is not None:
            raise DataError(f"{wrong.traits.path}: the file has displacements only, expected a file of coordinates beside it; export one")
        if not moving and len(stages) < 2:
            raise DataError(
                f"{stages[0].traits.path}: one stage of coordinates has no displacements, expected several stages; give them all"
            )
        return stages
    if len(resting) > 1 or resting[0].reference is None or any(stage.reference is not None for stage in moving):
        raise DataError(
            f"{resting[0].traits.path}: the file has coordinates only, but {moving[0].traits.path.name} has displacements, expected the "
            f"same columns in all files; export all stages alike"
        )
    base = resting[0]
    place = {int(name): position for name, position in zip(base.point_id, base.reference, strict=True)}  # type: ignore[arg-type]
    nowhere = np.full(3, np.nan)
    return [replace(stage, reference=np.array([place.get(int(name), nowhere) for name in stage.point_id])) for stage in moving]


def _taken_as_deformed(stage: DicStage) -> DicStage:
    """A stage whose open coordinates the user declares to be deformed ones."""
    if stage.deformed is not None or stage.reference is None or stage.displacement is None:
        raise DataError(f"{stage.traits.path}: 'coordinates_of' is deformed, but the format says itself which they are; remove the key")
    return replace(stage, deformed=stage.reference, reference=stage.reference - stage.displacement)


def _clean(time: np.ndarray, joined: Joined, paths: list[Path]) -> tuple[DicField, list[str]]:
    """The field without stages that hold nothing and without those after fracture; missing points are counted."""
    remarks = []
    u = joined.displacement
    present = np.isfinite(u[:, :, :2]).all(axis=2)
    kept = present.any(axis=1)
    if not kept.any():
        raise DataError(f"{paths[0]}: no stage holds a displacement, expected at least one; export the field again")
    if not kept.all():
        names = ", ".join(paths[k].name for k in np.flatnonzero(~kept)[:3])
        remarks.append(f"{int((~kept).sum())} stages without any displacement left out ({names})")
    time, u, present = time[kept], u[kept], present[kept]
    end, why = after_fracture(u)
    if end < len(time):
        remarks.append(f"{len(time) - end} last stages from {time[end]:g} s on left out: {why}")
        time, u, present = time[:end], u[:end], present[:end]
    ever = present.any(axis=0)
    if not ever.all():
        remarks.append(f"{int((~ever).sum())} points that no stage holds left out")
    u, present = u[:, ever], present[:, ever]
    lost = int((~present).sum())
    if lost:
        hit = int((~present).any(axis=0).sum())
        remarks.append(f"{lost} of {present.size} displacements missing, {hit} of {present.shape[1]} points concerned")
    return DicField(time, joined.point_id[ever], joined.reference[ever], u), remarks


def _turned(field: DicField, rules: Rules) -> DicField:
    """The field in the axes of the specimen."""
    names = [axis.lstrip("+-") for axis in rules.axes]
    pick = ["xyz".index(name) for name in names]
    sign = np.array([-1.0 if axis.startswith("-") else 1.0 for axis in rules.axes])
    reference = (field.reference - np.array(rules.origin_mm))[:, pick] * sign
    return replace(field, reference=reference, displacement=field.displacement[:, :, pick] * sign)
