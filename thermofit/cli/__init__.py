"""The command line: parse, call one stage, print. No logic of the identification lives here."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType

_INTERRUPTED = 130

# Set before numpy and numba are first imported; what the user has set stays.
# BLAS: one thread, because the dense systems are small, so that its threads cost more than they give, and the cores belong to the
# numba threads of the kernel (numerics.threads of the study). OpenMP: threads that wait between the many short parallel loops must
# sleep, not spin: on a machine with other work, spinning threads took 5.1 s where sleeping ones took 0.17 s.
for _variable, _value in {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OMP_WAIT_POLICY": "PASSIVE",
}.items():
    os.environ.setdefault(_variable, _value)


def main() -> None:
    """Entry point of the command `thermofit`."""
    _hear(_before_it_began)
    try:
        from thermofit.cli.app import app  # imports take a second, during which an interrupt must be heard as well

        app(prog_name="thermofit")
    finally:
        _hear(signal.SIG_IGN)  # what is done is done, and the process ends by itself


def _hear(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    for name in ("SIGINT", "SIGTERM", "SIGUSR1"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), handler)


def _before_it_began(number: int, frame: FrameType | None) -> None:
    """Nothing is open that has to be put away."""
    sentence = f"interrupted by {signal.Signals(number).name} before anything was begun"
    if "--json" in sys.argv:
        os.write(1, json.dumps({"error": sentence, "exit_code": _INTERRUPTED}).encode() + b"\n")
    os.write(2, f"error: {sentence}\n".encode())
    os._exit(_INTERRUPTED)
