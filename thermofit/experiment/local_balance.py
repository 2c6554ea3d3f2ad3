"""A balance evaluated locally on a body test, before anything is concluded from it: what is missing in every cell of place and time.

`section_force` makes the one of forces, `piece_heat` that of heat. Both use measured fields where the whole model has boundaries: what
is wrong beyond the observed length does not enter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from thermofit.body.mesh.dogbone import half_width
from thermofit.core.errors import NumericsError
from thermofit.core.experiment import Specimen
from thermofit.core.parameters import Parameters
from thermofit.experiment.channels import field_of
from thermofit.experiment.joint import Joint
from thermofit.experiment.prediction import Errors
from thermofit.study.geometry import STRAIGHT

Kind = Literal["force", "heat"]


@dataclass(frozen=True)
class LocalBalance:
    """What a balance misses in cells of place and time, m of them.

    `amount` (m,) in `unit` with noise `covariance` (m, m); `columns` (m, p): how it changes with the fitted parameters `names`, of which
    `value` (p,) are the values and `bounds` those of the study; `told` (k, p): what the other channels say of a change of them, in
    standard errors; `beside` (m, k): what errors of unit variance of the prescribed force, mesh and steps make of it. `y` mm, `time` s
    (m,) are the centres of the cells, `row` and `column` (m,) their numbers in time and place, `extent` mm and `duration` s (m,) their
    size; `dropped` counts cells without enough values.
    """

    kind: Kind
    channel: str
    unit: str
    amount: np.ndarray
    covariance: np.ndarray
    columns: np.ndarray
    names: tuple[str, ...]
    value: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]
    told: np.ndarray
    beside: np.ndarray
    y: np.ndarray
    time: np.ndarray
    row: np.ndarray
    column: np.ndarray
    extent: float
    duration: np.ndarray
    dropped: int
    volume: np.ndarray
    """Volume (m,) mm^3 under the weight of a cell, by which a heat becomes a power; area mm^2 of a section."""
    follow: Callable[[np.ndarray], LocalBalance] | None = None
    """The same at parameters that are off by so much (p,) from the fitted ones, without a run; None: it is linear in them as it is.
    NumericsError where it cannot be."""
    scan: tuple[np.ndarray, ...] = ()
    """Such changes (p,) among which the best is looked for, each with noise of its own; empty: from step to step."""


@dataclass(frozen=True)
class JointErrors:
    """What a joint problem shows at given parameters: error fields (prediction less observation) and their derivatives by the free
    parameters, and which points count at which time: those that its channels compare, of temperatures those at rest as well."""

    joint: Joint
    parameters: Parameters
    errors: Errors
    slopes: dict[str, np.ndarray]
    left: dict[str, np.ndarray]
    """Error (n_t, n_s, n_c) of mesh and steps that may be left in a field; empty where it is not known."""

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds (p,) of the free parameters."""
        each = [self.joint.study.bounds(name) for name in self.parameters.free]
        return np.array([float(low) for low, _ in each]), np.array([float(high) for _, high in each])

    @cached_property
    def known_by_motion(self) -> np.ndarray:
        """Triangle (k, p) of the whitened derivatives of displacements, force and readings: |R x| is what they say against a change x."""
        model = self.joint.model
        columns = model.assemble_jacobian(self.errors, self.slopes)
        readings = model.with_priors(columns, self.parameters.free)[len(columns) :]
        ends = np.cumsum([0, *(c.n for c in model.comparisons)])
        own = [columns[a:b] for a, b, c in zip(ends[:-1], ends[1:], model.comparisons, strict=True) if field_of(c) != "theta"]
        rows = np.concatenate([readings, *own])
        return np.asarray(np.linalg.qr(rows, mode="r")) if len(rows) > rows.shape[1] else rows

    def mask(self, channel: str) -> np.ndarray:
        """Points (n_t, n_s) that a channel compares."""
        comparison = next(c for c in self.joint.model.comparisons if c.channel == channel)
        seen = self.joint.model.observations[field_of(comparison)]
        out = np.zeros(seen.mask.shape, dtype=bool)
        out[comparison.rows[:, 0], comparison.rows[:, 1]] = True
        return out


def shown(joint: Joint, parameters: Parameters, numerical: Sequence[tuple[str, np.ndarray]] = ()) -> JointErrors:
    """What a joint problem shows at parameters; `numerical`: by channel the whitened error (n,) of mesh and steps that may be left.

    Not run again where the fit ended there. NumericsError where the run fails.
    """
    model = joint.model
    if model.linearise is None:
        raise NumericsError("local balances: this model has no exact derivatives")
    errors, slopes = model.linearise(parameters, parameters.free)
    left: dict[str, np.ndarray] = {}
    for channel, rows in numerical:
        for c in model.comparisons:
            if c.channel == channel and len(rows) == c.n:
                out = np.zeros_like(model.observations[field_of(c)].value)
                out[tuple(c.rows.T)] = rows / np.sqrt(c.weight)
                left[field_of(c)] = out
    return JointErrors(joint, parameters, errors, dict(slopes), left)


def has_sections(joint: Joint) -> bool:
    """True where every section is one bar: local balances over the width know no holes and arms."""
    return joint.study.geometry.shape in STRAIGHT


def width(joint: Joint, y: np.ndarray) -> np.ndarray:
    """Width (n,) mm of the unloaded specimen at y (n,) mm."""
    specimen: Specimen = joint.data.specimen
    if joint.study.geometry.shape == "bar":
        return np.full(len(y), specimen.gauge_width)
    return np.asarray(2.0 * half_width(specimen, y))
