"""Tables and figures of `identifiability`: correlations, spectrum with its directions, intervals, profiles, and programmes side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from thermofit.core.parameters import param
from thermofit.fit.information import FREEDOM, Flat
from thermofit.identify.identifiability import STRONG, Analysis, combination
from thermofit.identify.intervals import Interval
from thermofit.identify.linear import Linear
from thermofit.report.figures import draw_matrix, new_figure

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


_ALLOWED = 3.84
"""Rise of the objective, in units of its variance, at the end of a 95 % interval."""


def correlations_figure(analysis: Analysis) -> Figure:
    """C^S (2.34) and C^P (2.37) side by side."""
    names = analysis.covariance.names
    figure = new_figure(1.24 * len(names) + 3.0, 0.62 * len(names) + 1.9)
    axes = figure.subplots(1, 2)
    for ax, matrix, title in zip(
        axes,
        (analysis.covariance.correlation_sensitivity, analysis.covariance.correlation_parameters),
        ("sensitivities $C^S$", "parameters $C^P$"),
        strict=True,
    ):
        image = draw_matrix(ax, matrix, names, names)
        ax.set_title(title)
    figure.colorbar(image, ax=list(axes), label="correlation", shrink=0.9)
    return figure


def spectrum_figure(analysis: Analysis) -> Figure | None:
    """Standard error along every eigenvector of the Hessian in relative changes, above the components of each; None for one parameter."""
    s = analysis.spectrum
    p = len(s.values)
    if p < 2:
        return None
    figure = new_figure(0.9 * p + 2.2, 0.5 * p + 3.0)
    upper, lower = figure.subplots(2, 1, height_ratios=(2.0, 0.5 * p + 0.6))
    height = np.clip(s.sigma, 1e-12, 1e4)
    upper.bar(range(p), height, color=["tab:red" if value > FREEDOM else "tab:blue" for value in s.sigma])
    upper.axhline(FREEDOM, color="black", linewidth=0.8, linestyle="--")
    upper.set_yscale("log")
    upper.set_xticks(range(p), [])
    upper.set_xlim(-0.5, p - 0.5)
    upper.set_ylabel("relative standard error")
    draw_matrix(lower, s.vectors, analysis.names, [f"direction {k + 1}" for k in range(p)])
    return figure


def profile_figure(linear: Linear, curves: Mapping[str, np.ndarray], intervals: Mapping[str, Mapping[str, Interval]]) -> Figure | None:
    """Rise of the objective over every parameter, with the parabola of Laplace's interval; None where no profile was made."""
    if not curves:
        return None
    columns = min(3, len(curves))
    rows = -(-len(curves) // columns)
    figure = new_figure(2.9 * columns, 2.5 * rows)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, (name, points) in zip(axes, curves.items(), strict=False):
        laplace = intervals["laplace"][name]
        half = 0.5 * (laplace.high - laplace.low)
        x = float(linear.x[linear.names.index(name)])
        grid = np.linspace(points[:, 0].min(), points[:, 0].max(), 101)
        if half > 0.0 and not laplace.open_low and not laplace.open_high:
            ax.plot(grid, np.minimum(_ALLOWED * ((grid - x) / half) ** 2, 3.0 * _ALLOWED), color="tab:blue", label="Laplace")
        ax.plot(points[:, 0], np.minimum(points[:, 1], 3.0 * _ALLOWED), "o-", color="tab:red", label="profile")
        ax.axhline(_ALLOWED, color="black", linewidth=0.8, linestyle="--")
        ax.set_title(name)
    axes[0].legend(loc="upper center")
    axes[0].set_ylabel("rise of the objective / variance")
    for ax in axes[len(curves) :]:
        ax.set_axis_off()
    return figure


def programmes_figure(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> Figure | None:
    """Relative standard error of every parameter after each programme; None where none could be carried out."""
    shown = [row for row in rows if row["kind"] != "failed"]
    if not shown:
        return None
    figure = new_figure(1.1 * len(names) + 2.5, 3.2)
    ax = figure.subplots()
    width = 0.8 / len(shown)
    for k, row in enumerate(shown):
        height = [min(max(float(row[name]), 1e-12), 1e4) for name in names]
        ax.bar(np.arange(len(names)) + (k - 0.5 * (len(shown) - 1)) * width, height, width, label=str(row["programme"]))
    ax.axhline(FREEDOM, color="black", linewidth=0.8, linestyle="--")
    ax.set_yscale("log")
    ax.set_xticks(range(len(names)), names)
    ax.set_ylabel("relative standard error")
    ax.legend(loc="upper right")
    return figure
