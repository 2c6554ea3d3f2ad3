"""Tasks for workers, and a Dask scheduler with workers in processes of their own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from thermofit.core.errors import StudyError
from thermofit.core.executor import Executor, Task, run_all

_QUIET: dict[str, int] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}


def square(x: int) -> int:
    return x * x


def process_and_threads() -> tuple[int, int]:
    import numba

    return os.getpid(), numba.get_num_threads()


def meet(folder: str, own: str, other: str) -> str:
    """Ends when the other has begun."""
    (Path(folder) / own).touch()
    deadline = time.monotonic() + 60.0
    while not (Path(folder) / other).exists():
        if time.monotonic() > deadline:
            return "alone"
        time.sleep(0.01)
    return "met"


def killed_at_first(mark: str, answer: int) -> int:
    if not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return answer


def always_killed() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def refused() -> None:
    raise StudyError("key 'a' is wrong")


def mistaken() -> float:
    return 1 / 0


def write_on(path: str) -> None:
    """Say that this process lives, as long as it does, at most a minute."""
    for turn in range(600):
        Path(path).write_text(f"{os.getpid()} {turn}")
        time.sleep(0.1)


def run_two_that_write(folder: str) -> None:
    run_all([Task(str(i), write_on, (str(Path(folder) / str(i)),)) for i in range(2)], Executor(jobs=2))


def start_scheduler(folder: Path, environment: Mapping[str, str]) -> tuple[subprocess.Popen[bytes], str]:
    """A local scheduler on a free port, and its address, which it leaves in a file of the folder."""
    file = folder / "scheduler.json"
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    process = subprocess.Popen([*command, "--scheduler-file", str(file)], **_QUIET, env=dict(environment))
    deadline = time.monotonic() + 60.0
    while not file.exists() or not file.read_text().rstrip().endswith("}"):
        assert process.poll() is None and time.monotonic() < deadline, "the scheduler does not start"
        time.sleep(0.05)
    return process, str(json.loads(file.read_text())["address"])


def start_worker(address: str, environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
    """A worker process of one thread that nobody starts again when it is killed."""
    command = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
    return subprocess.Popen(command, **_QUIET, env=dict(environment))
