"""Settings of all tests."""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

# No deadline: a loaded machine is no error. The same examples every time where a change is judged, new ones elsewhere.
settings.register_profile("thermofit", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("thermofit")


WITHOUT_KERNELS = (*(f"tests/{room}/" for room in ("read", "study", "records", "fit", "report", "observe", "effects")), "tests/test_")
"""Tests that call no compiled kernel. They come first, while the kernels are compiled."""
COMPILING = "THERMOFIT_TESTS_COMPILING"
"""Variable of the environment: the file that is there once the process that compiles has ended, whatever came of it."""
LONGEST_COMPILATION = 600.0
"""s after which tests no longer wait for that process: a kernel that is not there is compiled when it is called."""


def pytest_configure(config: pytest.Config) -> None:
    """Where tests run in several processes one other process compiles the kernels for all of them: else each compiles them for itself."""
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        ended = Path(tempfile.mkdtemp(prefix="thermofit-tests-")) / "ended"
        os.environ[COMPILING] = str(ended)
        code = (
            "import pathlib, sys\n"
            "from thermofit.experiment.compiling import compiled\n"
            "try:\n    compiled()\n"
            "finally:\n    pathlib.Path(sys.argv[1]).touch()"
        )
        running = subprocess.Popen([sys.executable, "-P", "-c", code, str(ended)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

        def end() -> None:
            running.terminate()
            running.wait()
            shutil.rmtree(ended.parent)
            del os.environ[COMPILING]

        config.add_cleanup(end)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What needs no kernel comes first; the order is kept otherwise."""
    if COMPILING in os.environ:
        items.sort(key=lambda item: not item.nodeid.startswith(WITHOUT_KERNELS))


@pytest.fixture(autouse=True, scope="module")
def kernels(request: pytest.FixtureRequest) -> None:
    """Tests that may call kernels wait until these are compiled."""
    ended = os.environ.get(COMPILING)
    if ended is None or request.node.nodeid.startswith(WITHOUT_KERNELS):
        return
    until = time.monotonic() + LONGEST_COMPILATION
    while not Path(ended).exists() and time.monotonic() < until:
        time.sleep(0.1)


@pytest.fixture(scope="module")
def scripts() -> Iterator[Any]:
    """Import of a script by name; the scripts import one another."""
    folder = str(Path(__file__).parents[1] / "scripts")
    sys.path.insert(0, folder)
    try:
        yield importlib.import_module
    finally:
        sys.path.remove(folder)
