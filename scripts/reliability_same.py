"""The same answer: bit for bit from run to run, on one thread and on two, and with kernels compiled anew in a cache of their own.

Each time the chain of a small study runs in a process of its own, until `verify`; all datasets and parameters of its artefacts are compared
by their bytes. The cache that is compiled anew holds the same machine code where compiler and processor are the same. OpenBLAS with the
kernels of another processor rounds otherwise: there the identified parameters have to agree to 1e-8.
"""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from reliability_signals import PARAMETER, values_of
from reliability_study import command, environment, small_study

STAGES = ("simulate", "calibrate-ir", "interpolate", "identify-elastic", "identify-plastic", "identify-thermal", "verify")
BLAS = "BLAS kernels of another processor"
ALIKE = 1e-8


def ran(folder: Path, *settings: str, **variables: str) -> dict[str, bytes]:
    """All values of a chain in a folder of its own."""
    folder.mkdir()
    study = small_study(folder)
    sets = [word for text in settings for word in ("--set", text)]
    words = command("run", str(study), "--until", "verify", *sets)
    subprocess.run(words, env={**environment(), **variables}, capture_output=True, check=False)
    return {f"{stage}:{name}": value for stage in STAGES for name, value in values_of(folder / "run", stage).items()}


def apart(a: dict[str, bytes], b: dict[str, bytes]) -> float:
    """Largest relative difference of a parameter, which stands as text: (value, standard error)."""
    both = [key for key in a if key in b and PARAMETER in key]
    pairs = [(ast.literal_eval(a[key].decode()), ast.literal_eval(b[key].decode())) for key in both]
    return max((abs(x[0] - y[0]) / abs(x[0]) for x, y in pairs if x[0]), default=float("inf"))


def difference(a: dict[str, bytes], b: dict[str, bytes]) -> dict[str, object]:
    """How many values differ, and by how much at most over the largest of their dataset."""
    differing = [name for name in a if a[name] != b.get(name)]
    largest, where = 0.0, ""
    for name in differing:
        if PARAMETER in name:  # `apart` compares these
            continue
        x, y = (np.frombuffer(values.get(name, b"")) for values in (a, b))
        relative = float(np.nanmax(np.abs(x - y)) / np.nanmax(np.abs(x))) if x.size == y.size else float("inf")
        if relative > largest:
            largest, where = relative, name
    return {"compared": len(a), "differing": len(differing), "largest_relative": largest, "where": where}


def main() -> int:
    """0 where run to run, threads and caches give the same bytes."""
    with tempfile.TemporaryDirectory(prefix="thermofit-same-") as name:
        folder = Path(name)
        first = ran(folder / "a")
        found = {
            "run to run": difference(first, ran(folder / "b")),
            "1 and 2 threads": difference(first, ran(folder / "c", "numerics.threads=2", NUMBA_NUM_THREADS="2")),
            "2 threads of BLAS": difference(first, ran(folder / "d", OPENBLAS_NUM_THREADS="2", OMP_NUM_THREADS="2", MKL_NUM_THREADS="2")),
        }
        if "--caches" in sys.argv[1:]:
            found["kernels compiled anew"] = difference(first, ran(folder / "e", THERMOFIT_CACHE_DIR=os.fspath(folder / "cache")))
        other = ran(folder / "f", OPENBLAS_CORETYPE="Nehalem")
    found[BLAS] = difference(first, other)
    parameters = apart(first, other)
    print(json.dumps({**found, "parameters": parameters}))
    same = [one["differing"] == 0 for key, one in found.items() if key not in ("2 threads of BLAS", BLAS)]
    return 0 if all(same) and parameters < ALIKE else 1


if __name__ == "__main__":
    sys.exit(main())
