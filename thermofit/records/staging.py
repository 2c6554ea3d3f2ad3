"""How every stage makes its record: say `fresh` where nothing changed, otherwise compute and write atomically."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from thermofit.core.errors import DataError
from thermofit.records.artefact import Dataset, ParameterResult, Record, RecordContent, fresh, open_record, write_record
from thermofit.records.lock import locked
from thermofit.records.log import END, logged
from thermofit.records.stopping import kept
from thermofit.study.reading import reading


@dataclass(frozen=True)
class Made:
    """What a stage computed: datasets, parameters and the JSON-able summary of its record."""

    datasets: Mapping[str, Dataset]
    summary: Mapping[str, Any]
    parameters: Mapping[str, ParameterResult] = field(default_factory=dict)
    seed: int | None = None


@dataclass(frozen=True)
class Outcome:
    """The record of a stage, and whether it was still fresh."""

    record: Record
    fresh: bool


@dataclass(frozen=True)
class Job:
    """One stage about to run: its name, artefact, the configuration and the inputs that decide whether it is fresh."""

    stage: str
    path: Path
    config: Mapping[str, Any]
    inputs: Mapping[str, Path]


def job(run_dir: Path, stage: str, config: Mapping[str, Any], inputs: Mapping[str, Path]) -> Job:
    """Job of a stage whose artefact is `<run_dir>/<stage>.h5`."""
    return Job(stage, artefact_path(run_dir, stage), config, inputs)


def artefact_path(run_dir: Path, stage: str) -> Path:
    """Where the artefact of a stage lies."""
    return run_dir / f"{stage}.h5"


def produce(task: Job, make: Callable[[], Made], *, force: bool = False) -> Outcome:
    """The record of a job: the one on disk where config, inputs and sources are unchanged, else a new one, with its log beside it.

    While it is made only those sections of the study can be read that its config holds (`study.reading`), and no other process can work
    in its folder (StudyError). A damaged one is made anew, which a remark says.
    """
    if not force and fresh(task.path, task.stage, task.config, task.inputs):
        return Outcome(open_record(task.path), True)
    begin = time.perf_counter()
    with locked(task.path.parent), logged(task.path, task.stage) as log:
        kept()
        damage = _damage(task.path)
        with reading(task.config):
            made = make()
        content = RecordContent(
            stage=task.stage,
            config=task.config,
            inputs=task.inputs,
            datasets=made.datasets,
            parameters=made.parameters,
            summary={"stage": task.stage, **made.summary, **_with_remark(made.summary, damage)},
            seed=made.seed,
        )
        task.path.parent.mkdir(parents=True, exist_ok=True)
        record = write_record(task.path, content)
        if log is not None and not task.path.name.startswith("."):
            said = {"verdict": made.summary.get("verdict"), "trustworthy": made.summary.get("trustworthy") is not False}
            log.event(END, **said, wall_s=round(time.perf_counter() - begin, 3))
    kept()
    return Outcome(record, False)


def _damage(path: Path) -> str:
    """What is wrong with the artefact that is about to be replaced; empty where it can be read or is not there."""
    try:
        if path.exists():
            open_record(path)
    except DataError as error:
        return str(error)
    return ""


def _with_remark(summary: Mapping[str, Any], damage: str) -> dict[str, Any]:
    """The remarks of a record with one more."""
    return {"remarks": [*summary.get("remarks", ()), f"the artefact that was there has been made anew: {damage}"]} if damage else {}
