"""The command line: parse, call one stage, print. No logic of the identification lives here."""

from __future__ import annotations

import os

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

from thermofit.cli.app import app  # noqa: E402


def main() -> None:
    """Entry point of the command `thermofit`."""
    app(prog_name="thermofit")
