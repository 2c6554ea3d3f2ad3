"""Points of a static test in the axes of the model, from the export of a DIC system."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import DicStage
from thermofit.read.formats.registry import read_native


@dataclass(frozen=True)
class StaticPoints:
    """`xy` (n, 2) and `u` (n, 2) mm, x across and y along the load; nan where not correlated. `remarks`: what the reader said."""

    xy: np.ndarray
    u: np.ndarray
    remarks: tuple[str, ...]


def static_points(path: Path, load_axis: str, centre: tuple[float, float]) -> StaticPoints:
    """The points of one stage, turned by 90 degrees where the load acts along the file's x. DataError for every defect."""
    if not path.is_file():
        raise DataError(f"{path}: the field of the static test does not exist; correct the key static.field or the folder experiment")
    content = read_native(path)
    if not isinstance(content, DicStage) or content.reference is None or content.displacement is None:
        raise DataError(f"{path}: {type(content).__name__} found, expected one DIC stage with coordinates and displacements of its points")
    if content.length_unit != "mm":
        raise DataError(f"{path}: coordinates in {content.length_unit or 'an unknown unit'}, expected mm; export the field in mm")
    xy, u = content.reference[:, :2] - np.asarray(centre), content.displacement[:, :2]
    if load_axis == "x":
        xy, u = turned(xy), turned(u)
    return StaticPoints(xy, u, content.traits.remarks)


def turned(vector: np.ndarray) -> np.ndarray:
    """Vectors (n, 2) in axes turned by 90 degrees: what pointed along x points along y."""
    return np.stack([-vector[:, 1], vector[:, 0]], axis=1)
