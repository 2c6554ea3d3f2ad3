"""Coupon records: the native files that a study names, mapped onto nominal strain and stress, tension positive."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError, StudyError
from thermofit.core.experiment import CELSIUS, CouponRecord
from thermofit.core.study_coupon import ColumnSource, Coupon, CouponRecordSettings, TemperatureSource
from thermofit.core.study_paths import path_from
from thermofit.measure.coupon_clocks import clock_offset
from thermofit.measure.coupon_columns import channel, pick_record, strain_channel, stress_channel, time_channel
from thermofit.measure.coupon_phases import coupon_phases, thinned
from thermofit.measure.coupon_repair import Rows, cut, repaired, suspected_jumps, time_from_rate, without_jumps
from thermofit.measure.coupon_signs import branch_suspicion, sign_suspicion
from thermofit.measure.formats.contents import Record
from thermofit.measure.phases import noise_level, working_sigma


def coupon_files(settings: Coupon, base_folder: Path) -> tuple[Path, ...]:
    """All files that the section names, each once, in its order; StudyError for a variable that is not set."""
    paths = []
    for index, record in enumerate(settings.records):
        key = f"key 'coupon.records.{index}"
        paths.append(path_from(base_folder, record.file, f"{key}.file'"))
        if isinstance(record.temperature, TemperatureSource) and record.temperature.file is not None:
            paths.append(path_from(base_folder, record.temperature.file, f"{key}.temperature.file'"))
    return tuple(dict.fromkeys(paths))


def read_coupon(settings: Coupon, base_folder: Path) -> tuple[CouponRecord, ...]:
    """All records of the section, in its order; `base_folder` is that of the study file.

    StudyError for a column, a test, a unit or a length that the study must give; DataError for a file or values that are wrong.
    """
    return tuple(read_coupon_record(record, base_folder, f"coupon.records.{k}") for k, record in enumerate(settings.records))


def read_coupon_record(settings: CouponRecordSettings, base_folder: Path, key: str = "coupon.records.0") -> CouponRecord:
    """One record; errors as `read_coupon`. `key` is its place in the study, for messages."""
    path = path_from(base_folder, settings.file, f"key '{key}.file'")
    record = pick_record(path, settings.test, key)
    where = f"{path}, record '{settings.label}'"
    rows = _rows(record, settings, base_folder, key)
    rows = cut(repaired(rows, where), settings, where)
    remarks = [*rows.remarks, *suspected_jumps(rows), *_suspicions(rows)]
    theta_start, theta_air, said = _temperatures(rows, record, settings, key)
    noise, estimated = _noise(rows, settings)
    phases = coupon_phases(rows.time, rows.strain, rows.stress)
    kept = np.arange(rows.time.size)
    if settings.points is not None and settings.points < rows.time.size:
        kept = thinned(rows.time, rows.strain, rows.stress, settings.points)
        said.append(f"thinned from {rows.time.size} to {kept.size} samples, turning points kept")
    return CouponRecord(
        name=settings.label,
        time=rows.time[kept],
        strain=rows.strain[kept],
        stress=rows.stress[kept],
        temperature=None if rows.temperature is None else rows.temperature[kept],
        theta_air=theta_air,
        noise=noise,
        phases=phases,
        remarks=(*record.traits.remarks, *remarks, *said, estimated),
        theta_start=theta_start,
        over_plastic=settings.over_plastic,
    )


def _rows(record: Record, settings: CouponRecordSettings, base_folder: Path, key: str) -> Rows:
    """Channels as the study names them, with remarks on units, signs, lengths and clocks."""
    time, remarks = time_channel(record, settings, key)
    strain, said = strain_channel(record, settings, key)
    strain, jumps = without_jumps(strain, settings.jumps, f"key '{key}")
    stress, more = stress_channel(record, settings, strain, key)
    remarks = [*remarks, *said, *jumps, *more]
    if settings.tension == "negative":
        remarks.append("signs of force and extension turned: tension is negative in the file")
    if time is None:
        if settings.temperature is not None:
            raise StudyError(f"key '{key}.temperature' needs a time column, but the time is built from 'rate'; leave one of them out")
        assert settings.rate is not None
        built = time_from_rate(strain, stress, settings.rate, f"{record.traits.path}, record '{settings.label}'")
        return Rows(built.time, built.strain, built.stress, None, (*remarks, *built.remarks))
    theta, on_theta = _temperature(record, settings, base_folder, (key, time, stress))
    rows = Rows(time, strain, stress, theta, (*remarks, *on_theta))
    return rows


def _temperature(
    record: Record, settings: CouponRecordSettings, base_folder: Path, place: tuple[str, np.ndarray, np.ndarray]
) -> tuple[np.ndarray | None, list[str]]:
    """Temperature in K at the rows of the record, NaN where a second file does not cover them; `place`: key, time and stress."""
    key, time, stress = place
    given = settings.temperature
    if given is None:
        return None, []
    source = TemperatureSource(column=given) if isinstance(given, str) else given
    column = ColumnSource(column=source.column, unit=source.unit)
    if source.file is None:
        return channel(record, column, "temperature", f"{key}.temperature")
    key = f"{key}.temperature"
    path = path_from(base_folder, source.file, f"key '{key}.file'")
    second = pick_record(path, source.test, key)
    theta, remarks = channel(second, column, "temperature", key)
    clock, said = channel(second, ColumnSource(column=source.time or _only(second, "time", key, "time")), "time", f"{key}.time")
    known = np.isfinite(clock) & np.isfinite(theta)
    if known.sum() < 2 or (np.diff(clock[known]) <= 0.0).any():
        raise DataError(f"{path}: the time of the temperature does not increase, expected increasing times; export it again")
    offset, found = _offset(second, source, (clock, time, stress), key)
    at = time + offset
    inside = (at >= clock[known][0]) & (at <= clock[known][-1])
    joined = np.where(inside, np.interp(at, clock[known], theta[known]), np.nan)
    return joined, [*remarks, *said, found]


def _only(record: Record, meaning: str, key: str, missing: str) -> str:
    """The only column of that meaning; StudyError where there is none or several."""
    names = [c.name for c in record.traits.columns if c.meaning == meaning and c.name in record.channels]
    if len(names) != 1:
        what = f"{len(names)} columns of {meaning}" + (f" ({', '.join(names)})" if names else "")
        raise StudyError(f"key '{key}.{missing}' is missing, and {record.traits.path} has {what}: name one of {', '.join(record.channels)}")
    return names[0]


def _offset(second: Record, source: TemperatureSource, signals: tuple[np.ndarray, np.ndarray, np.ndarray], key: str) -> tuple[float, str]:
    """Offset of the second clock in s, and the remark on it."""
    if source.offset_s != "auto":
        return float(source.offset_s), f"clock of the temperature set {source.offset_s:g} s ahead, as the study says"
    clock, time, stress = signals
    name = source.repeats or _only(second, "force", key, "repeats")
    if name not in second.channels:
        raise StudyError(f"key '{key}.repeats' is '{name}', but {second.traits.path} has no such channel: {', '.join(second.channels)}")
    repeated = second.channels[name]
    pairs = []
    for t, f in ((time, stress), (clock, repeated)):
        known = np.isfinite(t) & np.isfinite(f)
        t, f = t[known], f[known]
        first = np.concatenate([[True], np.diff(t) > 0.0])
        pairs.append((t[first], f[first]))
    try:
        found = clock_offset(pairs[0], pairs[1])
    except DataError as error:
        raise DataError(f"{second.traits.path}: key '{key}.offset_s' is auto, but {error}") from None
    return found.offset, (
        f"clock of the temperature is {found.offset:.3f} s ahead (+/- {found.sigma:.2g} s), from '{name}', which repeats the force "
        f"(correlation {found.correlation:.4f})"
    )


def _suspicions(rows: Rows) -> list[str]:
    """Remarks where signs contradict physics."""
    found = [branch_suspicion(rows.strain, rows.stress)]
    if rows.temperature is not None:
        found.append(sign_suspicion(rows.time, rows.stress, rows.temperature))
    return [text for text in found if text is not None]


def _temperatures(rows: Rows, record: Record, settings: CouponRecordSettings, key: str) -> tuple[float, float, list[str]]:
    """Temperatures in K of the specimen before the test and of the air, and remarks. StudyError where nothing says the first."""
    remarks = []
    if settings.initial_temperature_degC is not None:
        start = settings.initial_temperature_degC + CELSIUS
    elif "temperature" in record.about:
        start = record.about["temperature"]
        remarks.append(f"initial temperature {start:.2f} K from the header of the file")
    elif rows.temperature is not None:
        n = max(1, min(20, rows.time.size // 100))
        start = float(np.median(rows.temperature[:n]))
        remarks.append(f"initial temperature {start:.2f} K, the median of the first {n} values of the sensor")
    else:
        raise StudyError(f"key '{key}.initial_temperature_degC' is missing, and neither header nor sensor gives it: add it")
    if settings.air_temperature_degC is not None:
        return start, settings.air_temperature_degC + CELSIUS, remarks
    return start, start, [*remarks, f"air taken to be at the initial temperature, {start:.2f} K"]


def _noise(rows: Rows, settings: CouponRecordSettings) -> tuple[dict[str, float], str]:
    """Standard deviations by channel: the study's, else from second differences; and the remark on them."""
    given = {"strain": settings.noise.strain, "stress": settings.noise.stress, "theta": settings.noise.temperature}
    values = {"strain": rows.strain, "stress": rows.stress, "theta": rows.temperature}
    noise: dict[str, float] = {}
    words = []
    for name, value in values.items():
        if value is None:
            continue
        declared = given[name]
        noise[name] = declared if declared is not None else working_sigma(noise_level(rows.time, value), value)
        words.append(f"{name} {noise[name]:.3g}" + (" (declared)" if declared is not None else ""))
    return noise, "noise of single values: " + ", ".join(words) + " (else from second differences)"
