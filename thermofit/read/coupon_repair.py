"""Rows of a coupon record: unambiguous repairs, each counted, and the cuts that the study asks for. What is ambiguous is an error."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import median_filter

from thermofit.core.errors import DataError, StudyError
from thermofit.read.coupon_phases import turning_points
from thermofit.read.formats.contents import ChannelRecord
from thermofit.study.coupon import CouponRecordSettings

LEAST_ROWS = 10
_HOLES = 0.1
_SPREAD = 0.02
_BACK = 0.01
_FITTED = 6
_WILD, _UNUSUAL = 5.0, 20.0
"""How far a wild sample is off: times the steps beside it, and times the usual second difference."""
_SHOWN = 5


@dataclass(frozen=True)
class CouponRows:
    """Channels over rows: `time` s, `strain`, `stress` MPa, `temperature` K or None, all (n,); `remarks` in words.

    `lateral` (n,) or None is the strain across, NaN where it has gaps; `row` (n,) are the data rows of the file.
    """

    time: np.ndarray
    strain: np.ndarray
    stress: np.ndarray
    temperature: np.ndarray | None
    remarks: tuple[str, ...] = ()
    lateral: np.ndarray | None = None
    row: np.ndarray | None = None

    def take(self, keep: np.ndarray, *remarks: str) -> CouponRows:
        """The kept rows (mask or indices), with more remarks."""
        theta, across, row = (None if x is None else x[keep] for x in (self.temperature, self.lateral, self.row))
        said = (*self.remarks, *(remark for remark in remarks if remark))
        return CouponRows(self.time[keep], self.strain[keep], self.stress[keep], theta, said, across, row)

    def saying(self, *remarks: str) -> CouponRows:
        """The same rows with more remarks."""
        return replace(self, remarks=(*self.remarks, *remarks))

    def columns(self) -> list[np.ndarray]:
        """All channels that a row must have."""
        return [x for x in (self.time, self.strain, self.stress, self.temperature) if x is not None]


def without_jumps(strain: np.ndarray, rows: Sequence[int], where: str) -> tuple[np.ndarray, list[str]]:
    """Strain that continues over the rows at which the extensometer slipped; `rows` (from 0) are the first ones after each slip.

    The jump is what the row differs from the line through the rows before it, less its mean slope. StudyError for a row outside.
    """
    shifted, remarks = strain.copy(), []
    for row in rows:
        if not 1 < row < strain.size:
            raise StudyError(f"{where}.jumps names row {row}, but the record has the rows 0 to {strain.size - 1}; correct it")
        before = shifted[max(0, row - _FITTED) : row]
        index = np.flatnonzero(np.isfinite(before))
        if index.size < 2 or not np.isfinite(shifted[row]):
            raise StudyError(f"{where}.jumps names row {row}, beside which strain is missing; name the first measured row after the slip")
        slope, base = np.polyfit(index - before.size, before[index], 1)
        del slope  # the line is evaluated at the row itself, whose distance is 0
        jump = float(shifted[row] - base)
        shifted[row:] -= jump
        remarks.append(f"extensometer jump of {jump:.3g} at row {row} taken out")
    return shifted, remarks


def without_rows(rows: CouponRows, left_out: Sequence[int], where: str) -> CouponRows:
    """Rows without those that the study leaves out. StudyError for a row outside."""
    assert rows.row is not None
    if not left_out:
        return rows
    beyond = [row for row in left_out if row >= rows.row.size]
    if beyond:
        raise StudyError(f"{where}.leave_out' names row {beyond[0]}, but the record has the rows 0 to {rows.row.size - 1}; correct it")
    return rows.take(~np.isin(rows.row, left_out), f"{len(left_out)} data rows left out, as the study says")


def wild_samples(rows: CouponRows, left_out: Sequence[int] = ()) -> list[str]:
    """A remark on every channel with single samples far off both of their neighbours, which the others follow smoothly; they are kept.

    Far: more than five times the steps beside it and twenty times the usual second difference, and 2 % of the range. A reversal is none:
    the steps beside it are as large. `left_out` rows are not told again.
    """
    assert rows.row is not None
    found = []
    for name, x, unit in (
        ("strain", rows.strain, ""),
        ("stress", rows.stress, " MPa"),
        ("temperature", rows.temperature, " K"),
        ("lateral strain", rows.lateral, ""),
    ):
        if x is None:
            continue
        held = np.flatnonzero(np.isfinite(x))
        places = [int(rows.row[k]) for k in held[wild_places(x[held])] if int(rows.row[k]) not in left_out]
        if not places:
            continue
        shown = ", ".join(f"row {k} ({x[k]:.6g}{unit})" for k in places[:_SHOWN]) + (", ..." if len(places) > _SHOWN else "")
        found.append(
            f"{len(places)} wild samples of the {name}, far off their neighbours: {shown}; kept as they are (leave_out: {places[:_SHOWN]} "
            "leaves them out)"
        )
    return found


def wild_places(x: np.ndarray) -> np.ndarray:
    """Places of single samples far off both neighbours in values (n,)."""
    if x.size < LEAST_ROWS:
        return np.zeros(0, dtype=int)
    step = np.diff(x)
    usual = float(np.median(np.abs(np.diff(x, 2))))
    k = np.arange(2, x.size - 2)
    before, after = step[k - 1], step[k]
    smaller = np.minimum(np.abs(before), np.abs(after))
    beside = np.maximum.reduce([np.abs(step[k - 2]), np.abs(step[k + 1]), np.abs(x[k + 1] - x[k - 1])])
    size = np.sort(x)
    range_ = float(size[-1 - x.size // 50] - size[x.size // 50]) or float(np.ptp(x))
    far = (before * after < 0.0) & (smaller > _WILD * beside) & (smaller > _UNUSUAL * usual) & (smaller > _SPREAD * range_)
    return k[far]


def time_from_rows(record: ChannelRecord, rate: float) -> tuple[np.ndarray, str]:
    """Time in s (n,) of a record whose rows follow each other at `rate` 1/s, and the remark on it."""
    count = max(values.size for values in record.channels.values())
    return np.arange(count) / rate, f"time built from the number of the row at {rate:g} rows per second, which the file does not confirm"


def time_from_rate(rows: CouponRows, rate: float, where: str) -> CouponRows:
    """Rows of a record without time, strained at a constant nominal rate (1/s) back and forth: t = path of the strain / rate.

    Kept are the most rows of a branch whose strain goes on from one to the next; the others are dropped and counted: holds have no time.
    DataError for too few.
    """
    known = np.isfinite(rows.strain) & np.isfinite(rows.stress)
    if known.sum() < LEAST_ROWS:
        raise DataError(
            f"{where}: {int(known.sum())} rows with strain and stress found, expected at least {LEAST_ROWS}; export the whole test"
        )
    lost = int((~known).sum())
    rows = rows.take(known, f"{lost} rows without strain or stress dropped" if lost else "")
    e = rows.strain
    if not np.ptp(e) > 0.0:
        raise DataError(f"{where}: the strain never changes, so a rate cannot build the time; export the time")
    sense = 1.0 if abs(float(e.max() - e[0])) >= abs(float(e.min() - e[0])) else -1.0
    back = float(np.max(np.maximum.accumulate(sense * e) - sense * e))
    edges = turning_points(np.arange(e.size, dtype=float), e) if back > _BACK * np.ptp(e) else np.array([0, e.size - 1])
    time, advances, start = np.zeros(e.size), np.zeros(e.size, dtype=bool), 0.0
    for a, b in pairwise(edges):
        path = np.sign(e[b] - e[a]) * (e[a : b + 1] - e[a])
        rise = longest_rise(path)
        time[a + rise] = start + path[rise] - path[rise[0]]
        advances[a + rise[rise > 0]] = True  # the first row of a later branch is the last one of that before
        advances[0] |= a + rise[0] == 0
        start += float(path[rise[-1]] - path[rise[0]])
    rows = replace(rows, time=time / rate)
    turns = len(edges) - 2
    words = f"along the path of the strain with {turns} reversals" if turns else "from the strain"
    said = f"time built {words} at {rate:g} 1/s, a rate that the file does not confirm"
    still = int((~advances).sum())
    words = " between two reversals" if turns else ""
    return rows.take(advances, said, f"{still} rows dropped with which the strain would not go on{words}" if still else "")


def longest_rise(x: np.ndarray) -> np.ndarray:
    """Indices of the most values (n,) that rise strictly from one to the next (longest increasing subsequence, Fredman 1975); the earlier
    ones of equally many.

    A wild value, or a reading before the gauge is set, costs itself and not all that follow until it is passed.
    """
    ends: list[float] = []  # the smallest value with which so many rise
    rank = np.empty(x.size, dtype=int)
    for k, value in enumerate(x.tolist()):
        rank[k] = bisect_left(ends, value)
        ends[rank[k] : rank[k] + 1] = [value]
    # Values of one rank do not rise, so that the earliest one below the next is found by halving.
    order = np.argsort(rank, kind="stable")
    edges = np.searchsorted(rank[order], np.arange(len(ends) + 1))
    found, below = [], np.inf
    for first, last in reversed(list(pairwise(edges.tolist()))):
        alike = order[first:last]
        found.append(int(alike[np.searchsorted(-x[alike], -below, side="right")]))
        below = x[found[-1]]
    return np.array(found[::-1], dtype=int)


def repaired(rows: CouponRows, where: str) -> CouponRows:
    """Rows without holes, repetitions and shared times, each counted. DataError for times that go back, or too many repairs."""
    complete = np.all([np.isfinite(x) for x in rows.columns()], axis=0)
    if complete.sum() < LEAST_ROWS:
        raise DataError(
            f"{where}: {int(complete.sum())} rows with all channels found, expected at least {LEAST_ROWS}; export the whole test"
        )
    if not complete.all():
        held = np.flatnonzero(complete)
        inside = int((~complete[held[0] : held[-1]]).sum())
        if inside > _HOLES * held.size:
            raise DataError(f"{where}: {inside} rows inside the record miss a channel; expected complete rows, export them again")
        rows = rows.take(complete, f"{int((~complete).sum())} rows that miss a channel dropped, {inside} of them inside the record")
    same = np.concatenate([[False], np.all([np.diff(x) == 0.0 for x in rows.columns()], axis=0)])
    if same.any():
        rows = rows.take(~same, f"{int(same.sum())} repeated rows dropped")
    steps = np.diff(rows.time)
    if (steps < 0.0).any():
        k = int(np.flatnonzero(steps < 0.0)[0])
        raise DataError(
            f"{where}: the time goes back from {rows.time[k]:g} s to {rows.time[k + 1]:g} s at row {k + 1} "
            f"({int((steps < 0.0).sum())} such places), expected increasing times; split the file there"
        )
    return _one_row_per_time(rows, where)


def _one_row_per_time(rows: CouponRows, where: str) -> CouponRows:
    """Rows that share a time become their mean; DataError where they differ by more than 2 % of a range, so that their order matters."""
    first = np.concatenate([[True], np.diff(rows.time) > 0.0])
    shared = int((~first).sum())
    if not shared:
        return rows
    group = np.cumsum(first) - 1
    starts = np.flatnonzero(first)
    for name, x in (("strain", rows.strain), ("stress", rows.stress)):
        spread = np.maximum.reduceat(x, starts) - np.minimum.reduceat(x, starts)
        if spread.max() > _SPREAD * np.ptp(x):
            at = rows.time[starts[int(np.argmax(spread))]]
            raise DataError(
                f"{where}: {shared} of {first.size} rows share their time with the row before, and their {name} differs by up to "
                f"{spread.max():.3g} (at {at:g} s); expected increasing times, export them with more digits"
            )
    count = np.bincount(group)
    means = [np.bincount(group, x) / count for x in rows.columns()]
    theta = means[3] if rows.temperature is not None else None
    across = None if rows.lateral is None else np.bincount(group, rows.lateral) / count
    row = None if rows.row is None else rows.row[first]
    said = (*rows.remarks, f"{shared} rows that share the time of the row before merged with it (mean)")
    return replace(rows, time=means[0], strain=means[1], stress=means[2], temperature=theta, remarks=said, lateral=across, row=row)


def cut(rows: CouponRows, settings: CouponRecordSettings, where: str) -> CouponRows:
    """The part that the study wants: window, exclude, maximum force, largest strain. DataError where too little is left."""
    if settings.window is not None:
        low, high = settings.window
        rows = _kept(rows, (rows.time >= low) & (rows.time <= high), f"window {low:g} to {high:g} s")
    for low, high in settings.exclude:
        rows = _kept(rows, (rows.time < low) | (rows.time > high), f"excluded {low:g} to {high:g} s")
    if settings.until == "maximum-force" and rows.time.size:
        last = int(np.argmax(np.abs(rows.stress)))
        rows = _kept(rows, np.arange(rows.time.size) <= last, f"ends at the maximum force, strain {rows.strain[last]:.4g}")
    if settings.strain_max is not None:
        over = np.flatnonzero(np.abs(rows.strain) > settings.strain_max)
        last = int(over[0]) if over.size else rows.time.size
        rows = _kept(rows, np.arange(rows.time.size) < last, f"ends where the strain exceeds {settings.strain_max:g}")
    if rows.time.size < LEAST_ROWS:
        raise DataError(f"{where}: {rows.time.size} rows left after the cuts, expected at least {LEAST_ROWS}; widen window or strain_max")
    return rows


def _kept(rows: CouponRows, keep: np.ndarray, words: str) -> CouponRows:
    return rows.take(keep, f"{words}: {int((~keep).sum())} rows left out")


def suspected_jumps(rows: CouponRows) -> list[str]:
    """A remark on steps of the strain far above their neighbours that the stress does not follow, none where there are none."""
    de, ds = np.abs(np.diff(rows.strain)), np.abs(np.diff(rows.stress))
    if de.size < 50 or np.ptp(rows.strain) == 0.0:
        return []
    rate = de / np.diff(rows.time)
    local = median_filter(rate, size=21, mode="nearest")
    large = (rate > 20.0 * local + 1e-9) & (de > 2e-3 * np.ptp(rows.strain)) & (ds < 0.02 * np.ptp(rows.stress))
    places = np.flatnonzero(large) + 1
    if not places.size or places.size > 20:
        return []
    said = ", ".join(f"{rows.time[k]:.6g} s" for k in places[:5])
    return [f"the strain steps without the stress at {said}: an extensometer jump? (name its data row under jumps)"]
