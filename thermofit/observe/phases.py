"""Noise and kinks of a test record: where the programme of the machine changes, and where the force bends sharply.

A kink is a jump of slope. It is found by a matched filter: in a window of 2 h + 1 samples the hinge |t - t_i| is
fitted next to a straight line (a parabola for the wider windows, so that smooth hardening or drift is no kink), and
z = hinge / sigma(hinge) is compared with a fixed false-alarm level. Windows go from narrow to wide and never cross a
kink that is already known. The time between the samples is the intersection of the straight lines of both sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import ForceRecord

HALF_WIDTHS = (1, 2, 4, 8, 16, 32)
"""Half widths of the hinge windows in samples."""
ALARM = 6.0
"""A kink needs |z| above this: for Gaussian noise less than one false alarm in 1e6 records of 1e3 samples."""
LEAST_SAMPLES = 10
_REACH = 10
_RELATIVE_FLOOR = 1e-5
_HOLD_RATE = 0.01


@dataclass(frozen=True)
class Phase:
    """One stretch of the programme from `t0` to `t1` (s); `kind` is "hold", "loading" or "unloading".

    `crosshead_rate` mm/s (None without crosshead) and `force_rate` N/s are slopes of straight lines through the phase.
    """

    t0: float
    t1: float
    kind: str
    crosshead_rate: float | None
    force_rate: float


@dataclass(frozen=True)
class Phases:
    """Programme of a test: `items` in order; `kinks` (n,) s between them with standard error `kink_sigma` (n,) s.

    `knees` (m,) s are sharp bends of the force that the machine did not command: onset of yield, yield after reloading.
    """

    items: tuple[Phase, ...]
    kinks: np.ndarray
    kink_sigma: np.ndarray
    knees: np.ndarray


@dataclass(frozen=True)
class _Kinks:
    """Kinks of one signal: `time` s, `sigma` s, and the slopes `before` and `after` per s, all (n,)."""

    time: np.ndarray
    sigma: np.ndarray
    before: np.ndarray
    after: np.ndarray

    def take(self, keep: np.ndarray) -> _Kinks:
        return _Kinks(self.time[keep], self.sigma[keep], self.before[keep], self.after[keep])


def check_record(record: ForceRecord) -> None:
    """Refuse a record that cannot be smoothed: DataError for too few samples, NaN, times that do not increase, a constant force."""
    time, force, crosshead = record.time, record.force, record.crosshead
    if time.size < LEAST_SAMPLES:
        raise DataError(f"force record: found {time.size} samples, expected at least {LEAST_SAMPLES}; export the whole test")
    for name, column in (("time", time), ("force", force), ("crosshead", crosshead)):
        if column is None:
            continue
        if column.shape != time.shape:
            raise DataError(f"force record: column {name} has {column.size} samples, expected {time.size} as in time; correct the file")
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            raise DataError(
                f"force record: column {name} has {bad.size} samples that are not finite, first at sample {bad[0] + 1}; "
                "expected numbers, remove or repair these rows"
            )
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        i = int(back[0])
        raise DataError(
            f"force record: time goes from {time[i]:g} s to {time[i + 1]:g} s at sample {i + 2} ({back.size} such places), "
            "expected increasing times; sort or remove these rows"
        )
    if np.ptp(force) == 0.0:
        raise DataError(
            f"force record: the force is {force[0]:g} N throughout; expected a test under load, check which column holds the force"
        )


def noise_level(time: np.ndarray, value: np.ndarray) -> float:
    """Standard deviation of white noise on a piecewise smooth signal, in the unit of `value`.

    Each sample minus the chord of its neighbours, d_i = f_i - w f_{i-1} - (1 - w) f_{i+1}, has variance
    sigma^2 (1 + w^2 + (1 - w)^2), that is 6/4 sigma^2 for equal spacing (the second difference has 6 sigma^2); the median
    of |d| ignores kinks. Not below the quantisation noise q / sqrt(12) of the last digit.
    """
    w = (time[2:] - time[1:-1]) / (time[2:] - time[:-2])
    d = (value[1:-1] - w * value[:-2] - (1.0 - w) * value[2:]) / np.sqrt(1.0 + w**2 + (1.0 - w) ** 2)
    levels = np.diff(np.unique(value))
    quantum = float(levels.min()) if levels.size else 0.0
    if quantum > 0.0 and np.any(np.abs(levels / quantum - np.round(levels / quantum)) > 1e-2):
        quantum = 0.0  # the values are on no grid, or on one too fine to be seen
    return max(float(np.median(np.abs(d))) / 0.67449, quantum / float(np.sqrt(12.0)))


def force_noise(record: ForceRecord) -> float:
    """Noise of the force in N from its second differences, insensitive to kinks; DataError for a bad record."""
    check_record(record)
    return noise_level(record.time, record.force)


def working_sigma(noise: float, value: np.ndarray) -> float:
    """Noise for tests of significance: at least 1e-5 of the range, so that rounding of a clean signal is no signal."""
    rounding = np.finfo(float).eps * (1.0 + float(np.abs(value).max()))
    return max(noise, _RELATIVE_FLOOR * float(np.ptp(value)), float(rounding))


def find_phases(record: ForceRecord, noise: float | None = None) -> Phases:
    """Phases of the programme from the crosshead, where there is one, and from the force; `noise` of the force in N.

    With a crosshead its kinks are the programme, and force kinks elsewhere are knees of the material. Without, a force
    kink is programme where the force turns round or where a hold begins or ends; the others are knees.
    """
    check_record(record)
    spacing = float(np.median(np.diff(record.time)))
    level = force_noise(record) if noise is None else noise
    by_force = _find_kinks(record.time, record.force, working_sigma(level, record.force))
    moved = record.crosshead is not None and float(np.ptp(record.crosshead)) > 0.0
    if record.crosshead is not None and moved:
        sigma_x = working_sigma(noise_level(record.time, record.crosshead), record.crosshead)
        kinks, rest = _match(_find_kinks(record.time, record.crosshead, sigma_x), by_force, spacing)
    else:
        commanded = _turns_or_holds(record, by_force)
        kinks, rest = by_force.take(commanded), by_force.take(~commanded)
    kinks = _apart(kinks, record.time)
    near = np.abs(rest.time[:, None] - kinks.time[None, :]) < 2.0 * spacing
    knees = _apart(rest.take(~near.any(axis=1)), record.time)
    edges = np.concatenate([record.time[:1], kinks.time, record.time[-1:]])
    crosshead = record.crosshead if moved else None
    return Phases(_describe(record, crosshead, edges), kinks.time, kinks.sigma, knees.time)


def _hinge_z(time: np.ndarray, value: np.ndarray, h: int, sigma: float) -> np.ndarray:
    """Significance of the slope jump at each sample, shape (n,); zero where the window does not fit into the record.

    Gram-Schmidt leaves of the hinge what the polynomial cannot say, g; then z = g.f / (sigma |g|), for any spacing.
    """
    z = np.zeros(time.size)
    chunk = max(1, 2_000_000 // (2 * h + 1))
    windows_t = np.lib.stride_tricks.sliding_window_view(time, 2 * h + 1)
    windows_f = np.lib.stride_tricks.sliding_window_view(value, 2 * h + 1)
    for first in range(0, windows_t.shape[0], chunk):
        t, f = windows_t[first : first + chunk], windows_f[first : first + chunk]
        s = (t - t[:, h : h + 1]) / (t[:, -1:] - t[:, :1])
        columns = [np.ones_like(s), s, s * s, np.abs(s)] if h >= 4 else [np.ones_like(s), s, np.abs(s)]
        basis: list[np.ndarray] = []
        for column in columns:
            g = column
            for q in basis:
                g = g - q * np.sum(q * g, axis=1, keepdims=True)
            basis.append(g / np.linalg.norm(g, axis=1, keepdims=True))
        centred = f - f[:, h : h + 1]
        z[first + h : first + h + t.shape[0]] = np.sum(basis[-1] * centred, axis=1) / sigma
    return z


def _find_kinks(time: np.ndarray, value: np.ndarray, sigma: float) -> _Kinks:
    """All kinks of a signal with noise `sigma`, in order of time."""
    found: list[float] = []
    for h in HALF_WIDTHS:
        if time.size < 2 * h + 1:
            break
        z = np.abs(_hinge_z(time, value, h, sigma)) * _clear(time, np.array(found), h)
        while True:
            i = int(np.argmax(z))
            if z[i] <= ALARM:
                break
            found.append(_locate(time, value, time[i], np.array(found), max(2, h) + 1))
            z *= _clear(time, np.array(found[-1:]), h)
            z[i] = 0.0
    times = np.sort(np.array(found))
    for _ in range(2):
        times = np.sort([_locate(time, value, t, times[times != t], _REACH) for t in times])
    return _with_slopes(time, value, times, sigma)


def _clear(time: np.ndarray, kinks: np.ndarray, h: int) -> np.ndarray:
    """True for samples whose window of h samples to either side holds no known kink, shape (n,)."""
    clear = np.ones(time.size, dtype=bool)
    for kink in kinks:
        i = int(np.searchsorted(time, kink))
        clear[max(0, i - h) : i + h] = False
    return clear


def _sides(time: np.ndarray, kink: float, others: np.ndarray, reach: int) -> tuple[slice, slice]:
    """Samples of the straight stretches before and after a kink, up to `reach` each, not beyond the next kinks.

    A sample within a quarter of a step of the kink is left out where others remain: it may lie on either line.
    """
    i = int(np.searchsorted(time, kink))
    before, after = others[others < kink], others[others > kink]
    low = int(np.searchsorted(time, before.max())) if before.size else 0
    high = int(np.searchsorted(time, after.min())) if after.size else time.size
    low, high = max(low, i - reach), min(high, i + reach)
    left, right = i, i
    if i > 0 and i < time.size:
        step = time[i] - time[i - 1]
        left -= int(kink - time[i - 1] < 0.25 * step and i - low > 2)
        right += int(time[i] - kink < 0.25 * step and high - i > 2)
    return slice(low, left), slice(right, high)


def _line(time: np.ndarray, value: np.ndarray, part: slice, origin: float) -> tuple[float, float, float]:
    """Value at `origin`, slope and variance of the value at `origin` for unit noise, of the line through a part."""
    t, f = time[part] - origin, value[part]
    mean = float(t.mean())
    spread = float(np.sum((t - mean) ** 2))
    slope = float(np.sum((t - mean) * f)) / spread
    return float(f.mean()) - slope * mean, slope, 1.0 / t.size + mean**2 / spread


def _locate(time: np.ndarray, value: np.ndarray, guess: float, known: np.ndarray, reach: int) -> float:
    """Intersection of the lines of both sides, kept within one sample of the guess; the guess if a side is too short."""
    left, right = _sides(time, guess, known, reach)
    if left.stop - left.start < 2 or right.stop - right.start < 2:
        return guess
    f0, slope0, _ = _line(time, value, left, guess)
    f1, slope1, _ = _line(time, value, right, guess)
    if slope0 == slope1:
        return guess
    low, high = time[left.stop - 1], time[right.start]
    margin = 0.5 * (high - low)
    return float(np.clip(guess + (f0 - f1) / (slope1 - slope0), low - margin, high + margin))


def _with_slopes(time: np.ndarray, value: np.ndarray, times: np.ndarray, sigma: float) -> _Kinks:
    """Slopes on both sides of each kink and its standard error; a kink with a side shorter than two samples has an
    error of one sample step and the slope of the chord."""
    rows = []
    for kink in times:
        left, right = _sides(time, kink, times[times != kink], _REACH)
        if left.stop - left.start < 2 or right.stop - right.start < 2:
            i = int(np.clip(np.searchsorted(time, kink), 2, time.size - 2))
            chord = np.diff(value[i - 2 : i + 2]) / np.diff(time[i - 2 : i + 2])
            rows.append((kink, time[i] - time[i - 1], chord[0], chord[-1]))
            continue
        _, slope0, var0 = _line(time, value, left, kink)
        _, slope1, var1 = _line(time, value, right, kink)
        jump = max(abs(slope1 - slope0), np.finfo(float).tiny)
        rows.append((kink, sigma * np.sqrt(var0 + var1) / jump, slope0, slope1))
    table = np.array(rows).reshape(-1, 4)
    return _Kinks(*table.T)


def _match(programme: _Kinks, force: _Kinks, spacing: float) -> tuple[_Kinks, _Kinks]:
    """Kinks of the crosshead, each at the better known of both times where the force has the same kink, and the force
    kinks that are left. "The same" is within one and a half samples or four standard errors."""
    time, sigma = programme.time.copy(), programme.sigma.copy()
    free = np.ones(force.time.size, dtype=bool)
    for i, t in enumerate(programme.time):
        distance = np.where(free, np.abs(force.time - t), np.inf)
        j = int(np.argmin(distance)) if distance.size else -1
        if j >= 0 and distance[j] <= max(1.5 * spacing, 4.0 * float(np.hypot(sigma[i], force.sigma[j]))):
            free[j] = False
            if force.sigma[j] < sigma[i]:
                time[i], sigma[i] = force.time[j], force.sigma[j]
    order = np.argsort(time)
    return _Kinks(time, sigma, programme.before, programme.after).take(order), force.take(free)


def _turns_or_holds(record: ForceRecord, kinks: _Kinks) -> np.ndarray:
    """Which force kinks the machine must have commanded: a change of sign of the rate, or one side a hold, (n,) bool."""
    edges = np.concatenate([record.time[:1], kinks.time, record.time[-1:]])
    hold = np.array([_is_flat(record.time, record.force, pair) for pair in _pairs(edges)], dtype=bool)
    slope = np.array([_line(record.time, record.force, _inside(record.time, pair), 0.0)[1] for pair in _pairs(edges)])
    return np.asarray((slope[:-1] * slope[1:] < 0.0) | hold[:-1] | hold[1:])


def _pairs(edges: np.ndarray) -> list[tuple[float, float]]:
    return [(float(a), float(b)) for a, b in pairwise(edges)]


def _inside(time: np.ndarray, span: tuple[float, float]) -> slice:
    """Samples from the first to the last time of a span, both included; at least the two that enclose it."""
    low, high = int(np.searchsorted(time, span[0])), int(np.searchsorted(time, span[1], side="right"))
    return slice(low, high) if high - low >= 2 else slice(max(0, min(low - 1, time.size - 2)), min(time.size, max(high + 1, 2)))


def _is_flat(time: np.ndarray, force: np.ndarray, span: tuple[float, float]) -> bool:
    """True where the slope is below four standard errors, or the change over the span below twice the noise."""
    part = _inside(time, span)
    if part.stop - part.start < 4:
        return False
    sigma = working_sigma(noise_level(time, force), force)
    _, slope, _ = _line(time, force, part, span[0])
    error = sigma / np.sqrt(float(np.sum((time[part] - time[part].mean()) ** 2)))
    return abs(slope) < 4.0 * error or abs(slope) * (span[1] - span[0]) < 2.0 * sigma


def _apart(kinks: _Kinks, time: np.ndarray) -> _Kinks:
    """Kinks with at least two samples between any two of them and the ends; of two that are closer the sharper stays."""
    keep: list[int] = []
    jump = np.abs(kinks.after - kinks.before)
    for i in np.argsort(-jump, kind="stable"):
        edges = np.sort(np.concatenate([time[:1], kinks.time[[*keep, int(i)]], time[-1:]]))
        held = np.searchsorted(time, edges[1:], side="right") - np.searchsorted(time, edges[:-1])
        if time[0] < kinks.time[i] < time[-1] and held.min() >= 2:
            keep.append(int(i))
    return kinks.take(np.array(sorted(keep), dtype=int))


def _describe(record: ForceRecord, crosshead: np.ndarray | None, edges: np.ndarray) -> tuple[Phase, ...]:
    """Rates and kind of each phase. Hold: crosshead below 1 % of the fastest phase (heat still moves it while the
    machine holds a force), or without crosshead a flat force. Loading: the force grows in the sense of the test."""
    time, force = record.time, record.force
    spans = _pairs(edges)
    parts = [_inside(time, span) for span in spans]
    rates = [_line(time, force, part, 0.0)[1] for part in parts]
    moves = None if crosshead is None else [_line(time, crosshead, part, 0.0)[1] for part in parts]
    sense = 1.0 if force.max() >= -force.min() else -1.0
    fastest = max(map(abs, moves)) if moves else 0.0
    items = []
    for i, (a, b) in enumerate(spans):
        still = abs(moves[i]) < _HOLD_RATE * fastest if moves else _is_flat(time, force, (a, b))
        kind = "hold" if still else "loading" if sense * rates[i] > 0.0 else "unloading"
        items.append(Phase(a, b, kind, moves[i] if moves else None, rates[i]))
    return tuple(items)
