"""Figures of `identifiability`: correlations, spectrum with its directions, profiles, and programmes side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from thermofit.fit.information import FREEDOM
from thermofit.identify.identifiability import Analysis
from thermofit.identify.intervals import Interval
from thermofit.identify.linear import Linear
from thermofit.report.figures import draw_matrix, new_figure

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
