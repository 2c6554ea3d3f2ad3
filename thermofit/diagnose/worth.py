"""How many independent values a residual is worth, and what information criteria make of that.

The correlation of the whitened residual is measured in time (pooled over the points) and over distance (pooled over the times), each
up to where it first dies away; n values are worth n / (tau_time tau_space). Misfit and interpolated noise hang together alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist, squareform

from thermofit.experiment.channels import field_of
from thermofit.experiment.model import StageModel
from thermofit.fit.memory import memories
from thermofit.observe.comparison import Comparison
from thermofit.observe.observation import FieldObservation

_GONE = 0.02
"""Correlation below which values count as independent."""
_BINS = 24
_LEAST_TIMES = 8
"""Fewer times of a point tell nothing of the memory; then every time counts as independent."""


def independent(model: StageModel, residual: np.ndarray) -> dict[str, float]:
    """Number of independent values by channel at a residual (n,) whitened by the noise."""
    if model.segments is not None:
        found, out, at = memories(residual[: sum(model.segments)], model.segments), {}, 0
        for c in model.comparisons:
            out[c.channel] = sum(m.independent for m in found if at <= m.part.start < at + c.n)
            at += c.n
        return out
    out, at = {}, 0
    for c in model.comparisons:
        out[c.channel] = _of_field(c, residual[at : at + c.n], model.observations[field_of(c)])
        at += c.n
    return out


def _of_field(c: Comparison, r: np.ndarray, observation: FieldObservation) -> float:
    z = np.zeros((len(observation.time), len(observation.xy), int(c.rows[:, 2].max(initial=0)) + 1))
    np.add.at(z, tuple(c.rows.T), r)
    return max(c.n / (time_scale(z) * length_scale(z, observation.xy)), 1.0)


def time_scale(z: np.ndarray) -> float:
    """1 + 2 sum of the correlation over time of z (n_t, n_s, n_c), zero where nothing is compared; at least 1."""
    n_t = len(z)
    total = float(np.sum(z**2))
    if n_t < _LEAST_TIMES or total == 0.0:
        return 1.0
    rho = np.array([np.sum(z[:-k] * z[k:]) / total for k in range(1, n_t)])
    below = np.flatnonzero(rho <= _GONE)
    return float(1.0 + 2.0 * np.sum(rho[: below[0]] if below.size else rho))


def length_scale(z: np.ndarray, xy: np.ndarray) -> float:
    """Number of points that err as one: mean over points of the sum of the correlation over distance of z (n_t, n_s, n_c); at least 1."""
    if len(xy) < 3:
        return 1.0
    flat = z.transpose(1, 0, 2).reshape(len(xy), -1)
    size = np.sqrt(np.sum(flat**2, axis=1))
    used = np.flatnonzero(size > 0.0)
    if len(used) < 3:
        return 1.0
    product, mean = flat[used] @ flat[used].T, float(np.mean(size[used] ** 2))
    distance = squareform(pdist(xy[used]))
    edges = np.linspace(0.0, 0.5 * float(distance.max()), _BINS + 1)
    number = np.digitize(distance, edges[1:])
    off = ~np.eye(len(used), dtype=bool)
    total = 0.0
    for k in range(_BINS):
        here = off & (number == k)
        if not here.any():
            continue
        rho = float(product[here].mean()) / mean
        if rho <= _GONE:
            break
        total += rho * float(here.sum()) / len(used)
    return 1.0 + total


@dataclass(frozen=True)
class Criteria:
    """Information criteria of a fit: deviance, AIC, BIC, number of fitted parameters and of independent values."""

    deviance: float
    aic: float
    bic: float
    parameters: int
    independent: float


def criteria(mean_square: Mapping[str, float], worth: Mapping[str, float], parameters: int, priors: float = 0.0) -> Criteria:
    """AIC and BIC from the mean square of every channel's whitened residual and the number of independent values in it.

    The variance of a channel is the noise's, or larger where the model misfits: -2 ln L = sum n (ln s^2 + q / s^2) with s^2 = max(q, 1)
    the most likely one, q the mean square; so a misfit counts as one, not as thousands of sure contradictions. `priors` is the square
    sum of departures from what is known of parameters.
    """
    deviance = priors
    for channel, q in mean_square.items():
        variance = max(q, 1.0)
        deviance += worth[channel] * (np.log(variance) + q / variance)
    count = float(sum(worth.values()))
    return Criteria(float(deviance), float(deviance + 2.0 * parameters), float(deviance + parameters * np.log(count)), parameters, count)


def mean_squares(model: StageModel, residual: np.ndarray) -> dict[str, float]:
    """Mean square of the residual by channel."""
    out, at = {}, 0
    for c in model.comparisons:
        out[c.channel] = float(np.mean(residual[at : at + c.n] ** 2))
        at += c.n
    return out


def least(values: Sequence[float]) -> int:
    """Place of the smallest value."""
    return int(np.argmin(np.array(values)))
