"""Many files of one DIC export -> one DicField: joined by point number or reference position, sorted by time, checked, repairs counted.

Points are joined by their numbers, else by their reference positions. Stages after fracture are cut off: there the software repeats its
last result (frozen), or most points are gone and halves fly apart (torn).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField
from thermofit.core.units import known_unit, to_fixed
from thermofit.read.formats.clock import Member, Rules, files_of, set_clock
from thermofit.read.formats.contents import Content, DicSequence, DicStage
from thermofit.read.formats.registry import format_of

_ROUNDING = 1e-3
"""mm by which the reference position of a point may differ between stages: rounding of the export, not another point ..."""
_SHARE_OF_SPACING = 0.01
"""... or this share of the spacing of the points, if it is more, ..."""
_MOST_OF_SPACING = 0.2
"""... but never more than this share: neighbours are not the same point."""


@dataclass(frozen=True)
class Joined:
    """`point_id` (n_s,), `reference` mm (n_s, 3), `displacement` mm (n_t, n_s, 3) with NaN where a point is missing, `remarks`."""

    point_id: np.ndarray
    reference: np.ndarray
    displacement: np.ndarray
    remarks: tuple[str, ...]


def has_numbers(stage: DicStage) -> bool:
    """Whether the file numbers its points: one of its columns means `id`."""
    return any(column.meaning == "id" for column in stage.traits.columns)


def join(stages: Sequence[DicStage]) -> Joined:
    """Stages in the order of time, all in mm. DataError where their references differ or points occur twice in a stage."""
    numbered = [has_numbers(stage) for stage in stages]
    if any(numbered) and not all(numbered):
        odd = stages[numbered.index(not numbered[0])].traits.path
        raise DataError(f"{odd}: some stages number their points and some do not, expected the same columns in all; export them alike")
    if all(stage.displacement is None for stage in stages):
        return _from_coordinates(stages)
    return _by_number(stages) if numbered[0] else _by_position(stages)


def _from_coordinates(stages: Sequence[DicStage]) -> Joined:
    """Coordinates only: displacements are differences to the first stage; points that it lacks have no reference and are left out."""
    first = stages[0]
    start = _coordinates(first)
    point_id, order = np.unique(first.point_id, return_index=True)
    reference = start[order]
    displacement = np.full((len(stages), len(point_id), 3), np.nan)
    unknown = 0
    for k, stage in enumerate(stages):
        _check_once(stage)
        place = np.searchsorted(point_id, stage.point_id).clip(max=len(point_id) - 1)
        known = point_id[place] == stage.point_id
        unknown += int((~known).sum())
        displacement[k, place[known]] = _coordinates(stage)[known] - reference[place[known]]
    remarks = [f"coordinates only: displacements are differences to the first stage, {first.traits.path.name}"]
    if unknown:
        remarks.append(f"{unknown} rows of points that the first stage lacks left out")
    return Joined(point_id, reference, displacement, tuple(remarks))


def _coordinates(stage: DicStage) -> np.ndarray:
    """Coordinates (n, 3) of a stage that holds no displacements."""
    found = stage.deformed if stage.deformed is not None else stage.reference
    if found is None or not has_numbers(stage):
        raise DataError(f"{stage.traits.path}: coordinates without point numbers cannot be followed, expected numbered points; export ids")
    return found


def _check_once(stage: DicStage) -> None:
    """DataError where a point number occurs twice."""
    ids, count = np.unique(stage.point_id, return_counts=True)
    if (count > 1).any():
        raise DataError(f"{stage.traits.path}: the point {ids[count > 1][0]} occurs {count.max()} times in this stage; export it again")


def _by_number(stages: Sequence[DicStage]) -> Joined:
    """The union of all point numbers; a point's reference is that of the first stage that has it."""
    point_id = np.unique(np.concatenate([stage.point_id for stage in stages]))
    reference = np.full((len(point_id), 3), np.nan)
    displacement = np.full((len(stages), len(point_id), 3), np.nan)
    tolerance = _tolerance(stages)
    for k, stage in enumerate(stages):
        _check_once(stage)
        here, moved = _arrays(stage)
        place = np.searchsorted(point_id, stage.point_id)
        known = reference[place]
        apart = np.nan_to_num(np.abs(here - known)).max(axis=1)
        if (apart > tolerance).any():
            n = int(apart.argmax())
            raise DataError(
                f"{stage.traits.path}: the reference position of point {stage.point_id[n]} is {apart[n]:.4g} mm away from that in earlier "
                f"stages, expected the same; export all stages with one reference"
            )
        reference[place] = np.where(np.isnan(known), here, known)
        displacement[k, place] = moved
    located = np.isfinite(reference[:, :2]).all(axis=1)
    remarks = () if located.all() else (f"{int((~located).sum())} points without reference position left out",)
    return Joined(point_id[located], reference[located], displacement[:, located], remarks)


def _arrays(stage: DicStage) -> tuple[np.ndarray, np.ndarray]:
    """Reference positions and displacements (n, 3). DataError where a stage lacks one of them."""
    if stage.reference is None or stage.displacement is None:
        raise DataError(f"{stage.traits.path}: coordinates or displacements are absent, expected both as in the other stages; export them")
    return stage.reference, stage.displacement


def _located(points: np.ndarray) -> np.ndarray:
    """Rows whose components in use are all known, and of these components only."""
    used = points[:, _axes_in_use(points)]
    return used[np.isfinite(used).all(axis=1)] if used.shape[1] else used[:0]


def _axes_in_use(points: np.ndarray) -> np.ndarray:
    """Components (n, 3) that hold values."""
    return np.flatnonzero(~np.isnan(points).all(axis=0))


def _tolerance(stages: Sequence[DicStage]) -> float:
    """mm within which two reference positions are the same point: rounding, or a share of the median spacing in a stage."""
    located = [_located(_arrays(stage)[0]) for stage in stages]
    known = max(located, key=len)
    if len(known) < 2:
        return _ROUNDING
    spacing = float(np.median(cKDTree(known).query(known, k=2)[0][:, 1]))
    return min(max(_ROUNDING, _SHARE_OF_SPACING * spacing), _MOST_OF_SPACING * spacing)


def _by_position(stages: Sequence[DicStage]) -> Joined:
    """Points without numbers: the same where their reference positions are; numbered from 0 as they first occur."""
    axes, tolerance = _axes_in_use(np.vstack([_arrays(stage)[0] for stage in stages])), _tolerance(stages)
    points = np.empty((0, 3))
    rows: list[tuple[np.ndarray, np.ndarray]] = []
    for stage in stages:
        here, moved = _arrays(stage)
        known = np.isfinite(here[:, axes]).all(axis=1)
        here, moved = here[known], moved[known]
        place = _places(points[:, axes], here[:, axes], tolerance, stage)
        new = place < 0
        if len(points) and new.sum() > 0.5 * len(here):
            raise DataError(
                f"{stage.traits.path}: {int(new.sum())} of {len(here)} reference positions are not those of earlier stages, expected the "
                f"same points; export all stages with one reference"
            )
        place[new] = len(points) + np.arange(int(new.sum()))
        points = np.vstack([points, here[new]])
        rows.append((place, moved))
    displacement = np.full((len(stages), len(points), 3), np.nan)
    for k, (place, moved) in enumerate(rows):
        displacement[k, place] = moved
    remark = f"points have no numbers: joined by reference position within {tolerance:.2g} mm"
    return Joined(np.arange(len(points)), points, displacement, (remark,) if len(stages) > 1 else ())


def _places(points: np.ndarray, here: np.ndarray, tolerance: float, stage: DicStage) -> np.ndarray:
    """Index (n,) of the known point at every position, -1 where there is none. DataError where two rows are at one point."""
    if len(here) == 0:
        return np.empty(0, dtype=int)
    pairs = cKDTree(here).query_pairs(tolerance, output_type="ndarray")
    if len(pairs):
        at = ", ".join(f"{value:g}" for value in here[pairs[0][0]])
        raise DataError(f"{stage.traits.path}: {len(pairs)} pairs of points are at one position (such as {at}); export every point once")
    if len(points) == 0:
        return np.full(len(here), -1)
    distance, index = cKDTree(points).query(here, distance_upper_bound=tolerance)
    return np.where(np.isfinite(distance), index, -1)


_LEAST_SHARE = 0.5
"""A stage with fewer than this share of the largest number of points is torn, at the end of a series."""
_SUDDEN_SHARE = 0.75
"""... if it lost them at once: it has fewer than this share of the points of the stage before it."""
_JUMP = 10.0
"""A step is the fracture itself where it is this many times the median of the steps before, and frozen stages follow."""
_STEPS_BEFORE = 10


def after_fracture(displacement: np.ndarray) -> tuple[int, str]:
    """Number of stages to keep of `displacement` (n_t, n_s, 3), and why the others go ("" where none does)."""
    n = len(displacement)
    present = np.isfinite(displacement[:, :, :2]).all(axis=2).sum(axis=1)
    end = n
    while end > 1 and present[end - 1] < _LEAST_SHARE * present.max():
        end -= 1
    # Stages whose points went one by one are measured: only a sudden loss is fracture.
    end = next((k for k in range(end, n) if present[k] < _SUDDEN_SHARE * present[k - 1]), n)
    torn = n - end
    last = end
    while last > 1 and _repeats(displacement[last - 1], displacement[last - 2]):
        last -= 1
    frozen = end - last
    if frozen and last > 2 and _is_jump(displacement[:last]):
        last -= 1
    if last == n:
        return n, ""
    words = [f"{torn} hold fewer than half of the points"] if torn else []
    if frozen:
        words.append(f"{frozen} repeat the extreme values of the one before")
    if end - last > frozen:
        words.append(f"the one before these jumps by more than {_JUMP:g} times the usual step")
    return last, "after fracture, " + ", ".join(words)


def _repeats(stage: np.ndarray, before: np.ndarray) -> bool:
    """Whether all extreme values of two stages (n_s, 3) are the same; noise never leaves them so. A stage at rest (zeros) is none."""
    extremes = [_extremes(field) for field in (stage, before)]
    return bool(np.array_equal(extremes[0], extremes[1], equal_nan=True) and np.nanmax(np.abs(extremes[0])) > 0.0)


def _extremes(field: np.ndarray) -> np.ndarray:
    """Smallest and largest value of every component (2, 3), NaN for one that is not measured."""
    found = np.full((2, 3), np.nan)
    for k, column in enumerate(field.T):
        known = column[np.isfinite(column)]
        if len(known):
            found[:, k] = known.min(), known.max()
    return found


def _is_jump(displacement: np.ndarray) -> bool:
    """Whether the last step of the stages is far larger than those before it."""
    steps = []
    for before, after in zip(displacement[-_STEPS_BEFORE - 2 : -1], displacement[-_STEPS_BEFORE - 1 :], strict=True):
        apart = np.abs(after - before)[:, :2]
        known = apart[np.isfinite(apart).all(axis=1)]
        steps.append(float(known.max()) if len(known) else np.inf)
    return len(steps) > 1 and steps[-1] > _JUMP * float(np.median(steps[:-1]))


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
