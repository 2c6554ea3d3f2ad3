"""Lines to start a study or an experiment.yaml from, as YAML. What the file does not say is left as a comment to fill in, not guessed."""

from __future__ import annotations

import json
from pathlib import Path

from thermofit.measure.formats.contents import Content, DicSequence, DicStage, Record, ThermalFrames

_STRAINS = (("strain", "column"), ("true_strain", "true_strain"), ("extension", "extension"))
_STRESSES = (("stress", "column"), ("true_stress", "true_stress"), ("force", "force"))


def _text(value: str) -> str:
    """A string as YAML reads it: JSON's quotes are YAML's."""
    return json.dumps(value, ensure_ascii=False)


def _first(record: Record, meanings: tuple[tuple[str, str], ...]) -> tuple[str, str, str] | None:
    """Key of the study, name and written unit of the first column that has one of the meanings, in their order."""
    for meaning, key in meanings:
        for column in record.traits.columns:
            if column.meaning == meaning and column.name in record.channels:
                return key, column.name, "" if column.source == "unknown" and not column.unit else column.unit or "1"
    return None


def coupon_lines(record: Record, test: str = "", tension: str = "") -> str:
    """Section `coupon` of a study on one record. `tension` is "negative" where the signs say so."""
    time = _first(record, (("time", "time"),))
    strain, stress = _first(record, _STRAINS), _first(record, _STRESSES)
    temperature = _first(record, (("temperature", "temperature"),))
    if strain is None and stress is None:
        return ""
    lines = ["coupon:", "  records:", f"    - file: {_text(str(record.traits.path.absolute()))}"]
    if test:
        lines.append(f"      test: {_text(test)}")
    lines.append(f"      time: {_source(time[1], time[2])}" if time else "      rate:                 # 1/s: the file has no time")
    lines.append(
        f"      strain: {_strain(record, strain)}" if strain else "      strain:               # no column was recognised: name it"
    )
    lines.append(
        f"      stress: {_stress(record, stress)}" if stress else "      stress:               # no column was recognised: name it"
    )
    if temperature:
        lines.append(f"      temperature: {_source(temperature[1], temperature[2])}")
    elif "temperature" not in record.about:
        lines.append("      initial_temperature_degC:   # fill in: the file does not say it")
    if tension:
        lines.append(f"      tension: {tension}     # suspected from the signs, check it")
    return "\n".join(lines)


def _source(name: str, unit: str) -> str:
    """A column with its unit, which the user must give where the file does not."""
    return _text(name) if unit else f"{{column: {_text(name)}, unit: }}   # the file does not say the unit"


def _strain(record: Record, found: tuple[str, str, str]) -> str:
    key, name, unit = found
    if key == "extension":
        length = record.about.get("gauge_length")
        tail = "" if length is not None else ", gauge_length: }   # mm: fill in"
        return f"{{extension: {_text(name)}{_unit(unit)}" + (f", gauge_length: {length:g}}}" if length is not None else tail)
    return _text(name) if key == "column" and unit else f"{{{key}: {_text(name)}{_unit(unit)}}}"


def _stress(record: Record, found: tuple[str, str, str]) -> str:
    key, name, unit = found
    if key == "force":
        for about in ("diameter", "area"):
            if about in record.about:
                return f"{{force: {_text(name)}{_unit(unit)}, {about}: {record.about[about]:g}}}"
        return f"{{force: {_text(name)}{_unit(unit)}, area: }}   # mm^2: fill in"
    return _text(name) if key == "column" and unit else f"{{{key}: {_text(name)}{_unit(unit)}}}"


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
