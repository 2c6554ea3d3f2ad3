"""Figures of docs/reproduction: fields, temperatures of several models, the valley, the dissipation, reactions to a prescribed value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from thesis_read import SIZES, free_names, solved_starts, value

from thermofit.records.artefact import Record
from thermofit.report.figures import MEASURED, STYLE, legend_below, new_figure, with_residual
from thermofit.report.figures_maps import Scale, draw_map

FOLDER = "figures"
COLOURS = ("tab:red", "tab:blue", "tab:green", "tab:purple", "tab:orange", "tab:brown")
_DPI = 80
CENTRE = 1
"""Place of the followed temperatures in the middle of the specimen."""


def saved(pages: Path, name: str, figure: Figure, caption: str) -> str:
    """Write a figure below the pages; its Markdown."""
    folder = pages / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{name}.png", dpi=_DPI, format="png", metadata={"Software": ""}, pil_kwargs={"optimize": True})
    return f"![{caption}]({FOLDER}/{name}.png)\n\n*{caption}*"


def styled() -> object:
    """The settings of all figures, for `with`."""
    return matplotlib.rc_context(STYLE)


def field_maps(verify: Record) -> Figure:
    """Displacement u_y and temperature change at the largest force: measured and model side by side."""
    force_time = verify["curves/stress_stretch/step_time"].value
    at = float(force_time[int(np.argmax(verify["curves/stress_stretch/step_stress"].value))])
    figure = new_figure(8.4, 3.6)
    axes = figure.subplots(1, 4, sharex=True, sharey=True)
    for column, (field, component, label, factor) in enumerate((("u", 1, "u_y in mm", 1.0), ("theta", 0, "temperature change in K", 1.0))):
        measured, model = _at(verify, field, component, at)
        low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
        for side, (name, shown) in enumerate((("measured", measured), ("model", model))):
            ax = axes[2 * column + side]
            image = draw_map(ax, verify[f"{field}/xy"].value, factor * shown, Scale(low, high, "viridis"))
            ax.set_title(f"{name}, t = {at:.0f} s")
            ax.set_xlabel("x in mm")
        figure.colorbar(image, ax=list(axes[2 * column : 2 * column + 2]), label=label, shrink=0.9)
    axes[0].set_ylabel("y in mm")
    return figure


def _at(verify: Record, field: str, component: int, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Measured and predicted field at the observation nearest to a time; u without its mean (rigid motion), theta from its first frame."""
    times = verify[f"{field}/time"].value
    index = int(np.argmin(np.abs(times - time)))
    seen = verify[f"{field}/mask"].value[index].astype(bool)
    out = []
    for name in ("value", "predicted"):
        whole = verify[f"{field}/{name}"].value[:, :, component]
        shown = whole[index] - (np.nanmean(whole[index][seen]) if field == "u" else whole[0])
        out.append(np.where(seen, shown, np.nan))
    return out[0], out[1]


def temperatures(records: Mapping[str, Record], end: tuple[float, float] | None = None) -> Figure:
    """Temperature change in the middle over time, measured and by several parameter sets, with what is left; `end`: a detail in s."""
    figure = new_figure(9.0 if end else 6.4, 4.6)
    upper, lower = with_residual(figure, 2 if end else 1)
    first = next(iter(records.values()))
    time, measured = first["curves/temperature/time"].value, first["curves/temperature/measured"].value[:, CENTRE]
    for top, below in zip(upper, lower, strict=True):
        top.plot(time, measured, label="measured", **MEASURED)
        for colour, (label, record) in zip(COLOURS, records.items(), strict=False):
            at, model = (record[f"curves/temperature/{name}"].value for name in ("step_time", "step_model"))
            top.plot(at, model[:, CENTRE], color=colour, label=label)
            left = record["curves/temperature/model"].value - record["curves/temperature/measured"].value
            below.plot(record["curves/temperature/time"].value, 1e3 * left[:, CENTRE], color=colour, marker=".", linewidth=0.6)
        below.set_xlabel("time in s")
    upper[0].set_ylabel("temperature change in K")
    lower[0].set_ylabel("model - measured\nin mK")
    if end:
        _detail(upper[1], lower[1], end, (time, measured))
    handles, _ = upper[0].get_legend_handles_labels()
    legend_below(figure, handles, min(4, len(handles)))
    return figure


def _detail(top: Axes, below: Axes, end: tuple[float, float], curve: tuple[np.ndarray, np.ndarray]) -> None:
    """Limit a pair of panels to a span of time and to what is seen there."""
    inside = (curve[0] >= end[0]) & (curve[0] <= end[1])
    top.set_xlim(*end)
    for ax in (top, below):
        seen = np.concatenate(
            [np.asarray(line.get_ydata())[_within(line.get_xdata(), end)] for line in ax.lines if len(line.get_xdata()) > 2]
        )
        pad = 0.08 * float(np.ptp(seen)) + 1e-9
        ax.set_ylim(float(seen.min()) - pad, float(seen.max()) + pad)
    top.set_title(f"end of the cooling ({int(inside.sum())} frames)")


def _within(x: object, span: tuple[float, float]) -> np.ndarray:
    values = np.asarray(x, dtype=float)
    return (values >= span[0]) & (values <= span[1])


def valley(record: Record) -> Figure:
    """Optimum of every start over that of beta, with the line of constant ratio through the best one."""
    starts = solved_starts(record)
    best = min(starts, key=lambda start: start["f"])["optimum"]
    names = [name for name in free_names(record) if name != "beta"]
    figure = new_figure(8.4, 2.9)
    for ax, name in zip(figure.subplots(1, len(names)), names, strict=True):
        factor, label, _ = SIZES[name]
        beta = np.array([start["optimum"]["beta"] for start in starts])
        line = np.array([0.0, 1.08 * beta.max()])
        ax.plot(line, factor * best[name] / best["beta"] * line, color="0.6", label="constant ratio")
        for number, start in enumerate(starts):
            ax.plot(
                start["optimum"]["beta"], factor * start["optimum"][name], "o", color=COLOURS[number % 6], label=f"start {'ABCD'[number]}"
            )
        ax.set_xlabel("beta")
        ax.set_title(label)
        ax.set_xlim(left=0.0)
        ax.set_ylim(bottom=0.0)
    handles, _ = ax.get_legend_handles_labels()
    legend_below(figure, handles, 5)
    return figure


def model_dissipation(model: int, record: Record, strain: np.ndarray, slope: float = 0.0) -> np.ndarray:
    """Dissipation per plastic strain in MPa over the plastic strain: (4.21), (4.22), times 1 + slope Lambda."""
    first, beta = value(record, "M_y0"), value(record, "beta")
    if model == 1:
        return beta * first * (1.0 + slope * strain)
    share = 1.0 - np.exp(-value(record, "H_exp") * strain)
    return ((value(record, "M_yinf") - first) * share**2 + (1.0 - beta) * first * share + beta * first) * (1.0 + slope * strain)


def slope_of(truth: Record) -> float:
    """Slope of the dissipation of a virtual material over the plastic strain."""
    return float(truth.config["simulate"]["truth"]["stored_energy.slope"])


def dissipation(truth: Record, fitted: Mapping[str, tuple[int, Record]]) -> Figure:
    """Dissipation per plastic strain of the virtual material and of fitted models, over the plastic strain; right: as share of the work."""
    strain = np.linspace(0.0, 0.15, 76)
    stress = value(truth, "M_yinf") - (value(truth, "M_yinf") - value(truth, "M_y0")) * np.exp(-value(truth, "H_exp") * strain)
    figure = new_figure(8.4, 3.2)
    axes = figure.subplots(1, 2)
    curves = {"virtual material": model_dissipation(1, truth, strain, slope_of(truth))}
    curves |= {label: model_dissipation(model, record, strain) for label, (model, record) in fitted.items()}
    for colour, (label, curve) in zip(("black", *COLOURS), curves.items(), strict=False):
        axes[0].plot(strain, curve, color=colour, label=label)
        axes[1].plot(strain, curve / stress, color=colour)
    axes[0].set_ylabel("dissipation per plastic strain in MPa")
    axes[1].set_ylabel("share of the plastic work")
    for ax in axes:
        ax.set_xlabel("accumulated plastic strain")
        ax.set_ylim(bottom=0.0)
    handles, _ = axes[0].get_legend_handles_labels()
    legend_below(figure, handles, 3)
    return figure


Changes = Mapping[str, Sequence[float]]
"""Relative change in % by parameter, one value per prescribed temperature."""


def reactions(difference: Sequence[float], change: Changes, printed: Changes, linearised: Changes) -> Figure:
    """Relative change of every parameter over the prescribed difference: lines here, dotted as linearised, crosses in the thesis."""
    names = list(change)
    strong = [name for name in names if max(abs(v) for v in printed[name]) > 5.0]
    figure = new_figure(8.4, 3.4)
    axes = figure.subplots(1, 2)
    order = np.argsort(difference)
    x = np.asarray(difference)[order]
    for number, name in enumerate(names):
        ax = axes[0 if name in strong else 1]
        ax.plot(x, np.asarray(change[name])[order], marker="o", color=COLOURS[number], label=name)
        ax.plot(x, np.asarray(linearised[name])[order], linestyle=":", color=COLOURS[number])
        ax.plot(x, np.asarray(printed[name])[order], linestyle="none", marker="x", color=COLOURS[number])
    for ax, title in zip(axes, ("react strongly in the thesis", "react little in the thesis"), strict=True):
        ax.set_title(title)
        ax.set_xlabel("air - jaws in K")
        ax.xaxis.set_major_locator(MaxNLocator(6))
        ax.legend()
    axes[0].set_ylabel("change in % (line: here, dotted: linearised,\nx: thesis)")
    return figure
