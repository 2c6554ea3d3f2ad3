"""Real files in the layouts of other programmes, which lie outside this project."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def sample(name: str) -> Path:
    """A sample of the folder that THERMOFIT_DATA names; skips where it is absent."""
    folder = os.environ.get("THERMOFIT_DATA")
    if not folder:
        pytest.skip("THERMOFIT_DATA is not set: the samples of native formats are not at hand")
    path = Path(folder) / "real" / "native-format-samples" / name
    if not path.exists():
        pytest.skip(f"{name} is not among the samples of native formats")
    return path
