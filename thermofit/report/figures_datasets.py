"""A quick picture of any artefact or dataset, by the names of its axes: courses over time, matrices, maps, rms over the points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thermofit.core.errors import DataError
from thermofit.records.artefact import Dataset, Record, layout
from thermofit.report.figures import new_figure
from thermofit.report.figures_search import correlation_figure

_ABSCISSAE = ("time", "step_time")
"""Names of datasets over which the others of their folder are drawn, the first that is there."""
_PANELS = 6


def picture_of(record: Record, dataset: str | None = None) -> Figure:
    """A picture of one dataset, or of what the artefact has to show. DataError where there is nothing that can be drawn."""
    if dataset is not None:
        figure = new_figure(6.0, 4.0)
        _draw(figure.add_subplot(), record, dataset)
        return figure
    if record.has("correlation") and (matrix := correlation_figure([record])) is not None:
        return matrix
    folders = _folders(record)
    if not folders:
        raise DataError(f"{record.path}: this artefact of '{record.stage}' holds nothing over time; name a dataset by --dataset")
    shown = list(folders.items())[:_PANELS]
    columns = min(len(shown), 3)
    rows = -(-len(shown) // columns)
    figure = new_figure(4.2 * columns, 3.0 * rows)
    for k, (title, names) in enumerate(shown):
        ax = figure.add_subplot(rows, columns, k + 1)
        _courses(ax, record, names)
        ax.set_title(title)
    return figure


def _folders(record: Record) -> dict[str, list[str]]:
    """Datasets of one axis that are known over time, by their folder and unit."""
    described = layout(record)
    found: dict[str, list[str]] = {}
    for name, data in described.items():
        folder = name.rpartition("/")[0]
        if folder and len(data.dims) == 1 and data.dtype.startswith(("float", "int")) and _abscissa(record, name) is not None:
            found.setdefault(f"{folder} in {data.unit}", []).append(name)
    return {title: own for title, own in found.items() if any(name.rpartition("/")[2] not in _ABSCISSAE for name in own)}


def _abscissa(record: Record, name: str) -> str | None:
    """The dataset over which one of the same folder is drawn: times of as many entries."""
    folder = name.rpartition("/")[0]
    size = record[name].value.shape[0]
    for word in _ABSCISSAE:
        other = f"{folder}/{word}"
        if record.has(other) and record[other].value.shape == (size,):
            return other
    return None


def _courses(ax: Axes, record: Record, names: Sequence[str]) -> None:
    for name in names:
        word = name.rpartition("/")[2]
        over = _abscissa(record, name)
        if word in _ABSCISSAE or over is None:
            continue
        data = record[name]
        ax.plot(record[over].value, data.value, label=word, marker="." if len(data.value) < 60 else None)
        ax.set_xlabel(f"{over.rpartition('/')[2]} in {record[over].unit}")
    ax.legend(fontsize=6.5)


def _draw(ax: Axes, record: Record, name: str) -> None:
    data = record[name]
    value = data.value
    if value.dtype.kind not in "biuf":
        raise DataError(
            f"{record.path}: dataset '{name}' holds {_kind(data)}, expected numbers; `thermofit show --dataset {name}` lists them"
        )
    over = _abscissa(record, name) if value.ndim else None
    if value.ndim == 2 and value.shape[0] == value.shape[1] and data.dims[0] == data.dims[1]:
        limit = float(np.nanmax(np.abs(value))) or 1.0
        image = ax.imshow(value, cmap="RdBu_r", vmin=-limit, vmax=limit)
        ax.figure.colorbar(image, ax=ax, label=data.unit)
    elif value.ndim and data.dims[0] == "point":
        place = record[f"{_xy_folder(record, name)}/xy"].value
        shown = np.sqrt(np.sum(value.reshape(len(value), -1).astype(float) ** 2, axis=1))
        points = ax.scatter(place[:, 0], place[:, 1], c=shown, s=12)
        ax.figure.colorbar(points, ax=ax, label=data.unit)
        ax.set_aspect("equal")
        ax.set_xlabel("x in mm")
        ax.set_ylabel("y in mm")
    elif value.ndim:
        x = record[over].value if over is not None else np.arange(len(value))
        flat = value.reshape(len(value), -1).astype(float)
        few = flat.shape[1] <= 8
        counted = np.maximum(np.isfinite(flat).sum(axis=1), 1)
        ax.plot(x, flat if few else np.sqrt(np.nansum(flat**2, axis=1) / counted), marker="." if len(x) < 60 else None)
        ax.set_xlabel(data.dims[0] if over is None else f"{over.rpartition('/')[2]} in {record[over].unit}")
        ax.set_ylabel(data.unit if few else f"rms over {', '.join(data.dims[1:])} in {data.unit}")
    else:
        raise DataError(f"{record.path}: dataset '{name}' is one number, expected an array to draw")
    ax.set_title(f"{record.stage}: {name}")


def _kind(data: Dataset) -> str:
    return "texts" if data.value.dtype.kind in "UO" else f"values of type {data.value.dtype}"


def _xy_folder(record: Record, name: str) -> str:
    """The field at whose points a dataset lies: its own folder, else the field that the channel du or dtheta is of."""
    size = record[name].value.shape[0]
    for folder in (name.rpartition("/")[0], name.rpartition("/")[2].removeprefix("d"), "u", "theta"):
        if record.has(f"{folder}/xy") and len(record[f"{folder}/xy"].value) == size:
            return folder
    raise DataError(f"{record.path}: no points are known at which dataset '{name}' lies; draw another one")
