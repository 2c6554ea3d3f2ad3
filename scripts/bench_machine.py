"""What the machine can do: matrix product and memory bandwidth on one thread, the limits beside which the kernel is shown."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version

import numba
import numpy as np
from bench_measure import Limits, Options, Part, Row, cpu

_PRODUCT_SIZE = 1000
_TRIAD_SIZE = 8_000_000


@numba.njit
def _triad(a: np.ndarray, b: np.ndarray, c: np.ndarray, s: float) -> None:
    for i in range(a.shape[0]):
        a[i] = b[i] + s * c[i]


def limits(repeat: int) -> Limits:
    """Matrix product of numpy's BLAS and STREAM triad, here and now, on one thread."""
    a = np.random.default_rng(1).normal(size=(_PRODUCT_SIZE, _PRODUCT_SIZE))
    product = cpu(lambda: a @ a, max(repeat, 3))
    x, y, z = (np.full(_TRIAD_SIZE, value) for value in (0.0, 1.0, 2.0))
    triad = cpu(lambda: _triad(x, y, z, 3.0), max(repeat, 3))
    # STREAM counts what the program reads and writes; the line of `a` that is fetched before it is written is not counted.
    return Limits(product, 2.0 * _PRODUCT_SIZE**3 / product / 1e9, 3.0 * 8.0 * _TRIAD_SIZE / triad / 1e9, {"triad": triad})


def measure(options: Options, found: Limits) -> Part:
    """The limits as a table, with the machine they are of."""
    rows = (
        Row(f"matrix product {_PRODUCT_SIZE}^3", found.product, f"{found.gflops:.1f} GF/s (double)"),
        Row(f"triad a = b + s c, {_TRIAD_SIZE:,} doubles", found.extra["triad"], f"{found.bandwidth:.1f} GB/s"),
    )
    packages = ", ".join(f"{name} {_version(name)}" for name in ("numpy", "scipy", "numba", "thermofit"))
    remarks = (
        f"{_processor()}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}; {packages}.",
        f"Load average at the start {os.getloadavg()[0]:.2f}; numba threads {options.threads}.",
    )
    return Part("Limits of the machine", rows, (), remarks)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "(from source)"


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            return next(line.split(":", 1)[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
