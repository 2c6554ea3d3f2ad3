"""Settings of all tests."""

from __future__ import annotations

import os

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
