"""The written report of coupon records. Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from thermofit.records.artefact import Record
from thermofit.report.tables import parameter_rows, phase_rows, remark_lines, stale_lines, table
from thermofit.study.study import Study


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
