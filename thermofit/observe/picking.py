"""Landmarks by hand: a window with a frame, in which eight points are clicked in turn."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.experiment import CELSIUS

POINTS: Sequence[tuple[str, str, str]] = (
    ("length", "p1", "lower end of a known distance along the specimen"),
    ("length", "p2", "upper end of that distance"),
    ("edge_left", "p1", "left edge, low"),
    ("edge_left", "p2", "left edge, high"),
    ("edge_right", "p1", "right edge"),
    ("circle", "p1", "first point of a circle about the centre"),
    ("circle", "p2", "second point of that circle"),
    ("circle", "p3", "third point of that circle"),
)
"""Group, key and words of what is clicked, in this order."""
Clicks = Callable[[np.ndarray, Sequence[str]], Sequence[tuple[float, float]]]
"""Shows a frame (n_row, n_col) in degC and asks for one point for each of the texts; answers (column, row) px."""


def pick(frame: np.ndarray, length_mm: float, clicks: Clicks | None = None) -> dict[str, Any]:
    """Section `landmarks` of a frame (n_row, n_col) K, with pixels [row, col]. StudyError without a display, and where the window was
    closed before the last point."""
    points = (clicks or on_screen)(frame - CELSIUS, [text for *_, text in POINTS])
    if len(points) < len(POINTS):
        raise StudyError(f"--pick: {len(points)} of {len(POINTS)} points were clicked; start it again and click all of them")
    found: dict[str, Any] = {"length": {"length_mm": length_mm}}
    for (group, key, _), (column, row) in zip(POINTS, points, strict=False):
        found.setdefault(group, {})[key] = [round(float(row), 2), round(float(column), 2)]
    return found


def on_screen(frame: np.ndarray, texts: Sequence[str]) -> Sequence[tuple[float, float]]:
    """Points clicked in a window of matplotlib. StudyError where there is no display, or no backend that opens a window."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise StudyError("--pick opens a window, and there is no display (DISPLAY is not set); give ir.landmarks in the study instead")
    import matplotlib.pyplot as plt
    from matplotlib.backends.registry import BackendFilter, backend_registry

    windows: list[str] = backend_registry.list_builtin(BackendFilter.INTERACTIVE)  # type: ignore[no-untyped-call]
    if plt.get_backend().lower() not in (name.lower() for name in windows):
        raise StudyError(f"--pick opens a window, which matplotlib's '{plt.get_backend()}' cannot; install PyQt6, or give ir.landmarks")
    low, high = np.nanpercentile(frame, [1.0, 99.0])
    figure, ax = plt.subplots(figsize=(8.0, 9.0), layout="constrained")
    ax.imshow(frame, cmap="inferno", vmin=low, vmax=max(high, low + 1e-3), interpolation="nearest")
    points: list[tuple[float, float]] = []
    for k, text in enumerate(texts):
        ax.set_title(f"{k + 1} of {len(texts)}: {text}")
        clicked = plt.ginput(1, timeout=0)
        if not clicked:
            break
        points.append((float(clicked[0][0]), float(clicked[0][1])))
        ax.plot(*points[-1], "+", color="cyan", markersize=12)
    plt.close(figure)
    return points
