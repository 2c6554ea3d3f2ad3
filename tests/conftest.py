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
COLLECTED = "collected"
"""Name of the file beside that one: there once the first process has collected the tests."""
LONGEST_COLLECTION = 300.0
"""s after which the others no longer wait for it: each then rewrites and compiles all test modules for itself."""


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


def _wait_for(file: Path, longest: float) -> None:
    """Until the file is there, `longest` s at most."""
    until = time.monotonic() + longest
    while not file.exists() and time.monotonic() < until:
        time.sleep(0.1)


def _collected(session: pytest.Session) -> tuple[Path, bool] | None:
    """Where tests run in several processes: the file that says that the first one has collected, and whether this process is that one."""
    worker = getattr(session.config, "workerinput", None)
    if worker is None or COMPILING not in os.environ:
        return None
    return Path(os.environ[COMPILING]).with_name(COLLECTED), worker["workerid"] == "gw0"


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """One process makes the bytecode of all test modules, in which pytest rewrites every assertion; the others read it."""
    collected = _collected(session)
    if collected is not None and not collected[1]:
        _wait_for(collected[0], LONGEST_COLLECTION)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Lets the others collect, also where the collection has failed."""
    collected = _collected(session)
    if collected is not None and collected[1]:
        collected[0].touch()


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
    _wait_for(Path(ended), LONGEST_COMPILATION)


@pytest.fixture(scope="module")
def scripts() -> Iterator[Any]:
    """Import of a script by name; the scripts import one another."""
    folder = str(Path(__file__).parents[1] / "scripts")
    sys.path.insert(0, folder)
    try:
        yield importlib.import_module
    finally:
        sys.path.remove(folder)
