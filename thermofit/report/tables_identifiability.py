"""Tables of `identifiability`: rows of plain values, for the record, the terminal and --json alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from thermofit.core.parameters import param
from thermofit.fit.information import Flat
from thermofit.identify.identifiability import STRONG, Analysis, combination
from thermofit.identify.intervals import Interval
from thermofit.identify.linear import Linear

Row = dict[str, Any]


def determined_rows(linear: Linear, analysis: Analysis, half_width: float) -> list[Row]:
    """Per parameter: value, standard error, relative, the share of its effect that no other imitates, and the smallest change shown."""
    rows = []
    for i, name in enumerate(linear.names):
        held = name not in analysis.names
        k = -1 if held else analysis.names.index(name)
        sigma = float(analysis.sigma[i])
        rows.append(
            {
                "parameter": name,
                "unit": param(name).unit,
                "value": float(linear.x[i]),
                "sigma": sigma,
                "relative_sigma": sigma / float(linear.size[i]),
                "detectability": None if held else float(analysis.detectability[k]),
                "smallest_change": half_width * sigma,
                "at_bound": held,
            }
        )
    return rows


def correlation_rows(analysis: Analysis, which: str) -> list[Row]:
    """Matrix C^S (2.34) or C^P (2.37) as rows."""
    matrix = analysis.covariance.correlation_sensitivity if which == "C^S" else analysis.covariance.correlation_parameters
    names = analysis.covariance.names
    return [{which: name, **{other: float(matrix[i, j]) for j, other in enumerate(names)}} for i, name in enumerate(names)]


def spectrum_rows(analysis: Analysis) -> list[Row]:
    """Directions of the Hessian in relative changes, the best determined first: standard error along each, and its components."""
    s = analysis.spectrum
    return [
        {
            "direction": _words(analysis.names, s.vectors[:, k]),
            "sigma": float(s.sigma[k]),
            "eigenvalue": float(s.values[k]),
        }
        for k in range(len(s.values))
    ]


def _words(names: Sequence[str], vector: np.ndarray) -> str:
    """A direction by its components, the largest first, small ones left out."""
    order = np.argsort(-np.abs(vector))
    vector = vector * np.sign(vector[order[0]])
    return " ".join(f"{vector[i]:+.2f} {names[i]}" for i in order if abs(vector[i]) >= 0.05)


def flat_rows(flats: Sequence[Flat]) -> list[Row]:
    """Every flat direction with what stays constant along it."""
    return [
        {
            "members": list(flat.members),
            "direction": flat.direction.tolist(),
            "sigma": flat.sigma,
            "exact": flat.exact,
            "constant": [
                {
                    "combination": combination(i, flat.reference),
                    "exponent": i.exponent,
                    "relative_sigma": i.sigma,
                    "drift": i.drift if i.plain is not None else None,
                }
                for i in flat.invariants
            ],
        }
        for flat in flats
    ]


def shift_rows(linear: Linear, analysis: Analysis) -> list[Row]:
    """Relative change of every parameter by errors of what is prescribed, from the slopes."""
    return [
        {"by": linear.shifts[name].words, **{p: float(v) for p, v in zip(linear.names, change, strict=True)}}
        for name, change in analysis.shifts.items()
    ]


def sensitive(linear: Linear, change: np.ndarray) -> tuple[str, ...]:
    """Parameters that an error of something prescribed moves by a large share of their value, most first."""
    order = np.argsort(-np.abs(change))
    return tuple(linear.names[i] for i in order if abs(change[i]) >= STRONG)


def move_remarks(linear: Linear, analysis: Analysis) -> list[str]:
    """What an error of something prescribed moves, one sentence for each that moves anything by a large share."""
    out = []
    for name, change in analysis.shifts.items():
        strong = sensitive(linear, change)
        if strong:
            moves = ", ".join(f"{p} by {100.0 * change[linear.names.index(p)]:+.2g} %" for p in strong)
            out.append(f"{linear.shifts[name].words} moves {moves}; all others by less than {100.0 * STRONG:g} %")
    return out


def interval_rows(found: Mapping[str, Mapping[str, Interval]]) -> list[Row]:
    """One row for each parameter and way; `<`, `>` mark an end that a bound, not the data, sets."""
    names = list(dict.fromkeys(name for ways in found.values() for name in ways))
    return [
        {"parameter": name, "way": way, "low": ways[name].low, "high": ways[name].high, "open": _open(ways[name])}
        for name in names
        for way, ways in found.items()
        if name in ways
    ]


def _open(interval: Interval) -> str:
    return ", ".join(word for word, is_open in (("below", interval.open_low), ("above", interval.open_high)) if is_open)


def intervals_json(found: Mapping[str, Mapping[str, Interval]]) -> dict[str, dict[str, Any]]:
    """Per parameter and way: `[low, high]`, with `open` and remarks where there are any."""
    out: dict[str, dict[str, Any]] = {}
    for way, ways in found.items():
        for name, i in ways.items():
            out.setdefault(name, {})[way] = {
                "low": i.low,
                "high": i.high,
                "open_low": i.open_low,
                "open_high": i.open_high,
                "remark": i.remark,
            }
    return out


def programme_rows(found: Sequence[Row]) -> list[Row]:
    """Programmes ranked by the D-criterion: first those that determine all, then those that do so poorly, then those that leave something
    open; those that cannot be carried out at the end."""

    def place(row: Row) -> tuple[int, float]:
        order = {"unique": 0, "weak": 1, "failed": 3}.get(row["kind"], 2)
        return order, row["D"] if np.isfinite(row["D"]) and order < 3 else np.inf

    ordered = sorted(found, key=place)
    return [{"rank": n if row["kind"] != "failed" else None, **row} for n, row in enumerate(ordered, start=1)]
