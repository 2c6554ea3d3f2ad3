"""`report`: figures, a written report and a page to look at, from the records of a run; nothing is computed anew."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

from thermofit.core.errors import StudyError, ThermofitError
from thermofit.core.files import replacing
from thermofit.experiment.fields import INTERPOLATE
from thermofit.experiment.forms import experiment_of
from thermofit.experiment.verification import identified_stages
from thermofit.records.artefact import Record, open_record, read_record, stale
from thermofit.records.key import drifted
from thermofit.records.staging import Made, Outcome, artefact_path, job, produce
from thermofit.report.figures import FORMATS, STYLE, save_figures
from thermofit.report.html.page import HTML, Written, write_report
from thermofit.report.page import figures_of, text_of
from thermofit.study.errors import near_miss
from thermofit.study.study import Study

NAME = "report"
VERIFY = "verify"
FIGURES = "figures"
TEXT = "report.md"
_SHOWN = ("diagnose", "close-loop", "identifiability", "validate", "compare", "gridsearch", "sensitivity", "mesh")
"""Stages that are no link of the chain: the page shows them where they have run."""


def run(study: Study, *, force: bool = False, also: Sequence[str] = ()) -> Outcome:
    """Write `<run_dir>/figures/*.png`, the same in the formats `also` (pdf, svg), and `report.md`, of several experiments in the folder of
    each, and `<run_dir>/report.html` with its JSON twin and the text of methods; the record lists them.

    StudyError for a format that is not known. Fresh only while these files are there. Artefacts that are stale, or made with other settings
    than the study has now, are reported as what they are: the report says so, and its record is not trustworthy. StudyError where
    `interpolate`, `identify-elastic` or `verify` has not run (names the command; the page then shows what there is) or where the folder
    cannot be written.
    """
    for kind in also:
        if kind not in FORMATS:
            raise StudyError(f"--also {kind} is no format of figures{near_miss(kind, FORMATS)}; expected {' or '.join(FORMATS)}")
    try:
        return _whole(study, tuple(dict.fromkeys(also)), force=force)
    except ThermofitError as error:
        written = unfinished(study, str(error))
        if written is None:
            raise
        raise type(error)(f"{error}; {written.html} shows what there is") from error


def unfinished(study: Study, failure: str = "") -> Written | None:
    """The page of a run that stopped, with the error that ended it; None where there is nothing to show, or no place to write it."""
    try:
        return write_report(study.run_dir, study, failure=failure)
    except ThermofitError:
        return None


def of_folder(folder: Path) -> dict[str, Any]:
    """The page of a run folder alone, whose study need not be at hand: JSON of the result. Errors of `write_report`."""
    written = write_report(folder)
    return {"stage": NAME, **_page_summary(written), "trustworthy": written.content.verdict.trustworthy}


def _page_summary(written: Written) -> dict[str, Any]:
    verdict = written.content.verdict.sentence
    paths = {"html": written.html, "json": written.json, "methods": written.methods, "references": written.references}
    return {"verdict": f"{verdict} {written.html}", "pages": {name: str(path) for name, path in paths.items()}}


def _whole(study: Study, also: tuple[str, ...], *, force: bool) -> Outcome:
    """The record of a report of a verified run."""
    tests = experiment_of(study).tests
    alone = not tests[0].name
    stages = (*((INTERPOLATE,) if alone else ()), *identified_stages(study), VERIFY)
    paths = {stage: artefact_path(study.run_dir, stage) for stage in stages}
    records = {stage: read_record(path, stage, f"thermofit {stage} {study.source.name}") for stage, path in paths.items()}
    doubts, pages = _doubts(study, records), []
    for test in tests:
        own = {stage: open_record(artefact_path(test.study.run_dir, stage)) for stage in (INTERPOLATE, VERIFY)}
        pages.append((test.study, {**records, **own}))
        if not alone:
            doubts += [f"{test.name}: {text}" for text in _doubts(test.study, {INTERPOLATE: own[INTERPOLATE]})]
    config = study.config_of(
        "name", "model", "hardening", "yield_surface", "mesh", "geometry", "stages", "simulate", "coupon", "experiments"
    )
    shown = {stage: path for stage in _SHOWN if (path := artefact_path(study.run_dir, stage)).exists()}
    task = job(study.run_dir, NAME, {**config, "stale": doubts}, {**paths, **shown})

    def make() -> Made:
        """The pages of all tests and the paths of what they show."""
        made = [_page(one, of, doubts, also) for one, of in pages]
        figures, texts = [path for paths, _ in made for path in paths], [text for _, text in made]
        what = f"{TEXT} and {HTML} written to"
        if not alone:
            what = f"{HTML} written to, and {len(texts)} reports to the folders of the experiments in,"
        written = write_report(study.run_dir, study)
        summary = {
            **_judged(f"{len(figures)} figures and {what} {study.run_dir}", doubts),
            FIGURES: figures,
            "pages": _page_summary(written)["pages"],
            "sentence": written.content.verdict.sentence,
            **({"report": texts[0]} if alone else {"reports": texts}),
            "verified": records[VERIFY].summary["verdict"],
        }
        return Made({}, summary)

    outcome = produce(task, make, force=force)
    said = outcome.record.summary
    files = (
        *said[FIGURES],
        *(str(Path(path).with_suffix(f".{kind}")) for path in said[FIGURES] for kind in also),
        *said.get("reports", [said.get("report")]),
        *said["pages"].values(),
    )
    if outcome.fresh and not all(Path(path).exists() for path in files):
        outcome = produce(task, make, force=True)
    return outcome


def _doubts(study: Study, records: dict[str, Record]) -> list[str]:
    """Why the artefacts are not what the study, its data and each other would give now."""
    return [*(f"{r.path.name}: {text}" for r in records.values() for text in stale(r)), *drifted(study, records)]


def _judged(line: str, doubts: list[str]) -> dict[str, object]:
    """Verdict of a report, and whether it can be trusted: it cannot where artefacts are stale."""
    if not doubts:
        return {"verdict": line, "remarks": []}
    more = f" (and {len(doubts) - 1} more)" if len(doubts) > 1 else ""
    return {"verdict": f"reported from stale results: {doubts[0]}{more}; {line}", "trustworthy": False, "remarks": doubts}


def _page(study: Study, records: dict[str, Record], doubts: list[str], also: Sequence[str]) -> tuple[list[str], str]:
    """Paths of the figures and of the text of one test."""
    text = study.run_dir / TEXT
    try:
        with matplotlib.rc_context(STYLE):
            figures = save_figures(study.run_dir / FIGURES, figures_of(study, records), also)
        with replacing(text, durable=False) as temporary:
            temporary.write_text(text_of(study, records, figures, doubts), encoding="utf-8")
    except OSError as error:
        raise StudyError(f"report: '{study.run_dir}' cannot be written ({error}): expected a writable folder with free space") from error
    return [str(path) for path in figures], str(text)
