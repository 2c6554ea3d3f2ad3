"""VIC-2D and VIC-3D: export of a stage as a MAT file (MATLAB 5): matrices `x y u v sigma exx ...` (px) and `x_c y_c u_c v_c` (metric).

Source: cbbuaa/FEMU-DIC, Demo/VirtualImageVIC.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from thermofit.core.errors import DataError
from thermofit.measure.formats.contents import DicStage, Head, Traits
from thermofit.measure.formats.vic import vic_column, vic_columns, vic_stage

NAME = "VIC MAT (MATLAB 5)"
MAX_VALUES = 100_000_000
_DAMAGES = (
    *(OSError, ValueError, TypeError, KeyError, IndexError, OverflowError, MemoryError, AttributeError, AssertionError, EOFError),
    *(struct.error, zlib.error, NotImplementedError, scipy.io.matlab.MatReadError, UnboundLocalError),
)
"""What scipy raises for defects of a file, depending on where they are."""


def recognises(head: Head) -> bool:
    """Whether the file is a MAT file of version 5 with matrices of VIC."""
    if not head.first.startswith(b"MATLAB 5.0 MAT-file"):
        return False
    try:
        names = tuple(name for name, _, _ in _contents(head.path))
    except DataError:
        return False
    return "sigma" in names and vic_columns(names) is not None


def read(path: Path) -> DicStage:
    """Points of the stage, row by row of the matrices, NaN where `sigma` < 0. DataError for every defect."""
    listed = _contents(path)
    shapes = {name: shape for name, shape, kind in listed if kind in ("single", "double") or kind.startswith(("int", "uint"))}
    chosen = vic_columns(shapes)
    if chosen is None or "sigma" not in shapes:
        found = ", ".join(shapes) or "none"
        raise DataError(f"{path}: found the matrices {found[:100]}, expected sigma and X, Y, U, V or x_c, y_c, u_c, v_c; export again")
    shape = shapes["sigma"]
    if len(shape) != 2 or np.prod(shape, dtype=float) > MAX_VALUES or not np.prod(shape):
        raise DataError(f"{path}: sigma has the shape {shape}, expected a matrix of points; export the stage again")
    taken = [name for name, other in shapes.items() if other == shape]
    wrong = next((name for name in (*chosen[0], *chosen[1]) if name not in taken), None)
    if wrong is not None:
        raise DataError(f"{path}: {wrong} has the shape {shapes[wrong]}, sigma has {shape}, expected the same; export the stage again")
    stored = _load(path, taken)
    columns = {}
    for name in taken:
        values = stored.get(name)
        if not isinstance(values, np.ndarray) or values.shape != shape or values.dtype.kind not in "fiu":
            raise DataError(f"{path}: {name} is no matrix of numbers of the shape {shape}, expected one; export the stage again")
        numbers = values.astype(float).ravel()
        columns[name] = np.where(np.isfinite(numbers), numbers, np.nan)
    return vic_stage(columns, chosen, Traits(NAME, path, columns=tuple(vic_column(name, chosen) for name in columns)))


def _contents(path: Path) -> list[tuple[str, tuple[int, ...], str]]:
    """Name, shape and class of every variable."""
    try:
        listed: list[tuple[str, tuple[int, ...], str]] = scipy.io.whosmat(str(path))
    except _DAMAGES as error:
        raise _damaged(path, error) from None
    return listed


def _load(path: Path, names: list[str]) -> dict[str, Any]:
    try:
        stored: dict[str, Any] = scipy.io.loadmat(str(path), variable_names=names)
    except _DAMAGES as error:
        raise _damaged(path, error) from None
    return stored


def _damaged(path: Path, error: BaseException) -> DataError:
    reason = " ".join(str(error).split())[:120]
    return DataError(f"{path}: cannot be read as a MAT file ({reason}), expected an undamaged file; copy or export it again")
