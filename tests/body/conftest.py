"""One thread for the kernels of all finite element tests."""

from __future__ import annotations

import pytest

from thermofit.core.jit import set_threads


@pytest.fixture(autouse=True, scope="session")
def _one_thread() -> None:
    set_threads(1)
