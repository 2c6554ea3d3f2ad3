"""Figures of searches: the objective over the evaluations, the correlation of what was found, where every start ends, how optima move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from thermofit.core.parameters import is_known, param
from thermofit.records.artefact import Record
from thermofit.report.figures import draw_matrix, new_figure

_COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:purple")


def objective_figure(records: Sequence[Record]) -> Figure | None:
    """Objective (2.24) per compared value over the evaluations of every stage, and the best one so far; None without any."""
    records = [record for record in records if record.has("evaluations/f")]  # a stage may have had nothing to identify
    if not records:
        return None
    figure = new_figure(3.2 * len(records) + 0.6, 3.2)
    axes = figure.subplots(1, len(records), squeeze=False)[0]
    for ax, record in zip(axes, records, strict=True):
        _objective(ax, record)
    axes[0].set_ylabel("objective f / n")
    return figure


def _objective(ax: Axes, record: Record) -> None:
    n = sum(int(channel["n"]) for channel in record.summary["channels"].values())
    f, purpose = record["evaluations/f"].value / max(n, 1), record["evaluations/purpose"].value
    number = np.arange(1, len(f) + 1)
    good = np.isfinite(f) & ~record["evaluations/failed"].value.astype(bool)
    for colour, kind in zip(_COLOURS, dict.fromkeys(purpose.tolist()), strict=False):
        here = good & (purpose == kind)
        ax.plot(number[here], f[here], linestyle="none", marker="o", color=colour, label=kind)
    if good.any():
        ax.step(number, np.minimum.accumulate(np.where(good, f, np.inf)), where="post", color="black", linewidth=0.9, label="best so far")
        ax.set_yscale("log")
        spread = float(f[good].max() / max(f[good].min(), np.finfo(float).tiny))
        if spread < 10.0:
            _plain_log_scale(ax, f[good])
    failed = f", {int((~good).sum())} failed" if (~good).any() else ""
    ax.set_title(f"{record.stage}: {len(f)} evaluations{failed}")
    ax.set_xlabel("evaluation")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend(loc="upper right")


def _plain_log_scale(ax: Axes, f: np.ndarray) -> None:
    """Less than a decade has no ticks on a logarithmic scale: a linear one with room above."""
    ax.set_yscale("linear")
    low, high = float(f.min()), float(f.max())
    pad = max(0.1 * (high - low), 1e-3 * abs(high))
    ax.set_ylim(low - pad, high + 3.0 * pad)


def correlation_figure(records: Sequence[Record]) -> Figure | None:
    """Correlation of the identified parameters (2.37) of every stage that has one; None where none has."""
    shown = [record for record in records if record.has("correlation")]
    if not shown:
        return None
    sizes = [len(record["evaluations/names"].value) for record in shown]
    figure = new_figure(0.62 * sum(sizes) + 1.3 * len(shown) + 1.0, 0.62 * max(sizes) + 1.9)
    axes = figure.subplots(1, len(shown), squeeze=False, width_ratios=sizes)[0]
    for ax, record in zip(axes, shown, strict=True):
        names, matrix = record["evaluations/names"].value.tolist(), record["correlation"].value
        image = draw_matrix(ax, matrix, names, names, aspect="equal")
        ax.set_title(record.stage)
        ax.set_anchor("N")
    figure.colorbar(image, ax=list(axes), label="correlation", shrink=0.9, panchor=False)
    figure.draw_without_rendering()  # squares change their place in the first layout, and their labels need a second one
    return figure


_COLUMNS = 4
_WIDE = 30.0
"""Largest over smallest value from which an axis is logarithmic."""
_LINES = ("-", "--", "-.", ":")


def basin_figure(record: Record) -> Figure:
    """Optimum over start for every free parameter, and f of every start; one colour per optimum, from a record of `gridsearch`."""
    names = record["starts/names"].value.tolist()
    start, optimum, f = (record[f"starts/{key}"].value for key in ("start", "optimum", "f"))
    group = record["starts/group"].value
    rows = -(-(len(names) + 1) // _COLUMNS)
    columns = min(_COLUMNS, len(names) + 1)
    figure = new_figure(2.6 * columns + 0.4, 2.4 * rows + 0.3)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes[len(names) + 1 :]:
        ax.set_visible(False)
    for index, name in enumerate(names):
        _points(axes[index], start[:, index], optimum[:, index], group)
        unit = param(name).unit
        axes[index].set_title(name if unit == "1" else f"{name} in {unit}")
        axes[index].set_xlabel("start")
        axes[index].set_ylabel("optimum")
    last = axes[len(names)]
    _points(last, np.arange(1, len(f) + 1), f / np.nanmin(f), group)
    last.set_title("objective over the lowest one")
    last.set_xlabel("start number")
    last.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


def _points(ax: Axes, x: np.ndarray, y: np.ndarray, group: np.ndarray) -> None:
    """Points (n,) in the colour of their optimum; crosses did not converge, failed starts are ticks on the axis."""
    if _spans(x):
        ax.set_xscale("log")
    if _spans(y):
        ax.set_yscale("log")
    for number in sorted(set(group.tolist())):
        here = (group == number) & np.isfinite(y)
        marker, colour = ("x", "0.5") if number == 0 else ("o", f"C{(number - 1) % 10}")
        ax.plot(x[here], y[here], linestyle="none", marker=marker, color=colour, markersize=4.5)
    lost = ~np.isfinite(y)
    if lost.any():
        ax.plot(x[lost], np.zeros(int(lost.sum())), linestyle="none", marker="|", color="tab:red", transform=ax.get_xaxis_transform())
    good = y[np.isfinite(y)]
    if good.size and good.max() - good.min() < 1e-3 * abs(good.mean()):
        # Optima that agree are one height, not a picture of the last digits.
        ax.set_ylim(good.mean() - 0.05 * abs(good.mean()), good.mean() + 0.05 * abs(good.mean()))


def _spans(values: np.ndarray) -> bool:
    good = values[np.isfinite(values)]
    return bool(good.size and good.min() > 0.0 and good.max() > _WIDE * good.min())


def change_figure(record: Record) -> Figure:
    """Relative change of every parameter over the prescribed value: identified anew (points), and linearised (lines); of `sensitivity`."""
    names = record["values/names"].value.tolist()
    value, change = record["values/value"].value, 100.0 * record["values/change"].value
    slopes: Mapping[str, float] = record.summary["linearised"]["relative_slope"]
    quantity = str(record.summary["quantity"])
    figure = new_figure(6.4, 4.2)
    ax = figure.subplots()
    ends = np.array([value.min(), value.max()])
    for index, name in enumerate(names):
        colour = f"C{index % 10}"
        ax.plot(value, change[:, index], linestyle="none", marker="osD^vP"[index % 6], markersize=4.5, color=colour, label=name)
        if slopes.get(name) is not None:
            ax.plot(ends, 100.0 * slopes[name] * (ends - value[0]), linestyle=_LINES[index % 4], linewidth=0.9, color=colour)
    ax.axhline(0.0, color="black", linewidth=0.6)
    ax.axvline(value[0], color="black", linewidth=0.6, linestyle=":")
    unit = param(quantity).unit if is_known(quantity) else str(record.summary["unit"])
    ax.set_xlabel(quantity if unit == "1" else f"{quantity} in {unit}")
    ax.set_ylabel("relative change in %")
    ax.set_title("points: identified anew; lines: linearised at the nominal value")
    ax.legend(loc="best")
    return figure
