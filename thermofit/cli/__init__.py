"""The command line: parse, call one stage, print. No logic of the identification lives here."""

from __future__ import annotations

import os

# One thread per linear algebra call, set before numpy is first imported: the dense systems are small, so that the threads of BLAS
# cost more than they give, and the cores belong to the numba threads of the kernel (numerics.threads of the study).
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

from thermofit.cli.app import app  # noqa: E402


def main() -> None:
    """Entry point of the command `thermofit`."""
    app(prog_name="thermofit")
