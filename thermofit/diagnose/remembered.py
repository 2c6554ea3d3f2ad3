"""Noise that samples which follow each other share: on a coupon those of a record, on a body the frames that one point is seen in.

A mean over what remembers scatters more than one over white noise. So scores, held-out comparisons, buffers beside held-out blocks and
structure have to know of it. What a model misses remembers, too: `fit.memory` tells both apart in time, and on a body smooth functions of
the place are taken off first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.diagnose.case import Case
from thermofit.diagnose.held_out import Rows
from thermofit.fit.covariance import NoiseOperator
from thermofit.fit.memory import NeighbourNoise, autoregressive, neighbours, rough_in_place

HARDLY_ALIKE = 0.1
"""Correlation below which samples count as independent of a held-out block."""


@dataclass(frozen=True)
class Remembered:
    """Noise of every channel, and the series that the residual (n,) is made of: number of its series and of the sample in it of every row
    (n,), channel of every series, -1 of priors, which remember nothing."""

    of_channel: tuple[NeighbourNoise, ...]
    series: np.ndarray
    sample: np.ndarray
    channel: np.ndarray

    @property
    def rho(self) -> np.ndarray:
        """Correlation (n_series,) of one sample with the next."""
        return np.array([0.0 if k < 0 else self.of_channel[k].rho for k in self.channel])

    @property
    def size(self) -> np.ndarray:
        """Standard deviation (n,) over the declared one, where that is too small."""
        return np.sqrt(np.array([1.0 if k < 0 else max(self.of_channel[k].variance, 1.0) for k in self.channel]))[self.series]

    def lag(self, case: Case, rows: Rows) -> float:
        """Time after which noise is HARDLY_ALIKE, in samples on coupons, in s on bodies; the longest of all channels."""
        lags = [one.lag(HARDLY_ALIKE) for one in self.of_channel]
        if case.cheap:
            return max(lags, default=0.0)
        spacings = [_spacing(rows.time[rows.channel == k]) for k in range(len(lags))]
        return max((lag * spacing for lag, spacing in zip(lags, spacings, strict=True)), default=0.0)


def remembered(case: Case, rows: Rows, residual: np.ndarray) -> Remembered:
    """What the samples of a residual (n,) share."""
    comparisons = case.model.comparisons
    series, sample, channel = _of_records(case) if case.model.segments is not None else _of_points(case, len(residual))
    of_row = channel[series]
    found = []
    for k in range(len(comparisons)):
        own = np.flatnonzero(of_row == k)
        r, place = residual[own], series[own] - series[own].min(initial=0)
        if case.model.segments is not None:
            found.append(neighbours(r, place, sample[own]))
            continue
        rough = rough_in_place(r, comparisons[k].rows[:, 2], sample[own], rows.xy[own])
        found.append(neighbours(rough, place, sample[own]) if len(rough) else NeighbourNoise(1.0, 0.0))
    return Remembered(tuple(found), series, sample, channel)


def _of_records(case: Case) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Series and sample of every row of coupons, and channel of every series: one for each record and channel."""
    lengths = case.model.segments or ()
    ends = np.cumsum([c.n for c in case.model.comparisons])
    channel = np.searchsorted(ends, np.cumsum(lengths))
    series = np.repeat(np.arange(len(lengths)), lengths)
    sample = np.concatenate([np.arange(n) for n in lengths]) if lengths else np.zeros(0, dtype=int)
    return series, sample, np.where(channel < len(ends), channel, -1)


def _of_points(case: Case, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of a body: one series for each component that is compared at a point, one for each prior."""
    series: list[np.ndarray] = []
    sample: list[np.ndarray] = []
    channel: list[int] = []
    for k, c in enumerate(case.model.comparisons):
        own = np.unique(c.rows[:, 1] * (c.rows[:, 2].max(initial=0) + 1) + c.rows[:, 2], return_inverse=True)[1]
        series.append(own + len(channel))
        sample.append(c.rows[:, 0])
        channel += [k] * (int(own.max(initial=-1)) + 1)
    priors = n - sum(len(s) for s in series)
    series.append(len(channel) + np.arange(priors))
    sample.append(np.zeros(priors, dtype=int))
    return np.concatenate(series), np.concatenate(sample), np.array([*channel, *[-1] * priors], dtype=int)


def _spacing(time: np.ndarray) -> float:
    """Mean time in s between frames at times (n,); 0 where there is one."""
    known = np.unique(time)
    return float(np.mean(np.diff(known))) if len(known) > 1 else 0.0


def noise_of(case: Case, found: Remembered) -> NoiseOperator | None:
    """Applies the covariance of the noise to columns (n, k): what the comparisons know of it, and what samples share beside; on a body with
    the variance that frames show, where that declared is too small. None where it is white, and no larger than declared."""
    known = case.model.noise if any(c.noise is not None for c in case.model.comparisons) else None
    rho, size = found.rho, found.size[:, None]
    if case.cheap or np.all(size == 1.0):
        size = np.ones((1, 1))
    if not np.any(rho > 0.0) and np.all(size == 1.0):
        return known
    shared = autoregressive(found.series, found.sample, rho)

    def apply(columns: np.ndarray) -> np.ndarray:
        scaled = size * columns
        return np.asarray(size * (shared(scaled) if known is None else known(scaled) + shared(scaled) - scaled))

    return apply
