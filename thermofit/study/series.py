"""Entries of `coupon.series`: one entry of a study becomes a record for each of its files.

What differs from file to file stands in the name of the file (`flow_{temperature_C}C_{rate}.csv`) or in lists under `each`.
"""

from __future__ import annotations

import glob
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from thermofit.core.errors import StudyError
from thermofit.core.experiment import CELSIUS
from thermofit.study.coupon import Coupon, CouponRecordSettings, CouponSeriesSettings
from thermofit.study.errors import near_miss, sentence
from thermofit.study.paths import path_from

Value = float | str | bool
_FIELD = re.compile(r"(?<!\$)\{([^{}]*)\}")
_WILD = re.compile(r"(?<!\$)\{[^{}]*\}|\*\*/|\*|\?")
_NUMBER = r"[+-]?\d+(?:[.,p]\d+)?(?:[eE][+-]?\d+)?"
_WORD = r"[^/\\]+?"

_TEMPERATURES: Mapping[str, tuple[float, float]] = {
    "degC": (1.0, 0.0),
    "C": (1.0, 0.0),
    "K": (1.0, -CELSIUS),
    "degF": (5.0 / 9.0, -160.0 / 9.0),
    "F": (5.0 / 9.0, -160.0 / 9.0),
}
"""degC = factor * value + shift, by the unit behind `temperature_`."""
_KEYS: Mapping[str, tuple[str, ...]] = {
    "rate": ("rate",),
    "sampling_rate": ("sampling_rate",),
    "air_temperature_degC": ("air_temperature_degC",),
    "area": ("stress", "area"),
    "diameter": ("stress", "diameter"),
    "width": ("stress", "width"),
    "thickness": ("stress", "thickness"),
    "gauge_length": ("strain", "gauge_length"),
    "name": ("name",),
    "test": ("test",),
    "held_out": ("held_out",),
}
"""Where a value of each file goes in the settings of a record."""
_TEXTS = ("name", "test", "held_out")
_SOURCES: Mapping[str, str] = {"strain": "extension", "stress": "force"}


def with_series(coupon: Coupon, folder: Path, source: str) -> Coupon:
    """The section with a record for each file of its series, behind the other records; `folder` is that of the study.

    StudyError, with `source` in front, where no file fits, values and files differ in number, or a record is wrong.
    """
    if not coupon.series:
        return coupon
    records = list(coupon.records)
    for index, series in enumerate(coupon.series):
        records += _records(series, folder, f"{source}: key 'coupon.series.{index}")
    for k, record in enumerate(records):
        twin = next((other for other in records[:k] if other.label == record.label), None)
        if twin is not None:
            raise StudyError(
                f"{source}: the records of {twin.file} and {record.file} are both called '{record.label}'; give them names "
                "(each: {name: [...]}, or {name} in the pattern of the files)"
            )
    if all(record.held_out for record in records):
        raise StudyError(f"{source}: key 'coupon' holds out all records; expected at least one that is fitted")
    return coupon.model_copy(update={"records": tuple(records), "series": ()})


def _records(series: CouponSeriesSettings, folder: Path, key: str) -> list[CouponRecordSettings]:
    """One record for each file of an entry."""
    found = _files(series, folder, f"{key}.files'")
    counts = {name: len(values) for name, values in series.each.items()}
    many = max(counts.values(), default=1)
    if len(found) == 1 and many > 1:
        found = found * many  # several tests of one file
    for name, count in counts.items():
        if count != len(found):
            raise StudyError(f"{key}.each.{name}' has {count} values for {len(found)} files; expected one for each file, in their order")
        _target(name, f"{key}.each.{name}'")
    common = series.model_dump(exclude={"file", "files", "each"}, exclude_unset=True)
    records = []
    for number, (file, fields) in enumerate(found):
        own = {name: values[number] for name, values in series.each.items()}
        if twice := sorted(set(own) & set(fields)):
            raise StudyError(f"{key}.each.{twice[0]}' is in the pattern of the files, too; expected it in one place")
        records.append(_record(common, file, {**fields, **own}, set(fields), key))
    return records


def _record(common: Mapping[str, Any], file: str, values: Mapping[str, Value], named: set[str], key: str) -> CouponRecordSettings:
    """The settings of one file; `named` values are from its name."""
    tree: dict[str, Any] = {**common, "file": file}
    for name, given in values.items():
        place, value = _target(name, f"{key}.each.{name}'"), _converted(name, given, f"{key}.each.{name}'")
        if len(place) > 1 and place[0] in _SOURCES and not isinstance(tree.get(place[0]), dict):
            raise StudyError(f"{key}.each.{name}' needs {{{_SOURCES[place[0]]}: COLUMN}} under '{place[0]}'; write it so")
        inner = tree
        for part in place[:-1]:
            inner[part] = dict(inner.get(part) or {})
            inner = inner[part]
        inner[place[-1]] = value
    try:
        record = CouponRecordSettings.model_validate(tree)
    except ValidationError as error:
        raise StudyError(f"{key}', file {file}: {sentence(error.errors(include_url=False)[0])[1]}") from None
    said = tuple(f"{name} {value} from {'the name of the file' if name in named else 'the study'}" for name, value in values.items())
    record._origin = (key.partition("key '")[2], said)
    return record


def _target(name: str, where: str) -> tuple[str, ...]:
    """Place of a value of each file in the settings of a record."""
    if name.startswith("where.") and len(name) > 6:
        return ("where", name[6:])
    if (unit := _temperature_unit(name)) is not None and unit in _TEMPERATURES:
        return ("initial_temperature_degC",)
    if name not in _KEYS:
        known = [*_KEYS, *(f"temperature_{unit}" for unit in _TEMPERATURES), "initial_temperature_degC", "where.COLUMN"]
        raise StudyError(f"{where} is not known{near_miss(name, known)}")
    return _KEYS[name]


def _temperature_unit(name: str) -> str | None:
    match = re.fullmatch(r"(?:initial_)?temperature_(\w+)", name)
    return match.group(1) if match else None


def _converted(name: str, value: Value, where: str) -> Value:
    """A temperature in degC; numbers of the others as they are. StudyError for a text where a number is expected."""
    if name in _TEXTS or name.startswith("where."):
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise StudyError(f"{where} holds '{value}'; expected numbers")
    unit = _temperature_unit(name)
    if unit is None or name.startswith("air"):
        return value
    factor, shift = _TEMPERATURES[unit]
    return factor * value + shift


def _files(series: CouponSeriesSettings, folder: Path, where: str) -> list[tuple[str, dict[str, Value]]]:
    """Files as the study would name them, with what their names say; StudyError where a pattern fits none."""
    patterns: Sequence[str] = (series.files,) if isinstance(series.files, str) else series.files
    found: list[tuple[str, dict[str, Value]]] = []
    for pattern in patterns:
        found += _matching(pattern, folder, where) if _WILD.search(pattern) else [(pattern, {})]
    return found


def _matching(pattern: str, folder: Path, where: str) -> list[tuple[str, dict[str, Value]]]:
    """Files of a pattern in the order of the numbers in their names, with the fields of each."""
    names = _FIELD.findall(pattern)
    for name in names:
        _target(name, f"{where} holds {{{name}}}, which")
    if len(set(names)) < len(names):
        raise StudyError(f"{where} holds a field twice ({pattern}); expected each once")
    wild = _WILD.search(pattern)
    assert wild is not None
    cut = pattern.rfind("/", 0, wild.start()) + 1
    fixed, rest = pattern[:cut], pattern[cut:]
    base = path_from(folder, fixed or ".", where)
    shell, regular, last = "", "", 0
    for part in _WILD.finditer(rest):
        literal, sign = rest[last : part.start()], part.group()
        shell += glob.escape(literal) + (sign if sign in ("*", "?", "**/") else "*")
        regular += re.escape(literal)
        regular += {"*": r"[^/\\]*", "?": r"[^/\\]", "**/": r"(?:.*/)?"}.get(sign) or f"(?P<f{names.index(sign[1:-1])}>{_form(sign[1:-1])})"
        last = part.end()
    shell, regular = shell + glob.escape(rest[last:]), regular + re.escape(rest[last:])
    files = sorted((Path(name).as_posix() for name in glob.glob(shell, root_dir=base, recursive=True)), key=_by_numbers)
    files = [name for name in files if (base / name).is_file()]
    if not files:
        raise StudyError(f"{where} is '{pattern}', which fits no file in {base}; correct the pattern or the folder")
    found = []
    for name in files:
        match = re.fullmatch(regular, name)
        if match is None:
            raise StudyError(f"{where} is '{pattern}', but a field of {name} is no number; expected numbers there, or a list of files")
        found.append((fixed + name, {field: _field_value(field, match.group(f"f{k}")) for k, field in enumerate(names)}))
    return found


def _form(name: str) -> str:
    return _WORD if name in _TEXTS or name.startswith("where.") else _NUMBER


def _field_value(name: str, text: str) -> Value:
    """A number of a file's name, whose decimal sign may be p or a comma; a text for names and tests."""
    return text if _form(name) == _WORD else float(text.replace("p", ".").replace(",", "."))


def _by_numbers(name: str) -> list[tuple[int, float, str]]:
    """Key that sorts names by the numbers in them."""
    pieces = re.split(r"(\d+(?:\.\d+)?)", name)
    return [(1, float(piece), "") if k % 2 else (0, 0.0, piece) for k, piece in enumerate(pieces)]
