"""Figures of coupon records: stress over strain, and stress and temperature over time with what is left beside the noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from thermofit.core.artefact import Record
from thermofit.diagnose.figures import MODEL, NOISE, legend_below, new_figure, with_residual
from thermofit.diagnose.figures_search import correlation_figure, objective_figure
from thermofit.diagnose.verification import IDENTIFY

_SHOWN = 6
"""So many records have panels of their own; of more, they are evenly chosen."""
_RECORD: dict[str, Any] = {"color": "black", "linewidth": 0.8}


def coupon_figures(records: Mapping[str, Record]) -> dict[str, Figure]:
    """Every figure of coupons, by the name of its file; `records` by stage hold `verify` and the identification stages that have run."""
    verify = records["verify"]
    identified = [records[name] for name in IDENTIFY if name in records]
    channels = verify.summary["channels"]
    mechanical = "stress" if "stress" in channels else "strain"
    made = {
        "stress-strain": stress_strain_figure(verify),
        f"{mechanical}-time": over_time_figure(verify, mechanical),
        "temperature": over_time_figure(verify, "theta") if "dtheta" in channels else None,
        "objective": objective_figure(identified),
        "correlation": correlation_figure(identified),
    }
    return {name: figure for name, figure in made.items() if figure is not None}


def shown_records(verify: Record) -> list[tuple[int, str]]:
    """Number and name of the records that are drawn."""
    names = [str(row["record"]) for row in verify.summary["records"]]
    chosen = np.unique(np.linspace(0, len(names) - 1, min(_SHOWN, len(names))).round().astype(int))
    return [(int(n), names[n]) for n in chosen]


def stress_strain_figure(verify: Record) -> Figure:
    """Nominal stress over nominal strain of every shown record, measured and model."""
    shown = shown_records(verify)
    columns = min(len(shown), 3)
    rows = -(-len(shown) // columns)
    figure = new_figure(3.6 * columns + 1.0, 3.0 * rows + 0.5)
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


_AXES = {"stress": ("stress", "nominal stress in MPa"), "strain": ("strain", "nominal strain"), "theta": ("theta_sensor", "sensor in K")}


def over_time_figure(verify: Record, name: str) -> Figure | None:
    """A channel over time, measured and model, with the difference beside the noise below; None where no shown record has it."""
    shown = [(n, label) for n, label in shown_records(verify) if verify.has(f"curves/{n}/measured_{name}")][:3]
    if not shown:
        return None
    model, label = _AXES[name]
    sigma = float(np.nanmedian(verify[f"{name}/sigma"].value))
    figure = new_figure(3.6 * len(shown) + 2.0, 4.6)
    upper, lower = with_residual(figure, len(shown))
    for top, below, (number, title) in zip(upper, lower, shown, strict=True):
        time, measured, value = (verify[f"curves/{number}/{key}"].value for key in ("time", f"measured_{name}", model))
        top.plot(time, measured, label="measured", **_RECORD)
        top.plot(time, value, label="model", **MODEL)
        below.axhspan(-2.0 * sigma, 2.0 * sigma, label="2 sigma of the noise", **NOISE)
        below.plot(time, value - measured, **_RECORD)
        top.set_title(title)
        below.set_xlabel("time in s")
    upper[0].set_ylabel(label)
    lower[0].set_ylabel("model - measured")
    handles, _ = upper[0].get_legend_handles_labels()
    legend_below(figure, [*handles, lower[0].patches[0]], 3)
    return figure
