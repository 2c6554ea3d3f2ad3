"""Runs one stage over and over until it is killed; started by test_kill.

Arguments: study file, longest time in s, seed. Reads lines `STAGE random` or `STAGE writing` from standard input; for each one it
forks a child that runs the stage with force until SIGKILL, after a random time or as soon as the run folder shows that its artefact
is being written, and answers `done`.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import tiny

from thermofit.study.study import Study


def artefact_files(run_dir: Path, stage: str) -> set[tuple[str, int, int]]:
    """Name, time and size of everything in the run folder that belongs to the artefact of a stage."""
    found = set()
    for entry in os.scandir(run_dir):
        if f"{stage}.h5" in entry.name:
            with suppress(FileNotFoundError):
                state = entry.stat()
                found.add((entry.name, state.st_mtime_ns, state.st_size))
    return found


def wait_for_writing(run_dir: Path, stage: str) -> None:
    """Return as soon as the artefact of the stage, or what will become it, changes; after a minute in any case."""
    before, deadline = artefact_files(run_dir, stage), time.monotonic() + 60.0
    while artefact_files(run_dir, stage) == before and time.monotonic() < deadline:
        pass


def killed_run(study: Study, stage: str, wait: Callable[[], None]) -> None:
    """One child, killed when `wait` returns."""
    begun_read, begun_write = os.pipe()
    child = os.fork()
    if child == 0:
        # Whatever happens here must not run on as a second copy of the parent.
        try:
            run = tiny.stage_run(stage)
            os.write(begun_write, b"x")
            while True:
                run(study, force=True)
        except BaseException:
            # The test shows what this process says on stderr.
            traceback.print_exc()
        finally:
            os._exit(1)
    os.close(begun_write)
    begun = os.read(begun_read, 1)
    os.close(begun_read)
    wait()
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    survived = begun == b"x" and os.WIFSIGNALED(status)
    print("done" if survived else f"the stage ended by itself with status {status}", flush=True)


def main() -> None:
    study, longest, draw = tiny.load_study(sys.argv[1]), float(sys.argv[2]), random.Random(int(sys.argv[3]))
    for line in sys.stdin:
        stage, moment = line.split()
        # Imported here: the child is killed in its work, not in its imports.
        tiny.stage_run(stage)
        if moment == "writing":
            killed_run(study, stage, partial(wait_for_writing, study.run_dir, stage))
        else:
            killed_run(study, stage, partial(time.sleep, draw.uniform(0.0, longest)))


if __name__ == "__main__":
    main()
