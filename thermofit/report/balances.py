"""What `diagnose` and `close-loop` say of local balances and of drifting parameters: JSON, datasets, and the figure "significance map"."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import AT
from thermofit.diagnose.balances import Witness, Witnesses, witnesses
from thermofit.diagnose.drift import Drifts, drifts
from thermofit.diagnose.significance import SignificanceMap
from thermofit.diagnose.trace import Traced
from thermofit.experiment.joint import JointParts
from thermofit.experiment.row_states import row_states
from thermofit.records.artefact import Dataset
from thermofit.report.figures import STYLE, new_figure, save_figures
from thermofit.study.study import Study

FIGURE = "significance-map"
GROUP = "balance"
TITLES = {"force": "force through sections", "heat": "heat of pieces"}
_UNITS = {"force": "N", "heat": "mW/mm^3"}
_LIMIT = 5.0
"""Standard errors at the ends of the colours."""
_BUMP = 8.0 / 15.0
"""Mean of the weight of a cell over its length."""


@dataclass(frozen=True)
class BalanceEntries:
    """Entries of a summary and datasets of an artefact."""

    entries: dict[str, Any]
    datasets: dict[str, Dataset]


def local_findings(study: Study, here: Traced, parts: JointParts | None) -> BalanceEntries:
    """Local balances and drifts of a traced case: entries `local_balances` (None: no body was tested) and `drift`; writes the figure into
    the run folder."""
    seen = witnesses(here, parts)
    datasets = {} if seen is None else balance_datasets(seen)
    figure = None
    if datasets:
        with matplotlib.rc_context(STYLE):
            figure = save_figures(study.run_dir / "figures", {FIGURE: significance_figure(maps_of(datasets))})[0]
    return BalanceEntries({"local_balances": balance_entry(seen, figure), "drift": _drift(here, parts)}, datasets)


def balance_entry(seen: Witnesses | None, figure: Path | None) -> dict[str, Any] | None:
    """The entry `local_balances`."""
    if seen is None:
        return None
    return {
        "where": seen.where,
        "maps": [_map_row(w) for w in seen.maps],
        "without": list(seen.without),
        "figure": None if figure is None else str(figure),
    }


def _map_row(one: Witness) -> dict[str, Any]:
    """One map as plain types."""
    m, b = one.map, one.map.balance
    peak = m.peak
    return {
        "balance": b.kind,
        "channel": b.channel,
        "experiment": one.test or None,
        "where": one.where,
        "in_whole_model": one.whole,
        "in_local_balance": m.stands_out,
        "unit": b.unit,
        "cells": len(b.amount),
        "dropped": b.dropped,
        "taken_by_parameters": m.taken,
        "extent_mm": b.extent,
        "duration_s": [float(b.duration.min()), float(b.duration.max())],
        "chi2": m.chi2,
        "degrees": m.degrees,
        "chance": min(1.0, 2.0 * min(m.chance_peak, m.chance_chi2)),
        "beyond_3": m.beyond,
        "threshold": m.threshold,
        "peak": {
            "y_mm": float(b.y[peak]),
            "t_s": float(b.time[peak]),
            "value": float(m.amount[peak]),
            "sigma": float(m.sigma[peak]),
            "z": float(m.z[peak]),
        },
        "block": _block(m) if m.stands_out else None,
        "closes_with": None
        if m.asks is None
        else {"parameter": m.asks.name, "value": m.asks.value, "sigma": m.asks.sigma, "fitted": m.asks.fitted},
    }


def _block(m: SignificanceMap) -> dict[str, Any]:
    """Where, when and how much is missing: the block of cells that takes most of chi2."""
    b, found = m.balance, m.block
    out = {"y_mm": list(found.y), "when_s": list(found.time), "value": found.amount, "sigma": found.sigma, "chi2_drop": found.drop}
    if b.kind == "heat":
        area = float(b.volume.mean()) / (_BUMP * b.extent)
        volume = area * (found.y[1] - found.y[0])
        out |= {"power_mW": found.amount * volume, "power_sigma_mW": found.sigma * volume}
    return out


def _drift(here: Traced, parts: JointParts | None) -> dict[str, Any]:
    """The entry `drift`."""
    try:
        found = drifts(here, row_states(here.case.model, here.case.parameters, parts))
    except (NumericsError, StudyError) as error:
        return {"asked": 0, "found": [], "without": f"the states of the material could not be run ({error})"}
    return {"asked": found.asked, "found": _drift_rows(found), "without": ""}


def _drift_rows(found: Drifts) -> list[dict[str, Any]]:
    """Drifts as plain types, the strongest first."""
    return [
        {
            "parameter": d.parameter,
            "variable": d.variable,
            "words": d.words,
            "slope": d.slope,
            "sigma": d.sigma,
            "unit": d.unit,
            "z": d.z,
            "chance": d.chance,
            "alike": [{"parameter": p, "variable": v} for p, v in d.alike],
            "blocks": [{"at": at, "value": value, "sigma": sigma} for at, value, sigma in d.blocks],
        }
        for d in found.found
    ]


def balance_datasets(seen: Witnesses) -> dict[str, Dataset]:
    """Maps over (window in time, place): amount, standard error and significance, nan where there is no cell; their centres and sizes."""
    out: dict[str, Dataset] = {}
    for one in seen.maps:
        m, b = one.map, one.map.balance
        lead, dims = f"{GROUP}/{b.kind}{AT}{one.test}" if one.test else f"{GROUP}/{b.kind}", ("window", "place")
        windows = [b.row == k for k in range(int(b.row.max()) + 1)]
        out |= {
            f"{lead}/amount": Dataset(m.gridded(m.amount), b.unit, dims),
            f"{lead}/sigma": Dataset(m.gridded(m.sigma), b.unit, dims),
            f"{lead}/z": Dataset(m.gridded(m.z), "1", dims),
            f"{lead}/time": Dataset(np.array([_mean(b.time[w]) for w in windows]), "s", ("window",)),
            f"{lead}/duration": Dataset(np.array([_mean(b.duration[w]) for w in windows]), "s", ("window",)),
            f"{lead}/y": Dataset(np.array([_mean(b.y[b.column == k]) for k in range(int(b.column.max()) + 1)]), "mm", ("place",)),
            f"{lead}/threshold": Dataset(np.array([m.threshold]), "1", ("map",)),
        }
    return out


def _mean(value: np.ndarray) -> float:
    return float(value.mean()) if len(value) else float("nan")


class Held(Protocol):
    """A dataset of a record."""

    @property
    def value(self) -> np.ndarray:
        """Its values, of any shape."""
        ...


@dataclass(frozen=True)
class DrawnMap:
    """A significance map as it is drawn: `time` s (n_t,), `y` mm (n_y,), z (n_t, n_y), threshold of |z|."""

    kind: str
    test: str
    time: np.ndarray
    y: np.ndarray
    z: np.ndarray
    threshold: float


def maps_of(data: Mapping[str, Held]) -> list[DrawnMap]:
    """The maps in the datasets of an artefact, by name."""
    found = []
    for key in data:
        group, _, rest = key.partition("/")
        name, _, last = rest.partition("/")
        if group == GROUP and last == "z":
            lead = f"{GROUP}/{name}"
            kind, _, test = name.partition(AT)
            own = {part: np.asarray(data[f"{lead}/{part}"].value) for part in ("time", "y", "z", "threshold")}
            found.append(DrawnMap(kind, test, own["time"], own["y"], own["z"], float(own["threshold"][0])))
    return sorted(found, key=lambda m: (m.test, m.kind))


def significance_figure(maps: Sequence[DrawnMap]) -> Figure:
    """What every balance misses over its standard error, over time and place; a ring marks cells beyond the threshold."""
    figure = new_figure(7.2, 0.6 + 2.2 * len(maps))
    axes = figure.subplots(len(maps), 1, squeeze=False)[:, 0]
    for ax, one in zip(axes, maps, strict=True):
        order = np.flatnonzero(np.isfinite(one.time))
        order = order[np.argsort(one.time[order], kind="stable")]
        time, z = one.time[order], one.z[order]
        ax.set_facecolor("0.75")
        image = ax.pcolormesh(
            _edges(time), _edges(one.y), np.ma.masked_invalid(z.T), cmap="RdBu_r", vmin=-_LIMIT, vmax=_LIMIT, edgecolors="none"
        )
        row, column = np.nonzero(np.abs(np.nan_to_num(z)) > one.threshold)
        ax.plot(time[row], one.y[column], linestyle="none", marker="o", markerfacecolor="none", color="black", markersize=4.0)
        known = z[np.isfinite(z)]
        share = 100.0 * float(np.mean(np.abs(known) > 3.0)) if known.size else 0.0
        lead = f"{one.test}: " if one.test else ""
        ax.set_title(f"{lead}{TITLES[one.kind]}: {share:.1f} % of {known.size} cells beyond 3 (noise alone: 0.3 %)")
        ax.set_ylabel("y in mm")
        figure.colorbar(image, ax=ax, label="missing / standard error", extend="both")
    axes[-1].set_xlabel("time in s")
    return figure


def _edges(centre: np.ndarray) -> np.ndarray:
    """Edges (n + 1,) half way between centres (n,)."""
    if len(centre) == 1:
        return np.array([centre[0] - 0.5, centre[0] + 0.5])
    middle = 0.5 * (centre[1:] + centre[:-1])
    return np.concatenate([[2.0 * centre[0] - middle[0]], middle, [2.0 * centre[-1] - middle[-1]]])
