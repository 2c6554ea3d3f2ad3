"""What is left of a residual beside its noise: size per phase of the test, memory from one observation to the next, maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from thermofit.experiment.fields import TestPhase
from thermofit.observe.comparison import Comparison
from thermofit.observe.observation import FieldObservation

AXES = "xy"


@dataclass(frozen=True)
class ResidualField:
    """The compared error of one channel at every time and point, in `unit`; nan where it is not compared.

    `time` s (n_t,), `value` and `sigma` (n_t, n_s, n_c). `shared` (n_t, n_s, n_c) is the standard error of the part of the noise
    that all times of a point have in common: the reference of dtheta (2.22), zero for other channels.
    """

    channel: str
    unit: str
    time: np.ndarray
    value: np.ndarray
    sigma: np.ndarray
    shared: np.ndarray

    @property
    def normalised(self) -> np.ndarray:
        """Error over its sigma (n_t, n_s, n_c): one on the average where only noise is left."""
        return self.value / self.sigma

    def component(self, axis: int) -> ResidualField:
        """The part along x (0) or y (1), as a channel of its own such as du_x."""
        part = (slice(None), slice(None), slice(axis, axis + 1))
        name = f"{self.channel}_{AXES[axis]}"
        return replace(self, channel=name, value=self.value[part], sigma=self.sigma[part], shared=self.shared[part])

    def at(self, times: np.ndarray) -> ResidualField:
        """The part at the times that are True (n_t,)."""
        return replace(self, time=self.time[times], value=self.value[times], sigma=self.sigma[times], shared=self.shared[times])


def residual_field(comparison: Comparison, error: np.ndarray, observation: FieldObservation) -> ResidualField:
    """The residual of a comparison put back to its times and points; `error` (n_t, n_s, n_c) = prediction - observation."""
    shape = observation.value.shape
    place = tuple(comparison.rows.T)
    value, sigma, shared = np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
    value[place] = comparison.residual(error) / np.sqrt(comparison.weight)
    sigma[place] = comparison.sigma
    if comparison.channel == "dtheta":
        shared[place] = np.sqrt(np.maximum(comparison.sigma**2 - observation.sigma[place] ** 2, 0.0))
    else:
        shared[place] = 0.0
    return ResidualField(comparison.channel, comparison.unit, observation.time, value, sigma, shared)


@dataclass(frozen=True)
class Span:
    """A part of the test: its name, t0 < t <= t1 in s; the experiment, or the record of a coupon, that it is of where there are several."""

    name: str
    t0: float
    t1: float
    experiment: str = ""
    record: str = ""


def named_phases(phases: Sequence[TestPhase]) -> tuple[Span, ...]:
    """Phases of the test: neighbours of one label are one phase, several phases of one label are numbered."""
    merged: list[Span] = []
    for phase in phases:
        if merged and merged[-1].name == phase.label:
            merged[-1] = replace(merged[-1], t1=phase.t1)
        else:
            merged.append(Span(phase.label, phase.t0, phase.t1))
    labels = [span.name for span in merged]
    spans = []
    for n, span in enumerate(merged):
        number = f" {labels[: n + 1].count(span.name)}" if labels.count(span.name) > 1 else ""
        spans.append(replace(span, name=span.name + number))
    return tuple(spans)


def span_of(time: np.ndarray, spans: Sequence[Span]) -> np.ndarray:
    """Index of the span (n_t,) of every time s; times outside belong to the first or the last, so that none is lost."""
    ends = np.array([span.t1 for span in spans[:-1]])
    return np.asarray(np.searchsorted(ends, time - 1e-9))


@dataclass(frozen=True)
class Statistics:
    """A residual in numbers: `n` values, mean and rms in `unit`, rms of the noise, reduced chi-square.

    `lag1` is the correlation of neighbouring observations of one point, `lag1_noise` what the noise alone gives (None where no
    point is observed twice in a row).
    """

    n: int
    mean: float
    rms: float
    unit: str
    floor_rms: float
    chi2_reduced: float
    lag1: float | None
    lag1_noise: float | None

    @property
    def over_floor(self) -> float:
        """How many times its noise the residual is: sqrt of the reduced chi-square."""
        return float(np.sqrt(self.chi2_reduced))


def statistics(field: ResidualField) -> Statistics | None:
    """Statistics of a residual field, None where nothing of it is compared."""
    used = np.isfinite(field.value)
    if not used.any():
        return None
    value, sigma = field.value[used], field.sigma[used]
    lag, expected = lag_one(field)
    return Statistics(
        n=int(used.sum()),
        mean=float(value.mean()),
        rms=float(np.sqrt(np.mean(value**2))),
        unit=field.unit,
        floor_rms=float(np.sqrt(np.mean(sigma**2))),
        chi2_reduced=float(np.mean((value / sigma) ** 2)),
        lag1=lag,
        lag1_noise=expected,
    )


def lag_one(field: ResidualField) -> tuple[float | None, float | None]:
    """Correlation of z = error/sigma with itself one observation later, over all points, and the value that noise alone gives.

    rho = sum z_n z_(n+1) / sqrt(sum z_n^2 sum z_(n+1)^2), sums over the pairs that are both compared; no mean is taken off, so that a
    constant misfit counts as memory. Of the noise only the part `shared` by all times of a point is remembered.
    """
    z = field.normalised
    both = np.isfinite(z[:-1]) & np.isfinite(z[1:])
    if not both.any():
        return None, None
    part = field.shared / field.sigma
    return _correlation(z[:-1], z[1:]), float(np.mean(part[:-1][both] * part[1:][both]))


def lag_ones(z: np.ndarray, xy: np.ndarray) -> tuple[float | None, float | None]:
    """Correlation of whitened residuals z (n_t, n_s, n_c), nan where nothing is compared: of neighbouring times at a point, and of every
    point of xy (n_s, 2) mm with the one nearest to it at the same time.

    None where there are no such pairs. No mean is taken off, as in `lag_one`.
    """
    if len(xy) < 2:
        return _correlation(z[:-1], z[1:]), None
    nearest = cKDTree(xy).query(xy, k=2)[1]
    pairs = np.unique(np.sort(nearest, axis=1), axis=0)
    return _correlation(z[:-1], z[1:]), _correlation(z[:, pairs[:, 0]], z[:, pairs[:, 1]])


def _correlation(one: np.ndarray, other: np.ndarray) -> float | None:
    """sum a b / sqrt(sum a^2 sum b^2) of the pairs that are both compared; None where there are none."""
    both = np.isfinite(one) & np.isfinite(other)
    a, b = one[both], other[both]
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else None


def node_rms(field: ResidualField) -> np.ndarray:
    """Rms over time (n_s, n_c) of error/sigma at every point; nan at points that are never compared."""
    z = field.normalised
    used = np.isfinite(z)
    count = used.sum(axis=0)
    total = np.where(used, z, 0.0) ** 2
    return np.where(count > 0, np.sqrt(total.sum(axis=0) / np.maximum(count, 1)), np.nan)


def time_rms(field: ResidualField) -> np.ndarray:
    """Rms over points and components (n_t,) of error/sigma at every time; nan at times that are never compared."""
    z = field.normalised.reshape(len(field.time), -1)
    used = np.isfinite(z)
    count = used.sum(axis=1)
    total = np.where(used, z, 0.0) ** 2
    return np.where(count > 0, np.sqrt(total.sum(axis=1) / np.maximum(count, 1)), np.nan)
