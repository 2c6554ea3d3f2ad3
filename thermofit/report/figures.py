"""How figures look and how they reach the disk: one style, panels with residuals below, phases of the test in the background."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Patch

from thermofit.core.errors import StudyError
from thermofit.core.files import replacing
from thermofit.experiment.residuals import Span

STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 9.0,
    "axes.linewidth": 0.7,
    "axes.grid": False,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.0,
    "legend.fontsize": 8.0,
    "legend.framealpha": 0.9,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "axes.formatter.useoffset": False,
    "image.interpolation": "nearest",
}
"""Settings of matplotlib for all figures of a report."""
MEASURED: dict[str, Any] = {"color": "black", "linestyle": "none", "marker": "o", "markerfacecolor": "white", "markeredgewidth": 0.7}
"""Measured values: open circles."""
MODEL: dict[str, Any] = {"color": "tab:red"}
"""The model: a red line."""
NOISE: dict[str, Any] = {"color": "tab:blue", "alpha": 0.2, "linewidth": 0.0}
"""Two standard errors of the noise: a blue band."""
PHASES: Mapping[str, str] = {
    "rest": "#e8e8e8",
    "elastic": "#fff1c9",
    "loading": "#fbe0dc",
    "unloading": "#dcebf7",
    "hold": "#ece2f3",
    "cooling": "#def0df",
}
"""Background of every kind of phase."""
_DPI = 150
_PAD = 0.08
"""Inches around every panel."""


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of that size in inches."""
    figure = Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=_PAD, h_pad=_PAD))
    FigureCanvasAgg(figure)
    return figure


def with_residual(figure: Figure, panels: int, columns: int | None = None) -> tuple[list[Axes], list[Axes]]:
    """Panels side by side, in rows of `columns` (None: in one), and a lower one for the residual below each, with a common abscissa."""
    columns = panels if columns is None else min(columns, panels)
    rows = -(-panels // columns)
    upper, lower = [], []
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=(3.0, 1.2) * rows)
    for panel in range(panels):
        row, column = divmod(panel, columns)
        top = figure.add_subplot(grid[2 * row, column])
        below = figure.add_subplot(grid[2 * row + 1, column], sharex=top)
        top.tick_params(labelbottom=False)
        below.axhline(0.0, color="black", linewidth=0.6)
        upper.append(top)
        lower.append(below)
    return upper, lower


def shade_phases(axes: Sequence[Axes], spans: Sequence[Span]) -> list[Patch]:
    """Colour the phases of the test behind panels over time; returns one legend entry per kind of phase."""
    kinds: dict[str, str] = {}
    for span in spans:
        kind = span.name.split()[0]
        colour = kinds.setdefault(kind, PHASES.get(kind, "#f5f5f5"))
        for ax in axes:
            ax.axvspan(span.t0, span.t1, color=colour, linewidth=0.0, zorder=0)
    return [Patch(color=colour, label=kind) for kind, colour in kinds.items()]


def legend_below(figure: Figure, handles: Sequence[Any], columns: int) -> None:
    """One legend for the whole figure, under its panels."""
    figure.legend(handles=list(handles), loc="outside lower center", ncols=columns, frameon=False)


def draw_matrix(
    ax: Axes, matrix: np.ndarray, rows: Sequence[str], columns: Sequence[str], aspect: Literal["auto", "equal"] = "auto"
) -> Any:
    """Numbers (n_r, n_c) from -1 to 1, such as correlations, in colour and as text; a dash where there is none. Returns the image."""
    image = ax.imshow(matrix, cmap="RdBu_r", vmin=-1.0, vmax=1.0, aspect=aspect)
    ax.set_xticks(range(len(columns)), columns, rotation=40, ha="right", rotation_mode="anchor")
    ax.set_yticks(range(len(rows)), rows)
    for (i, j), r in np.ndenumerate(matrix):
        text = f"{r:.2f}" if np.isfinite(r) else "-"
        ax.text(j, i, text, ha="center", va="center", fontsize=7.5, color="white" if abs(r) > 0.65 else "black")
    return image


def symmetric_limit(values: np.ndarray, at_least: float) -> float:
    """A limit for a symmetric scale that covers 99.5 % of the values (any shape, nan left out), `at_least` or more."""
    used = np.abs(values[np.isfinite(values)])
    return max(float(np.quantile(used, 0.995)) if used.size else 0.0, at_least)


FORMATS: Mapping[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""Formats that figures may have besides PNG, and what their files do not say, so that the same figure is the same file."""


def save_figures(folder: Path, figures: Mapping[str, Figure], also: Sequence[str] = ()) -> list[Path]:
    """Write every figure as `<folder>/<name>.png`, and in the formats `also`, each whole or not at all; returns the paths of the PNG
    files."""
    paths = []
    for name, figure in figures.items():
        for kind in ("png", *also):
            path = folder / f"{name}.{kind}"
            with rc_context({"svg.hashsalt": name}), replacing(path, durable=False) as temporary:
                figure.savefig(temporary, dpi=_DPI, format=kind, metadata=FORMATS.get(kind))
        paths.append(folder / f"{name}.png")
    return paths


def png(figure: Figure) -> bytes:
    """A figure as the content of a PNG file."""
    content = io.BytesIO()
    figure.savefig(content, dpi=_DPI, format="png")
    return content.getvalue()


def drawn(run_dir: Path, figures: Mapping[str, Callable[[], Figure]], *, anew: bool) -> None:
    """Figures of a stage in `<run_dir>/figures/<name>.png`: all where `anew`, else those that are missing. StudyError where they cannot be
    written."""
    folder = run_dir / "figures"
    missing = [name for name in figures if anew or not (folder / f"{name}.png").exists()]
    if not missing:
        return
    try:
        with rc_context(STYLE):
            save_figures(folder, {name: figures[name]() for name in missing})
    except OSError as error:
        raise StudyError(
            f"figures in '{folder}' cannot be written ({error.strerror or error}): expected a writable folder with free space"
        ) from error
