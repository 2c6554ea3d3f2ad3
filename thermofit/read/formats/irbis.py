"""InfraTec IRBIS: ASCII, CSV or `.asc`, one image in each file, in sections `[Settings]`, `[Parameter]`, `[MeasDefs]`, `[Data]` (last).

`DelimiterValue` and `CommaValue` are codes of characters and hold for the data only: the header may use a decimal comma besides. A
separator ends each row of some exports. The text is Latin-1 (degree sign). Lock-in results (`Content=Amplitude`, `Phase`) are no
temperatures and stay as they are, in mK or deg. Pixels out of range are clipped to the ends of `ShotRange`.
Sources: thomas-tran-de/lockinthermography, gadomski/irb-rs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.units import known_unit
from thermofit.read.formats.contents import Column, Head, ThermalFrames, Traits
from thermofit.read.formats.text import Layout, detect_layout, head_lines, parse_number, read_text
from thermofit.read.formats.thermal_rows import check_some, in_kelvin, matrix, stamp

NAME = "InfraTec IRBIS text"
_SECTION = re.compile(r"\s*\[(Settings|Parameter|Parameters|MeasDefs|Data)\]\s*", re.IGNORECASE)
_TEMPERATURE_WORDS = ("", "temperature", "temperatur", "temp", "temperatures")
_KEPT = ("Version", "Content", "TempUnit", "ShotRange", "ImageWidth", "ImageHeight", "LIT.LockInFrequency", "LIT.CameraFramerate")
_WHAT = "an IRBIS export with the sections [Settings] and [Data]"


def recognises(head: Head) -> bool:
    """Whether the first line is a section of IRBIS, and [Settings], [Parameter] or [Data] is there."""
    lines = [line for line in head_lines(head) if line.strip()]
    if not lines or not _SECTION.fullmatch(lines[0]):
        return False
    sections = {match.group(1).lower() for line in lines if (match := _SECTION.fullmatch(line))}
    return "data" in sections or "settings" in sections


def read(path: Path) -> ThermalFrames:
    """The image of the file: K for temperatures, as written for everything else. DataError for every defect."""
    text = read_text(path, _WHAT)
    header, rows = _sections(text.lines, path)
    layout = _layout(header, rows, path)
    width, height = (_size(header, key, path) for key in ("ImageWidth", "ImageHeight"))
    if height is not None and len(rows) != height:
        raise DataError(f"{path}: [Data] has {len(rows)} rows, expected {height} by ImageHeight; export or copy the file again")
    values = matrix(rows, path, layout, width)
    missing = check_some(values, path)
    remarks = [f"{missing} pixels hold no number"] if missing else []
    if width is None or height is None:
        remarks.append(f"the header does not say how large the image is: {values.shape[0]} rows of {values.shape[1]} pixels were found")
    content, unit_text = header.get("Content", "").strip(), header.get("TempUnit", "").strip()
    unit, source = _unit(content, unit_text, remarks)
    if unit == "K":
        values = in_kelvin(values, unit_text, path)
        remarks += _clipped(header.get("ShotRange", ""), values, unit_text)
    date = stamp(header.get("RecDate") or header.get("Params.Rec.Date", ""), header.get("RecTime") or header.get("Params.Rec.Time", ""))
    if not date:
        remarks.append("no time stamp found")
    kept = {key: header[key] for key in (*_KEPT, "RecDate", "RecTime", "Params.Rec.Date", "Params.Rec.Time") if key in header}
    column = Column(content or "Data", "temperature" if unit == "K" else "", unit_text, source)
    return ThermalFrames(
        traits=Traits(NAME, path, text.encoding, layout.separator, layout.decimal, (column,), missing, tuple(remarks), kept),
        values=values[np.newaxis],
        unit=unit,
        time=np.zeros(1) if date else None,
        date=date,
    )


def _sections(lines: list[str], path: Path) -> tuple[dict[str, str], list[tuple[int, str]]]:
    """`Key=Value` of the settings, and the numbered rows of data. DataError where [Data] is missing or empty."""
    header: dict[str, str] = {}
    section = ""
    for k, line in enumerate(lines):
        match = _SECTION.fullmatch(line)
        if match is None:
            key, equals, value = line.partition("=")
            # Regions are parted by tabs; a setting whose section line was lost still counts.
            if equals and (section.startswith(("settings", "parameter")) or "\t" not in line):
                header.setdefault(key.strip(), value.strip())
            continue
        section = match.group(1).lower()
        if section == "data":
            return header, [(number, row) for number, row in enumerate(lines[k + 1 :], start=k + 2) if row.strip()]
    raise DataError(f"{path}: no section [Data] found, expected {_WHAT}; export or copy the file again")


def _layout(header: Mapping[str, str], rows: list[tuple[int, str]], path: Path) -> Layout:
    """Separator and decimal sign of the data: as announced, else as found."""
    separator, decimal = (_character(header, key, path) for key in ("DelimiterValue", "CommaValue"))
    lines = [row for _, row in rows[:200]]
    if decimal is not None and decimal not in (".", ","):
        raise DataError(f"{path}: CommaValue announces {decimal!r}, expected the code of a point or a comma (0x2E, 0x2C); export it again")
    if separator is not None and separator == decimal:
        raise DataError(f"{path}: DelimiterValue and CommaValue are both {decimal!r}, expected two characters; export it again with tab")
    if not lines:
        raise DataError(f"{path}: the section [Data] is empty, expected rows of values; export or copy the file again")
    found = detect_layout(lines, path, separator)
    return Layout(found.separator, decimal or found.decimal)


def _character(header: Mapping[str, str], key: str, path: Path) -> str | None:
    """The character whose code a key holds, None where it is absent."""
    value = header.get(key)
    if value is None:
        return None
    if not re.fullmatch(r"0x[0-9A-Fa-f]{1,4}", value) or int(value, 16) not in (0x09, 0x20, 0x2C, 0x2E, 0x3B, 0x7C):
        raise DataError(f"{path}: {key} is {value[:20]!r}, expected the code of a separator such as 0x3B; correct it or export again")
    return chr(int(value, 16))


def _size(header: Mapping[str, str], key: str, path: Path) -> int | None:
    value = header.get(key)
    if value is None:
        return None
    if not re.fullmatch(r"[0-9]{1,6}", value) or int(value) == 0:
        raise DataError(f"{path}: {key} is {value[:20]!r}, expected a number of pixels; correct it or export again")
    return int(value)


def _unit(content: str, unit_text: str, remarks: list[str]) -> tuple[str, str]:
    """Unit of the values (K: they are absolute temperatures to be converted) and where it is from; what is doubtful is remarked."""
    kind, found = content.lower(), known_unit(unit_text) if unit_text else None
    if kind.startswith("phase"):
        remarks.append(f"lock-in phase in deg, no temperature{f' (TempUnit is {unit_text[:20]})' if unit_text else ''}")
        return "deg", "format"
    if kind not in _TEMPERATURE_WORDS:
        remarks.append(f"Content={content[:30]} is no temperature: values are left as they are")
        return (unit_text or "mK", "file" if unit_text else "format") if kind.startswith("amplitude") else (unit_text, "file")
    if found is None or found.quantity != "temperature":
        remarks.append(f"TempUnit is {unit_text[:20]!r}: the unit is not known, values are left as they are")
        return "", "unknown"
    if found.factor == 1e-3:
        remarks.append("values in mK are differences, no temperatures: left as they are")
        return "mK", "file"
    return "K", "file"


def _clipped(text: str, kelvin: np.ndarray, unit_text: str) -> list[str]:
    """Pixels at or beyond the ends of ShotRange. It does not name its unit: that of the image or K, whichever holds most pixels."""
    ends = [parse_number(end.strip().replace(",", "."), ".") for end in text.split(";")]
    if not text:
        return []
    if len(ends) != 2 or not ends[0] < ends[1]:
        return [f"ShotRange={text[:30]} is no range: clipped pixels cannot be counted"]
    found = known_unit(unit_text)
    ranges = {"K": np.array(ends)} | ({unit_text: (np.array(ends) + found.shift) * found.factor} if found else {})
    inside = {unit: float(np.mean((kelvin > low) & (kelvin < high))) for unit, (low, high) in ranges.items()}
    unit = max(inside, key=lambda name: inside[name])
    low, high = ranges[unit]
    if inside[unit] < 0.5:
        return [f"most pixels lie outside ShotRange={text[:30]}: clipped pixels cannot be counted"]
    count = int(np.sum((kelvin <= low) | (kelvin >= high)))
    return [f"{count} pixels lie at or beyond the ends of ShotRange={text[:30]} {unit}: suspected clipped"] if count else []
