"""Page on the nodal values: what changes where they come from all points and pixels instead of the three nearest (algorithms 2 and 3)."""

from __future__ import annotations

import numpy as np
from thesis_read import SIZES, cell, free_names, value
from thesis_runs import INTERPOLATED, THREE_POINT, Place

from thermofit.records.artefact import Record
from thermofit.report.tables import table


def deviations(record: Record, truth: Record) -> dict[str, tuple[float, float]]:
    """Deviation from the virtual material and combined standard uncertainty of every identified parameter."""
    found = {name: record.parameters[name] for name in free_names(record) if not name.startswith("theta_")}
    return {name: (p.value - value(truth, name), p.sigma) for name, p in found.items() if p.sigma is not None}


def rows(place: Place, run: str) -> list[list[str]]:
    """Virtual material, then by interpolation the value, its +-, and the deviation from the material in its +-; one row per parameter."""
    truth = place.record(run, "simulate")
    both = [place.record(name, "refine") for name in (run, run + THREE_POINT)]
    found, lines = [deviations(record, truth) for record in both], []
    for name in found[0]:
        line = [SIZES[name][1], cell(name, value(truth, name))]
        for record, off in zip(both, found, strict=True):
            away, sigma = off.get(name, (np.nan, np.nan))
            line += [cell(name, record.parameters[name].value), f"{SIZES[name][0] * sigma:.2g}", f"{away / sigma:+.1f}"]
        lines.append(line)
    return lines


def compared(place: Place, run: str) -> str:
    """What changes, in words: the data used, the widths, the departures."""
    truth = place.record(run, "simulate")
    found = [deviations(place.record(name, "refine"), truth) for name in (run, run + THREE_POINT)]
    both = [name for name in found[0] if name in found[1]]
    width = float(np.median([found[1][name][1] / found[0][name][1] for name in both]))
    moved = {
        name: abs(found[1][name][0] - found[0][name][0]) / np.hypot(found[0][name][1], found[1][name][1]) for name in both
    }  # fmt: skip
    most = max(moved, key=lambda name: moved[name])
    beyond = [sum(abs(away) > 2.0 * sigma for away, sigma in of.values()) for of in found]
    used = [_used(place.record(name, "interpolate")) for name in (run, run + THREE_POINT)]
    return (
        f"Projection uses {used[0]}, the other interpolation {used[1]}. With three points the standard uncertainties are {width:.2f} "
        f"times as large (median). The largest change is that of {most}, {moved[most]:.1f} of the combined uncertainty of both. "
        f"More than two of its own uncertainties off are {beyond[0]} of {len(found[0])} parameters by projection, {beyond[1]} of "
        f"{len(found[1])} by three points."
    )


def _used(record: Record) -> str:
    """Share of points and pixels that a record of `interpolate` has used; three values a node are known by their number alone."""
    if record.summary.get("nodal_values") is None:
        return "three values a node"
    parts = {row["field"]: row for row in record.summary["nodal_values"]}
    said = {"u": "of the DIC points", "theta": "of the pixels"}
    return " and ".join(f"{100.0 * row['share_used']:.0f} % {said[field]}" for field, row in parts.items() if field in said)


def page(place: Place) -> str:
    """The page as a whole."""
    heads = ["parameter", "virtual material", "projection", "+-", "off, in +-", "three points", "+-", "off, in +-"]
    parts = [
        "# Nodal values: all of the data, or three points",
        f"Written by `make thesis MESH={place.mesh}`. The same virtual experiments, identified twice: by projection of all points and "
        "pixels (the default), and with values from the three nearest ones as in the thesis "
        "(`evaluation.interpolation: three-point`). After the "
        "joint fit; +- is the combined standard uncertainty.",
    ]
    for run in sorted(INTERPOLATED):
        parts += [f"## {run}", compared(place, run), table(heads, rows(place, run))]
    return "\n\n".join(parts) + "\n"
