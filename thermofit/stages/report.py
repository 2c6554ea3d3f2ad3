"""`report`: figures and a written report of a verified run, from its records; nothing is computed anew."""

from __future__ import annotations

from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from thermofit.core.atomic import replacing
from thermofit.core.errors import StudyError
from thermofit.experiment.fields import INTERPOLATE, measured_of
from thermofit.experiment.residuals import named_phases
from thermofit.experiment.verification import IDENTIFY, identified_stages
from thermofit.experiment.window import window_times
from thermofit.records.artefact import Record, open_record, read_record
from thermofit.records.key import drifted
from thermofit.records.staging import Made, Outcome, artefact_path, job, produce
from thermofit.records.stale import stale
from thermofit.report.figures import STYLE, save_figures
from thermofit.report.figures_curves import force_figure, over_time_figure, stress_stretch_figure, temperature_figure
from thermofit.report.figures_maps import residual_maps, rms_maps
from thermofit.report.figures_records import coupon_figures
from thermofit.report.figures_search import correlation_figure, objective_figure
from thermofit.report.tables import report_text
from thermofit.report.tables_records import coupon_report_text
from thermofit.study.study import Study

NAME = "report"
VERIFY = "verify"
FIGURES = "figures"
TEXT = "report.md"


def run(study: Study, *, force: bool = False) -> Outcome:
    """Write `<run_dir>/figures/*.png` and `<run_dir>/report.md`; the record lists them.

    Fresh only while these files are there. Artefacts that are stale, or made with other settings than the study has now, are reported as
    what they are: the report says so, and its record is not trustworthy. StudyError where `interpolate`, `identify-elastic` or `verify` has
    not run (names the command) or where the folder cannot be written.
    """
    if study.fitted:
        return _several(study, force)
    stages = (INTERPOLATE, *identified_stages(study), VERIFY)
    paths = {stage: artefact_path(study.run_dir, stage) for stage in stages}
    records = {stage: read_record(path, stage, f"thermofit {stage} {study.source.name}") for stage, path in paths.items()}
    doubts = _doubts(study, records)
    task = job(study.run_dir, NAME, {**study.config_of("name", "stages", "simulate", "coupon"), "stale": doubts}, paths)
    outcome = produce(task, lambda: _make(study, records, doubts), force=force)
    if outcome.fresh and not all(Path(path).exists() for path in (*outcome.record.summary[FIGURES], outcome.record.summary["report"])):
        outcome = produce(task, lambda: _make(study, records, doubts), force=True)
    return outcome


def _several(study: Study, force: bool) -> Outcome:
    """A report for each of several experiments, in the folder of each; the outcome lists them."""
    shared = {stage: artefact_path(study.run_dir, stage) for stage in (*identified_stages(study), VERIFY)}
    records = {stage: read_record(path, stage, f"thermofit {stage} {study.source.name}") for stage, path in shared.items()}
    each = {name: study.one_of(name) for name in study.fitted}
    own = {name: {stage: open_record(artefact_path(one.run_dir, stage)) for stage in (INTERPOLATE, VERIFY)} for name, one in each.items()}
    doubts = _doubts(study, records)
    for name, one in each.items():
        doubts += [f"{name}: {text}" for text in _doubts(one, {INTERPOLATE: own[name][INTERPOLATE]})]
    task = job(study.run_dir, NAME, {**study.config_of("name", "stages", "simulate", "experiments"), "stale": doubts}, shared)

    def make() -> Made:
        made = [_make(one, {**records, **own[name]}, doubts).summary for name, one in each.items()]
        figures = [path for summary in made for path in summary[FIGURES]]
        texts = [summary["report"] for summary in made]
        line = f"{len(figures)} figures and {len(texts)} reports written to the folders of the experiments in {study.run_dir}"
        return Made({}, {**_judged(line, doubts), FIGURES: figures, "reports": texts, "verified": records[VERIFY].summary["verdict"]})

    outcome = produce(task, make, force=force)
    if outcome.fresh and not all(Path(path).exists() for path in (*outcome.record.summary[FIGURES], *outcome.record.summary["reports"])):
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


def _make(study: Study, records: dict[str, Record], doubts: list[str]) -> Made:
    text = study.run_dir / TEXT
    try:
        with matplotlib.rc_context(STYLE):
            pictures = _figures(study, records) if study.coupon is None else coupon_figures(records)
            figures = save_figures(study.run_dir / FIGURES, pictures)
        with replacing(text, durable=False) as temporary:
            words = report_text if study.coupon is None else coupon_report_text
            temporary.write_text(words(study, records, figures, doubts), encoding="utf-8")
    except OSError as error:
        raise StudyError(f"report: '{study.run_dir}' cannot be written ({error}): expected a writable folder with free space") from error
    summary = {
        **_judged(f"{len(figures)} figures and {TEXT} written to {study.run_dir}", doubts),
        FIGURES: [str(path) for path in figures],
        "report": str(text),
        "verified": records[VERIFY].summary["verdict"],
    }
    return Made({}, summary)


def _figures(study: Study, records: dict[str, Record]) -> dict[str, Figure]:
    """Every figure that the records allow, by the name of its file; what the experiment does not have is left out."""
    verify, interpolate = records[VERIFY], records[INTERPOLATE]
    data = measured_of(interpolate)
    spans = named_phases(data.phases)
    identified = [records[name] for name in IDENTIFY if name in records]
    t0, t1, _ = window_times(study.stages.elastic.window, data, data.steps["displacement"])
    made = {
        "stress-stretch": stress_stretch_figure(verify, (t0, t1)),
        "temperature": temperature_figure(verify, spans) if verify.has("curves/temperature/time") else None,
        "force": force_figure(interpolate, spans),
        "residual-over-time": over_time_figure(verify, spans),
        "residual-maps-u": residual_maps(verify, "du"),
        "residual-maps-theta": residual_maps(verify, "dtheta"),
        "residual-rms-maps": rms_maps(verify),
        "objective": objective_figure(identified),
        "correlation": correlation_figure(identified),
    }
    return {name: figure for name, figure in made.items() if figure is not None}
