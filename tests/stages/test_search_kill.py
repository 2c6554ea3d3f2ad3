"""Grid search, sensitivity and bootstrap killed in the middle, or robbed of a worker: the same command then gives the same table.

Repeated is at most what was running: one evaluation per process.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import local_dask
import numpy as np
import pytest
import tiny

from thermofit.records.artefact import Record, open_record
from thermofit.records.executor import Executor
from thermofit.records.staging import artefact_path
from thermofit.study.study import Study

StudyOf = Callable[..., Study]
ROOT = Path(__file__).parents[2]
SUPPORT = ROOT / "tests" / "support"
STARTS = [
    {"alpha_exp": 23.0e-6, "c0": 2.43, "beta": 1.0},
    {"alpha_exp": 12.0e-6, "c0": 4.0, "beta": 0.5},
    {"alpha_exp": 46.0e-6, "c0": 1.2, "beta": 2.0},
    {"alpha_exp": 30.0e-6, "c0": 5.0, "beta": 0.3},
]


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(SUPPORT)]), "OPENBLAS_NUM_THREADS": "1"}


def kept(study: Study, stage: str) -> int:
    """Evaluations and whole trials on disk."""
    return len(list(study.run_dir.glob(f".{stage}.*/*.npz"))) + len(list(study.run_dir.glob(f".{stage}.*.h5")))


def killed(study: Study, stage: str, jobs: int, more: int) -> None:
    """Run a stage in a process of its own, kill it when it has left `more` files, and see that it leaves no worker behind."""
    code = (
        "import tiny; from thermofit.records.executor import Executor; "
        f"tiny.stage_run({stage!r})(tiny.load_study({str(study.source)!r}), force=True, where=Executor(jobs={jobs}))"
    )
    before = kept(study, stage)
    with subprocess.Popen([sys.executable, "-c", code], env=environment()) as process:
        deadline = time.monotonic() + 300.0
        while kept(study, stage) < before + more:
            assert process.poll() is None and time.monotonic() < deadline, f"{stage} ended before it had left {more} files"
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
    settled(study, stage)


COUNTED = """
import sys, tiny
from pathlib import Path
from thermofit.experiment.held import HeldRun
from thermofit.stages.identifiability import IdentifiabilityOptions, run
plain = HeldRun.__call__
def counted(self, *arguments, **options):
    with Path(sys.argv[2]).open("a") as log:
        log.write("run\\n")
    return plain(self, *arguments, **options)
HeldRun.__call__ = counted
run(tiny.load_study(sys.argv[1]), IdentifiabilityOptions(repeats=8, refit=True), force=True)
"""
"""A bootstrap in a process of its own, which notes every heat run before it begins."""


def bootstrap(study: Study, log: Path, more: int | None = None) -> int:
    """Run it to the end, or kill it after it has begun `more` further heat runs; the number of runs that the log then holds."""

    def count() -> int:
        return len(log.read_text().splitlines()) if log.exists() else 0

    before = count()
    with subprocess.Popen([sys.executable, "-c", COUNTED, str(study.source), str(log)], env=environment()) as process:
        if more is None:
            assert process.wait(timeout=600) == 0
            return count()
        deadline = time.monotonic() + 300.0
        while count() < before + more:
            assert process.poll() is None and time.monotonic() < deadline, f"the bootstrap ended before {more} heat runs"
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
    return count()


@pytest.mark.slow
def test_killed_bootstrap_resumes(study_of: StudyOf) -> None:
    """Repeats fitted anew: the same optima to the last digit, and of the heat runs at most the one that was killed runs twice."""
    study = study_of()
    log = study.run_dir.parent / "runs.log"
    path = artefact_path(study.run_dir, "identifiability")
    whole = bootstrap(study, log)
    optima = open_record(path)["bootstrap/x"].value
    log.unlink()
    path.unlink()
    kills = 3
    for _ in range(kills):
        bootstrap(study, log, random.randint(1, max(whole // (kills + 2), 2)))
        assert not path.exists()
    assert whole <= bootstrap(study, log) <= whole + kills
    np.testing.assert_array_equal(open_record(path)["bootstrap/x"].value, optima)
    assert not list(study.run_dir.glob(".identifiability.*"))


def settled(study: Study, stage: str) -> None:
    """Wait until nobody writes any more."""
    last, since = kept(study, stage), time.monotonic()
    while time.monotonic() - since < 1.0:
        time.sleep(0.05)
        if kept(study, stage) != last:
            last, since = kept(study, stage), time.monotonic()


def same_answer(found: Record, whole: Record, group: str, repeated: int) -> None:
    """The same table, and hardly an evaluation twice."""
    assert found.summary["trustworthy"] and found.summary["verdict"] == whole.summary["verdict"]
    np.testing.assert_allclose(found[f"{group}/optimum"].value, whole[f"{group}/optimum"].value, rtol=1e-9)
    np.testing.assert_allclose(found[f"{group}/f"].value, whole[f"{group}/f"].value, rtol=1e-9)
    counts, uninterrupted = found.summary["evaluations"], whole.summary["evaluations"]
    assert uninterrupted["forward"] <= counts["forward"] + counts["replayed"] <= uninterrupted["forward"] + repeated


@pytest.mark.parametrize(("stage", "group", "jobs"), [("gridsearch", "starts", 2), ("sensitivity", "values", 1)])
def test_killed_search_resumes(study_of: StudyOf, stage: str, group: str, jobs: int) -> None:
    study = study_of()
    whole = open_record(artefact_path(study.run_dir, stage))
    before = whole.path.read_bytes()
    killed(study, stage, jobs, random.randint(2, 5))
    assert whole.path.read_bytes() == before, "the old artefact stays until the new one is whole"
    expected = {name: whole[name] for name in (f"{group}/optimum", f"{group}/f")}
    found = tiny.stage_run(stage)(study, force=True).record
    assert found.summary["evaluations"]["replayed"] >= 1
    same_answer(found, _Kept(whole, expected), group, 0)  # type: ignore[arg-type]
    assert not list(study.run_dir.glob(f".{stage}.*"))


class _Kept:
    """What is compared of a record whose file is about to be replaced."""

    def __init__(self, record: Record, datasets: dict[str, Any]) -> None:
        self.summary, self._datasets = record.summary, datasets

    def __getitem__(self, name: str) -> Any:
        return self._datasets[name]


def table_of(study: Study, run: Callable[..., Any], **options: Any) -> _Kept:
    record = run(study, force=True, **options).record
    return _Kept(record, {name: record[name] for name in ("starts/optimum", "starts/f")})


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["gridsearch", "sensitivity"])
def test_search_killed_again_and_again(study_of: StudyOf, stage: str) -> None:
    study = study_of(gridsearch={"stage": "thermal", "starts": STARTS})
    group = {"gridsearch": "starts", "sensitivity": "values"}[stage]
    record = tiny.stage_run(stage)(study, force=True).record
    whole = _Kept(record, {name: record[name] for name in (f"{group}/optimum", f"{group}/f")})
    # Three kills, together before the search has ended.
    most = max(record.summary["evaluations"]["forward"] // 6, 1)
    for jobs in (2, 1, 2):
        killed(study, stage, jobs, random.randint(1, most))
    found = tiny.stage_run(stage)(study, force=True, where=Executor(jobs=2)).record
    same_answer(found, whole, group, 0)  # type: ignore[arg-type]


@pytest.mark.slow
def test_dask_worker_killed_during_a_grid_search(study_of: StudyOf, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="needs the extra dask")
    study = study_of(gridsearch={"stage": "thermal", "starts": STARTS})
    run = tiny.stage_run("gridsearch")
    whole = table_of(study, run)
    with local_dask.cluster_of(tmp_path, environment(), 2) as cluster:

        def kill_one() -> None:
            while kept(study, "gridsearch") < 3:
                time.sleep(0.002)
            cluster.workers[0].kill()

        thread = threading.Thread(target=kill_one)
        thread.start()
        found = run(study, force=True, where=Executor(scheduler=cluster.address)).record
        thread.join()
        assert cluster.workers[0].wait(timeout=20) == -signal.SIGKILL and cluster.workers[1].poll() is None
    same_answer(found, whole, "starts", 0)  # type: ignore[arg-type]
