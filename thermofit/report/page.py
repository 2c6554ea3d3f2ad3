"""Figures and text of a report: what the records of a test allow, of full fields or of coupon records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from thermofit.experiment.fields import Measured, measured_of
from thermofit.experiment.residuals import named_phases
from thermofit.experiment.verification import IDENTIFY
from thermofit.experiment.window import window_times
from thermofit.records.artefact import Record
from thermofit.report.figures_curves import force_figure, over_time_figure, records_figures, stress_stretch_figure, temperature_figure
from thermofit.report.figures_maps import residual_maps, rms_maps
from thermofit.report.figures_search import correlation_figure, objective_figure
from thermofit.report.tables import parameter_rows, phase_rows, remark_lines, report_text, stale_lines, table
from thermofit.study.study import Study

ROWS = "records"
"""Key of a check that lists coupon records one by one."""


def figures_of(study: Study, records: Mapping[str, Record]) -> dict[str, Figure]:
    """Every figure that the records (by stage) of a test allow, by the name of its file; what it does not have is left out."""
    verify, interpolate = records["verify"], records["interpolate"]
    if ROWS in verify.summary:
        return records_figures(records)
    data = measured_of(interpolate)
    spans = named_phases(data.phases)
    identified = [records[name] for name in IDENTIFY if name in records]
    made = {
        "stress-stretch": _stress_stretch(study, data, verify),
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


def _stress_stretch(study: Study, data: Measured, verify: Record) -> Figure | None:
    """The curve with the elastic window; None without displacements."""
    if data.displacement is None:
        return None
    t0, t1, _ = window_times(study.stages.elastic.window, data, data.steps["displacement"])
    return stress_stretch_figure(verify, (t0, t1))


def text_of(study: Study, records: Mapping[str, Record], figures: Sequence[Path], stale: Sequence[str]) -> str:
    """The report as Markdown; `stale`: why the records are not what the study would give now."""
    words = records_text if ROWS in records["verify"].summary else report_text
    return words(study, records, figures, stale)


def records_text(study: Study, records: Mapping[str, Record], figures: Sequence[Path], stale: Sequence[str] = ()) -> str:
    """The report of a run on coupons; `records` by stage hold `interpolate`, `verify` and the identification stages that have run, `stale`
    why they are not what the study would give now."""
    verify, interpolate = records["verify"], records["interpolate"]
    phases = ("channel", "phase", "t0 s", "t1 s", "n", "rms", "noise", "unit", "chi2/n", "lag-1", "lag-1 of noise")
    parts = [
        f"# {study.name}",
        *stale_lines(study, stale),
        str(verify.summary["verdict"]) + ".",
        "## Records",
        f"Prescribed: {interpolate.summary['control']}. Material: model {verify.config['model']}. "
        f"thermofit {verify.attributes['thermofit_version']}, source {verify.attributes['source_digest'][:12]}.",
        table(
            ("record", "samples", "duration s", "strain", "stress MPa", "start K", "noise of strain", "of stress MPa", "of theta K"),
            _rows(interpolate),
        ),
        "## Parameters",
        table(*parameter_rows(study, verify)),
        "Standard errors count the memory of the misfit (Newey and West); fixed parameters and earlier stages count as exact.",
        "## Channels",
        table(("channel", "n", "independent", "rms", "noise", "unit", "chi2/n"), _channel_rows(verify)),
        "## Phases of the test",
        table(phases, phase_rows(verify)),
        "## Remarks",
        *remark_lines(records),
        "## Figures",
        *(f"![{path.stem}]({path.parent.name}/{path.name})" for path in figures),
    ]
    return "\n\n".join(parts) + "\n"


def _rows(interpolate: Record) -> list[list[str]]:
    out = []
    for row, facts in zip(interpolate.summary["records"], interpolate.summary["tests"], strict=True):
        noise = [f"{facts['noise'][name]:.2g}" if name in facts["noise"] else "-" for name in ("strain", "stress", "theta")]
        start = f"{facts['theta_start']:.2f}"
        out.append([row["record"], str(row["n"]), f"{row['duration_s']:.4g}", row["strain"], row["stress_MPa"], start, *noise])
    return out


def _channel_rows(verify: Record) -> list[list[str]]:
    return [
        [name, str(c["n"]), f"{c['n_independent']:.3g}", f"{c['rms']:.4g}", f"{c['floor_rms']:.4g}", c["unit"], f"{c['chi2_reduced']:.3g}"]
        for name, c in verify.summary["channels"].items()
    ]
