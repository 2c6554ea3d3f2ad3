"""Figures over the face of the specimen: residuals at named moments, and where they exceed the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.figure import Figure

from thermofit.records.artefact import Record
from thermofit.report.figures import new_figure, symmetric_limit

_COLUMN, _ROW = 1.9, 2.9
"""Size of one map in inches."""


@dataclass(frozen=True)
class Scale:
    """Colours of a map and the values at both their ends."""

    low: float
    high: float
    colours: str


def residual_maps(verify: Record, channel: str) -> Figure | None:
    """Model minus measurement of du (um, x and y) or dtheta (mK) over the face at the named moments; None without that channel.

    The common scale of a row covers 99.5 % of its values and at least four standard errors of the noise.
    """
    if not verify.has(f"snapshots/{channel}/error"):
        return None
    field = "u" if channel == "du" else "theta"
    xy, error = verify[f"{field}/xy"].value, verify[f"snapshots/{channel}/error"].value
    times, names = verify[f"snapshots/{channel}/time"].value, verify["snapshots/name"].value
    noise = float(verify.summary["channels"][channel]["floor_rms"])
    unit, labels = ("um", ("du_x", "du_y")) if channel == "du" else ("mK", ("dtheta",))
    rows, columns = len(labels), len(names)
    figure = new_figure(_COLUMN * columns + 1.2, _ROW * rows + 0.5)
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for row, label in enumerate(labels):
        limit = 1e3 * symmetric_limit(error[:, :, row], 4.0 * noise)
        for column in range(columns):
            ax = axes[row, column]
            image = draw_map(ax, xy, 1e3 * error[column, :, row], Scale(-limit, limit, "RdBu_r"))
            if row == 0:
                ax.set_title(f"{names[column]}\nt = {times[column]:.1f} s")
        figure.colorbar(image, ax=list(axes[row]), label=f"{label}: model - measured in {unit}", shrink=0.9, extend="both")
    _label(axes)
    return figure


def rms_maps(verify: Record) -> Figure:
    """Rms over time of residual/sigma at every point for du_x, du_y and dtheta, where the test has them: one where only noise is left."""
    shown = []
    for field, channel, labels in (("u", "du", ("du_x", "du_y")), ("theta", "dtheta", ("dtheta",))):
        if verify.has(f"maps/{channel}"):
            value = verify[f"maps/{channel}"].value
            shown += [(label, verify[f"{field}/xy"].value, value[:, k]) for k, label in enumerate(labels)]
    figure = new_figure(_COLUMN * len(shown) + 1.2, _ROW + 0.5)
    axes = figure.subplots(1, len(shown), squeeze=False, sharex=True, sharey=True)
    high = max(2.0, *(float(np.nanmax(value)) for _, _, value in shown))
    for ax, (name, xy, value) in zip(axes[0], shown, strict=True):
        image = draw_map(ax, xy, value, Scale(0.0, high, "viridis"))
        used = value[np.isfinite(value)]
        ax.set_title(f"{name}: {used.min():.2f} to {used.max():.2f}")
    figure.colorbar(image, ax=list(axes[0]), label="rms over time / noise", shrink=0.9)
    _label(axes)
    return figure


def _label(axes: np.ndarray) -> None:
    for ax in axes[-1]:
        ax.set_xlabel("x in mm")
    for ax in axes[:, 0]:
        ax.set_ylabel("y in mm")


def draw_map(ax: Axes, xy: np.ndarray, value: np.ndarray, scale: Scale) -> Collection:
    """Values (n,) at points xy (n, 2) mm: cells around the points of a grid, else coloured dots. Points without a value are grey."""
    ax.set_aspect("equal")
    ax.set_facecolor("0.75")
    x, column = np.unique(np.round(xy[:, 0], 6), return_inverse=True)
    y, row = np.unique(np.round(xy[:, 1], 6), return_inverse=True)
    if len(x) * len(y) == len(xy) and min(len(x), len(y)) > 1:
        grid = np.full((len(y), len(x)), np.nan)
        grid[row, column] = value
        colours = np.ma.masked_invalid(grid)
        return ax.pcolormesh(x, y, colours, shading="nearest", cmap=scale.colours, vmin=scale.low, vmax=scale.high)
    used = np.isfinite(value)
    where = xy[used]
    return ax.scatter(where[:, 0], where[:, 1], c=value[used], s=12.0, marker="s", cmap=scale.colours, vmin=scale.low, vmax=scale.high)
