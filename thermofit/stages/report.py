"""`report`: figures and a written report of a verified run, from its records; nothing is computed anew."""

from __future__ import annotations

from pathlib import Path

import matplotlib

from thermofit.core.atomic import replacing
from thermofit.core.errors import StudyError
from thermofit.experiment.fields import INTERPOLATE
from thermofit.experiment.forms import experiment_of
from thermofit.experiment.verification import identified_stages
from thermofit.records.artefact import Record, open_record, read_record
from thermofit.records.key import drifted
from thermofit.records.staging import Made, Outcome, artefact_path, job, produce
from thermofit.records.stale import stale
from thermofit.report.figures import STYLE, save_figures
from thermofit.report.page import figures_of, text_of
from thermofit.study.study import Study

NAME = "report"
VERIFY = "verify"
FIGURES = "figures"
TEXT = "report.md"


def run(study: Study, *, force: bool = False) -> Outcome:
    """Write `<run_dir>/figures/*.png` and `<run_dir>/report.md`, of several experiments in the folder of each; the record lists them.

    Fresh only while these files are there. Artefacts that are stale, or made with other settings than the study has now, are reported as
    what they are: the report says so, and its record is not trustworthy. StudyError where `interpolate`, `identify-elastic` or `verify` has
    not run (names the command) or where the folder cannot be written.
    """
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
    config = study.config_of("name", "model", "hardening", "stages", "simulate", "coupon", "experiments")
    task = job(study.run_dir, NAME, {**config, "stale": doubts}, paths)

    def make() -> Made:
        """The pages of all tests and the paths of what they show."""
        made = [_page(one, of, doubts) for one, of in pages]
        figures, texts = [path for paths, _ in made for path in paths], [text for _, text in made]
        what = f"{TEXT} written to" if alone else f"{len(texts)} reports written to the folders of the experiments in"
        summary = {
            **_judged(f"{len(figures)} figures and {what} {study.run_dir}", doubts),
            FIGURES: figures,
            **({"report": texts[0]} if alone else {"reports": texts}),
            "verified": records[VERIFY].summary["verdict"],
        }
        return Made({}, summary)

    outcome = produce(task, make, force=force)
    said = outcome.record.summary
    if outcome.fresh and not all(Path(path).exists() for path in (*said[FIGURES], *said.get("reports", [said.get("report")]))):
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


def _page(study: Study, records: dict[str, Record], doubts: list[str]) -> tuple[list[str], str]:
    """Paths of the figures and of the text of one test."""
    text = study.run_dir / TEXT
    try:
        with matplotlib.rc_context(STYLE):
            figures = save_figures(study.run_dir / FIGURES, figures_of(study, records))
        with replacing(text, durable=False) as temporary:
            temporary.write_text(text_of(study, records, figures, doubts), encoding="utf-8")
    except OSError as error:
        raise StudyError(f"report: '{study.run_dir}' cannot be written ({error}): expected a writable folder with free space") from error
    return [str(path) for path in figures], str(text)
