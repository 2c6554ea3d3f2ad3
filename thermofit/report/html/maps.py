"""Residual maps of a report: rows of a fit as fields over time and place, before and after effects were added."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from thermofit.records.artefact import Record
from thermofit.report.html.gather import DIAGNOSE, LOOP, VERIFY, channel_words
from thermofit.report.html.run_folder import Records, RunFolder

_RASTER = 260
"""Pixels of a map along its longer side."""
_REACH = 0.75
"""A pixel shows the nearest point within this many distances to its third neighbour."""
_AXES = ("across the load (x)", "along the load (y)", "out of plane (z)")


@dataclass(frozen=True)
class FieldOverTime:
    """A field of residuals over the noise: `time` s (n_t,), `xy` mm (n_p, 2), `value` (n_t, n_p, n_c) with NaN where there is no datum."""

    time: np.ndarray
    xy: np.ndarray
    value: np.ndarray


@dataclass(frozen=True)
class BeforeAfter:
    """A component of a channel before and after (None: there is no second model), with what the two models are in words."""

    test: str
    channel: str
    label: str
    before: FieldOverTime
    after: FieldOverTime | None
    words: tuple[str, str]
    component: int


def field_of_rows(time: np.ndarray, xy: np.ndarray, value: np.ndarray) -> FieldOverTime:
    """Rows (n,) as a field; rows of one time and place are its components in their order."""
    times, at = np.unique(time, return_inverse=True)
    places, where = np.unique(np.round(xy, 6), axis=0, return_inverse=True)
    key = at.astype(np.int64) * len(places) + where.ravel()
    order = np.argsort(key, kind="stable")
    first = np.r_[0, np.flatnonzero(np.diff(key[order])) + 1]
    number = np.empty(len(key), dtype=int)
    number[order] = np.arange(len(key)) - np.repeat(first, np.diff(np.r_[first, len(key)]))
    field = np.full((len(times), len(places), int(number.max()) + 1), np.nan)
    field[at, where.ravel(), number] = value
    return FieldOverTime(times, places, field)


def pairs(run: RunFolder) -> Iterator[BeforeAfter]:
    """Every channel and component that can be drawn: of the loop, else of the diagnosis, else of the verified model."""
    found = list(_judged_pairs(run))
    seen = {(pair.test, pair.channel) for pair in found}
    for test, records in run.tests.items():
        if VERIFY in records:
            for channel, field in verified(records[VERIFY]).items():
                if channel in ("du", "dtheta", "stress", "strain", "theta") and (test, channel) not in seen:
                    yield from _components(test, channel, field, None, ("the verified model", ""))
    yield from found


def verified(record: Record) -> dict[str, FieldOverTime]:
    """Residual fields of `verify` by channel."""
    found = {}
    for name in record.names:
        channel = name.removeprefix("residual/")
        source = next((s for s in (channel, channel.removeprefix("d")) if record.has(f"{s}/time")), None)
        if channel != name and source is not None:
            value = record[name].value
            time, xy = record[f"{source}/time"].value, record[f"{source}/xy"].value
            if value.shape[:2] == (len(time), len(xy)):
                found[channel] = FieldOverTime(time, xy, value)
    return found


def _judged_pairs(run: RunFolder) -> Iterator[BeforeAfter]:
    record = next((run.records[stage] for stage in (LOOP, DIAGNOSE) if run.has(stage)), None)
    if record is None or not record.has("residual/value") or not record.has("rms/channel"):
        return
    rows = {key: record[f"residual/{key}"].value for key in ("channel", "time", "xy", "value")}
    before = _values_before(run, record, rows)
    added = " + ".join(map(str, record.summary.get("accepted", ())))
    words = ("without an added effect", f"with {added}") if added else ("the joint fit", "")
    names = [n.decode() if isinstance(n, bytes) else str(n) for n in record["rms/channel"].value]
    for number, name in enumerate(names):
        own = rows["channel"] == number
        if not own.any():
            continue
        channel, _, test = name.partition("@")
        time = rows["time"][own]
        if test in run.tests and test:
            of_test = [rows["time"][rows["channel"] == k] for k, n in enumerate(names) if n.endswith(f"@{test}")]
            time = time - _shift(run.tests[test], of_test)
        last = field_of_rows(time, rows["xy"][own], rows["value"][own])
        if record.stage == DIAGNOSE or not added:
            yield from _components(test, channel, last, None, words)
        elif before is not None:
            first = field_of_rows(time, rows["xy"][own], before[own])
            yield from _components(test, channel, first, last, words)
        else:
            stages = verified(run.tests.get(test, run.records)[VERIFY]) if VERIFY in run.tests.get(test, run.records) else {}
            if channel in stages:
                yield from _components(test, channel, stages[channel], last, ("the model of the stages, not fitted jointly", words[1]))
            else:
                yield from _components(test, channel, last, None, (words[1], ""))


def _values_before(run: RunFolder, record: Record, rows: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Residual of the joint fit without an added effect in the same rows: of the loop itself, else of a diagnosis of the same data."""
    if record.has("residual/before"):
        return record["residual/before"].value
    other = run.records.get(DIAGNOSE)
    if record.stage == LOOP and other is not None and other.has("residual/value") and other.inputs == record.inputs:
        same = all(np.array_equal(other[f"residual/{key}"].value, rows[key]) for key in ("channel", "time"))
        return other["residual/value"].value if same else None
    return None


def _shift(records: Records, times: list[np.ndarray]) -> float:
    """By how much the rows of one experiment are shifted, because those of several follow one another in time."""
    fields = verified(records[VERIFY]).values() if VERIFY in records else ()
    starts = [float(f.time[np.isfinite(f.value).any(axis=(1, 2))].min()) for f in fields if np.isfinite(f.value).any()]
    return min(float(t.min()) for t in times) - min(starts, default=0.0)


def _components(
    test: str, channel: str, before: FieldOverTime, after: FieldOverTime | None, words: tuple[str, str]
) -> Iterator[BeforeAfter]:
    n = before.value.shape[2]
    for k in range(n):
        label = channel_words(channel) + (f" {_AXES[k]}" if n > 1 and channel in ("u", "du") else f" {k + 1}" if n > 1 else "")
        yield BeforeAfter(test, channel, label, before, after, words, k)


def raster(xy: np.ndarray) -> dict[str, Any]:
    """Which point (n, 2) every pixel of a map shows, -1 for none: rows from the top, extent in mm, numbers as base64 of 16-bit integers."""
    tree = cKDTree(xy)
    near = tree.query(xy, k=min(4, len(xy)))[0]
    step = float(np.median(near[:, -1])) if len(xy) > 1 else 1.0
    low, high = xy.min(axis=0) - 0.5 * step, xy.max(axis=0) + 0.5 * step
    size = np.maximum(np.rint(_RASTER * (high - low) / (high - low).max()), 1).astype(int)
    x = low[0] + (np.arange(size[0]) + 0.5) * (high[0] - low[0]) / size[0]
    y = high[1] - (np.arange(size[1]) + 0.5) * (high[1] - low[1]) / size[1]
    away, index = tree.query(np.stack(np.meshgrid(x, y), axis=-1))
    index[away > _REACH * step] = -1
    data = base64.b64encode(index.astype("<i2").tobytes()).decode("ascii")
    return {"w": int(size[0]), "h": int(size[1]), "low": low.tolist(), "high": high.tolist(), "data": data}
