"""Tables that several pages of docs/reproduction share: identified beside the thesis, optima of all starts, and a page as a whole."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from thesis_printed import Values
from thesis_read import SIZES, Statement, cell, free_names, headings, left_over, per_datum, squared_error, value
from thesis_runs import RUNS, TOTAL, Place, cpu_of, noted

from thermofit.records.artefact import Record
from thermofit.report.tables import table

UNWEIGHTED = "f_theta in K^2"


def identified(record: Record, printed: Values, truth: Record) -> str:
    """Start, optimum, standard error, virtual material, deviation from it, and the thesis's figure; one row per parameter."""
    lines = []
    for name in free_names(record):
        p, true = record.parameters[name], value(truth, name)
        sigma = "-" if p.sigma is None else f"{SIZES[name][0] * p.sigma:.2g}"
        off = f"{100.0 * (p.value / true - 1.0):+.2f} %" if true else "-"
        flag = " (bound)" if p.at_bound else ""
        lines.append(
            [SIZES[name][1], cell(name, p.start), cell(name, p.value) + flag, sigma, cell(name, true), off, cell(name, printed.get(name))]
        )
    return table(["parameter", "start", "identified", "standard error", "virtual material", "deviation", "thesis"], lines)


def misfit(record: Record, channel: str) -> str:
    """What is left of a channel, in words."""
    rms, floor, n = left_over(record, channel)
    factor, unit = (1e3, "mK") if channel == "dtheta" else (1e3, "um")
    return f"rms {factor * rms:.3g} {unit}, {rms / floor:.2f} times the noise, {n} values"


def starts_table(record: Record, printed: Sequence[Values] = (), ratios: Sequence[str] = ()) -> str:
    """Optimum of every start with its objective per datum, and the thesis's rows below; `ratios` of parameters to beta beside them."""
    names = free_names(record)
    lines = []
    for number, start in enumerate(record.summary["starts"], start=1):
        if start["failed"]:
            lines.append([str(number), *["failed"] * (len(names) + len(ratios)), ""])
            continue
        x = start["optimum"]
        at = [cell(name, x[name]) + (" (bound)" if name in start["at_bound"] else "") for name in names]
        lines.append(
            [
                str(number),
                *at,
                *_over_beta(x, ratios),
                f"{per_datum(record, start):.5f}" + ("" if start["converged"] else " (not converged)"),
            ]
        )
    for number, row in enumerate(printed, start=1):
        label = "thesis" if len(printed) == 1 else f"thesis {number}"
        lines.append([label, *(cell(name, row.get(name)) for name in names), *_over_beta(row, ratios), f"f {row['f']:.2f} K^2"])
    heads = [f"{name}/beta" for name in ratios]
    return table(["start", *headings(names), *heads, "chi2 per datum"], lines)


def _over_beta(row: Mapping[str, float], ratios: Sequence[str]) -> list[str]:
    return [cell(name, row[name] / row["beta"]) if name in row else "-" for name in ratios]


def of_f(thermal: Record, printed: float) -> str:
    """Why the f of the thesis is not comparable, with the same sum here."""
    rms, floor, n = left_over(thermal)
    return (
        f"The unweighted sum of the thesis's f is {squared_error(thermal):.2f} K^2 over {n} values here (rms {1e3 * rms:.1f} mK, noise "
        f"{1e3 * floor:.1f} mK). The thesis has {printed:.2f} K^2 over its own points and steps. Only its ratios mean something."
    )


def document(title: str, place: Place, parts: Sequence[str], statements: Sequence[Statement]) -> str:
    """A page: what the data are, what holds, tables and figures."""
    size = {"quick": "2 x 16 x 1", "coarse": "6 x 40 x 2", "full": "12 x 80 x 4"}[place.mesh]
    made = "2 x 16 x 1" if place.mesh == "quick" else "10 x 72 x 3"
    head = (
        f"Written by `make thesis MESH={place.mesh}`. The data are virtual: files of force, image correlation and infrared camera. "
        "They have noise, rigid-body motion, compliance and slip of the machine, and a turned camera. They were computed on a mesh of "
        f"{made} elements and identified from the files on {size}. The thesis's own measurements are not public. {_time_of(place)}"
    )
    return "\n\n".join([f"# {title}", head, "## What was found", "\n".join(s.line for s in statements), *parts]) + "\n"


def _time_of(place: Place) -> str:
    """How long the last call from nothing took, or that there was none."""
    calls = noted(place.folder / TOTAL)
    anew = [n for n, entry in enumerate(calls) if entry["from_nothing"]]
    if not anew:
        spent = cpu_of(RUNS, place)
        return f"The runs behind the pages were made in several goes, with {spent / 60.0:.1f} minutes of CPU time in all."
    last, later = calls[anew[-1]], calls[anew[-1] + 1 :]
    wall, cpu = (sum(entry[key] for entry in later) / 60.0 for key in ("wall_s", "cpu_s"))
    again = f" Later calls made anew what had changed since, in {wall:.1f} minutes with {cpu:.1f} minutes of CPU time." if later else ""
    return (
        f"All runs behind section(s) {', '.join(last['sections'].split())} were made from nothing in {last['wall_s'] / 60.0:.1f} minutes, "
        f"{last['jobs']} at a time. They took {last['cpu_s'] / 60.0:.1f} minutes of CPU time, on a machine of {os.cpu_count()} cores."
        f"{again}"
    )
