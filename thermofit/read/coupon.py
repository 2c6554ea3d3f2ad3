"""Coupon records: the native files that a study names, mapped onto nominal strain and stress, tension positive."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.experiment import CELSIUS, CouponRecord
from thermofit.observe.phases import noise_level, working_sigma
from thermofit.read.coupon_clocks import Main, beside_another_clock
from thermofit.read.coupon_columns import channel, lateral_channel, pick_record, strain_channel, stress_channel, time_channel, width_of
from thermofit.read.coupon_phases import coupon_phases, thinned, turning_points
from thermofit.read.coupon_repair import (
    CouponRows,
    cut,
    repaired,
    suspected_jumps,
    time_from_rate,
    time_from_rows,
    wild_samples,
    without_jumps,
    without_rows,
)
from thermofit.read.coupon_signs import branch_suspicion, lateral_suspicion, sign_suspicion
from thermofit.read.formats.contents import ChannelRecord
from thermofit.read.plausible import questions_of_record, settled
from thermofit.study.coupon import (
    ColumnSource,
    Coupon,
    CouponRecordSettings,
    LateralSource,
    SecondClock,
    StrainSource,
    StressSource,
    TemperatureSource,
)
from thermofit.study.paths import path_from

_LOADED = 0.1
"""Share of the largest change of the strain from which on a record is loaded."""
_RATE_DIFFERS = 2.0
"""Factor between the rate that a header says and that of the record from which on a remark says so."""


def coupon_files(settings: Coupon, base_folder: Path) -> tuple[Path, ...]:
    """All files that the section names, each once, in its order; StudyError for a variable that is not set."""
    paths = []
    for index, record in enumerate(settings.records):
        key = f"key '{record.place or f'coupon.records.{index}'}"
        paths.append(path_from(base_folder, record.file, f"{key}.file'"))
        for name in ("strain", "stress", "temperature", "lateral"):
            source = getattr(record, name)
            if isinstance(source, SecondClock) and source.file is not None:
                paths.append(path_from(base_folder, source.file, f"{key}.{name}.file'"))
    paths += [path_from(base_folder, row.file, f"key 'coupon.rows.{index}.file'") for index, row in enumerate(settings.rows)]
    return tuple(dict.fromkeys(paths))


def read_coupon(settings: Coupon, base_folder: Path) -> tuple[CouponRecord, ...]:
    """All records of the section, in its order; `base_folder` is that of the study file.

    StudyError for a column, a test, a unit or a length that the study must give; DataError for a file or values that are wrong.
    """
    return tuple(
        read_coupon_record(record, base_folder, record.place or f"coupon.records.{k}") for k, record in enumerate(settings.records)
    )


def read_coupon_record(settings: CouponRecordSettings, base_folder: Path, key: str = "coupon.records.0") -> CouponRecord:
    """One record; errors as `read_coupon`. `key` is its place in the study, for messages."""
    path = path_from(base_folder, settings.file, f"key '{key}.file'")
    record = pick_record(path, settings.test, key, settings.where)
    where = f"{path}, record '{settings.label}'"
    rows = _rows(record, settings, base_folder, key)
    rows = cut(repaired(rows, where), settings, where)
    remarks = [*settings.taken, *rows.remarks, *suspected_jumps(rows), *_suspicions(rows), *_rate_suspicion(rows, record, settings)]
    theta_start, theta_air, said = _temperatures(rows, record, settings, key)
    noise, estimated = _noise(rows, settings)
    phases = coupon_phases(rows.time, rows.strain, rows.stress)
    kept = every = np.arange(rows.time.size)
    if settings.points is not None and settings.points < rows.time.size:
        kept = thinned(rows.time, rows.strain, rows.stress, settings.points)
        said.append(f"thinned from {rows.time.size} to {kept.size} samples, turning points kept")
    read = CouponRecord(
        name=settings.label,
        **_samples(rows, kept),
        theta_air=theta_air,
        noise=noise,
        phases=phases,
        remarks=(*record.traits.remarks, *remarks, *said, estimated),
        theta_start=theta_start,
        shift_strain=settings.strain_zero == "elastic-line",
        measured_clock=settings.time is not None,
        over_plastic=settings.over_plastic,
    )
    if len(kept) < len(every) and not settings.over_plastic:
        first = every[: _first_turn(rows) + 1]
        read = replace(read, first_loading=replace(read, **_samples(rows, first), phases=(), remarks=()))
    questions = questions_of_record(read, rate_is_given=settings.time is None and settings.sampling_rate is None)
    return replace(read, remarks=(*read.remarks, *settled(questions, settings.confirmed, where)))


def _first_turn(rows: CouponRows) -> int:
    """Row of the first reversal of the strain after a part of its largest change: before that a machine at rest turns back and forth."""
    away = np.abs(rows.strain - rows.strain[0])
    turns = turning_points(rows.time, rows.strain)
    return int(turns[int(np.argmax(away[turns] >= _LOADED * away.max()))])


def _samples(rows: CouponRows, kept: np.ndarray) -> dict[str, Any]:
    """Channels of a CouponRecord at some of the rows."""
    return {
        "time": rows.time[kept],
        "strain": rows.strain[kept],
        "stress": rows.stress[kept],
        "temperature": None if rows.temperature is None else rows.temperature[kept],
        "lateral": None if rows.lateral is None else rows.lateral[kept],
    }


def _rows(record: ChannelRecord, settings: CouponRecordSettings, base_folder: Path, key: str) -> CouponRows:
    """Channels as the study names them, with remarks on units, signs, lengths and clocks."""
    time, remarks = time_channel(record, settings, key)
    where = f"{record.traits.path}, record '{settings.label}'"
    if settings.sampling_rate is not None:
        time, said = time_from_rows(record, settings.sampling_rate)
        remarks = [*remarks, said]
    strain_source = settings.strain if isinstance(settings.strain, StrainSource) else StrainSource(column=settings.strain)
    stress_source = settings.stress if isinstance(settings.stress, StressSource) else StressSource(column=settings.stress)
    strain = stress = None
    if not strain_source.apart:
        strain, said_strain = strain_channel(record, settings, key)
        strain, jumps = without_jumps(strain, settings.jumps, f"key '{key}")
        remarks = [*remarks, *said_strain, *jumps]
    elif settings.jumps:
        raise StudyError(f"key '{key}.jumps' names rows of the record, but the strain has a clock of its own; leave one of them out")
    if not stress_source.apart and (stress_source.true_stress is None or strain is not None):
        stress, said_stress = stress_channel(record, settings, strain, key)
        remarks = [*remarks, *said_stress]
    if time is None:
        apart = [name for name in ("strain", "stress", "temperature", "lateral") if _apart(getattr(settings, name))]
        if apart:
            raise StudyError(f"key '{key}.{apart[0]}' has a clock of its own and needs a time column, but the time is built; name 'time'")
    main = Main(record, settings, base_folder, time, strain, stress)
    if strain is None:
        strain, said_strain = beside_another_clock(main, strain_source, "strain", key, lambda r: strain_channel(r, settings, key))
        remarks = [*remarks, *said_strain]
    if stress is None and stress_source.apart:
        # A true stress becomes nominal by the strain at its own times, which only the record's clock has.
        if stress_source.true_stress is not None:
            raise StudyError(
                f"key '{key}.stress' is a true stress beside another clock, which cannot be converted; give force or nominal stress"
            )
        stress, said_stress = beside_another_clock(main, stress_source, "stress", key, lambda r: stress_channel(r, settings, None, key))
        remarks = [*remarks, *said_stress]
    elif stress is None:
        stress, said_stress = stress_channel(record, settings, strain, key)
        remarks = [*remarks, *said_stress]
    if settings.tension == "negative":
        remarks.append("signs of force and extension turned: tension is negative in the file")
    theta, said_theta = _temperature(main, key)
    lateral, said_lateral = _lateral(main, stress_source, key)
    built = np.full(strain.size, np.nan) if time is None else time
    rows = CouponRows(built, strain, stress, theta, (*remarks, *said_theta, *said_lateral), lateral, np.arange(strain.size))
    rows = without_rows(rows.saying(*wild_samples(rows, settings.leave_out)), settings.leave_out, f"key '{key}")
    if time is None:
        rate, said = _rate(record, settings, key)
        rows = time_from_rate(rows, rate, where).saying(said)
    return rows


def _apart(source: object) -> bool:
    return isinstance(source, SecondClock) and source.apart


def _rate(record: ChannelRecord, settings: CouponRecordSettings, key: str) -> tuple[float, str]:
    """Strain rate in 1/s that builds the time, and where it is from. StudyError where the record has a clock, or nothing says the rate."""
    if settings.rate is not None:
        return settings.rate, f"strain rate {settings.rate:g} 1/s of the study"
    clocks = [c.name for c in record.traits.columns if c.meaning in ("time", "date") and c.name in record.channels]
    if clocks:
        raise StudyError(
            f"key '{key}.time' is missing, and {record.traits.path} has the clock {' and '.join(clocks)}: name it, or give rate"
        )
    if "rate" not in record.about:
        raise StudyError(
            f"key '{key}.time' is missing, and {record.traits.path} says no strain rate: name the column of time, or give rate (1/s) or "
            "sampling_rate (rows per second)"
        )
    return record.about["rate"], f"strain rate {record.about['rate']:g} 1/s from the header of the file"


def _rate_suspicion(rows: CouponRows, record: ChannelRecord, settings: CouponRecordSettings) -> list[str]:
    """A remark where the rate that the header says is not that of the record's own clock."""
    said = record.about.get("rate")
    if said is None or settings.time is None:
        return []
    peak = int(np.argmax(np.abs(rows.strain - rows.strain[0])))
    if peak < 1:
        return []
    own = float(np.abs(rows.strain[peak] - rows.strain[0]) / (rows.time[peak] - rows.time[0]))
    if 1.0 / _RATE_DIFFERS < own / said < _RATE_DIFFERS:
        return []
    return [
        f"the header says a strain rate of {said:g} 1/s, the record has {own:.3g} 1/s on the way to its largest strain: the clock counts"
    ]


def _temperature(main: Main, key: str) -> tuple[np.ndarray | None, list[str]]:
    """Temperature in K at the rows of the record, NaN where a second clock does not cover them."""
    given = main.settings.temperature
    if given is None:
        return None, []
    source = TemperatureSource(column=given) if isinstance(given, str) else given
    column = ColumnSource(column=source.column, unit=source.unit)
    if not source.apart:
        return channel(main.record, column, "temperature", f"{key}.temperature")
    return beside_another_clock(main, source, "temperature", key, lambda r: channel(r, column, "temperature", f"{key}.temperature"))


def _lateral(main: Main, stress: StressSource, key: str) -> tuple[np.ndarray | None, list[str]]:
    """Lateral strain at the rows of the record, NaN where it is missing, with the number of gaps."""
    given = main.settings.lateral
    if given is None:
        return None, []
    source = LateralSource(column=given) if isinstance(given, str) else given

    def read(record: ChannelRecord) -> tuple[np.ndarray, list[str]]:
        return lateral_channel(record, source, width_of(source, stress, record, f"{key}.lateral"), f"{key}.lateral")

    values, remarks = beside_another_clock(main, source, "lateral", key, read) if source.apart else read(main.record)
    gaps = int(np.isnan(values).sum())
    return values, [*remarks, f"lateral strain '{source.name}': {gaps} of {values.size} rows without value"]


def _suspicions(rows: CouponRows) -> list[str]:
    """Remarks where signs contradict physics."""
    found = [branch_suspicion(rows.strain, rows.stress)]
    if rows.temperature is not None:
        found.append(sign_suspicion(rows.time, rows.stress, rows.temperature))
    if rows.lateral is not None:
        found.append(lateral_suspicion(rows.strain, rows.lateral))
    return [text for text in found if text is not None]


def _temperatures(rows: CouponRows, record: ChannelRecord, settings: CouponRecordSettings, key: str) -> tuple[float, float, list[str]]:
    """Temperatures in K of the specimen before the test and of the air, and remarks. StudyError where nothing says the first."""
    remarks = []
    if settings.initial_temperature_degC is not None:
        start = settings.initial_temperature_degC + CELSIUS
    elif "temperature" in record.about:
        start = record.about["temperature"]
        remarks.append(f"initial temperature {start:.2f} K from the header of the file or a column that holds one value")
    elif rows.temperature is not None:
        n = max(1, min(20, rows.time.size // 100))
        start = float(np.median(rows.temperature[:n]))
        remarks.append(f"initial temperature {start:.2f} K, the median of the first {n} values of the sensor")
    else:
        raise StudyError(f"key '{key}.initial_temperature_degC' is missing, and neither header nor sensor gives it: add it")
    if settings.air_temperature_degC is not None:
        return start, settings.air_temperature_degC + CELSIUS, remarks
    return start, start, [*remarks, f"air taken to be at the initial temperature, {start:.2f} K"]


def _noise(rows: CouponRows, settings: CouponRecordSettings) -> tuple[dict[str, float], str]:
    """Standard deviations by channel: the study's, else from second differences; and the remark on them."""
    given = {
        "strain": settings.noise.strain,
        "stress": settings.noise.stress,
        "theta": settings.noise.temperature,
        "lateral": settings.noise.lateral,
    }
    values = {"strain": rows.strain, "stress": rows.stress, "theta": rows.temperature, "lateral": rows.lateral}
    noise: dict[str, float] = {}
    words = []
    for name, value in values.items():
        if value is None:
            continue
        declared, known = given[name], np.isfinite(value)
        if declared is None and known.sum() < 5:
            continue
        noise[name] = declared if declared is not None else working_sigma(noise_level(rows.time[known], value[known]), value[known])
        words.append(f"{name} {noise[name]:.3g}" + (" (declared)" if declared is not None else ""))
    return noise, "noise of single values: " + ", ".join(words) + " (else from second differences)"
