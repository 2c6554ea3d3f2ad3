"""Figures of coupon records: stress over strain, and stress and temperature over time with what is left beside the noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from thermofit.experiment.verification import IDENTIFY
from thermofit.records.artefact import Record
from thermofit.report.figures import MODEL, NOISE, legend_below, new_figure, with_residual
from thermofit.report.figures_search import correlation_figure, objective_figure

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
        f"{mechanical}-time": over_time_figure(verify, mechanical),
        "temperature": over_time_figure(verify, "theta") if "dtheta" in channels else None,
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


def over_time_figure(verify: Record, name: str) -> Figure | None:
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
