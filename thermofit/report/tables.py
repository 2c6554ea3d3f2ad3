"""The written report: what was measured, how noisy it is, what was identified, what is left. Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from thermofit.records.artefact import Record
from thermofit.records.result import exact_words
from thermofit.study.section import recorded_mesh
from thermofit.study.study import Study

LEAST_SHARE = 0.01
"""Share of the variance from which on a cause is named."""


def report_text(study: Study, records: Mapping[str, Record], figures: Sequence[Path], stale: Sequence[str] = ()) -> str:
    """The report of a run as Markdown; `records` by stage hold `interpolate`, `verify` and the identification stages that have run, `stale`
    why they are not what the study would give now."""
    verify, interpolate = records["verify"], records["interpolate"]
    parts = [
        f"# {study.name}",
        *stale_lines(study, stale),
        str(verify.summary["verdict"]) + ".",
        "## Study and data",
        table(("item", "value"), _study_rows(study, records)),
        "## Noise of the data",
        table(("quantity", "standard deviation", "estimated by"), _noise_rows(interpolate)),
        "## Parameters",
        table(*parameter_rows(study, verify)),
        *budget_lines(verify, records),
        "## Channels",
        "Coupled run with all parameters; `noise` is the rms that noise alone would give.",
        table(("channel", "n", "rms", "noise", "unit", "chi2/n", "lag-1", "lag-1 of noise"), _channel_rows(verify.summary["channels"])),
        "## Phases of the test",
        table(("channel", "phase", "t0 s", "t1 s", "n", "rms", "noise", "unit", "chi2/n", "lag-1", "lag-1 of noise"), phase_rows(verify)),
        "## Energy and coupling",
        table(("quantity", "value", "unit"), _energy_rows(verify)),
        "## Remarks",
        *remark_lines(records),
        "## Figures",
        *(f"![{path.stem}]({path.parent.name}/{path.name})" for path in figures),
    ]
    return "\n\n".join(parts) + "\n"


def stale_lines(study: Study, stale: Sequence[str]) -> list[str]:
    """A warning where results are stale, empty where they are not."""
    if not stale:
        return []
    return ["**Stale results:** " + "; ".join(stale) + f". `thermofit run {study.source.name}` makes anew what has changed."]


def meshes(records: Mapping[str, Record]) -> str:
    """The mesh by which the artefacts were made, of every stage where they differ."""
    found = {stage: _mesh(record.config) for stage, record in records.items() if "mesh" in record.config}
    if len(set(found.values())) == 1:
        return next(iter(found.values()))
    return "; ".join(f"{stage}: {mesh}" for stage, mesh in found.items())


def _mesh(config: Mapping[str, Any]) -> str:
    geometry = config.get("geometry", {})
    if geometry.get("shape") == "file":
        return f"hex8 of the file {geometry['file']}"
    model = "whole body" if geometry.get("part") == "full" else "quarter model"
    return f"{recorded_mesh(config['mesh']).words} hex8 of the {model}"


def table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; a bar inside a cell is escaped."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines)


def _study_rows(study: Study, records: Mapping[str, Record]) -> list[tuple[str, str]]:
    verify, interpolate = records["verify"], records["interpolate"]
    s = interpolate.summary
    gauge = [s["specimen"][name] for name in ("gauge_width", "thickness", "parallel_length")]
    rows = [
        ("study file", study.source.name),
        ("raw data", ("virtual experiment, " if study.virtual else "") + str(study.experiment)),
        ("specimen", f"gauge {gauge[0]:g} mm x {gauge[1]:g} mm, parallel length {gauge[2]:g} mm"),
        ("air, jaws", f"{s['temperatures']['theta_air']:.2f} K, {s['temperatures']['theta_clamp']:.2f} K"),
        ("material", f"model {verify.config['model']}"),
        ("mesh", meshes(records)),
        ("load steps", str(len(interpolate["steps/all/time"].value))),
        ("compared points", str(s["displacement" if "displacement" in s else "temperature"]["nodes"])),
    ]
    if "displacement" in s:
        rows.append(("displacements", f"{len(interpolate['u/time'].value)} times, {s['displacement']['masked']} values left out"))
    else:
        rows.append(("displacements", "none; the motion is computed under the measured force"))
    if "temperature" in s:
        rows.append(("temperatures", f"{len(interpolate['theta/time'].value)} times, {s['temperature']['masked']} values left out"))
    rows += [("repairs of the data", str(text)) for text in s.get("repairs", ())]
    rows.append(("thermofit", f"{verify.attributes['thermofit_version']}, source {verify.attributes['source_digest'][:12]}"))
    return rows


def _noise_rows(interpolate: Record) -> list[tuple[str, str, str]]:
    s = interpolate.summary
    rows = []
    if (u := s.get("displacement")) is not None:
        rows += [
            (f"u_{axis}, raw points", f"{1e3 * v:.2f} um", str(u["noise_method"])) for axis, v in zip("xy", u["noise_mm"], strict=True)
        ]
    if "temperature" in s:
        rows.append(("theta, raw pixels", f"{1e3 * s['temperature']['noise_K']:.1f} mK", str(s["temperature"]["noise_method"])))
    force = s["force"]
    rows.append(("force", f"{force['noise_N']:.2f} N", f"smoothing takes away {force['residual_rms_N']:.2f} N rms"))
    return rows


def parameter_rows(study: Study, verify: Record) -> tuple[list[str], list[list[str]]]:
    """Columns and rows of the identified parameters, with the truth of a virtual experiment where there is one."""
    truth = None if study.simulate is None else study.simulate.truth
    columns = ["parameter", "unit", "value", "standard uncertainty", "start", "bounds"]
    if truth is not None:
        columns += ["true", "deviation", "in standard uncertainties"]
    rows = []
    for name in _free_order(study, verify):
        p = verify.parameters[name]
        bound = f"{p.lower:.6g} to {p.upper:.6g}" + (", reached" if p.at_bound else "")
        row = [name, p.unit, f"{p.value:.6g}", "-" if p.sigma is None else f"{p.sigma:.2g}", f"{p.start:.6g}", bound]
        if truth is not None:
            true = study.truth_of(name)
            row += [
                "-" if true is None else f"{true:.6g}",
                f"{100.0 * (p.value / true - 1.0):+.2f} %" if true else "-",
                "-" if true is None or not p.sigma else f"{(p.value - true) / p.sigma:+.1f}",
            ]
        rows.append(row)
    return columns, rows


def budget_lines(verify: Record, records: Mapping[str, Record]) -> list[str]:
    """What the standard uncertainties are made of: for every parameter its causes, largest first."""
    told = [record for record in records.values() if record.summary.get("budget")]
    rows: dict[str, list[str]] = {}
    for record in told:
        for name, causes in record.summary["budget"].items():
            rows[name] = [name, ", ".join(f"{c['cause']} {100.0 * c['share']:.0f} %" for c in causes if c["share"] >= LEAST_SHARE)]
    if not rows:
        return ["Standard uncertainties hold the noise of the data only."]
    words = "Standard uncertainties are combined: noise of all channels, what was prescribed, mesh and steps. Shares of the variance:"
    helps, exact = str(told[-1].summary.get("helps_most", "")), told[-1].summary.get("exact", ())
    return [words, table(("parameter", "causes"), rows.values()), helps, *([f"{exact_words(exact).capitalize()}."] if exact else [])]


def _free_order(study: Study, verify: Record) -> list[str]:
    """Identified parameters in the order of the study's stages."""
    listed = (*study.stages.elastic.free, *study.stages.plastic.free, *study.stages.thermal.free)
    free = [name for name, p in verify.parameters.items() if p.free]
    return sorted(free, key=lambda name: listed.index(name) if name in listed else len(listed))


def _channel_rows(channels: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    rows = []
    for name, c in channels.items():
        label = name if c["judged"] else f"{name} (information)"
        rows.append([label, str(c["n"]), f"{c['rms']:.4g}", f"{c['floor_rms']:.4g}", c["unit"], f"{c['chi2_reduced']:.3g}", *_lags(c)])
    return rows


def phase_rows(verify: Record) -> list[list[str]]:
    """Rows of the table of phases."""
    rows = []
    for r in verify.summary["phases"]:
        place = [r["channel"], r["phase"], f"{r['t0_s']:.1f}", f"{r['t1_s']:.1f}", str(r["n"])]
        rows.append([*place, f"{r['rms']:.4g}", f"{r['floor_rms']:.4g}", r["unit"], f"{r['chi2_reduced']:.3g}", *_lags(r)])
    return rows


def _lags(row: Mapping[str, Any]) -> list[str]:
    return ["-" if row[key] is None else f"{row[key]:.2f}" for key in ("lag1", "lag1_noise")]


def _energy_rows(verify: Record) -> list[list[str]]:
    s = verify.summary
    rows = [[name.replace("_", ", "), f"{value:.6g}", "mJ"] for name, value in s["energy_mJ"].items() if name != "heat_defect"]
    rows.append(["defect of the heat balance", f"{s['energy_mJ']['heat_defect']:.2g}", "mJ"])
    rows.append(["smallest dissipation", f"{s['smallest_dissipation_mJ_mm3']:.2g}", "mJ/mm^3"])
    coupling = s["coupling_error"]
    if coupling is not None:
        rows.append(["one-way coupling, largest error", f"{1e3 * coupling['max_K']:.2g}", "mK"])
        rows.append(["one-way coupling, rms error", f"{1e3 * coupling['rms_K']:.2g}", "mK"])
    return rows


def remark_lines(records: Mapping[str, Record]) -> list[str]:
    """Every remark and note of every stage; stages whose answer is not to be trusted come with their verdict."""
    lines = []
    for stage, record in records.items():
        doubts = [str(record.summary["verdict"])] if record.summary.get("trustworthy") is False else []
        lines += [f"- {stage}: {text}" for text in (*doubts, *record.summary.get("remarks", ()), *record.summary.get("notes", ()))]
    return ["\n".join(lines) if lines else "None."]
