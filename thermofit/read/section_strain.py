"""Strain of the cross-sections of a flat specimen from the displacements of a grid of points, frame by frame.

No scale is needed: strains are logarithms of length ratios. Source of the measure: logarithmic strain of material lines.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import DicSequence, DicStage
from thermofit.read.formats.registry import read_native

NORMAL = 1.4826
"""Standard deviation of normal values over their median absolute deviation."""


@dataclass(frozen=True)
class PointGrid:
    """Reference positions `along` (n_row,) the load and `across` (n_col,), positions `place` (n_frame, n_row, n_col, 2) along and across
    in every frame (NaN: not correlated), frame numbers `frame` (n_frame,) and the unit of lengths."""

    path: Path
    along: np.ndarray
    across: np.ndarray
    place: np.ndarray
    frame: np.ndarray
    unit: str


@dataclass(frozen=True)
class SectionStrain:
    """Strains of n_s cross-sections over n_f frames, zero in the first frame.

    `axial` and `width` (n_f, n_s): logarithmic strain along the load, mean over the width, and of the width itself; `sigma` (n_s,): noise
    of `axial`; `at` (n_s,) reference position along the load; `reference_width` of the grid; `frame` (n_f,); `lost` columns left out.
    """

    axial: np.ndarray
    width: np.ndarray
    sigma: np.ndarray
    at: np.ndarray
    reference_width: float
    frame: np.ndarray
    unit: str
    lost: int


def read_grid(path: Path, load_axis: Literal["x", "y"]) -> PointGrid:
    """Grid of points of a file of frames. DataError where the file holds one state only or its points are no grid."""
    content = read_native(path)
    if not isinstance(content, DicSequence) or len(content.stages) < 2:
        raise DataError(f"{path}: found {content.traits.format}, expected the displacements of points at several frames in one file")
    first = content.stages[0]
    a = 0 if load_axis == "x" else 1
    reference, _ = _known(first, path)
    along, row = np.unique(reference[:, a], return_inverse=True)
    across, column = np.unique(reference[:, 1 - a], return_inverse=True)
    if len(along) * len(across) != len(reference) or len(along) < 3 or len(across) < 2:
        raise DataError(
            f"{path}: {len(reference)} points at {len(along)} positions along and {len(across)} across the load, expected a grid that is "
            "full and has at least 3 rows of 2 points; interpolate to a grid or check the load axis"
        )
    place = np.full((len(content.stages), len(along), len(across), 2), np.nan)
    for k, stage in enumerate(content.stages):
        at, u = _known(stage, path)
        if at.shape != reference.shape or not np.array_equal(at, reference):
            raise DataError(f"{path}: the points of frame {stage.stage} are not those of frame {first.stage}, expected the same grid")
        place[k, row, column] = (at + u)[:, [a, 1 - a]]
    frames = np.array([k if stage.stage is None else stage.stage for k, stage in enumerate(content.stages)])
    return PointGrid(path, along, across, place, frames, first.length_unit)


def _known(stage: DicStage, path: Path) -> tuple[np.ndarray, np.ndarray]:
    if stage.reference is None or stage.displacement is None:
        raise DataError(f"{path}: frame {stage.stage} has no reference or no displacements, expected both in every frame")
    return stage.reference[:, :2], stage.displacement[:, :2]


def section_strain(grid: PointGrid, first: int, rows: tuple[int, int], per_section: int, noise: float | None) -> SectionStrain:
    """Strains from frame `first` on, of sections of `per_section` rows of elements between two rows of points.

    A column with a lost point is left out and counted. DataError where fewer than two columns or three sections are left, or where a
    row of points overtakes the next one.
    """
    place = grid.place[first:, rows[0] : rows[1] + 1]
    whole = np.isfinite(place).all(axis=(0, 1, 3))
    n = (place.shape[1] - 1) // per_section
    if whole.sum() < 2 or n < 3:
        raise DataError(
            f"{grid.path}: {int(whole.sum())} of {len(whole)} columns have all their points and the rows make {n} sections of "
            f"{per_section}, expected at least 2 columns and 3 sections; check necking.rows, necking.rows_per_section and lost points"
        )
    place = place[:, : n * per_section + 1, whole]
    length = np.linalg.norm(np.diff(place, axis=1), axis=-1)
    if not (np.diff(place[..., 0], axis=1) > 0.0).all():
        raise DataError(
            f"{grid.path}: a row of points overtakes the next one along the load, expected a specimen in tension; check the axis"
        )
    axial = np.log(length / length[0]).mean(axis=2).reshape(len(place), n, per_section).mean(axis=2)
    span = np.linalg.norm(place[:, :, -1] - place[:, :, 0], axis=-1)
    contraction = np.log(span / span[0])
    middle = 0.5 * (contraction[:, 1:] + contraction[:, :-1])
    reference = grid.along[rows[0] : rows[0] + n * per_section + 1]
    return SectionStrain(
        axial=axial,
        width=middle.reshape(len(place), n, per_section).mean(axis=2),
        sigma=_frame_noise(axial) if noise is None else np.full(n, noise),
        at=(0.5 * (reference[1:] + reference[:-1])).reshape(n, per_section).mean(axis=1),
        reference_width=float(span[0].mean()),
        frame=grid.frame[first:],
        unit=grid.unit,
        lost=int((~whole).sum()),
    )


def _frame_noise(axial: np.ndarray) -> np.ndarray:
    """Noise (n_s,) of one value from third differences over the frames, which a smooth course hardly has (variance 20); robust."""
    jumps = np.abs(np.diff(axial, 3, axis=0)) / np.sqrt(20.0)
    return np.asarray(np.maximum(NORMAL * np.median(jumps, axis=0), 1e-7))
