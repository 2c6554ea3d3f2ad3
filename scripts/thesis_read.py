"""What the pages of docs/reproduction read from the artefacts: optima of all starts, their spread and ratios, misfits, and statements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.parameters import NAMES
from thermofit.records.artefact import Record

ONE_OPTIMUM = 1e-3
"""Spread of a parameter up to which several starts have ended in one optimum."""
CONSTANT = 1e-2
"""Spread of a ratio up to which it is constant along a valley."""
SIZES: Mapping[str, tuple[float, str, str]] = {
    "E": (1.0, "E in MPa", "{:.0f}"),
    "nu": (1.0, "nu", "{:.3f}"),
    "M_y0": (1.0, "M_y0 in MPa", "{:.2f}"),
    "M_yinf": (1.0, "M_yinf in MPa", "{:.2f}"),
    "H_lin": (1.0, "H_lin in MPa", "{:.2f}"),
    "H_exp": (1.0, "H_exp", "{:.3f}"),
    "F": (1.0, "F", "{:.4f}"),
    "alpha_exp": (1e6, "alpha_exp in 1e-6/K", "{:.3f}"),
    "kappa": (1.0, "kappa in mW/(mm K)", "{:.2f}"),
    "c0": (1.0, "c0 in mJ/(mm^3 K)", "{:.4f}"),
    "beta": (1.0, "beta", "{:.4f}"),
    "alpha_air": (1.0, "alpha_air in W/(m^2 K)", "{:.3f}"),
    "alpha_clamp": (1.0, "alpha_clamp in W/(m^2 K)", "{:.2f}"),
}
"""Factor, heading and format of a parameter in a table."""


@dataclass(frozen=True)
class Statement:
    """A sentence of the thesis or of the issue about a result, whether it holds here, and the measured figures."""

    text: str
    holds: bool
    measured: str

    @property
    def line(self) -> str:
        """As an item of a list."""
        return f"- **{'holds' if self.holds else 'does not hold'}**: {self.text} ({self.measured})"


def cell(name: str, value: float | None) -> str:
    """A value in the unit of its table."""
    if value is None or not np.isfinite(value):
        return "-"
    factor, _, form = SIZES[name]
    return form.format(factor * value)


def headings(names: Sequence[str]) -> list[str]:
    """Headings of the columns of parameters."""
    return [SIZES[name][1] for name in names]


def value(record: Record, name: str) -> float:
    """A parameter of an artefact; DataError where it is not there."""
    if name not in record.parameters:
        raise DataError(f"{record.path}: no parameter '{name}'; it holds {', '.join(record.parameters)}")
    return record.parameters[name].value


def free_names(record: Record) -> list[str]:
    """Names of the identified parameters in the order of the law."""
    return [name for name in NAMES if name in record.parameters and record.parameters[name].free]


def solved_starts(record: Record) -> list[Mapping[str, Any]]:
    """Starts of a grid search that have an optimum."""
    return [start for start in record.summary["starts"] if not start["failed"]]


def optima(record: Record, names: Sequence[str]) -> np.ndarray:
    """Optimum (n_starts, n_p) of every start that has one."""
    return np.array([[start["optimum"][name] for name in names] for start in solved_starts(record)])


def uniqueness(record: Record) -> str:
    """The program's word for what the starts say."""
    return str(record.summary["uniqueness"])


def spread(record: Record) -> dict[str, float]:
    """(largest - smallest)/best of every parameter over all starts; DataError where a start failed."""
    if len(solved_starts(record)) < len(record.summary["starts"]):
        raise DataError(f"{record.path}: {record.summary['verdict']}")
    names = free_names(record)
    x = optima(record, names)
    best = x[int(np.argmin([start["f"] for start in solved_starts(record)]))]
    return dict(zip(names, ((x.max(axis=0) - x.min(axis=0)) / np.abs(best)).tolist(), strict=True))


def ratio_spread(record: Record, name: str, over: str = "beta") -> float:
    """(largest - smallest)/mean of name/over over all starts."""
    x = optima(record, (name, over))
    ratio = x[:, 0] / x[:, 1]
    return float((ratio.max() - ratio.min()) / ratio.mean())


def f_spread(record: Record) -> float:
    """(largest - smallest)/smallest objective over all starts."""
    f = np.array([start["f"] for start in solved_starts(record)])
    return float(f.max() / f.min() - 1.0)


def per_datum(record: Record, start: Mapping[str, Any]) -> float:
    """Objective of a start over the number of data: one where only noise is left."""
    return float(start["f"]) / sum(int(channel["n"]) for channel in record.summary["channels"].values())


def left_over(record: Record, channel: str = "dtheta") -> tuple[float, float, int]:
    """Rms of the misfit in its unit, that of the noise, and the number of data."""
    row = record.summary["channels"][channel]
    return float(row["rms"]), float(row["floor_rms"]), int(row["n"])


def squared_error(record: Record, channel: str = "dtheta") -> float:
    """Unweighted squared error summed over points and times, as the f of the thesis (K^2)."""
    rms, _, n = left_over(record, channel)
    return n * rms * rms


def percent(share: float) -> str:
    """A share as text in %."""
    return f"{100.0 * share:.0f} %" if abs(share) >= 0.1 else f"{100.0 * share:.2g} %"
