"""Figure of an unlisted effect: where it is, and how strong it is over time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thermofit.diagnose.trace import Traced
from thermofit.diagnose.unlisted import Unlisted
from thermofit.report.figures import NOISE, new_figure, shade_phases, symmetric_limit
from thermofit.report.figures_maps import Scale, draw_map

_FINE = 41
_WORDS = {"heat": "missing heat source", "displacement": "missing displacement", "stress": "missing stress"}


def unlisted_figure(here: Traced, found: Unlisted) -> Figure:
    """Map of the mean in the window (a body), and the strength over time with two standard errors."""
    field, place = found.field, found.place
    assert field is not None and place is not None
    mapped = field.basis.grid.places > 1
    figure = new_figure(7.6 if mapped else 5.2, 3.6)
    grid = figure.add_gridspec(1, 2 if mapped else 1, width_ratios=(1.0, 2.0) if mapped else None)
    over_time = figure.add_subplot(grid[0, -1])
    if mapped:
        _map(figure, figure.add_subplot(grid[0, 0]), found)
    handles = shade_phases([over_time], here.case.spans)
    lines = over_time.plot(place.time, place.strength, color="tab:red", marker="o")
    over_time.fill_between(place.time, place.strength - 2.0 * place.sigma, place.strength + 2.0 * place.sigma, **NOISE)
    for t in place.when:
        over_time.axvline(t, color="black", linewidth=0.7, linestyle="--")
    over_time.axhline(0.0, color="black", linewidth=0.6)
    unit = "mW" if mapped and field.basis.kind == "heat" else field.basis.unit
    over_time.set_xlabel("time in s")
    over_time.set_ylabel(f"{_WORDS[field.basis.kind]} in {unit}")
    over_time.legend(handles=[*lines, *handles], labels=["reconstructed", *(h.get_label() for h in handles)], loc="best")
    return figure


def _map(figure: Figure, ax: Axes, found: Unlisted) -> None:
    """Mean of the term in its window over the face."""
    field, place = found.field, found.place
    assert field is not None and place is not None
    grid = field.basis.grid
    inside = (grid.time >= place.when[0]) & (grid.time <= place.when[1])
    values = field.values[inside] if inside.any() else field.values[[int(np.argmax(np.abs(place.strength)))]]
    mean = values.mean(axis=0)
    level = mean[:, :, 0] if grid.components == 1 else np.linalg.norm(mean, axis=2)
    x, y = np.linspace(grid.x[0], grid.x[-1], _FINE), np.linspace(grid.y[0], grid.y[-1], _FINE)
    along = np.stack([np.interp(y, grid.y, column) for column in level.T], axis=1)
    fine = np.stack([np.interp(x, grid.x, row) for row in along])
    xy = np.stack([np.tile(x, _FINE), np.repeat(y, _FINE)], axis=1)
    limit = symmetric_limit(fine, 1e-12)
    image = draw_map(ax, xy, fine.ravel(), Scale(-limit, limit, "RdBu_r"))
    ax.plot(*place.centroid, marker="+", color="black", markersize=8.0)
    ax.set_xlabel("x in mm")
    ax.set_ylabel("y in mm")
    figure.colorbar(image, ax=ax, label=f"mean in the window, {field.basis.unit}")
