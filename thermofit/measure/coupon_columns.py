"""Which column of a native file is time, strain, stress and temperature, in which unit and with which sign: as the study says."""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError, StudyError
from thermofit.core.study_coupon import ColumnSource, CouponRecordSettings, StrainSource, StressSource
from thermofit.core.study_errors import near_miss
from thermofit.core.units import known_unit, to_fixed
from thermofit.measure.formats import coupon_text
from thermofit.measure.formats.contents import Column, Content, Record, Records
from thermofit.measure.formats.registry import FORMATS, head_of
from thermofit.measure.formats.text import name_and_unit

_FREE_UNITS = {"strain": ("1", "dimensionless"), "time": ("s", "seconds")}
"""Units that a column without any is taken to have, which is said in a remark; every other must be given."""


def pick_record(path: Path, test: str | None, key: str) -> Record:
    """The record of a file, or that of its tests which the study names. DataError, StudyError where it must name one."""
    head = head_of(path)
    # The study names the columns: a table whose own names say nothing is read too.
    module = next((module for module in FORMATS if module.recognises(head)), coupon_text)
    content: Content = module.read(path)
    if isinstance(content, Record):
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


def _same(name: str) -> str:
    return re.sub(r"\s+", " ", unicodedata.normalize("NFC", name)).strip()


def find_column(record: Record, name: str, key: str) -> Column:
    """The column of that name, with or without its unit in brackets. StudyError with the near miss, DataError where it holds no numbers."""
    columns = record.traits.columns
    found = [c for c in columns if c.name == _same(name)] or [c for c in columns if name_and_unit(c.name)[0] == _same(name)]
    if len(found) > 1:
        raise StudyError(f"key '{key}' is '{name}', which fits the columns {', '.join(c.name for c in found)}; give the full name of one")
    if not found:
        raise StudyError(f"key '{key}' is '{name}', but {record.traits.path} has no such column{near_miss(name, record.channels)}")
    if found[0].name not in record.channels:
        raise DataError(f"{record.traits.path}: column '{name}' holds no numbers, but key '{key}' needs it; export it with values")
    return found[0]


def channel(record: Record, source: ColumnSource, quantity: str, key: str) -> tuple[np.ndarray, list[str]]:
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
    return _converted(values, unit, quantity, (key, column.name)), remarks


def _converted(values: np.ndarray, unit: str, quantity: str, place: tuple[str, str]) -> np.ndarray:
    """Values in the fixed unit; StudyError where the unit is not one of the quantity."""
    known = known_unit(unit)
    if known is None or known.quantity != quantity:
        what = "is not known" if known is None else f"is one of {known.quantity}"
        raise StudyError(f"key '{place[0]}': unit '{unit}' of column '{place[1]}' {what}, expected one of {quantity}")
    return to_fixed(values, unit)[0]


def time_channel(record: Record, settings: CouponRecordSettings, key: str) -> tuple[np.ndarray | None, list[str]]:
    """Time in s, None where the study builds it from a rate."""
    if settings.time is None:
        return None, []
    source = ColumnSource(column=settings.time) if isinstance(settings.time, str) else settings.time
    return channel(record, source, "time", f"{key}.time")


def strain_channel(record: Record, settings: CouponRecordSettings, key: str) -> tuple[np.ndarray, list[str]]:
    """Nominal strain, tension positive, and remarks."""
    given = settings.strain
    source = StrainSource(column=given) if isinstance(given, str) else given
    key = f"{key}.strain"
    column = ColumnSource(column=source.name, unit=source.unit)
    values, remarks = channel(record, column, "length" if source.extension else "strain", key)
    values = _signed(values, source.tension or settings.tension)
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


def stress_channel(record: Record, settings: CouponRecordSettings, strain: np.ndarray, key: str) -> tuple[np.ndarray, list[str]]:
    """Nominal stress in MPa, tension positive, and remarks; `strain` (n,) nominal converts a true stress."""
    given = settings.stress
    source = StressSource(column=given) if isinstance(given, str) else given
    key = f"{key}.stress"
    column = ColumnSource(column=source.name, unit=source.unit)
    values, remarks = channel(record, column, "force" if source.force else "stress", key)
    values = _signed(values, source.tension or settings.tension)
    if source.true_stress is not None:
        said = f"true stress '{source.true_stress}' converted to nominal stress at constant volume, sigma / (1 + strain)"
        return values / (1.0 + strain), [*remarks, said]
    if source.force is None:
        return values, remarks
    area, said = area_of(source, record, key)
    return values / area, [*remarks, said]


def _signed(values: np.ndarray, tension: str) -> np.ndarray:
    return -values if tension == "negative" else values


def area_of(source: StressSource, record: Record, key: str) -> tuple[float, str]:
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
