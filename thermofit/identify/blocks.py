"""Blocks of time and space for the bootstrap, longer than the memory of the residual."""

from __future__ import annotations

import numpy as np

from thermofit.experiment.channels import field_of
from thermofit.experiment.model import StageModel
from thermofit.fit.bootstrap import Blocks
from thermofit.fit.memory import tapered_correlation
from thermofit.identify.correlated import correlogram
from thermofit.observe.comparison import Comparison
from thermofit.observe.observation import FieldObservation

LONGER = 6.0
"""Length of a block in units of the correlation time or length."""
_LEAST_BLOCKS = 12
"""A record is cut into this many blocks at least: fewer would say nothing of their scatter."""
_LARGE_FIELD = 400
"""Points of a field from which on a sample of them stands for all in its correlation over time."""


def residual_blocks(model: StageModel, residual: np.ndarray) -> Blocks:
    """Blocks of the whitened residual of a stage; entries of priors are blocks of their own."""
    if model.segments is not None:
        label, remark = _of_segments(residual, model.segments)
    else:
        label, remark = _of_fields(model, residual)
    rest = len(residual) - len(label)
    label = np.append(label, label.max(initial=-1) + 1 + np.arange(rest))
    _, label = np.unique(label, return_inverse=True)
    return Blocks(label, int(label.max()) + 1, remark)


def correlation_time(rho: np.ndarray) -> float:
    """1 + 2 sum of the correlation over positive lags, at least one."""
    return max(float(2.0 * rho.sum() - 1.0), 1.0)


def block_length(time: float) -> int:
    """Values in a block for a correlation time: one of white noise, LONGER times the memory beyond."""
    return 1 + int(np.ceil(LONGER * (time - 1.0)))


def _of_segments(residual: np.ndarray, segments: tuple[int, ...]) -> tuple[np.ndarray, str]:
    labels, at, count, lengths = [], 0, 0, []
    for n in segments:
        size = min(block_length(correlation_time(tapered_correlation(residual[at : at + n]))), max(n // _LEAST_BLOCKS, 1))
        number = np.arange(n) // size
        labels.append(count + number)
        count, at = count + int(number[-1]) + 1, at + n
        lengths.append(size)
    span = f"{min(lengths)}" if min(lengths) == max(lengths) else f"{min(lengths)} to {max(lengths)}"
    return np.concatenate(labels), f"{count} blocks of {span} samples"


def _of_fields(model: StageModel, residual: np.ndarray) -> tuple[np.ndarray, str]:
    labels, at, count, words = [], 0, 0, []
    for c in model.comparisons:
        observation = model.observations[field_of(c.channel)]
        part = residual[at : at + c.n]
        frames, side = _frames(c, part, len(observation.time)), _side(c, part, observation)
        low = observation.xy.min(axis=0)
        tile = ((observation.xy - low) // side).astype(int)
        across = int(tile[:, 0].max()) + 1
        place = (tile[:, 0] + across * tile[:, 1])[c.rows[:, 1]]
        number = (c.rows[:, 0] // frames) * (int(place.max()) + 1) + place
        _, number = np.unique(number, return_inverse=True)
        labels.append(count + number)
        count, at = count + int(number.max()) + 1, at + c.n
        words.append(f"{c.channel}: {frames} times x {side:.3g} mm")
    return np.concatenate(labels), f"{count} blocks ({'; '.join(words)})"


def _frames(c: Comparison, residual: np.ndarray, n_times: int) -> int:
    """Times in a block: LONGER times the correlation time of the residual, averaged over points."""
    chosen = np.unique(c.rows[:, 1])[:: max(len(np.unique(c.rows[:, 1])) // _LARGE_FIELD, 1)]
    sums = np.zeros(n_times)
    for point in chosen:
        for component in range(int(c.rows[:, 2].max()) + 1):
            mine = (c.rows[:, 1] == point) & (c.rows[:, 2] == component)
            if mine.sum() >= n_times // 2:
                series = np.zeros(n_times)
                series[c.rows[mine, 0]] = residual[mine]
                whole = np.fft.rfft(series, 2 * n_times)
                sums += np.fft.irfft(np.abs(whole) ** 2)[:n_times]
    if sums[0] <= 0.0:
        return 1
    rho = sums / sums[0]
    below = np.flatnonzero(rho <= 0.02)
    rho = rho[: int(below[0])] if len(below) else rho
    return min(block_length(correlation_time(rho)), n_times)


def _side(c: Comparison, residual: np.ndarray, observation: FieldObservation) -> float:
    """Side of a tile in mm: LONGER times the length over which the residual is alike, averaged over times; all of a single point."""
    xy = observation.xy
    if len(xy) < 4:
        return 1.0 + float(np.ptp(xy, axis=0).max())
    n_times, n_c = len(observation.time), int(c.rows[:, 2].max()) + 1
    field = np.zeros((len(xy), n_times, n_c))
    field[c.rows[:, 1], c.rows[:, 0], c.rows[:, 2]] = residual
    seen = np.unique(c.rows[:, 1])
    taken = np.linspace(0, n_times - 1, min(n_times, 25)).astype(int)
    distance, rho = correlogram(xy[seen], field[seen][:, taken].reshape(len(seen), -1))
    if len(distance) == 0:
        return 1e-6 + float(np.sqrt(np.prod(np.ptp(xy, axis=0)) / len(xy)))
    step = distance[1] - distance[0] if len(distance) > 1 else 2.0 * distance[0]
    return LONGER * step * (1.0 + 2.0 * float(rho.sum()))
