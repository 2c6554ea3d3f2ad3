"""Lines to start a study or an experiment.yaml from, as YAML. What the file does not say is left as a comment to fill in, not guessed."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from thermofit.read.formats.contents import ChannelRecord, Column, Content, DicSequence, DicStage, ThermalFrames
from thermofit.read.formats.record_words import spoken

_TIMES = (("time", "time"), ("date", "time"))
_STRAINS = (("strain", "column"), ("true_strain", "true_strain"), ("extension", "extension"), ("plastic_strain", "plastic_strain"))
_STRESSES = (("stress", "column"), ("true_stress", "true_stress"), ("force", "force"))
_LATERALS = (("lateral_strain", "column"), ("true_lateral_strain", "true_strain"), ("lateral_extension", "extension"))
_MOST_SHOWN = 10

Found = tuple[str, str, str]
"""Key of the study, name and written unit of a column; the unit is empty where the file does not say it."""


def _text(value: str) -> str:
    """A string as YAML reads it: JSON's quotes are YAML's."""
    return json.dumps(value, ensure_ascii=False)


def _found(key: str, column: Column) -> Found:
    return key, column.name, "" if column.source == "unknown" and not column.unit else column.unit or "1"


def _first(record: ChannelRecord, meanings: Sequence[tuple[str, str]]) -> Found | None:
    """The first column that has one of the meanings, in their order."""
    for meaning, key in meanings:
        for column in record.traits.columns:
            if column.meaning == meaning and column.name in record.channels:
                return _found(key, column)
    return None


def strain_pair(record: ChannelRecord) -> tuple[Column, Column] | None:
    """Strains along and across of a pair exx, eyy: along is the one that changes more; None where there is no such pair."""
    ends = {spoken(c.name)[-2:]: c for c in record.traits.columns if c.meaning in ("strain", "true_strain") and c.name in record.channels}
    if "xx" not in ends or "yy" not in ends:
        return None
    x, y = (record.channels[ends[end].name] for end in ("xx", "yy"))
    if not (np.isfinite(x).any() and np.isfinite(y).any()):
        return None
    wide = np.nanmax(np.abs(x)) > np.nanmax(np.abs(y))
    return (ends["xx"], ends["yy"]) if wide else (ends["yy"], ends["xx"])


def _beside(
    record: ChannelRecord, meanings: Sequence[tuple[str, str]], others: Mapping[str, ChannelRecord]
) -> tuple[Found | None, ChannelRecord, str]:
    """A column of the record, else one of another test of the file; with its record, and what names that test in a source."""
    if (found := _first(record, meanings)) is not None:
        return found, record, ""
    for name, other in others.items():
        if (found := _first(other, meanings)) is not None:
            return found, other, f", test: {_text(name)}"
    return None, record, ""


def record_body(
    record: ChannelRecord, tension: str = "", others: Mapping[str, ChannelRecord] | None = None, steady: Collection[str] = frozenset()
) -> list[str]:
    """Lines of an entry of `coupon.records` behind its file.

    `tension` is "negative" where the signs say so; in `others`, the other tests of the file, a channel may lie beside another clock.
    Columns that are `steady` within each test of a long table are no channels.
    """
    others = others or {}
    time = _first(record, _TIMES)
    pair = strain_pair(record)
    strain, strain_of, strain_test = _beside(record, _STRAINS, others)
    stress, stress_of, stress_test = _beside(record, _STRESSES, others)
    temperature, _, temperature_test = _beside(record, (("temperature", "temperature"),), others)
    lateral = _first(record, _LATERALS)
    if pair is not None:
        kinds = {"strain": "column", "true_strain": "true_strain"}
        strain, lateral = (_found(kinds[column.meaning], column) for column in pair)
    lines = []
    if time:
        lines.append(f"time: {_source(time[1], time[2])}")
    elif "rate" in record.about:
        lines.append(f"rate: {record.about['rate']:g}     # 1/s, from the header: the file has no time")
    else:
        lines.append("rate:                 # 1/s: the file has no time; or sampling_rate: (rows per second)")
    if strain is None and (moved := _first(record, (("displacement", "extension"),))) is not None:
        strain = moved
        lines.append("# the strain is from a displacement, in which the machine may give way: an extension of the gauge length is better")
    if pair is not None:
        lines.append(f"# {pair[0].name} changes more than {pair[1].name} and is taken as the one along the load: check it")
    numbered = _numbered(record)
    lines.append(f"strain: {_strain(strain_of, strain, strain_test)}" if strain else f"strain:               # {_unnamed(numbered)}")
    lines.append(f"stress: {_stress(stress_of, stress, stress_test)}" if stress else f"stress:               # {_unnamed(numbered)}")
    if lateral:
        lines.append(f"lateral: {_lateral(record, lateral)}")
    if temperature and temperature[1] in steady:
        known = f"# the initial temperature of each test is that of its rows of {_text(temperature[1])}"
        lines.append(known if temperature[2] else "initial_temperature_degC:   # fill in, see `each`: the file does not say the unit")
    elif temperature and "temperature" not in record.about:
        source = _source(temperature[1], temperature[2])
        shown = f"{{column: {_text(temperature[1])}{_unit(temperature[2])}{temperature_test}}}" if temperature_test else source
        lines.append(f"temperature: {shown}")
    elif "temperature" not in record.about:
        lines.append("initial_temperature_degC:   # fill in: the file does not say it")
    if tension:
        lines.append(f"tension: {tension}     # suspected from the signs, check it")
    return lines


def _numbered(record: ChannelRecord) -> str:
    """Columns of a table without known names, with their range."""
    shown = []
    for k, column in enumerate(record.traits.columns[:_MOST_SHOWN], start=1):
        values = record.channels.get(column.name)
        if values is not None and np.isfinite(values).any():
            shown.append(f"{k} ({np.nanmin(values):.4g} to {np.nanmax(values):.4g})")
    return ", ".join(shown)


def _unnamed(numbered: str) -> str:
    return f"no column was recognised: give its name or number of {numbered}"


def coupon_lines(
    record: ChannelRecord,
    test: str = "",
    tension: str = "",
    others: Mapping[str, ChannelRecord] | None = None,
    below: Mapping[str, Sequence[str]] | None = None,
    telling: Collection[str] = (),
) -> str:
    """Section `coupon` of a study on one record, or on each test of a long table.

    `below` are the columns that hold one value within each of these tests, with these values, and those in `telling` tell the tests apart.
    """
    if not record.channels:
        return ""
    body = record_body(record, tension, others, below or {})
    path = _text(str(record.traits.path.absolute()))
    if below:
        each = [f"        {_text(f'where.{name}')}: [{', '.join(below[name])}]" for name in telling]
        each += [f"        # {key}: [{', '.join(below[name])}]     # {_text(name)}: say the unit" for name, key in _silent(record, below)]
        return "\n".join(["coupon:", "  series:", f"    - files: {path}", "      each:", *each, *(f"      {line}" for line in body)])
    named = [f"test: {_text(test)}"] if test else []
    return "\n".join(["coupon:", "  records:", f"    - file: {path}", *(f"      {line}" for line in (*named, *body))])


def _silent(record: ChannelRecord, below: Mapping[str, Sequence[str]]) -> list[tuple[str, str]]:
    """Columns of a temperature or rate of each test whose unit the file does not say, with the key of `each` that they may be."""
    keys = {"temperature": "temperature_degC", "rate": "rate"}
    return [(c.name, keys[c.meaning]) for c in record.traits.columns if c.name in below and c.meaning in keys and not c.unit]


def series_lines(record: ChannelRecord, folder: Path, pattern: str) -> str:
    """Section `coupon` of a study on all files of a pattern, whose first is the record."""
    said = "# {temperature_degC}, {rate} and the like instead of * read what the names say"
    whole = re.sub(r"[0-9]*\*[0-9]*", "*", pattern)  # no part of a number
    body = (f"      {line}" for line in record_body(record))
    return "\n".join(["coupon:", "  series:", f"    - files: {_text(str(folder.absolute() / whole))}     {said}", *body])


def joined_lines(sections: Sequence[str]) -> str:
    """Suggestions below each other; series of records become entries of one section, the last one."""
    head = "coupon:\n  series:\n"
    series = [text.removeprefix(head) for text in sections if text.startswith(head)]
    others = [text for text in sections if not text.startswith(head)]
    return "\n".join([*others, *([head + "\n".join(series)] if series else [])])


def _source(name: str, unit: str) -> str:
    """A column with its unit, which the user must give where the file does not."""
    return _text(name) if unit else f"{{column: {_text(name)}, unit: }}   # the file does not say the unit"


def _strain(record: ChannelRecord, found: Found, test: str = "") -> str:
    key, name, unit = found
    if key == "extension":
        length = record.about.get("gauge_length")
        tail = "" if length is not None else ", gauge_length: }   # mm: fill in"
        return f"{{extension: {_text(name)}{_unit(unit)}{test}" + (f", gauge_length: {length:g}}}" if length is not None else tail)
    return _text(name) if key == "column" and unit and not test else f"{{{key}: {_text(name)}{_unit(unit)}{test}}}"


def _stress(record: ChannelRecord, found: Found, test: str = "") -> str:
    key, name, unit = found
    if key == "force":
        for about in ("area", "diameter"):
            if about in record.about:
                return f"{{force: {_text(name)}{_unit(unit)}{test}, {about}: {record.about[about]:g}}}"
        if "width" in record.about and "thickness" in record.about:
            width, thickness = (record.about[about] for about in ("width", "thickness"))
            return f"{{force: {_text(name)}{_unit(unit)}{test}, width: {width:g}, thickness: {thickness:g}}}"
        return f"{{force: {_text(name)}{_unit(unit)}{test}, area: }}   # mm^2: fill in"
    return _text(name) if key == "column" and unit and not test else f"{{{key}: {_text(name)}{_unit(unit)}{test}}}"


def _lateral(record: ChannelRecord, found: Found) -> str:
    key, name, unit = found
    if key != "extension":
        return _text(name) if key == "column" and unit else f"{{{key}: {_text(name)}{_unit(unit)}}}"
    width = record.about.get("width", record.about.get("diameter"))
    return f"{{extension: {_text(name)}{_unit(unit)}, width: " + (f"{width:g}}}" if width is not None else "}   # mm: fill in")


def _unit(unit: str) -> str:
    return "" if unit else ", unit: "


def dic_lines(stage: DicStage, folder: Path, pattern: str) -> str:
    """Section `dic` of an experiment.yaml on the files of a pattern, read as `stage`: what the files do not say is left to fill in."""
    lines = ["dic:", f"  files: {_text(str(folder.absolute() / pattern))}", "  side:                 # front or back of the sheet"]
    if stage.length_unit == "px":
        lines += ["  mm_per_pixel:         # the files are in px", "  axes: {y: -y}         # y of an image points down; check it"]
    elif not stage.length_unit:
        lines.append("  unit:                 # the files do not say the unit of length")
    if stage.time is None:
        lines.append("  rate:                 # 1/s, or times: [..] in s: the files have no times")
    return "\n".join(lines)


def ir_lines(frames: ThermalFrames, folder: Path, pattern: str) -> str:
    """Section `ir` of an experiment.yaml on the files of a pattern; nothing where the frames are no temperatures."""
    if frames.unit not in ("K", ""):
        return ""
    lines = ["ir:", f"  files: {_text(str(folder.absolute() / pattern))}", "  side:                 # front or back of the sheet"]
    if not frames.unit:
        lines.append("  unit:                 # degC or K: the files do not say it")
    if frames.time is None and not frames.date:
        lines.append("  rate:                 # 1/s, or times: [..] in s: the files have no times")
    return "\n".join(lines)


def field_lines(content: Content, folder: Path, pattern: str) -> str:
    """Lines of an experiment.yaml on a full field; nothing for anything else."""
    if isinstance(content, DicSequence):
        return dic_lines(content.stages[0], folder, pattern)
    if isinstance(content, DicStage):
        return dic_lines(content, folder, pattern)
    return ir_lines(content, folder, pattern) if isinstance(content, ThermalFrames) else ""
