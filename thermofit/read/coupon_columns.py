"""Which column of a native file is time, strain, stress and temperature, in which unit and with which sign: as the study says."""

from __future__ import annotations

import datetime as dt
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError, StudyError
from thermofit.core.units import known_unit, to_fixed
from thermofit.read.formats import coupon_text
from thermofit.read.formats.contents import ChannelRecord, Column, Content, Records
from thermofit.read.formats.record_columns import about_key
from thermofit.read.formats.record_words import kind_of
from thermofit.read.formats.registry import FORMATS, head_of
from thermofit.read.formats.text import name_and_unit
from thermofit.study.coupon import ColumnSource, CouponRecordSettings, LateralSource, StrainSource, StressSource
from thermofit.study.errors import near_miss

_CONSTANT = 10
"""Rows that a column must have to speak of the whole test by being constant."""
_FREE_UNITS = {"strain": ("1", "dimensionless"), "time": ("s", "seconds")}
"""Units that a column without any is taken to have, which is said in a remark; every other must be given."""


def pick_record(path: Path, test: str | None, key: str, where: Mapping[str, str | float] | None = None) -> ChannelRecord:
    """The record of a file, or that of its tests which the study names, and of its rows those in which the columns of `where` hold the
    given values. DataError, StudyError where it must name one."""
    return with_constants(_selected(_picked(path, test, key), where or {}, key))


def _selected(record: ChannelRecord, where: Mapping[str, str | float], key: str) -> ChannelRecord:
    """The rows in which every column of `where` holds its value; a number is in the unit of the column."""
    if not where:
        return record
    rows = max(values.size for values in record.channels.values())
    keep = np.ones(rows, dtype=bool)
    for name, wanted in where.items():
        if name in record.labels:
            keep &= np.array([text == str(wanted) for text in record.labels[name]])
            known = sorted(set(record.labels[name]))
        else:
            column = find_column(record, name, f"{key}.where.{name}")
            if isinstance(wanted, str):
                raise StudyError(f"key '{key}.where.{name}' is '{wanted}', but the column holds numbers; give a number")
            value = float(to_fixed(wanted, column.unit)[0]) if known_unit(column.unit) else float(wanted)
            values = record.channels[column.name]
            keep &= np.isclose(values, value, rtol=1e-9, atol=1e-12)
            known = [f"{v:.6g}" for v in np.unique(values[np.isfinite(values)])[:12]]
        if not keep.any():
            raise StudyError(
                f"key '{key}.where.{name}' is {wanted!r}, but no row of {record.traits.path} holds it; there are {', '.join(known[:12])}"
            )
    channels = {name: values[keep] for name, values in record.channels.items() if np.isfinite(values[keep]).any()}
    labels = {name: tuple(text for text, kept in zip(texts, keep, strict=True) if kept) for name, texts in record.labels.items()}
    said = f"{int(keep.sum())} of {rows} rows: {', '.join(f'{name} = {value}' for name, value in where.items())}"
    traits = replace(record.traits, remarks=(*record.traits.remarks, said))
    return replace(record, traits=traits, channels=channels, labels=labels)


def with_constants(record: ChannelRecord) -> ChannelRecord:
    """The record with what its constant columns (temperature, strain rate, sizes with a known unit) say of the test."""
    about, remarks = dict(record.about), []
    sensors = sum(column.meaning == "temperature" and column.name in record.channels for column in record.traits.columns)
    for column in record.traits.columns:
        values = record.channels.get(column.name)
        if values is None or values.size < _CONSTANT or not np.isfinite(values).all() or np.ptp(values) > 0.0:
            continue
        name = "strain rate" if column.meaning == "rate" and "strain" in column.name.lower() else name_and_unit(column.name)[0]
        key = "temperature" if column.meaning == "temperature" else about_key(name)
        unit = known_unit(column.unit)
        if column.meaning == "temperature" and sensors > 1:
            continue  # beside a sensor that moves, one that stands still is not connected
        if key is None or key in about or unit is None or unit.fixed != record.units.get(column.name) or not values[0] > 0.0:
            continue
        if {"temperature": "temperature", "rate": "rate"}.get(key, unit.quantity) != unit.quantity:
            continue
        about[key] = float(values[0])
        remarks.append(f"column '{column.name}' is constant: {key.replace('_', ' ')} {values[0]:.6g} {unit.fixed}")
    return replace(record, traits=replace(record.traits, remarks=(*record.traits.remarks, *remarks)), about=about)


def _picked(path: Path, test: str | None, key: str) -> ChannelRecord:
    head = head_of(path)
    # The study names the columns: a table whose own names say nothing is read too.
    module = next((module for module in FORMATS if module.recognises(head)), coupon_text)
    content: Content = module.read(path)
    if isinstance(content, ChannelRecord):
        if test is not None and test not in (content.traits.header.get("sheet"), content.traits.header.get("tag")):
            raise StudyError(f"key '{key}.test' is '{test}', but {path} holds a single test; leave the key out")
        return content
    if not isinstance(content, Records):
        raise DataError(f"{path}: found {content.traits.format}, expected the record of a coupon test; name its file")
    known = list(content.tests)
    if test is None:
        if len(known) == 1:
            return content.tests[known[0]]
        raise StudyError(f"key '{key}.test' is missing, and {path} holds {len(known)} tests: add one of {', '.join(known)}")
    if test not in content.tests:
        raise StudyError(f"key '{key}.test' is '{test}', but {path} holds no such test{near_miss(test, known)}")
    return content.tests[test]


_NUMBERED = re.compile(r"column ([1-9]\d*)")


def _same(name: str) -> str:
    return re.sub(r"\s+", " ", unicodedata.normalize("NFC", name)).strip()


def find_column(record: ChannelRecord, name: str, key: str) -> Column:
    """The column of that name, with or without its unit in brackets. StudyError with the near miss, DataError where it holds no numbers."""
    columns = record.traits.columns
    found = [c for c in columns if c.name == _same(name)] or [c for c in columns if name_and_unit(c.name)[0] == _same(name)]
    if not found and (number := _NUMBERED.fullmatch(name)) is not None:
        if int(number.group(1)) > len(columns):
            raise StudyError(f"key '{key}' is column {number.group(1)}, but {record.traits.path} has {len(columns)} columns; correct it")
        found = [columns[int(number.group(1)) - 1]]
    if len(found) > 1:
        raise StudyError(f"key '{key}' is '{name}', which fits the columns {', '.join(c.name for c in found)}; give the full name of one")
    if not found:
        raise StudyError(f"key '{key}' is '{name}', but {record.traits.path} has no such column{near_miss(name, record.channels)}")
    if found[0].name not in record.channels:
        raise DataError(f"{record.traits.path}: column '{name}' holds no numbers, but key '{key}' needs it; export it with values")
    return found[0]


def channel(record: ChannelRecord, source: ColumnSource, quantity: str, key: str) -> tuple[np.ndarray, list[str]]:
    """Values of a column in the fixed unit of the quantity, and remarks.

    StudyError where the unit is neither in the file nor in the study, is not known, or is one of another quantity.
    """
    column = find_column(record, source.column, key)
    values, remarks = record.channels[column.name], []
    written = known_unit(column.unit)
    if source.unit is not None:
        if written is not None:
            values = values / written.factor - written.shift
            remarks.append(f"column '{column.name}': unit {source.unit} of the study replaces {column.unit} of the file")
        unit = source.unit
    elif written is not None:
        unit = column.unit
        values = values / written.factor - written.shift
    elif column.unit:
        raise StudyError(f"key '{key}': the unit '{column.unit}' of column '{column.name}' is not known; give it as unit")
    elif quantity in _FREE_UNITS:
        unit, words = _FREE_UNITS[quantity]
        remarks.append(f"column '{column.name}' has no unit in the file and is taken as {words}")
    else:
        raise StudyError(f"key '{key}': column '{column.name}' has no unit in the file; give it, {{column: {column.name}, unit: ...}}")
    return _converted(values, unit, quantity, key, column.name), remarks


def _converted(values: np.ndarray, unit: str, quantity: str, key: str, name: str) -> np.ndarray:
    """Values in the fixed unit; StudyError where the unit is not one of the quantity."""
    known = known_unit(unit)
    if known is None or known.quantity != quantity:
        what = "is not known" if known is None else f"is one of {known.quantity}"
        raise StudyError(f"key '{key}': unit '{unit}' of column '{name}' {what}, expected one of {quantity}")
    return to_fixed(values, unit)[0]


def time_channel(record: ChannelRecord, settings: CouponRecordSettings, key: str) -> tuple[np.ndarray | None, list[str]]:
    """Time in s, None where the study builds it from a rate."""
    if settings.time is None:
        return None, []
    source = ColumnSource(column=settings.time) if isinstance(settings.time, str) else settings.time
    time, remarks = channel(record, source, "time", f"{key}.time")
    if find_column(record, source.column, f"{key}.time").meaning != "date":
        return time, remarks
    known = time[np.isfinite(time)]
    began = (dt.datetime(1970, 1, 1) + dt.timedelta(seconds=float(known[0]))).isoformat(sep=" ")
    return time - known[0], [*remarks, f"time counted from the first date, {began}"]


def _discriminated(name: str, declared: str, source: StrainSource | StressSource | LateralSource, key: str, quantity: str) -> list[str]:
    """A remark, or a StudyError, where the words of a column contradict what the study takes it for (`declared`: true or nominal)."""
    words = kind_of(name)
    if not words or words == declared:
        return []
    if source.despite_name:
        return [f"column '{name}' is taken as {declared} {quantity} despite its name, as the study says"]
    other = f"true_{quantity}" if words == "true" else "column"
    raise StudyError(
        f"key '{key}' takes column '{name}' as {declared} {quantity}, but its name says {words}; write {{{other}: \"{name}\"}}, or add "
        "despite_name: true if the name is wrong"
    )


def strain_channel(record: ChannelRecord, settings: CouponRecordSettings, key: str) -> tuple[np.ndarray, list[str]]:
    """Nominal strain, tension positive, and remarks."""
    given = settings.strain
    source = StrainSource(column=given) if isinstance(given, str) else given
    key = f"{key}.strain"
    column = ColumnSource(column=source.name, unit=source.unit)
    values, remarks = channel(record, column, "length" if source.extension else "strain", key)
    values = _signed(values, source.tension or settings.tension)
    if source.extension is None:
        name = find_column(record, source.name, key).name
        remarks += _discriminated(name, "nominal" if source.column is not None else "true", source, key, "strain")
    if source.true_strain is not None:
        return np.expm1(values), [*remarks, f"true strain '{source.true_strain}' converted to nominal strain, exp(e) - 1"]
    if source.plastic_strain is not None:
        return np.expm1(values), [*remarks, f"plastic strain '{source.plastic_strain}': the elastic strain is added from parameters.E"]
    if source.extension is None:
        return values, remarks
    length, said = source.gauge_length, ""
    if length is None:
        length = record.about.get("gauge_length")
        if length is None:
            raise StudyError(f"key '{key}.gauge_length' is missing and {record.traits.path} does not say it: add it in mm")
        said = f"gauge length {length:g} mm from the header of the file"
    return values / length, [*remarks, said] if said else remarks


def stress_channel(
    record: ChannelRecord, settings: CouponRecordSettings, strain: np.ndarray | None, key: str
) -> tuple[np.ndarray, list[str]]:
    """Nominal stress in MPa, tension positive, and remarks; `strain` (n,) nominal converts a true stress, and may be None for others."""
    given = settings.stress
    source = StressSource(column=given) if isinstance(given, str) else given
    key = f"{key}.stress"
    column = ColumnSource(column=source.name, unit=source.unit)
    values, remarks = channel(record, column, "force" if source.force else "stress", key)
    values = _signed(values, source.tension or settings.tension)
    if source.force is None:
        name = find_column(record, source.name, key).name
        remarks += _discriminated(name, "nominal" if source.column is not None else "true", source, key, "stress")
    if source.true_stress is not None and strain is not None:
        said = f"true stress '{source.true_stress}' converted to nominal stress at constant volume, sigma / (1 + strain)"
        return values / (1.0 + strain), [*remarks, said]
    if source.force is None:
        return values, remarks
    area, said = area_of(source, record, key)
    return values / area, [*remarks, said]


def lateral_channel(record: ChannelRecord, source: LateralSource, width: tuple[float, str], key: str) -> tuple[np.ndarray, list[str]]:
    """Nominal strain across the load, negative where the specimen gets narrower, and remarks; `width` mm and where it is from."""
    column = ColumnSource(column=source.name, unit=source.unit)
    values, remarks = channel(record, column, "length" if source.extension else "strain", key)
    if source.contraction == "positive":
        values = -values
        remarks.append("sign of the lateral strain turned: contraction is positive in the file")
    if source.extension is not None:
        return values / width[0], [*remarks, width[1]]
    name = find_column(record, source.name, key).name
    remarks += _discriminated(name, "nominal" if source.column is not None else "true", source, key, "strain")
    if source.true_strain is not None:
        return np.expm1(values), [*remarks, f"true lateral strain '{source.true_strain}' converted to nominal strain, exp(e) - 1"]
    return values, remarks


def width_of(source: LateralSource, stress: StressSource, record: ChannelRecord, key: str) -> tuple[float, str]:
    """Width (or diameter) in mm over which a change of width is a strain, and where it is from; (1, "") for a strain.

    StudyError where nothing says it.
    """
    if source.extension is None:
        return 1.0, ""
    given = (source.width, "lateral strain over the width"), (stress.width, "lateral strain over the width of the stress")
    header = tuple((record.about.get(name), f"lateral strain over the {name} in the header of the file") for name in ("width", "diameter"))
    for value, words in (*given, (stress.diameter, "lateral strain over the diameter of the stress"), *header):
        if value is not None:
            return value, f"{words}, {value:g} mm"
    raise StudyError(f"key '{key}.width' is missing and {record.traits.path} does not say it: add it in mm")


def _signed(values: np.ndarray, tension: str) -> np.ndarray:
    return -values if tension == "negative" else values


def area_of(source: StressSource, record: ChannelRecord, key: str) -> tuple[float, str]:
    """Initial cross-section in mm^2 and where it is from: the study, else the header. StudyError where neither gives it."""
    about = record.about
    if source.area is not None:
        return source.area, f"area {source.area:g} mm^2"
    if source.diameter is not None:
        return _disc(source.diameter), f"area {_disc(source.diameter):.6g} mm^2 from the diameter {source.diameter:g} mm"
    if source.width is not None or source.thickness is not None:
        width, thickness = source.width or about.get("width"), source.thickness or about.get("thickness")
        for name, value in (("width", width), ("thickness", thickness)):
            if value is None:
                raise StudyError(f"key '{key}.{name}' is missing and {record.traits.path} does not say it: add it in mm")
        assert width is not None and thickness is not None
        part = "" if source.width and source.thickness else ", one of them from the header of the file"
        return width * thickness, f"area {width * thickness:.6g} mm^2 = {width:g} mm x {thickness:g} mm{part}"
    if "area" in about:
        return about["area"], f"area {about['area']:.6g} mm^2 from the header of the file"
    if "diameter" in about:
        return _disc(about["diameter"]), f"area {_disc(about['diameter']):.6g} mm^2 from the diameter in the header of the file"
    if "width" in about and "thickness" in about:
        area = about["width"] * about["thickness"]
        return area, f"area {area:.6g} mm^2 from width and thickness in the header of the file"
    raise StudyError(f"key '{key}.area' is missing and {record.traits.path} does not say it: add area, diameter, or width and thickness")


def _disc(diameter: float) -> float:
    return float(np.pi * diameter**2 / 4.0)
