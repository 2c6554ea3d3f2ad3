"""How the benchmarks measure: CPU seconds of a piece of work, CPU, wall time and memory of a child process, and what a section returns."""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

SCRIPTS = Path(__file__).resolve().parent
ROOT = SCRIPTS.parent
ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "CCX_NPROC_RESULTS", "CCX_NPROC_STIFFNESS", "CCX_NPROC_EQUATION_SOLVER"),
    "1",
)
"""Environment that keeps a child's libraries on one thread; the kernels of thermofit have their own setting."""
_MAXRSS_UNIT = 1.0 if sys.platform == "darwin" else 1024.0
"""Bytes of one unit of ru_maxrss."""


@dataclass(frozen=True)
class Options:
    """What all sections are told: elements (n_x, n_y, n_z), repetitions of short work, threads, small settings, scratch folder."""

    mesh: tuple[int, int, int]
    repeat: int
    threads: int
    quick: bool
    scratch: Path


@dataclass(frozen=True)
class Row:
    """One line of a table: seconds (CPU unless the note says otherwise; None where the row is no time) and what there is to say."""

    name: str
    seconds: float | None
    note: str = ""


@dataclass(frozen=True)
class Target:
    """One promise beside its measured figure; `met` None where it could not be measured here."""

    name: str
    limit: str
    measured: str
    met: bool | None


@dataclass(frozen=True)
class Part:
    """Result of one section: its table, its targets and sentences below the table."""

    title: str
    rows: tuple[Row, ...]
    targets: tuple[Target, ...] = ()
    remarks: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return asdict(self)

    @staticmethod
    def of(stored: Mapping[str, Any]) -> Part:
        """The Part of what `as_dict` gave."""
        return Part(
            stored["title"],
            tuple(Row(**row) for row in stored["rows"]),
            tuple(Target(**target) for target in stored["targets"]),
            tuple(stored["remarks"]),
        )


def cpu(work: Callable[[], object], repeat: int) -> float:
    """Median CPU seconds of `work` over `repeat` runs after one warm-up."""
    work()
    return float(np.median([once(work) for _ in range(repeat)]))


def once(work: Callable[[], object]) -> float:
    """CPU seconds of one run, all threads of this process."""
    start = time.process_time()
    work()
    return time.process_time() - start


_LAUNCHER = """
import os, resource, sys
code = os.waitstatus_to_exitcode(os.waitpid(os.posix_spawnp(sys.argv[2], sys.argv[2:], os.environ), 0)[1])
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
open(sys.argv[1], "w").write(f"{usage.ru_utime + usage.ru_stime} {usage.ru_maxrss}")
sys.exit(code if code >= 0 else 128 - code)
"""


@dataclass(frozen=True)
class Child:
    """A finished child process: CPU s (with its own children), wall s, peak memory in bytes, exit code, what it printed."""

    cpu: float
    wall: float
    peak: float
    code: int
    stdout: str
    stderr: str


def run_child(command: Sequence[str], *, cwd: Path | None = None, env: Mapping[str, str] | None = None) -> Child:
    """Run a command on one thread to its end; its resources are those of the command and its children.

    They are read by a small launcher: Linux counts the memory of the process that forked as the child's, and this one is large.
    """
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err, tempfile.NamedTemporaryFile("r") as usage:
        launch = [sys.executable, "-I", "-S", "-c", _LAUNCHER, usage.name, *command]
        start = time.perf_counter()
        code = subprocess.run(
            launch, cwd=cwd, env=environment(env), stdout=out, stderr=err, stdin=subprocess.DEVNULL, check=False
        ).returncode
        wall = time.perf_counter() - start
        seconds, peak = (float(value) for value in usage.read().split())
        out.seek(0)
        err.seek(0)
        return Child(seconds, wall, peak * _MAXRSS_UNIT, code, out.read(), err.read())


def environment(extra: Mapping[str, str] | None = None) -> dict[str, str]:
    """Environment of a child on one thread."""
    return {**os.environ, **ONE_THREAD, "OMP_WAIT_POLICY": "PASSIVE", **(extra or {})}


def first_line(
    command: Sequence[str], *, cwd: Path | None = None, env: Mapping[str, str] | None = None, limit: float = 60.0
) -> tuple[float, str]:
    """Wall s until a command has written its first words to a terminal, and these words; it is ended as soon as they are there.

    (inf, "") where it wrote none within `limit` s or ended in silence.
    """
    master, slave = pty.openpty()
    start = time.perf_counter()
    settings = environment({"TERM": "xterm", **(env or {})})
    process = subprocess.Popen(list(command), cwd=cwd, env=settings, stdin=slave, stdout=slave, stderr=slave)
    os.close(slave)
    try:
        return _first_words(master, start, limit)
    finally:
        process.terminate()
        process.wait()
        os.close(master)


def _first_words(master: int, start: float, limit: float) -> tuple[float, str]:
    seen = b""
    while (left := limit - (time.perf_counter() - start)) > 0.0:
        ready, _, _ = select.select([master], [], [], left)
        if not ready:
            break
        try:
            piece = os.read(master, 4096)
        except OSError:  # Linux's way to say that the other end has closed
            break
        seen += piece
        words = _plain(seen.decode("utf-8", "replace"))
        if not piece or sum(letter.isalpha() for letter in words) >= 3:
            return time.perf_counter() - start, words
    return float("inf"), ""


def _plain(text: str) -> str:
    """Text without the control sequences of a terminal, on one line."""
    out, skipping = [], False
    for letter in text:
        if skipping:
            skipping = not letter.isalpha()
        elif letter == "\x1b":
            skipping = True
        elif letter.isprintable() or letter == " ":
            out.append(letter)
    return " ".join("".join(out).split())


@dataclass(frozen=True)
class Limits:
    """What the machine can do, measured beside a section: matrix product 1000^3 in s, its GF/s, triad GB/s."""

    product: float
    gflops: float
    bandwidth: float
    extra: Mapping[str, float] = field(default_factory=dict)

    def of_product(self, flops: float, seconds: float) -> str:
        """Rate of a piece of work beside that of the matrix product."""
        rate = flops / seconds / 1e9
        return f"{rate:.1f} GF/s, {100.0 * rate / self.gflops:.0f} % of the matrix product"

    def of_bandwidth(self, size: float, seconds: float) -> str:
        """Bytes per second of a piece of work beside the triad's."""
        rate = size / seconds / 1e9
        return f"{rate:.1f} GB/s, {100.0 * rate / self.bandwidth:.0f} % of the triad"


def exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """Least squares slope of log(seconds) over log(sizes)."""
    slope, _ = np.polyfit(np.log(sizes), np.log(seconds), 1)
    return float(slope)


def at_most(name: str, measured: float, limit: float, unit: str, aim: float | None = None) -> Target:
    """A target with an upper limit (and what was aimed at)."""
    text = f"<= {limit:g} {unit}".rstrip() + (f" (aim {aim:g})" if aim is not None else "")
    return Target(name, text, f"{measured:.3g} {unit}".rstrip(), measured <= limit)


def at_least(name: str, measured: float, limit: float, unit: str = "times", aim: float | None = None) -> Target:
    """A target with a lower limit (and what was aimed at)."""
    text = f">= {limit:g} {unit}" + (f" (aim {aim:g})" if aim is not None else "")
    return Target(name, text, f"{measured:.3g} {unit}", measured >= limit)
