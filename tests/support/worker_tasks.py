"""Tasks for workers."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from thermofit.core.errors import StudyError
from thermofit.records.executor import Executor, Task, run_all


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
    """Say that this process lives, as long as it does, at most a minute. The file is whole whenever it is there: a writer may be killed."""
    draft = Path(f"{path}.draft")
    for turn in range(600):
        draft.write_text(f"{os.getpid()} {turn}")
        draft.replace(path)
        time.sleep(0.1)


def run_two_that_write(folder: str) -> None:
    run_all([Task(str(i), write_on, (str(Path(folder) / str(i)),)) for i in range(2)], Executor(jobs=2))
