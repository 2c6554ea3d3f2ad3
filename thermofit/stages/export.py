"""`export`: the results of a run for other programmes. Nothing is identified; the fields need one more run of the model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from thermofit.core.errors import StudyError
from thermofit.core.files import replacing
from thermofit.core.jit import set_threads
from thermofit.core.jsonable import json_text
from thermofit.experiment.forms import experiment_of
from thermofit.export.card import card_of
from thermofit.export.card_texts import CARDS
from thermofit.export.fields import measured_series, model_series
from thermofit.export.results import Finished, finished, results_of
from thermofit.export.tables import csv_text, latex_text, markdown_text, printed, tables_of
from thermofit.records.artefact import open_record
from thermofit.records.staging import artefact_path
from thermofit.study.errors import near_miss
from thermofit.study.study import Study

NAME = "export"
FOLDER = "export"
T_PER_KG_M3 = 1e-12
"""t/mm^3 in one kg/m^3."""


def run(
    source: Path, load: Callable[[Path], Study], kinds: Sequence[str] = (), to: Path | None = None, density: float | None = None
) -> dict[str, Any]:
    """Write the given kinds (none: all that the run allows) into `to` (None: `<run_dir>/export`); the result lists the files by kind.

    `density` in kg/m^3 goes into the cards. StudyError for an unknown kind, where nothing has been run and where the folder cannot be
    written.
    """
    for kind in kinds:
        if kind not in KINDS:
            raise StudyError(f"export of '{kind}' is not known{near_miss(kind, KINDS)}; expected some of {', '.join(KINDS)}")
    if density is not None and density <= 0.0:
        raise StudyError(f"--density is {density:g}; expected kg/m^3 above zero")
    source_run = finished(source, load)
    folder = to or source_run.folder / FOLDER
    files: dict[str, list[str]] = {}
    left_out: dict[str, str] = {}
    for kind in kinds or KINDS:
        try:
            made = [str(path) for path in KINDS[kind](source_run, folder, density)]
        except StudyError as error:
            if kinds:
                raise
            left_out[kind] = str(error)
            continue
        except OSError as error:
            raise StudyError(f"export: '{folder}' cannot be written ({error.strerror or error}): expected a writable folder") from error
        if made:
            files[kind] = made
        else:
            left_out[kind] = "this run has none"
    count = sum(len(paths) for paths in files.values())
    return {
        "stage": NAME,
        "verdict": f"{count} files written to {folder}",
        "trustworthy": True,
        "folder": str(folder),
        "files": files,
        "left_out": left_out,
    }


def _written(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path, durable=False) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def _results(source: Finished, folder: Path, _: float | None) -> Iterator[Path]:
    yield _written(folder / "results.json", json_text(results_of(source)) + "\n")


def _tables(source: Finished, folder: Path, _: float | None) -> Iterator[Path]:
    made = tables_of(source.records)
    short = printed(made)
    yield _written(folder / "tables.md", markdown_text(short))
    yield _written(folder / "tables.tex", latex_text(short))
    for table in made:
        yield _written(folder / "tables" / f"{table.name}.csv", csv_text(table))


def _cards(source: Finished, folder: Path, density: float | None) -> Iterator[Path]:
    name = source.folder.name if source.given is None else source.given.name
    card = card_of(name, source.parameters, source.verified, source.tests)
    for file, text in CARDS.values():
        yield _written(folder / "cards" / file, text(card, None if density is None else density * T_PER_KG_M3))


def _fields(source: Finished, folder: Path, _: float | None) -> Iterator[Path]:
    parameters, study = source.parameters, source.study
    set_threads(study.numerics.threads)
    experiment = experiment_of(study)
    for test in experiment.fields:
        own = folder / "fields" / test.name if test.name else folder / "fields"
        yield from model_series(own, "model", test.study, test.data, experiment.seen_by(parameters, test.name))
        yield from measured_series(own, open_record(artefact_path(test.study.run_dir, "verify")))


Writer = Callable[[Finished, Path, float | None], Iterator[Path]]
KINDS: dict[str, Writer] = {"results": _results, "tables": _tables, "cards": _cards, "fields": _fields}
"""What can be exported, and who writes it."""
