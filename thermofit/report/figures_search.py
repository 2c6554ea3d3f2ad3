"""Figures of the search: the objective over the evaluations and the correlation of what was found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

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
