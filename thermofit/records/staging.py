"""How every stage makes its record: say `fresh` where nothing changed, otherwise compute and write atomically."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from thermofit.core.errors import DataError
from thermofit.records.artefact import Dataset, ParameterResult, Record, RecordContent, fresh, open_record, write_record
from thermofit.records.lock import locked
from thermofit.records.log import END, logged
from thermofit.records.stopping import kept
from thermofit.study.reading import reading
from thermofit.study.study import Study


class Note(str):
    """A remark that asks for nothing: it is printed with --verbose and stands in the report."""

    __slots__ = ()


def named(name: str, text: str) -> str:
    """The text with the name of its experiment before it; a note stays a note, and what has no name is as it is."""
    return type(text)(f"{name}: {text}") if name else text


def as_one(texts: Iterable[str]) -> str:
    """Texts as one, "" where there are none: a note where all of them are."""
    kept = [text for text in texts if text]
    line = "; ".join(kept)
    return Note(line) if kept and all(isinstance(text, Note) for text in kept) else line


def sorted_out(texts: Iterable[str]) -> dict[str, list[str]]:
    """The keys `remarks` and `notes` of a summary; empty texts are left out."""
    kept = [text for text in texts if text]
    return {"remarks": [t for t in kept if not isinstance(t, Note)], "notes": [str(t) for t in kept if isinstance(t, Note)]}


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


Run = Callable[..., Outcome]
"""`run(study, *, force) -> Outcome` of a stage."""


def each(study: Study, name: str, run: Run, applies: Callable[[Study], bool], *, force: bool = False) -> Outcome:
    """The stage on all experiments of a study, held-out ones too; the outcome is that of the fitted one, or the record of several.

    `applies` says of the study of one experiment whether the stage has anything to do there. Fresh where all of them are.
    """
    if not study.fitted:
        others = [run(study.one_of(held), force=force) for held in study.held_out if applies(study.one_of(held))]
        return run(study.alone, force=force) if applies(study.alone) or not others else others[-1]
    names = [n for n in (*study.fitted, *study.held_out) if applies(study.one_of(n))]
    outcomes = [run(study.one_of(n), force=force) for n in names]
    inputs = {f"{name}@{n}": artefact_path(study.run_dir / n, name) for n in names}
    task = job(study.run_dir, name, {"experiments": names}, inputs)
    return produce(task, lambda: _list(study, names, outcomes), force=force)


def _list(study: Study, names: Sequence[str], outcomes: Sequence[Outcome]) -> Made:
    rows: list[dict[str, Any]] = []
    pictures: list[str] = []
    told: dict[str, list[str]] = {"remarks": [], "notes": []}
    for name, outcome in zip(names, outcomes, strict=True):
        said = outcome.record.summary
        role = "held out" if name in study.held_out else "fitted"
        rows.append({"experiment": name, "role": role, "result": str(said.get("verdict", ""))})
        for kind, texts in told.items():
            texts += [f"{name}: {text}" for text in said.get(kind, ())]
        pictures += [str(said["picture"])] if said.get("picture") else []
    summary = {"verdict": f"{len(names)} experiments: {', '.join(names)}", "experiments": rows, **told, "figures": pictures}
    return Made({}, summary)
