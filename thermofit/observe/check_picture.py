"""Check picture of the infrared calibration: does the specimen's outline lie where the frame shows the specimen?"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from thermofit.core.experiment import CELSIUS, Landmarks, Specimen
from thermofit.core.files import replacing
from thermofit.observe.camera import CameraPose, specimen_to_pixel

_HEIGHT = 8.0
"""Height of the picture in inches."""
_AXIS_SHARE = 0.3
"""Length of the drawn axes as a share of the gauge width."""


def specimen_outline(specimen: Specimen, n_arc: int = 40) -> np.ndarray:
    """Closed polygon (n, 2) mm of the unloaded dogbone: parallel length, circular shoulders, straight grips.

    On a shoulder x = w/2 + R - sqrt(R^2 - (|y| - L/2)^2) up to half the grip width (DIN 50125-H).
    """
    half, radius = 0.5 * specimen.gauge_width, specimen.shoulder_radius
    rise = min(max(0.5 * (specimen.grip_width - specimen.gauge_width), 0.0), radius)
    angle = np.linspace(0.0, np.arccos(1.0 - rise / radius), n_arc)
    x = half + radius * (1.0 - np.cos(angle))
    y = 0.5 * specimen.parallel_length + radius * np.sin(angle)
    end = max(0.5 * specimen.total_length, float(y[-1]))
    quarter = np.column_stack([np.append(x, x[-1]), np.append(y, end)])
    upper = np.vstack([quarter, quarter[::-1] * [-1.0, 1.0]])
    return np.vstack([upper, -upper, upper[:1]])


def draw_check_picture(path: Path, frame: np.ndarray, pose: CameraPose, specimen: Specimen, landmarks: Landmarks | None = None) -> Path:
    """Draw one frame (n_row, n_col) K with outline, axes and landmarks into a PNG file; returns the path.

    Temperatures are shown in degC between their 1st and 99th percentile. A missing folder is made.
    """
    rows, columns = frame.shape
    figure = Figure(figsize=(max(_HEIGHT * columns / rows, 2.5) + 2.5, _HEIGHT), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.add_subplot()
    celsius = np.asarray(frame, dtype=float) - CELSIUS
    low, high = np.percentile(celsius, [1.0, 99.0])
    image = ax.imshow(celsius, cmap="inferno", vmin=low, vmax=max(high, low + 1e-3), interpolation="nearest")
    figure.colorbar(image, ax=ax, label="temperature in degC", shrink=0.8)
    outline = specimen_to_pixel(pose, specimen_outline(specimen))
    ax.plot(outline[:, 1], outline[:, 0], color="cyan", linewidth=1.0, label="outline")
    _draw_axes(ax, pose, _AXIS_SHARE * specimen.gauge_width)
    if landmarks is not None:
        _draw_landmarks(ax, landmarks)
    ax.set_xlim(-0.5, columns - 0.5)
    ax.set_ylim(rows - 0.5, -0.5)
    ax.set_xlabel("column in px")
    ax.set_ylabel("row in px")
    ax.set_title(f"{pose.side} view, {pose.scale:.4f} mm/px, roll {np.degrees(pose.roll):.2f} deg", fontsize=9)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7)
    with replacing(path, durable=False) as temporary:
        figure.savefig(temporary, dpi=130, format="png")
    return path


def _draw_axes(ax: Axes, pose: CameraPose, length: float) -> None:
    """Arrows of x and y from the specimen's centre, `length` mm."""
    for name, tip in (("x", [length, 0.0]), ("y", [0.0, length])):
        row, column = specimen_to_pixel(pose, np.array(tip))
        start = (pose.origin[1], pose.origin[0])
        ax.annotate("", xy=(column, row), xytext=start, arrowprops={"arrowstyle": "->", "color": "white", "linewidth": 1.5})
        ax.annotate(name, xy=(column, row), color="white", ha="center", va="center", xytext=(6, 6), textcoords="offset points")


def _draw_landmarks(ax: Axes, landmarks: Landmarks) -> None:
    """Landmarks in the marks of Figure 2.11: length +, circle o, edges squares."""
    edges = np.vstack([landmarks.edge_left, landmarks.edge_right[None]])
    for points, marker, colour, label in (
        (landmarks.length, "+", "red", f"length {landmarks.length_mm:g} mm"),
        (landmarks.circle, "o", "lime", "circle"),
        (edges, "s", "dodgerblue", "edges"),
    ):
        face = colour if marker == "+" else "none"
        ax.scatter(
            points[:, 1], points[:, 0], marker=marker, s=40, label=label, facecolors=face, edgecolors=None if marker == "+" else colour
        )
