"""Two clocks: channels beside another clock brought to that of the record, by a signal that both saw, by absolute dates, or as declared.

A signal that both recorders saw (the force, the extension) gives the offset by cross-correlation and least squares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import fftconvolve

from thermofit.core.errors import DataError, StudyError
from thermofit.observe.phases import noise_level
from thermofit.read.coupon_columns import channel, find_column, pick_record
from thermofit.read.formats.contents import ChannelRecord
from thermofit.read.formats.record_dates import start_in_header
from thermofit.study.coupon import ColumnSource, CouponRecordSettings, SecondClock
from thermofit.study.paths import path_from

_LOADS = (("force",), ("stress", "true_stress"))
_MOTIONS = (("extension",), ("strain", "true_strain"), ("displacement",))
_DETERMINED = 1e-6
"""Share of the signal's change over time that must be neither its value nor a constant, else it fits at any offset (a straight line)."""

_MOST = 60_000
_OVERLAP = 0.5
_LEAST_CORRELATION = 0.9
_RIVAL = 4.0
_ROUNDS = 20


@dataclass(frozen=True)
class ClockOffset:
    """`offset` s: time of the second clock minus that of the first; `sigma` s its standard error; `correlation` of the repeated signal."""

    offset: float
    sigma: float
    correlation: float


@dataclass(frozen=True)
class Main:
    """The record whose clock counts: its content and settings, folder of the study, time s (n,) and the channels that follow its clock."""

    record: ChannelRecord
    settings: CouponRecordSettings
    base_folder: Path
    time: np.ndarray | None
    strain: np.ndarray | None
    stress: np.ndarray | None


def beside_another_clock(
    main: Main, source: SecondClock, name: str, key: str, read: Callable[[ChannelRecord], tuple[np.ndarray, list[str]]]
) -> tuple[np.ndarray, list[str]]:
    """Values (n,) of a channel at the times of the record, NaN where the other clock does not cover them, and remarks.

    `name` is the key of the channel, `read` takes it from the record of the other clock. DataError for times that go back, and where
    no offset is found; StudyError for what the study must name.
    """
    assert main.time is not None
    where = f"{key}.{name}"
    second = main.record
    if source.file is not None or source.test is not None:
        path = main.record.traits.path if source.file is None else path_from(main.base_folder, source.file, f"key '{where}.file'")
        second = pick_record(path, source.test, where)
    values, remarks = read(second)
    column = ColumnSource(column=source.time or _only(second, ("time",), where, "time"))
    clock, said = channel(second, column, "time", f"{where}.time")
    known = np.isfinite(clock) & np.isfinite(values)
    if known.sum() < 2 or (np.diff(clock[known]) <= 0.0).any():
        raise DataError(f"{second.traits.path}: the time of the {name} does not increase, expected increasing times; export it again")
    offset, found = _offset(second, source, clock, main, name, where)
    at = main.time + offset
    inside = (at >= clock[known][0]) & (at <= clock[known][-1])
    joined = np.where(inside, np.interp(at, clock[known], values[known]), np.nan)
    return joined, [*remarks, *said, found]


def _names(record: ChannelRecord, meanings: tuple[str, ...]) -> list[str]:
    return [c.name for c in record.traits.columns if c.meaning in meanings and c.name in record.channels]


def _only(record: ChannelRecord, meanings: tuple[str, ...], key: str, missing: str) -> str:
    """The only column of one of the meanings; StudyError where there is none or several."""
    names = _names(record, meanings)
    if len(names) != 1:
        what = f"{len(names)} columns of {meanings[0]}" + (f" ({', '.join(names)})" if names else "")
        raise StudyError(f"key '{key}.{missing}' is missing, and {record.traits.path} has {what}: name one of {', '.join(record.channels)}")
    return names[0]


def _offset(second: ChannelRecord, source: SecondClock, clock: np.ndarray, main: Main, name: str, key: str) -> tuple[float, str]:
    """Offset of the second clock in s, and the remark on it."""
    if source.offset_s == "dates":
        return _by_dates(second, source, clock, main, name, key)
    if source.offset_s != "auto":
        return float(source.offset_s), f"clock of the {name} set {source.offset_s:g} s ahead, as the study says"
    repeats, meaning = _repeating(second, source, key)
    signal, what = _repeated(main, source, meaning, key)
    assert main.time is not None
    pairs = []
    for t, f in ((main.time, signal), (clock, second.channels[repeats])):
        known = np.isfinite(t) & np.isfinite(f)
        t, f = t[known], f[known]
        first = np.concatenate([[True], np.diff(t) > 0.0])
        pairs.append((t[first], f[first]))
    try:
        found = clock_offset(pairs[0], pairs[1])
    except DataError as error:
        raise DataError(f"{second.traits.path}: key '{key}.offset_s' is auto, but {error}") from None
    return found.offset, (
        f"clock of the {name} is {found.offset:.3f} s ahead (+/- {found.sigma:.2g} s), from '{repeats}', which repeats the {what} "
        f"(correlation {found.correlation:.4f})"
    )


def _repeating(second: ChannelRecord, source: SecondClock, key: str) -> tuple[str, str]:
    """Name and meaning of the channel beside the second clock that repeats one of the record."""
    if source.repeats is not None:
        column = find_column(second, source.repeats, f"{key}.repeats")
        return column.name, column.meaning
    for meanings in (*_LOADS, *_MOTIONS):
        names = _names(second, meanings)
        if len(names) == 1:
            return names[0], meanings[0]
        if names:
            break
    return _only(second, _LOADS[0], key, "repeats"), "force"


def _repeated(main: Main, source: SecondClock, meaning: str, key: str) -> tuple[np.ndarray, str]:
    """The signal (n,) of the record that is repeated, and what it is called in a remark."""
    if source.repeated is not None:
        column = find_column(main.record, source.repeated, f"{key}.repeated")
        return main.record.channels[column.name], f"channel '{column.name}'"
    motion = any(meaning in meanings for meanings in _MOTIONS)
    own, words = (main.strain, "extension") if motion else (main.stress, "force")
    if own is not None:
        return own, words
    for meanings in _MOTIONS if motion else _LOADS:
        if len(names := _names(main.record, meanings)) == 1:
            return main.record.channels[names[0]], f"{words} '{names[0]}'"
    raise StudyError(
        f"key '{key}.repeated' is missing, and {main.record.traits.path} has not one channel of {words}: name the channel that is repeated"
    )


def _by_dates(second: ChannelRecord, source: SecondClock, clock: np.ndarray, main: Main, name: str, key: str) -> tuple[float, str]:
    """Offset by the absolute times of both clocks."""
    assert main.time is not None
    first, within = absolute_start(main.record, main.settings.date, main.time, f"{key.rpartition('.')[0]}.date")
    other, also = absolute_start(second, source.date, clock, f"{key}.date")
    offset = first - other
    return offset, f"clock of the {name} set {offset:.3f} s ahead by the dates of both, which hold to {max(within, also):.2g} s"


def absolute_start(record: ChannelRecord, column: str | None, time: np.ndarray, key: str) -> tuple[float, float]:
    """Absolute time in s at which a clock (n,) in s is zero, and how far its dates scatter about it, s.

    Dates are cut off at their last digit, so that the largest difference counts. StudyError where the record has not one column of dates
    and its header does not say when it began.
    """
    names = _names(record, ("date",))
    if column is not None or len(names) == 1:
        name = names[0] if column is None else find_column(record, column, key).name
        away = record.channels[name] - time
        if np.isfinite(away).any():
            return float(np.nanmax(away)), float(np.nanmax(away) - np.nanmin(away))
    began = start_in_header(record.traits.header)
    if began is None or column is not None:
        what = f"{len(names)} columns of dates" + (f" ({', '.join(names)})" if names else " and no start of the test in its header")
        raise StudyError(f"key '{key}' is missing, and {record.traits.path} has {what}; name the column, or give offset_s in s")
    return began, 0.0


def clock_offset(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> ClockOffset:
    """Offset between two clocks from (time, signal) of both, in any units and with either sign.

    Cross-correlation on a common grid over all lags with at least half of the shorter record in common, then least squares of
    f_1(t) = a f_2(t + offset) + b. DataError where no lag correlates, or where another one does as well.
    """
    t1, t2 = first[0], second[0]
    step = max(float(np.median(np.diff(t1))), float(np.median(np.diff(t2))), max(np.ptp(t1), np.ptp(t2)) / _MOST)
    x1, x2 = (np.interp(np.arange(t[0], t[-1], step), t, f) for t, f in (first, second))
    if min(x1.size, x2.size) < 8 or np.ptp(x1) == 0.0 or np.ptp(x2) == 0.0:
        raise DataError("the repeated signal is too short or constant in one of the files, expected the same force in both; give offset_s")
    lags, correlation = _correlations(x1, x2)
    strength = np.abs(correlation)
    best = int(np.argmax(strength))
    if strength[best] < _LEAST_CORRELATION:
        raise DataError(
            f"the repeated signals correlate by {strength[best]:.2f} at best, expected at least {_LEAST_CORRELATION}; "
            "name the column that repeats the force, or give offset_s"
        )
    _no_rival(strength, best, step)
    guess = float(t2[0] - t1[0] - lags[best] * step)
    offset, sigma = _refined(first, second, guess, step)
    return ClockOffset(offset, sigma, float(correlation[best]))


def _correlations(x1: np.ndarray, x2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lags (in steps, x2 shifted right by the lag lies on x1) and correlation coefficients of the common parts."""
    x1, x2 = x1 - x1.mean(), x2 - x2.mean()
    one1, one2 = np.ones_like(x1), np.ones_like(x2)

    def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.asarray(fftconvolve(a, b[::-1]))

    n = np.maximum(np.round(cross(one1, one2)), 1.0)
    s1, s2, s11, s22, s12 = cross(x1, one2), cross(one1, x2), cross(x1**2, one2), cross(one1, x2**2), cross(x1, x2)
    v1, v2 = s11 - s1**2 / n, s22 - s2**2 / n
    enough = (n >= _OVERLAP * min(x1.size, x2.size)) & (v1 > 1e-3 * x1.var() * n) & (v2 > 1e-3 * x2.var() * n)
    correlation = np.where(enough, (s12 - s1 * s2 / n) / np.sqrt(np.where(enough, v1 * v2, 1.0)), 0.0)
    return np.arange(1 - x2.size, x1.size), correlation


def _no_rival(strength: np.ndarray, best: int, step: float) -> None:
    """DataError where a separate peak leaves less than four times the unexplained variance of the best."""
    low = high = best
    while low > 0 and strength[low - 1] < strength[low]:
        low -= 1
    while high < strength.size - 1 and strength[high + 1] < strength[high]:
        high += 1
    others = np.concatenate([strength[:low], strength[high + 1 :]])
    if others.size and 1.0 - others.max() ** 2 < _RIVAL * (1.0 - strength[best] ** 2 + 1e-6):
        rival = int(np.flatnonzero(strength == others.max())[0])
        apart = abs(rival - best) * step
        raise DataError(
            f"the repeated signals fit at two offsets {apart:.3g} s apart (correlation {strength[best]:.4f} and {others.max():.4f}), "
            "expected one; give offset_s"
        )


def _refined(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray], guess: float, step: float) -> tuple[float, float]:
    """Least-squares offset near the guess and its standard error; neighbouring residuals that belong together are counted as one."""
    (t1, f1), (t2, f2) = first, second
    offset, sigma = guess, step
    for _ in range(_ROUNDS):
        inside = (t1 + offset > t2[0] + 2 * step) & (t1 + offset < t2[-1] - 2 * step)
        t, f = t1[inside] + offset, f1[inside]
        value = np.interp(t, t2, f2)
        slope = (np.interp(t + step, t2, f2) - np.interp(t - step, t2, f2)) / (2.0 * step)
        design = np.stack([value, np.ones_like(value)], axis=1)
        (gain, base), *_ = np.linalg.lstsq(design, f, rcond=None)
        residual, rate = f - gain * value - base, gain * slope
        # The offset's own column, cleaned of gain and base.
        rate = rate - design @ np.linalg.lstsq(design, rate, rcond=None)[0]
        power = float(rate @ rate)
        if power <= _DETERMINED * float((gain * slope) @ (gain * slope)):
            raise DataError("the repeated signal is a straight line over time, which fits at any offset; give offset_s")
        change = float(np.clip(rate @ residual / power, -step, step))
        offset += change
        spread = float(np.sqrt(np.mean(residual**2)))
        white = noise_level(t1[inside], residual)
        sigma = spread / np.sqrt(power) * max(1.0, np.sqrt(_together(residual)) if spread > white else 1.0)
        if abs(change) < 1e-4 * step:
            break
    return offset, float(sigma)


def _together(residual: np.ndarray) -> float:
    """How many neighbouring residuals count as one: (1 + r) / (1 - r) with the autocorrelation r at lag one."""
    centred = residual - residual.mean()
    total = float(centred @ centred)
    r = float(centred[1:] @ centred[:-1]) / total if total > 0.0 else 0.0
    r = min(max(r, 0.0), 0.999)
    return (1.0 + r) / (1.0 - r)
