"""One process at a time in a run folder; what a killed one leaves is no lock."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from thermofit.core.errors import StudyError
from thermofit.records.lock import LOCK, locked

HOLD = """
import sys
from pathlib import Path
from thermofit.records.lock import locked
with locked(Path(sys.argv[1])):
    print("has it", flush=True)
    sys.stdin.readline()
"""


@contextmanager
def other(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that has the folder."""
    with subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdin is not None
        assert process.stdout.readline() == "has it\n"
        yield process
        if process.poll() is None:
            process.stdin.write("end\n")


def test_second_process_is_told_who_is_there(tmp_path: Path) -> None:
    run = tmp_path / "run"
    with other(run) as process:
        with pytest.raises(StudyError, match=rf"in use by process {process.pid} on .* s ago\): wait until") as refused, locked(run):
            pass
        assert "\n" not in str(refused.value) and refused.value.exit_code == 2
    with locked(run):
        assert json.loads((run / LOCK).read_text())["pid"] == os.getpid()
        with locked(run), locked(run / "second"):
            pass
        assert (run / LOCK).exists() and not (run / "second").exists()
    assert not list(run.iterdir())


def test_lock_of_a_killed_process_is_taken_over(tmp_path: Path) -> None:
    with other(tmp_path) as process:
        process.send_signal(signal.SIGKILL)
        process.wait()
    left = tmp_path / "figures" / f".a.png.{os.uname().nodename.split('.')[0]}.{process.pid}.00ff00ff.partial"
    left.parent.mkdir()
    left.write_text("half")
    assert (tmp_path / LOCK).exists()
    with locked(tmp_path):
        assert not left.exists()
    assert not (tmp_path / LOCK).exists()


def test_lock_that_says_nothing_is_a_lock(tmp_path: Path) -> None:
    with other(tmp_path):
        (tmp_path / LOCK).write_text("")
        with pytest.raises(StudyError, match="in use by another process: wait"), locked(tmp_path):
            pass


def test_folder_that_cannot_be_written_is_not_locked(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with locked(tmp_path / "file" / "run"):
        pass
