"""A Dask scheduler with workers in processes of their own."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

_QUIET: dict[str, int] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}


@dataclass(frozen=True)
class Cluster:
    """Address of the scheduler, the scheduler itself, and its workers."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: tuple[subprocess.Popen[bytes], ...]


@contextmanager
def cluster_of(folder: Path, environment: Mapping[str, str], workers: int) -> Iterator[Cluster]:
    """A scheduler with that many workers; all end with the block."""
    scheduler, address = start_scheduler(folder, environment)
    processes = [scheduler]
    try:
        processes += [start_worker(address, environment) for _ in range(workers)]
        yield Cluster(address, scheduler, tuple(processes[1:]))
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.wait(timeout=20)


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
