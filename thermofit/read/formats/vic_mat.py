"""VIC-2D and VIC-3D: export of a stage as a MAT file (MATLAB 5): matrices `x y u v sigma exx ...` (px) and `x_c y_c u_c v_c` (metric).

Source: cbbuaa/FEMU-DIC, Demo/VirtualImageVIC.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import DicStage, Head, Traits
from thermofit.read.formats.mat5 import MAGIC, variables
from thermofit.read.formats.vic import vic_column, vic_columns, vic_stage

NAME = "VIC MAT (MATLAB 5)"


def recognises(head: Head) -> bool:
    """Whether the file is a MAT file of version 5 with matrices of VIC."""
    if not head.first.startswith(MAGIC):
        return False
    try:
        names = _matrices(head.path)
    except DataError:
        return False
    return "sigma" in names and vic_columns(names) is not None


def read(path: Path) -> DicStage:
    """Points of the stage, row by row of the matrices, NaN where `sigma` < 0. DataError for every defect."""
    matrices = _matrices(path)
    chosen = vic_columns(matrices)
    if chosen is None or "sigma" not in matrices:
        found = ", ".join(matrices)[:100] or "none"
        raise DataError(f"{path}: found the matrices {found}, expected sigma and X, Y, U, V or x_c, y_c, u_c, v_c; export again")
    shape = matrices["sigma"].shape
    wrong = next((name for name in (*chosen[0], *chosen[1]) if matrices[name].shape != shape), None)
    if wrong is not None:
        raise DataError(f"{path}: {wrong} has the shape {matrices[wrong].shape}, sigma has {shape}, expected the same; export it again")
    if len(shape) != 2 or not matrices["sigma"].size:
        raise DataError(f"{path}: sigma has the shape {shape}, expected a matrix of points; export the stage again")
    columns = {name: _column(values) for name, values in matrices.items() if values.shape == shape}
    return vic_stage(columns, chosen, Traits(NAME, path, columns=tuple(vic_column(name, chosen) for name in columns)))


def _matrices(path: Path) -> dict[str, np.ndarray]:
    """Matrices of numbers by name; DataError where the file is damaged or a name occurs twice."""
    found: dict[str, np.ndarray] = {}
    try:
        for name, value in variables(path):
            if name in found:
                raise DataError(f"{path}: two variables are called {name[:30]!r}, expected each name once; export the stage again")
            if isinstance(value, np.ndarray):
                found[name] = value
    except (ValueError, OSError) as error:
        raise DataError(f"{path}: the MAT file is damaged ({error}), expected an undamaged one; copy or export it again") from None
    return found


def _column(values: np.ndarray) -> np.ndarray:
    """Points (n,) of a matrix, row by row, NaN where a value is not finite."""
    with np.errstate(invalid="ignore"):  # a signalling NaN of damaged single precision
        numbers = values.astype(float).ravel()
    return np.where(np.isfinite(numbers), numbers, np.nan)
