"""Rows of a coupon record: unambiguous repairs, each counted, and the cuts that the study asks for. What is ambiguous is an error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from thermofit.core.errors import DataError, StudyError
from thermofit.core.study_coupon import CouponRecordSettings

LEAST_ROWS = 10
_HOLES = 0.1
_SPREAD = 0.02
_BACK = 0.01
_FITTED = 6


@dataclass(frozen=True)
class Rows:
    """Channels over rows: `time` s, `strain`, `stress` MPa, `temperature` K or None, all (n,); `remarks` in words."""

    time: np.ndarray
    strain: np.ndarray
    stress: np.ndarray
    temperature: np.ndarray | None
    remarks: tuple[str, ...] = ()

    def take(self, keep: np.ndarray, remark: str = "") -> Rows:
        """The kept rows (mask or indices), with one more remark."""
        theta = None if self.temperature is None else self.temperature[keep]
        said = (*self.remarks, remark) if remark else self.remarks
        return Rows(self.time[keep], self.strain[keep], self.stress[keep], theta, said)

    def columns(self) -> list[np.ndarray]:
        """All channels."""
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


def time_from_rate(strain: np.ndarray, stress: np.ndarray, rate: float, where: str) -> Rows:
    """Rows of a record without time, strained monotonically at a constant nominal rate (1/s): t = strain / rate.

    Rows that do not exceed all before them are dropped and counted. DataError where the strain comes back by more than 1 % of its range.
    """
    known = np.isfinite(strain) & np.isfinite(stress)
    e, sigma = strain[known], stress[known]
    if e.size < LEAST_ROWS:
        raise DataError(f"{where}: {e.size} rows with strain and stress found, expected at least {LEAST_ROWS}; export the whole test")
    sense = 1.0 if abs(float(e.max() - e[0])) >= abs(float(e.min() - e[0])) else -1.0
    path = sense * e
    reached = np.maximum.accumulate(path)
    back = float(np.max(reached - path))
    if not 0.0 < np.ptp(e) or back > _BACK * np.ptp(e):
        raise DataError(
            f"{where}: the strain comes back by {back:.3g}, so a rate cannot build the time; export the time, or cut the unloading"
        )
    rising = np.concatenate([[True], path[1:] > reached[:-1]])
    lost = int((~rising).sum())
    time = np.abs(e[rising] - e[0]) / rate
    said = f"time built from the strain at {rate:g} 1/s, a rate that the file does not confirm"
    dropped = (f"{lost} rows whose strain does not exceed all before dropped",) if lost else ()
    return Rows(time, e[rising], sigma[rising], None, (said, *dropped))


def repaired(rows: Rows, where: str) -> Rows:
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


def _one_row_per_time(rows: Rows, where: str) -> Rows:
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
    said = (*rows.remarks, f"{shared} rows that share the time of the row before merged with it (mean)")
    return replace(rows, time=means[0], strain=means[1], stress=means[2], temperature=theta, remarks=said)


def cut(rows: Rows, settings: CouponRecordSettings, where: str) -> Rows:
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


def _kept(rows: Rows, keep: np.ndarray, words: str) -> Rows:
    return rows.take(keep, f"{words}: {int((~keep).sum())} rows left out")


def suspected_jumps(rows: Rows) -> list[str]:
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
