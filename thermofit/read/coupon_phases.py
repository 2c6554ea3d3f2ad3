"""Phases of a coupon record: elastic, loading, unloading, hold, with their rates; and thinning that keeps the turning points."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from thermofit.observe.phases import noise_level, working_sigma

_REVERSAL = 8.0
_LEAST_SWING = 2e-3
_RATE_JUMP = float(np.log(2.0))
_FLOOR = 1e-3
_WINDOWS = 200
_LEAST_WINDOWS = 4
_ELASTIC = 0.02
_EARLY = 0.3

Phase = tuple[float, float, str]


def coupon_phases(time: np.ndarray, strain: np.ndarray, stress: np.ndarray) -> tuple[Phase, ...]:
    """(t0, t1, label) in s of a record (n,). A label is `elastic`, `loading`, `unloading` or `hold`, then the strain rate in 1/s.

    Loading is the sense in which the strain first leaves its start; every reversal begins a phase, and so does a change of the rate by
    more than a factor of two. In a hold the strain changes by no more than its noise or 0.2 % of its range. `elastic` is loading before
    the first reversal, as long as the stress stays within 2 % of its largest value from the straight line through its beginning.
    """
    edges = phase_edges(time, strain)
    still = max(_REVERSAL * working_sigma(noise_level(time, strain), strain), _LEAST_SWING * float(np.ptp(strain)))
    changes = np.diff(strain[edges])
    moving = changes[np.abs(changes) > still]
    sense = 1.0 if not moving.size or moving[0] > 0.0 else -1.0
    phases: list[Phase] = []
    for (a, b), change in zip(pairwise(edges), changes, strict=True):
        kind = "hold" if abs(change) <= still else "loading" if sense * change > 0.0 else "unloading"
        phase = (float(time[a]), float(time[b]), f"{kind} {abs(_slope(time, strain, a, b)):.2g}/s")
        if kind == "hold" and phases and phases[-1][2].startswith("hold"):
            phase = (phases.pop()[0], phase[1], phase[2])
        phases.append(phase)
    return tuple(_with_elastic(phases, time, strain, stress))


def phase_edges(time: np.ndarray, strain: np.ndarray) -> np.ndarray:
    """Indices at which phases begin and end, the first and last sample included."""
    edges = turning_points(time, strain)
    found = [int(edges[0])]
    for a, b in pairwise(edges):
        found += [*_rate_changes(time, strain, int(a), int(b)), int(b)]
    return np.unique(np.array(found, dtype=int))


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
    splits = [0, *_splits(log, 0, log.size), log.size]
    found = []
    for before, k, after in zip(splits, splits[1:], splits[2:], strict=False):
        # The stretches are at least some windows long, so that a short one at an end pushes the split away from the kink.
        low, high = max(before, k - _LEAST_WINDOWS), min(after, k + _LEAST_WINDOWS)
        found.append(_kink(time, value, int(places[low]), int(places[high])))
    return found


def _kink(time: np.ndarray, value: np.ndarray, a: int, b: int) -> int:
    """The sample strictly between a and b that is farthest from their chord."""
    chord = value[a] + _slope(time, value, a, b) * (time[a : b + 1] - time[a])
    return a + 1 + int(np.argmax(np.abs(value[a : b + 1] - chord)[1:-1]))


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


def _with_elastic(phases: list[Phase], time: np.ndarray, strain: np.ndarray, stress: np.ndarray) -> list[Phase]:
    """Phases with the elastic part of the loading before the first reversal named."""
    reversal = next((t0 for t0, _, label in phases if label.startswith("unloading")), float(time[-1]))
    first = time <= reversal
    end = _linear_until(time[first], strain[first], stress[first])
    named: list[Phase] = []
    for t0, t1, label in phases:
        kind, rate = label.split(" ", 1)
        if kind != "loading" or t0 >= end:
            named.append((t0, t1, label))
        elif t1 <= end:
            named.append((t0, t1, f"elastic {rate}"))
        else:
            named += [(t0, end, f"elastic {rate}"), (end, t1, label)]
    return named


def _linear_until(time: np.ndarray, strain: np.ndarray, stress: np.ndarray) -> float:
    """Time at which the stress leaves the straight line through its beginning; the first time where there is no such line."""
    rise = np.abs(stress - stress[0])
    early = np.flatnonzero(rise > _EARLY * rise.max())
    n = max(6, int(early[0]) if early.size else 0)
    if time.size < 8 or n >= time.size or np.ptp(strain[:n]) == 0.0:
        return float(time[0])
    modulus, base = np.polyfit(strain[:n], stress[:n], 1)
    away = np.flatnonzero(np.abs(stress - modulus * strain - base) > _ELASTIC * rise.max())
    away = away[away >= n - 1]
    return float(time[away[0]] if away.size else time[-1])


def thinned(time: np.ndarray, strain: np.ndarray, stress: np.ndarray, points: int) -> np.ndarray:
    """Indices of about `points` samples: ends, turning points and changes of rate, the extremes, and between them samples at equal
    distance along the path in (time, strain, stress), each over its range."""
    if time.size <= points:
        return np.arange(time.size)
    kept = {*phase_edges(time, strain).tolist(), *turning_points(time, stress).tolist()}
    kept |= {int(np.argmax(x)) for x in (strain, stress)} | {int(np.argmin(x)) for x in (strain, stress)}
    steps = [np.diff(x) / max(float(np.ptp(x)), np.finfo(float).tiny) for x in (time, strain, stress)]
    length = np.concatenate([[0.0], np.cumsum(np.sqrt(sum(step**2 for step in steps)))])
    fixed = np.array(sorted(kept), dtype=int)
    low, high = 2, 4 * points
    chosen = fixed
    # Several wanted lengths may fall on one sample: the number of lengths that gives the number of samples is found by halving.
    while high - low > 1:
        middle = (low + high) // 2
        found = np.union1d(np.searchsorted(length, np.linspace(0.0, length[-1], middle)).clip(0, time.size - 1), fixed)
        low, high, chosen = (middle, high, found) if found.size <= points else (low, middle, chosen)
    return chosen
