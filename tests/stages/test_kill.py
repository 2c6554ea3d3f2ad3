"""A stage killed at any moment leaves the artefact that was there, or a whole new one; the same command then resumes."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import tiny

from thermofit.read.raw import read_experiment
from thermofit.records.artefact import open_record
from thermofit.records.staging import artefact_path
from thermofit.study.study import Study

StudyOf = Callable[..., Study]
LATER = tuple(name for name in ("verify", "report") if importlib.util.find_spec(f"thermofit.stages.{name}"))
STAGES = (*tiny.CHAIN, *LATER)
QUICK = ("calibrate-ir", "interpolate", "identify-elastic")
ROOT = Path(__file__).parents[2]
SUPPORT = ROOT / "tests" / "support"


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(SUPPORT)]), "OPENBLAS_NUM_THREADS": "1"}


@pytest.fixture
def worker(study_of: StudyOf) -> Iterator[Callable[..., None]]:
    """Kills a stage after a random time or as soon as it writes; the process that does it has all modules loaded."""
    study = study_of()
    command = [sys.executable, str(SUPPORT / "kill_worker.py"), str(study.source), "0.6", str(int(time.time()))]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment()) as process:
        assert process.stdin is not None and process.stdout is not None
        source, answer = process.stdin, process.stdout

        def kill(stage: str, moment: str = "random") -> None:
            source.write(f"{stage} {moment}\n")
            source.flush()
            assert answer.readline().strip() == "done", f"{stage}: the process that kills ended with {process.poll()}"

        yield kill
        source.close()


def intact(study: Study, stage: str) -> None:
    """The artefact and everything in it can be read; the raw folder of the virtual experiment too."""
    record = open_record(artefact_path(study.run_dir, stage))
    assert record.stage == stage and record.summary["verdict"]
    for name in record.names:
        assert record[name].unit
    if stage == "simulate":
        experiment = read_experiment(study.experiment)
        assert experiment.dic is not None and len(experiment.dic.time) == 14


def resumed(study: Study, stage: str) -> None:
    """The same command once more: what the killed one replaced makes later stages refuse until these are run again."""
    tiny.stage_run(stage)(study)
    intact(study, stage)


def test_every_stage_killed_leaves_its_artefact(study_of: StudyOf, worker: Callable[..., None]) -> None:
    study = study_of()
    for stage in LATER:
        tiny.stage_run(stage)(study)
    for stage in STAGES:
        worker(stage)
        for other in STAGES:
            intact(study, other)
        resumed(study, stage)
    for stage in QUICK:
        for _ in range(3):
            worker(stage, "writing")
            intact(study, stage)
        resumed(study, stage)


@pytest.mark.slow
def test_every_stage_killed_many_times(study_of: StudyOf, worker: Callable[..., None]) -> None:
    study = study_of()
    for stage in LATER:
        tiny.stage_run(stage)(study)
    for _ in range(6):
        for stage in STAGES:
            for moment in ("random", "writing"):
                worker(stage, moment)
                intact(study, stage)
            resumed(study, stage)
    for stage in STAGES:
        tiny.stage_run(stage)(study, force=True)
        left = [path.name for path in study.run_dir.iterdir() if path.name.startswith(".")]
        assert not [name for name in left if stage in name], f"{stage} leaves {left} behind"


def killed_with_evaluations(study: Study, stage: str, number: int) -> None:
    """Run a stage in a process of its own and kill it when `number` evaluations are on disk."""
    load = f"tiny.load_study({str(study.source)!r}, {study.overrides!r})"
    code = f"import tiny; tiny.stage_run({stage!r})({load}, force=True)"
    with subprocess.Popen([sys.executable, "-c", code], env=environment()) as process:
        deadline = time.monotonic() + 120.0
        while len(list(study.run_dir.glob(f".{stage}.*/*.npz"))) < number:
            assert process.poll() is None and time.monotonic() < deadline, f"{stage} ended before it had {number} evaluations"
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)


@pytest.mark.parametrize("stage", ["identify-plastic", "gridsearch"])
def test_killed_identification_resumes(study_of: StudyOf, stage: str) -> None:
    # The trust region takes evaluations enough to be killed among them.
    study = study_of("stages.plastic.method=trust-region") if stage == "identify-plastic" else study_of()
    path = artefact_path(study.run_dir, stage)
    whole = tiny.stage_run(stage)(study, force=True).record
    before = path.read_bytes()
    killed_with_evaluations(study, stage, 6)
    assert path.read_bytes() == before
    after = tiny.stage_run(stage)(study, force=True).record
    counts, uninterrupted = after.summary["evaluations"], whole.summary["evaluations"]
    assert counts["replayed"] >= 6
    assert counts["forward"] + counts["replayed"] == uninterrupted["forward"]
    for name, result in whole.parameters.items():
        assert after.parameters[name].value == pytest.approx(result.value, rel=1e-12)
    assert not list(study.run_dir.glob(f".{stage}.*"))
