"""Settings of all tests."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

# No deadline: a loaded machine is no error. The same examples every time where a change is judged, new ones elsewhere.
settings.register_profile("thermofit", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("thermofit")


def pytest_configure(config: pytest.Config) -> None:
    """Where tests run in several processes the kernels are compiled before these begin: else each compiles them for itself."""
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        from thermofit.experiment.compiling import compiled

        compiled()


@pytest.fixture(scope="module")
def scripts() -> Iterator[Any]:
    """Import of a script by name; the scripts import one another."""
    folder = str(Path(__file__).parents[1] / "scripts")
    sys.path.insert(0, folder)
    try:
        yield importlib.import_module
    finally:
        sys.path.remove(folder)
