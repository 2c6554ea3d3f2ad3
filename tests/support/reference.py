"""Reference numbers, `tests/reference`; its README says where each comes from."""

from __future__ import annotations

from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parents[1] / "reference"


def reference_table(name: str) -> dict[str, np.ndarray]:
    """Columns of a table of the reference solution."""
    table = np.genfromtxt(FOLDER / name, delimiter=",", names=True)
    return {column: table[column] for column in table.dtype.names}
