"""Phases of a coupon record: elastic, loading, unloading, hold, with their rates; and thinning that keeps the turning points."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from thermofit.measure.phases import noise_level, working_sigma

_REVERSAL = 8.0
_LEAST_SWING = 2e-3
_RATE_JUMP = float(np.log(2.0))
_FLOOR = 1e-3
_HOLD = 0.02
_WINDOWS = 200
_LEAST_WINDOWS = 4
_ELASTIC = 0.02

Phase = tuple[float, float, str]


def coupon_phases(time: np.ndarray, strain: np.ndarray, stress: np.ndarray) -> tuple[Phase, ...]:
    """(t0, t1, label) in s of a record (n,). A label is `elastic`, `loading`, `unloading` or `hold`, then the strain rate in 1/s.

    Loading is the sense in which the strain first leaves its start; every reversal begins a phase, and so does a change of the rate by more
    than a factor of two. `elastic` is the beginning of the first phase, up to 2 % of the largest stress from its straight line.
    """
    edges = phase_edges(time, strain)
    slopes = [_slope(time, strain, a, b) for a, b in pairwise(edges)]
    fastest = max((abs(slope) for slope in slopes), default=0.0)
    moving = [slope for slope in slopes if abs(slope) > _HOLD * fastest]
    sense = 1.0 if not moving or moving[0] > 0.0 else -1.0
    phases: list[Phase] = []
    for (a, b), slope in zip(pairwise(edges), slopes, strict=True):
        kind = "hold" if abs(slope) <= _HOLD * fastest else "loading" if sense * slope > 0.0 else "unloading"
        phases.append((float(time[a]), float(time[b]), f"{kind} {abs(slope):.2g}/s"))
    first = next((k for k, phase in enumerate(phases) if not phase[2].startswith("hold")), None)
    if first is not None:
        phases[first : first + 1] = _elastic_part(phases[first], (time, strain, stress))
    return tuple(phases)


def phase_edges(time: np.ndarray, strain: np.ndarray) -> np.ndarray:
    """Indices at which phases begin and end, the first and last sample included."""
    edges = turning_points(time, strain)
    found = [int(edges[0])]
    for a, b in pairwise(edges):
        found += [*_rate_changes(time, strain, int(a), int(b)), int(b)]
    return np.array(found, dtype=int)


def turning_points(time: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Indices of the first sample, of every reversal larger than noise and 0.2 % of the range, and of the last sample."""
    sigma = working_sigma(noise_level(time, value), value)
    swing = max(_REVERSAL * sigma, _LEAST_SWING * float(np.ptp(value)))
    found = [0]
    low = high = 0
    sense = 0
    for k in range(1, value.size):
        low = k if value[k] < value[low] else low
        high = k if value[k] > value[high] else high
        if sense >= 0 and value[high] - value[k] > swing and (sense > 0 or high >= low):
            found += [high] if high > found[-1] else []
            sense, low = -1, k
            high = k
        elif sense <= 0 and value[k] - value[low] > swing and (sense < 0 or low >= high or low == 0):
            found += [low] if low > found[-1] else []
            sense, high = 1, k
            low = k
    return np.array([*found, value.size - 1] if found[-1] < value.size - 1 else found, dtype=int)


def _slope(time: np.ndarray, value: np.ndarray, a: int, b: int) -> float:
    return float((value[b] - value[a]) / (time[b] - time[a]))


def _rate_changes(time: np.ndarray, value: np.ndarray, a: int, b: int) -> list[int]:
    """Indices within a branch at which the rate changes by more than a factor of two, by repeated halving of its logarithm."""
    places = np.unique(np.linspace(a, b, min(_WINDOWS, (b - a) // 5) + 1).astype(int))
    if places.size < 2 * _LEAST_WINDOWS + 1:
        return []
    rate = np.abs(np.diff(value[places]) / np.diff(time[places]))
    mean = abs(_slope(time, value, a, b))
    if mean == 0.0:
        return []
    log = np.log(np.maximum(rate, _FLOOR * mean))
    return [int(places[k]) for k in _splits(log, 0, log.size)]


def _splits(log: np.ndarray, a: int, b: int) -> list[int]:
    """Places within [a, b) that part it into stretches of one level."""
    if b - a < 2 * _LEAST_WINDOWS:
        return []
    cuts = np.arange(a + _LEAST_WINDOWS, b - _LEAST_WINDOWS + 1)
    total, running = log[a:b].sum(), np.cumsum(log[a:b])
    left = running[cuts - a - 1] / (cuts - a)
    right = (total - running[cuts - a - 1]) / (b - cuts)
    gain = (left - right) ** 2 * (cuts - a) * (b - cuts) / (b - a)
    k = int(cuts[int(np.argmax(gain))])
    if abs(float(np.median(log[a:k]) - np.median(log[k:b]))) < _RATE_JUMP:
        return []
    return [*_splits(log, a, k), k, *_splits(log, k, b)]


def _elastic_part(phase: Phase, record: tuple[np.ndarray, np.ndarray, np.ndarray]) -> list[Phase]:
    """The phase, parted at the end of its straight beginning."""
    time, strain, stress = record
    inside = np.flatnonzero((time >= phase[0]) & (time <= phase[1]))
    if inside.size < 8:
        return [phase]
    e, s = strain[inside], stress[inside] * np.sign(strain[inside][-1] - strain[inside][0])
    peak = float(np.max(np.abs(s - s[0])))
    early = np.flatnonzero(np.abs(s - s[0]) > 0.5 * peak)
    part = slice(0, max(6, int(early[0]) if early.size else s.size))
    if np.ptp(e[part]) == 0.0:
        return [phase]
    modulus, base = np.polyfit(e[part], s[part], 1)
    away = np.flatnonzero(np.abs(s - modulus * e - base) > _ELASTIC * peak)
    away = away[away >= part.stop - 1]
    if not away.size or inside[away[0]] <= inside[0]:
        return [(phase[0], phase[1], "elastic " + phase[2].split(" ", 1)[1])] if not away.size else [phase]
    end = float(time[inside[away[0]]])
    if end >= phase[1]:
        return [phase]
    return [(phase[0], end, "elastic " + phase[2].split(" ", 1)[1]), (end, phase[1], phase[2])]


def thinned(time: np.ndarray, strain: np.ndarray, stress: np.ndarray, points: int) -> np.ndarray:
    """Indices of about `points` samples: ends, turning points and changes of rate, the extremes, and between them samples at equal
    distance along the path in (time, strain, stress), each over its range."""
    if time.size <= points:
        return np.arange(time.size)
    kept = {*phase_edges(time, strain).tolist(), *turning_points(time, stress).tolist()}
    kept |= {int(np.argmax(x)) for x in (strain, stress)} | {int(np.argmin(x)) for x in (strain, stress)}
    coarse = np.unique(np.linspace(0, time.size - 1, min(time.size, 4 * points)).astype(int))
    steps = [np.diff(x[coarse]) / max(float(np.ptp(x)), np.finfo(float).tiny) for x in (time, strain, stress)]
    length = np.concatenate([[0.0], np.cumsum(np.sqrt(sum(step**2 for step in steps)))])
    wanted = np.linspace(0.0, length[-1], max(2, points - len(kept)))
    chosen = np.interp(wanted, length, coarse).round().astype(int)
    return np.unique(np.concatenate([chosen, np.array(sorted(kept), dtype=int)]))
