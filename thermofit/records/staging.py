"""How every stage makes its record: say `fresh` where nothing changed, otherwise compute and write atomically."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from thermofit.records.artefact import Dataset, ParameterResult, Record, RecordContent, fresh, open_record, write_record
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
    """The record of a job: the one on disk where config, inputs and sources are unchanged, else a new one.

    While it is made only those sections of the study can be read that its config holds (`study.reading`).
    """
    if not force and fresh(task.path, task.stage, task.config, task.inputs):
        return Outcome(open_record(task.path), True)
    with reading(task.config):
        made = make()
    content = RecordContent(
        stage=task.stage,
        config=task.config,
        inputs=task.inputs,
        datasets=made.datasets,
        parameters=made.parameters,
        summary={"stage": task.stage, **made.summary},
        seed=made.seed,
    )
    task.path.parent.mkdir(parents=True, exist_ok=True)
    return Outcome(write_record(task.path, content), False)
