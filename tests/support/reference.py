"""Reference numbers of the kernel, which lie beside the data folder."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest


def reference_table(name: str) -> dict[str, np.ndarray]:
    """Columns of a table of the reference solution, which lies beside the data folder."""
    data = os.environ.get("THERMOFIT_DATA")
    if not data:
        pytest.skip("THERMOFIT_DATA is not set: the reference numbers of the kernel lie beside that folder")
    path = Path(data).resolve().parent / "reference" / "kernel" / name
    if not path.is_file():
        pytest.skip(f"no reference numbers at {path}")
    table = np.genfromtxt(path, delimiter=",", names=True)
    return {column: table[column] for column in table.dtype.names}
