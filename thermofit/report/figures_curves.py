"""Figures over stretch and time: stress-stretch, temperature, force, and the size of the residuals; records of coupons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from thermofit.experiment.residuals import Span
from thermofit.experiment.verification import IDENTIFY
from thermofit.records.artefact import Record
from thermofit.report.figures import MEASURED, MODEL, NOISE, legend_below, new_figure, shade_phases, with_residual
from thermofit.report.figures_search import correlation_figure, objective_figure

_ZOOM = 2.5
"""The detail of the elastic range shows this many times its stretch."""


def stress_stretch_figure(verify: Record, window: tuple[float, float]) -> Figure:
    """Nominal stress over mean axial stretch with its residual; whole test and elastic range, whose window is t0, t1 in s.

    Circles are the stages at which model and measurement are compared (5.1.2), dots on the line the load steps of the solver.
    """
    get = {name: verify[f"curves/stress_stretch/{name}"].value for name in _CURVE}
    stretch, stress, model = get["stretch"], get["stress"], get["stretch_model"]
    residual, sigma = 1e6 * (model - stretch), 1e6 * get["stretch_sigma"]
    inside = (get["time"] >= window[0] - 1e-9) & (get["time"] <= window[1] + 1e-9)
    edge = float(np.max(model[inside])) if inside.any() else 1.0
    figure = new_figure(9.0, 4.8)
    upper, lower = with_residual(figure, 2)
    order = np.argsort(stretch)
    for top, below in zip(upper, lower, strict=True):
        top.plot(get["step_stretch"], get["step_stress"], marker=".", markersize=2.5, label="model, load steps", **MODEL)
        top.plot(stretch, stress, label="measured, compared stages", **MEASURED)
        for ax in (top, below):
            ax.axvspan(1.0, edge, color="#fff1c9", linewidth=0.0, zorder=0, label="elastic window")
        below.fill_between(stretch[order], -2.0 * sigma[order], 2.0 * sigma[order], label="2 sigma of the DIC noise", **NOISE)
        below.plot(stretch, residual, **MEASURED)
        below.set_xlabel("mean axial stretch of the window")
    upper[0].set_ylabel("nominal stress in MPa")
    lower[0].set_ylabel("model - measured\nin 1e-6")
    upper[0].set_title("whole test")
    upper[1].set_title("elastic range")
    _zoom(upper[1], (1.0, 1.0 + _ZOOM * (edge - 1.0)), stretch, stress)
    upper[0].set_ylim(bottom=min(0.0, 1.05 * float(stress.min())) - 0.03 * float(stress.max()))
    handles, _ = upper[0].get_legend_handles_labels()
    legend_below(figure, [*handles, lower[0].collections[0]], 4)
    return figure


_CURVE = ("time", "stress", "stretch", "stretch_sigma", "stretch_model", "step_stress", "step_stretch")


def _zoom(ax: Axes, limits: tuple[float, float], x: np.ndarray, y: np.ndarray) -> None:
    """Limit a panel to a range of x, and y to what is measured there."""
    low, high = limits
    if high <= low:
        return
    pad = 0.05 * (high - low)
    seen = y[(x >= low - pad) & (x <= high + pad)]
    ax.set_xlim(low - pad, high + pad)
    if seen.size:
        top = float(seen.max())
        ax.set_ylim(min(0.0, float(seen.min())) - 0.05 * abs(top), 1.15 * top if top > 0.0 else 1.0)


def temperature_figure(verify: Record, spans: Sequence[Span]) -> Figure:
    """Temperature change since the rest over time at the centre and near the ends of the window, with residual and noise."""
    get = {name: verify[f"curves/temperature/{name}"].value for name in _TEMPERATURE}
    places, time = get["place"], get["time"]
    figure = new_figure(10.0, 4.8)
    upper, lower = with_residual(figure, len(places))
    for k, (top, below) in enumerate(zip(upper, lower, strict=True)):
        patches = shade_phases((top, below), spans)
        top.plot(get["step_time"], get["step_model"][:, k], **MODEL)
        top.plot(time, get["measured"][:, k], **MEASURED)
        sigma = get["sigma"][:, k]
        used = np.isfinite(sigma)
        below.fill_between(time[used], -2e3 * sigma[used], 2e3 * sigma[used], **NOISE)
        below.plot(time[used], 1e3 * (get["model"] - get["measured"])[used, k], **MEASURED)
        x, y = get["xy"][k]
        top.set_title(f"{places[k]}: x = {x:.1f} mm, y = {y:.1f} mm")
        below.set_xlabel("time in s")
        top.set_xlim(spans[0].t0, spans[-1].t1)
    for row in (upper, lower):
        limits = np.array([ax.get_ylim() for ax in row])
        for ax in row:
            ax.set_ylim(limits[:, 0].min(), limits[:, 1].max())
    upper[0].set_ylabel("temperature change in K")
    lower[0].set_ylabel("model - measured\nin mK")
    legend_below(figure, [*_model_and_measured(), *patches], 9)
    return figure


_TEMPERATURE = ("place", "xy", "time", "measured", "sigma", "model", "step_time", "step_model")


def _model_and_measured() -> list[object]:
    return [
        Line2D([], [], label="model", **MODEL),
        Line2D([], [], label="measured", **MEASURED),
        Line2D([], [], color="tab:blue", alpha=0.3, linewidth=6.0, label="2 sigma of the noise"),
    ]


def force_figure(interpolate: Record, spans: Sequence[Span]) -> Figure:
    """Force as measured and smoothed over time, what the smoothing took away, and the noise it should be."""
    time, raw, smooth = (interpolate[f"force/{name}"].value for name in ("time", "raw", "smooth"))
    noise = float(interpolate.summary["force"]["noise_N"])
    steps, at_steps = interpolate["steps/all/time"].value, interpolate["steps/all/force"].value
    figure = new_figure(9.0, 4.8)
    (top,), (below,) = with_residual(figure, 1)
    patches = shade_phases((top, below), spans)
    top.plot(time, 1e-3 * raw, color="0.55", linewidth=0.6, label="measured")
    top.plot(time, 1e-3 * smooth, label="smoothed", **MODEL)
    top.plot(steps, 1e-3 * at_steps, linestyle="none", marker="|", markersize=5.0, color="tab:red", label="load steps")
    below.axhspan(-2.0 * noise, 2.0 * noise, label="2 sigma of the noise", **NOISE)
    below.plot(time, raw - smooth, linestyle="none", marker=".", markersize=1.0, color="0.35")
    top.set_ylabel("force in kN")
    below.set_ylabel("residual in N")
    below.set_xlabel("time in s")
    top.set_xlim(float(time[0]), float(time[-1]))
    handles, _ = top.get_legend_handles_labels()
    legend_below(figure, [*handles, below.patches[-1], *patches], 5)
    return figure


def over_time_figure(verify: Record, spans: Sequence[Span]) -> Figure:
    """Rms of every channel over the points at each time, in units of the noise: one where only noise is left."""
    figure = new_figure(9.0, 3.4)
    ax = figure.add_subplot()
    patches = shade_phases((ax,), spans)
    largest = 1.5
    for channel, field, marker, colour in (
        ("du_x", "u", "o", "tab:blue"), ("du_y", "u", "s", "tab:orange"), ("dtheta", "theta", "^", "tab:red"), ("force", "u", "x", "black"),
    ):  # fmt: skip
        if verify.has(f"over_time/{channel}"):
            size, time = verify[f"over_time/{channel}"].value, verify[f"{field}/time"].value
            ax.plot(time, size, marker=marker, markersize=3.5, linewidth=0.7, color=colour, label=channel)
            largest = max(largest, float(np.nanmax(size)))
    ax.axhline(1.0, color="black", linewidth=0.8, linestyle="--")
    ax.set_ylim(0.0, 1.08 * largest)
    ax.set_xlim(spans[0].t0, spans[-1].t1)
    ax.set_xlabel("time in s")
    ax.set_ylabel("rms over the points / noise")
    handles, _ = ax.get_legend_handles_labels()
    legend_below(figure, [*handles, *patches], 9)
    return figure


_SHOWN = 6
"""So many records have panels of their own; of more, those are drawn that the model misses most, over their noise."""
_COLUMNS = 3
_RECORD: dict[str, Any] = {"color": "black", "linewidth": 0.8}


def records_figures(records: Mapping[str, Record]) -> dict[str, Figure]:
    """Every figure of coupons, by the name of its file; `records` by stage hold `verify` and the identification stages that have run."""
    verify = records["verify"]
    identified = [records[name] for name in IDENTIFY if name in records]
    channels = verify.summary["channels"]
    mechanical = "stress" if "stress" in channels else "strain"
    made = {
        "stress-strain": stress_strain_figure(verify, mechanical),
        f"{mechanical}-time": records_over_time_figure(verify, mechanical),
        "temperature": records_over_time_figure(verify, "theta") if "dtheta" in channels else None,
        "objective": objective_figure(identified),
        "correlation": correlation_figure(identified),
    }
    return {name: figure for name, figure in made.items() if figure is not None}


def shown_records(verify: Record, channel: str) -> tuple[list[tuple[int, str]], str]:
    """Number and name of the records that are drawn, in the order of the study, and what is left out of those that have the channel.

    Of many, those are drawn whose error is largest over their noise: a record that the model misses must not be the one that is not seen.
    """
    key = f"{channel}_over_noise"
    having = [(n, row) for n, row in enumerate(verify.summary["records"]) if row.get(key) is not None]
    ranked = sorted(having, key=lambda one: -float(one[1][key]))
    worst, others = sorted(ranked[:_SHOWN], key=lambda one: one[0]), ranked[_SHOWN:]
    shown = [(n, f"{row['record']}: {float(row[key]):.3g} times the noise") for n, row in worst]
    if not others:
        return shown, ""
    at_most = f"{len(others)} left out, at most {float(others[0][1][key]):.3g} times the noise"
    return shown, f"the {len(shown)} of {len(having)} records with the largest error; {at_most}"


def stress_strain_figure(verify: Record, channel: str) -> Figure:
    """Nominal stress over nominal strain of every shown record, measured and model; `channel` is the mechanical one that is compared."""
    shown, left_out = shown_records(verify, channel)
    columns = min(len(shown), _COLUMNS)
    rows = -(-len(shown) // columns)
    figure = new_figure(3.6 * columns + 1.0, 3.0 * rows + 0.5)
    _say(figure, left_out)
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.ravel()[len(shown) :]:
        ax.set_visible(False)
    for ax, (number, name) in zip(axes.ravel(), shown, strict=False):
        get = {key: verify[f"curves/{number}/{key}"].value for key in ("strain", "stress", "measured_strain", "measured_stress")}
        ax.plot(100.0 * get["measured_strain"], get["measured_stress"], label="measured", **_RECORD)
        ax.plot(100.0 * get["strain"], get["stress"], label="model", **MODEL)
        ax.set_title(name)
        ax.set_xlabel("nominal strain in %")
        ax.set_ylabel("nominal stress in MPa")
    handles, _ = axes[0, 0].get_legend_handles_labels()
    legend_below(figure, handles, 2)
    return figure


def _say(figure: Figure, left_out: str) -> None:
    """What a figure does not show, above its panels."""
    if left_out:
        figure.suptitle(left_out)


_AXES = {"stress": ("stress", "nominal stress in MPa"), "strain": ("strain", "nominal strain"), "theta": ("theta_sensor", "sensor in K")}


def records_over_time_figure(verify: Record, name: str) -> Figure | None:
    """A channel over time, measured and model, with the difference beside the noise below; None where no record has it."""
    shown, left_out = shown_records(verify, "dtheta" if name == "theta" else name)
    if not shown:
        return None
    model, label = _AXES[name]
    sigma = float(np.nanmedian(verify[f"{name}/sigma"].value))
    columns = min(len(shown), _COLUMNS)
    figure = new_figure(3.6 * columns + 2.0, 4.6 * -(-len(shown) // columns))
    _say(figure, left_out)
    upper, lower = with_residual(figure, len(shown), columns)
    for top, below, (number, title) in zip(upper, lower, shown, strict=True):
        time, measured, value = (verify[f"curves/{number}/{key}"].value for key in ("time", f"measured_{name}", model))
        top.plot(time, measured, label="measured", **_RECORD)
        top.plot(time, value, label="model", **MODEL)
        below.axhspan(-2.0 * sigma, 2.0 * sigma, label="2 sigma of the noise", **NOISE)
        below.plot(time, value - measured, **_RECORD)
        top.set_title(title)
        below.set_xlabel("time in s")
    for top, below in list(zip(upper, lower, strict=True))[::columns]:
        top.set_ylabel(label)
        below.set_ylabel("model - measured")
    handles, _ = upper[0].get_legend_handles_labels()
    legend_below(figure, [*handles, lower[0].patches[0]], 3)
    return figure
