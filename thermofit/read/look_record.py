"""What `inspect` finds in a record of a testing machine: clock, channels with their noise, suspicions about sign and unit."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from thermofit.core.units import known_unit
from thermofit.observe.phases import noise_level
from thermofit.read.coupon_columns import with_constants
from thermofit.read.coupon_repair import wild_places
from thermofit.read.coupon_signs import branch_suspicion, sign_suspicion
from thermofit.read.formats.contents import ChannelRecord, Column, Records, Traits
from thermofit.read.ranges import outside
from thermofit.read.study_lines import coupon_lines

Fact = str | int | float


@dataclass(frozen=True)
class ColumnFinding:
    """A column: name and unit as written, meaning, where the unit is from, range in the fixed unit, cells without value, noise.

    `low`, `high` and `noise` are None where the column was not read or holds nothing that they could be taken from.
    """

    name: str
    meaning: str
    unit: str
    unit_from: str
    fixed_unit: str = ""
    low: float | None = None
    high: float | None = None
    missing: int | None = None
    noise: float | None = None


@dataclass(frozen=True)
class Part:
    """A file, or one test or stage of it: `points` rows, points or pixels, `missing` of them (or of the cells) without a value."""

    name: str
    kind: str
    points: int
    missing: int
    facts: Mapping[str, Fact]
    columns: tuple[ColumnFinding, ...] = ()
    remarks: tuple[str, ...] = ()
    lines: str = ""
    """YAML to start a study or an experiment.yaml from."""


@dataclass(frozen=True)
class Finding:
    """A whole file: its format and how it is written, and its parts."""

    traits: Traits
    kind: str
    parts: tuple[Part, ...]
    units: tuple[str, ...] = field(default=())
    """Units as the file writes them, each once."""


def column_finding(column: Column, values: np.ndarray | None, fixed_unit: str = "", noise: float | None = None) -> ColumnFinding:
    """A column with the range of its values (any shape; None: not read)."""
    if values is None:
        return ColumnFinding(column.name, column.meaning, column.unit, column.source)
    known = np.asarray(values, dtype=float)
    finite = known[np.isfinite(known)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (None, None)
    missing = int(known.size - finite.size)
    return ColumnFinding(column.name, column.meaning, column.unit, column.source, fixed_unit, low, high, missing, noise)


def units_of(columns: Sequence[Column]) -> tuple[str, ...]:
    """Units of the columns as written, each once, in their order."""
    return tuple(dict.fromkeys(column.unit for column in columns if column.unit))


GAP = 5.0
"""A step in time longer than this many median steps is a gap."""
_LEAST_SAMPLES = 10
_MOST_BLOCKS = 200
_MOST_WILD = 5
_LEAP = 10.0
"""Steps of the strain between two tests of a long table, over its usual step."""
_MIRRORED = -0.9
_LOADS = ("stress", "force", "true_stress")
_STRAINS = ("strain", "extension", "true_strain")
_SHOWN = {"area": "mm^2", "gauge_length": "mm", "diameter": "mm", "temperature": "K", "rate": "1/s"}


def look_at_record(record: ChannelRecord, name: str = "", others: Mapping[str, ChannelRecord] | None = None) -> Part:
    """Rows, clock, channels, suspicions and study lines of one test; `others` are the other tests of its file."""
    record = with_constants(record)
    rows = max((len(values) for values in record.channels.values()), default=0)
    facts: dict[str, Fact] = {"rows": rows, "without value": record.traits.missing}
    clock = time_channel(record)
    remarks: list[str] = list(record.traits.remarks)
    below, telling = tests_below_each_other(record)
    if below:
        columns, count = ", ".join(f"'{column}'" for column in below), len(next(iter(below.values())))
        remarks.append(f"{count} blocks of rows in which {columns} hold one value each: several tests below each other? (where)")
    if clock is None and channel_of(record, "force", "stress", "true_stress"):
        remarks.append("no column of time was recognised: a study must name it, or give the strain rate")
    elif clock is not None and not below:
        more, found = clock_facts(record.channels[clock])
        facts, remarks = facts | more, remarks + [f"{clock}: {text}" for text in found]
    facts |= {key: f"{record.about[key]:.6g} {unit}" for key, unit in _SHOWN.items() if key in record.about}
    clocks = [c.name for c in record.traits.columns if c.meaning == "time" and c.name in record.channels]
    if len(clocks) > 1:
        remarks.append(
            f"{len(clocks)} columns of time ({', '.join(clocks)}): which channel follows which clock, the file does not say (time: inside "
            "strain, stress, temperature)"
        )
    doubts, tension = suspicions(record, clock)
    remarks += [*doubts, *_wild(record)]
    found_columns = tuple(_column(record, column, clock) for column in record.traits.columns)
    lines = coupon_lines(record, name, tension, others, below, telling)
    return Part(name, "record", rows, record.traits.missing, facts, found_columns, tuple(remarks), lines)


def look_at_records(records: Records) -> tuple[Part, ...]:
    """One part for each test of a file."""
    tests = records.tests
    return tuple(look_at_record(test, name, {k: v for k, v in tests.items() if k != name}) for name, test in tests.items())


def _wild(record: ChannelRecord) -> list[str]:
    """A remark on each channel with single samples far off their neighbours."""
    found = []
    for column in record.traits.columns:
        values = record.channels.get(column.name)
        if values is None or not column.meaning:
            continue
        held = np.flatnonzero(np.isfinite(values))
        places = held[wild_places(values[held])]
        if places.size:
            shown = ", ".join(f"row {k} ({values[k]:.6g})" for k in places[:_MOST_WILD]) + (", ..." if places.size > _MOST_WILD else "")
            found.append(f"{column.name}: {places.size} wild samples, far off their neighbours: {shown} (leave_out)")
    return found


def tests_below_each_other(record: ChannelRecord) -> tuple[dict[str, list[str]], list[str]]:
    """Columns that hold one value in each of several blocks of rows, with these values as YAML, and those that tell the blocks apart.

    A block is at least ten rows long. Blocks that no column or pair of columns tells apart are none.
    """
    rows = max((len(values) for values in record.channels.values()), default=0)
    marks: dict[str, np.ndarray] = {name: np.array(texts) for name, texts in record.labels.items() if len(texts) == rows}
    for column in record.traits.columns:
        values = record.channels.get(column.name)
        if values is not None and column.meaning in ("", "temperature", "rate") and len(values) == rows and np.isfinite(values).all():
            marks[column.name] = values
    steady: dict[str, np.ndarray] = {}
    for name, values in marks.items():
        edges = np.flatnonzero(values[1:] != values[:-1]) + 1
        lengths = np.diff(np.concatenate([[0], edges, [rows]]))
        if 0 < edges.size < _MOST_BLOCKS and lengths.min() >= _LEAST_SAMPLES:
            steady[name] = edges
    if not steady:
        return {}, []
    starts = np.concatenate([[0], np.unique(np.concatenate(list(steady.values())))])
    blocks = [tuple(str(marks[name][k]) for name in steady) for k in starts]
    if len(set(blocks)) < len(blocks) or not _restarts(record, starts[1:]):
        return {}, []
    whole = next((name for name in steady if len({str(marks[name][k]) for k in starts}) == len(starts)), None)
    used = list(steady) if whole is None else [whole]
    shown = {name: [_value(marks[name][k], record, name) for k in starts] for name in (*used, *(n for n in steady if n not in used))}
    return shown, used


def _restarts(record: ChannelRecord, starts: np.ndarray) -> bool:
    """Does the clock go back at the rows `starts`, or, without one, does the strain leap there? Counted cycles are one test."""
    clock = time_channel(record)
    name = clock or channel_of(record, *_STRAINS) or channel_of(record, *_LOADS)
    if name is None:
        return True
    step = np.diff(record.channels[name])
    if clock is not None:
        return bool(np.any(step[starts - 1] < 0.0))
    return bool(np.median(np.abs(step[starts - 1])) > _LEAP * np.nanmedian(np.abs(step)))


def _value(value: str | float, record: ChannelRecord, name: str) -> str:
    """A mark of a block as YAML; a number in the unit of its column."""
    if isinstance(value, str):
        return json.dumps(str(value), ensure_ascii=False)
    unit = known_unit(next(c.unit for c in record.traits.columns if c.name == name))
    return f"{float(value) if unit is None else float(value) / unit.factor - unit.shift:.9g}"


def channel_of(record: ChannelRecord, *meanings: str) -> str | None:
    """Name of the first channel of one of the meanings, None where there is none."""
    return next((c.name for c in record.traits.columns if c.meaning in meanings and c.name in record.channels), None)


def time_channel(record: ChannelRecord) -> str | None:
    """The first column of time that increases somewhere."""
    times = [c.name for c in record.traits.columns if c.meaning == "time" and c.name in record.channels]
    return next((name for name in times if np.isfinite(record.channels[name]).sum() > 1), None)


def clock_facts(time: np.ndarray) -> tuple[dict[str, Fact], list[str]]:
    """Span and step of a time column (n,) in s, and remarks on gaps, repeated and backward times; NaN are left out."""
    known = time[np.isfinite(time)]
    if known.size < 2:
        return {}, []
    step = np.diff(known)
    forward = step[step > 0.0]
    if not forward.size:
        return {}, ["the time never increases"]
    usual = float(np.median(forward))
    facts: dict[str, Fact] = {"time s": f"{known.min():.6g} to {known.max():.6g}", "step s": usual, "samples per s": 1.0 / usual}
    remarks = []
    repeated, back = int((step == 0.0).sum()), int((step < 0.0).sum())
    gaps = np.flatnonzero(step > GAP * usual)
    facts |= {"gaps": len(gaps), "repeated times": repeated, "backward times": back}
    if len(gaps):
        k = gaps[np.argmax(step[gaps])]
        remarks.append(f"{len(gaps)} gaps of more than {GAP:g} median steps, the longest {step[k]:.4g} s after {known[k]:.6g} s")
    if repeated:
        remarks.append(f"{repeated} times are repeated, first at {known[:-1][step == 0.0][0]:.6g} s")
    if back:
        k = int(np.flatnonzero(step < 0.0)[0])
        remarks.append(f"the time goes back at {back} places, first from {known[k]:.6g} s to {known[k + 1]:.6g} s: another clock or test?")
    return facts, remarks


def _column(record: ChannelRecord, column: Column, clock: str | None) -> ColumnFinding:
    values = record.channels.get(column.name)
    if values is None:
        return column_finding(column, None)
    noise = None if clock is None or column.meaning in ("", "time") else channel_noise(record.channels[clock], values)
    return column_finding(column, values, record.units.get(column.name, ""), noise)


def channel_noise(time: np.ndarray, value: np.ndarray) -> float | None:
    """Noise of a channel (n,) over time (n,) from its second differences; None for too few samples. Rows at repeated times are left out."""
    if len(time) != len(value):
        return None
    known = np.isfinite(time) & np.isfinite(value)
    t, v = time[known], value[known]
    if not len(t):
        return None
    new = np.concatenate([[True], t[1:] > np.maximum.accumulate(t)[:-1]])
    return noise_level(t[new], v[new]) if new.sum() >= _LEAST_SAMPLES else None


def suspicions(record: ChannelRecord, clock: str | None) -> tuple[list[str], str]:
    """What looks wrong in sign or unit, in words, and "negative" where the signs say that tension is. Nothing is changed."""
    signs, tension = _signs(record, clock)
    return [*_units(record), *signs], tension


def _units(record: ChannelRecord) -> list[str]:
    found, silent = [], []
    for column in record.traits.columns:
        values = record.channels.get(column.name)
        if values is None or not column.meaning or not np.isfinite(values).any():
            continue
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        unit = record.units.get(column.name, "")
        if column.meaning in ("strain", "true_strain") and unit == "1" and outside("strain", max(-low, high)):
            found.append(f"{column.name}: strains up to {max(-low, high):.3g}; is the unit % or mm rather than '{column.unit}'?")
        if column.meaning in ("stress", "true_stress") and unit == "MPa" and outside("stress", max(-low, high)) == "possible":
            found.append(
                f"{column.name}: stresses up to {max(-low, high):.3g} MPa are those of no metal; is the unit '{column.unit}' right?"
            )
        if column.meaning == "temperature" and unit == "K" and "possible" in (outside("temperature", low), outside("temperature", high)):
            found.append(f"{column.name}: {low:.4g} to {high:.4g} K cannot be a specimen; is the unit '{column.unit}' right?")
        if not unit:
            silent.append(column.name)
    if silent:
        found.append(f"the file does not say the unit of {', '.join(silent)}: a study must")
    return found


def _signs(record: ChannelRecord, clock: str | None) -> tuple[list[str], str]:
    """Signs against physics: thermoelastic cooling in tension, stress that falls with strain, nominal against true quantities."""
    found, tension = [], ""
    load, strain, heat = (_channel(record, meanings) for meanings in (_LOADS, _STRAINS, ("temperature",)))
    if load and heat and clock is not None:
        text = sign_suspicion(record.channels[clock], load[1], heat[1])
        if text:
            unit = record.units.get(load[0], "")
            found.append(f"{heat[0]} against {load[0]}: {text.replace(' MPa ', f' {unit} ') if unit else text}")
            tension = "negative"
    if load and strain:
        known = np.isfinite(load[1]) & np.isfinite(strain[1])
        text = branch_suspicion(strain[1][known], load[1][known]) if known.sum() > 1 else None
        if text:
            found.append(f"{strain[0]} and {load[0]}: {text}")
    for meanings in (_LOADS, _STRAINS):
        found += _opposite(record, meanings)
    return found, tension


def _channel(record: ChannelRecord, meanings: tuple[str, ...]) -> tuple[str, np.ndarray] | None:
    """Name and values of the first channel that has the first of the meanings that is there."""
    name = next((name for meaning in meanings if (name := channel_of(record, meaning))), None)
    return None if name is None else (name, record.channels[name])


def _opposite(record: ChannelRecord, meanings: tuple[str, ...]) -> list[str]:
    """Channels of one quantity, nominal and true for instance, that mirror each other: one of them counts compression positive."""
    channels = [(c.name, record.channels[c.name]) for c in record.traits.columns if c.meaning in meanings and c.name in record.channels]
    found = []
    for name, values in channels[1:]:
        first, kept = channels[0][1], np.isfinite(values) & np.isfinite(channels[0][1])
        a, b = first[kept], values[kept]
        if a.size > _LEAST_SAMPLES and np.ptp(a) > 0.0 and np.ptp(b) > 0.0 and float(np.corrcoef(a, b)[0, 1]) < _MIRRORED:
            found.append(name)
    if not found:
        return []
    return [
        f"{', '.join(found)} and {channels[0][0]} have opposite signs: compression is positive in one of them, the study must say which"
    ]
