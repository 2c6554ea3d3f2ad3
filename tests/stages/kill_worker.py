"""Runs one stage over and over until it is killed; started by test_kill.

Arguments: study file, seconds. Reads names of stages from standard input, one a line; for each one it forks a child that runs the
stage with force until SIGKILL after a random time, and answers `done`.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time

import tiny

from thermofit.core.study import load_study


def killed_run(study_file: str, stage: str, seconds: float) -> None:
    """One child, killed after `seconds` of work on the stage."""
    begun_read, begun_write = os.pipe()
    child = os.fork()
    if child == 0:
        # Whatever happens here must not run on as a second copy of the parent.
        try:
            run, study = tiny.stage_run(stage), load_study(study_file)
            os.write(begun_write, b"x")
            while True:
                run(study, force=True)
        finally:
            os._exit(1)
    os.close(begun_write)
    begun = os.read(begun_read, 1)
    os.close(begun_read)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    survived = begun == b"x" and os.WIFSIGNALED(status)
    print("done" if survived else f"the stage ended by itself with status {status}", flush=True)


def main() -> None:
    study_file, longest, seed = sys.argv[1], float(sys.argv[2]), int(sys.argv[3])
    draw = random.Random(seed)
    # Imported once here: the children are killed in their work, not in their imports.
    for name in tiny.CHAIN:
        tiny.stage_run(name)
    for line in sys.stdin:
        killed_run(study_file, line.strip(), draw.uniform(0.0, longest))


if __name__ == "__main__":
    main()
