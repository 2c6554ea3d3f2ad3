"""Points of many stages as one table of points over stages: by their numbers, else by their reference positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import DicStage

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
