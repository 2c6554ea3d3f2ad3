"""`experiment.yaml` of a raw experiment folder: specimen, temperatures, where the records lie, landmarks of the infrared image."""

from __future__ import annotations

import difflib
import math
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from thermofit.core.errors import DataError
from thermofit.core.experiment import CELSIUS, Landmarks, Specimen
from thermofit.core.units import known_unit
from thermofit.read.formats.clock import Rules
from thermofit.read.raw_text import read_lines, shorten

DESCRIPTION = "experiment.yaml"

_SPECIMEN_KEYS = {
    "gauge_width": "gauge_width_mm",
    "thickness": "thickness_mm",
    "parallel_length": "parallel_length_mm",
    "shoulder_radius": "shoulder_radius_mm",
    "grip_width": "grip_width_mm",
    "total_length": "total_length_mm",
    "gripped_length": "gripped_length_each_end_mm",
}
_KNOWN = frozenset(
    (
        *_SPECIMEN_KEYS.values(),
        *("specimen", "temperatures", "time", "force", "dic", "ir", "programme", "theta_air_degC", "theta_clamp_degC", "file", "folder"),
        *("unit", "side", "stages", "frames", "image_shape", "landmarks_frame", "landmarks", "length", "length_mm", "edge_left"),
        *("edge_right", "circle", "p1", "p2", "p3"),
        *("files", "mm_per_pixel", "times", "rate", "time_offset_s", "axes", "origin_mm", "coordinates_of"),
    )
)
"""All keys that are read: none of them is another one misspelt."""


@dataclass(frozen=True)
class FieldSource:
    """Where a full field lies: `folder`, `side` ("front" or "back"), `count` of files as declared, or None.

    `files` is the pattern of native exports that are read instead of the folder, by `rules`; None where there are none.
    """

    folder: Path
    side: str
    count: int | None
    files: Path | None = None
    rules: Rules = Rules()


@dataclass(frozen=True)
class Description:
    """Content of `experiment.yaml`: mm, K. `dic` and `ir` are None where the file does not declare them.

    `image_shape` (rows, columns) and `landmarks` are None where not declared.
    """

    folder: Path
    specimen: Specimen
    theta_air: float
    theta_clamp: float
    force_file: Path
    dic: FieldSource | None
    ir: FieldSource | None
    image_shape: tuple[int, int] | None
    landmarks: Landmarks | None
    programme: tuple[str, ...]


@dataclass(frozen=True)
class _Section:
    """A mapping of the file and its dotted name, for messages."""

    path: Path
    name: str
    content: dict[Any, Any]

    def at(self, key: str) -> str:
        return f"{self.path}: key '{self.name}.{key}'" if self.name else f"{self.path}: key '{key}'"


class _Loader(yaml.SafeLoader):
    """YAML that refuses a key given twice: plain YAML keeps the last one without a word."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(None, None, f"the key '{key.value}' is given twice", key.start_mark)
                seen.add(key.value)
        return super().construct_mapping(node, deep=deep)


def _load(path: Path) -> dict[Any, Any]:
    """The file as nested dictionaries."""
    text = "\n".join(read_lines(path, "the description of the experiment"))
    try:
        tree = yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f", line {mark.line + 1}" if mark else ""
        raise DataError(f"{path}{where}: {error.problem or 'not valid YAML'}; correct the line") from None
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError, AttributeError) as error:
        # Dates and integers that cannot be made fail inside the loader with plain Python errors.
        raise DataError(f"{path}: not valid YAML ({' '.join(str(error).split())[:120]}); correct the file") from None
    if not isinstance(tree, dict):
        raise DataError(f"{path}: found {shorten(tree)}, expected keys such as 'specimen:' and 'temperatures:'; see the raw format")
    return tree


def _misspelt(section: _Section, key: str, likeness: float) -> str | None:
    """A key of the section that looks like the missing `key` and is not known itself."""
    names = {str(name).lower(): str(name) for name in section.content if name not in _KNOWN}
    close = difflib.get_close_matches(key.lower(), names, n=1, cutoff=likeness)
    return names[close[0]] if close else None


def _optional(section: _Section, key: str) -> Any:
    """Value of a key that may be absent; DataError where a key of nearly this name stands in its place."""
    value = section.content.get(key)
    if value is None and key not in section.content and (found := _misspelt(section, key, 0.8)):
        raise DataError(f"{section.at(found)} is not known; did you mean '{key}'?{_other_unit(found, key)}")
    return value


def _other_unit(found: str, key: str) -> str:
    """What to do with the value of a key that is named as another one but for its unit; empty where it is no matter of units."""
    (quantity, _, unit), (wanted, _, fixed) = found.rpartition("_"), key.rpartition("_")
    if quantity != wanted or known_unit(unit) is None or known_unit(fixed) is None:
        return ""
    return f" convert the value from {unit} to {fixed}"


def _required(section: _Section, key: str) -> Any:
    """Value of a key that must be there."""
    value = section.content.get(key)
    if value is None:
        if key in section.content:
            raise DataError(f"{section.at(key)} is empty; give its value")
        found = _misspelt(section, key, 0.6)
        other = _other_unit(found, key) if found else ""
        mend = f"{other} and name it '{key}'" if other else " correct the name, and convert the value where its unit is another one"
        hint = f"found '{found}' instead:{mend}" if found else "add it, see the raw format"
        raise DataError(f"{section.at(key)} is missing; {hint}")
    return value


def _as_section(section: _Section, key: str, value: Any) -> _Section:
    """A value as the section that it must be."""
    if not isinstance(value, dict):
        raise DataError(f"{section.at(key)} is {shorten(value)}; expected a section of keys")
    return _Section(section.path, f"{section.name}.{key}" if section.name else key, value)


def _finite(value: Any) -> float | None:
    """A finite number, else None. YAML 1.1 reads 1e-3 as a text, so that texts are tried too; true and false are no numbers."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def _number(section: _Section, key: str, above: float) -> float:
    """A finite number larger than `above`."""
    value = _required(section, key)
    number = _finite(value)
    if number is None or number <= above:
        raise DataError(f"{section.at(key)} is {shorten(value)}; expected a number above {above:g}")
    return number


def _count(section: _Section, key: str) -> int | None:
    """A declared number of files, if any."""
    value = _optional(section, key)
    if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < 1):
        raise DataError(f"{section.at(key)} is {shorten(value)}; expected a whole number of at least 1")
    return value


def _text(section: _Section, key: str, default: str | None) -> str:
    """A text; required where there is no default."""
    value = _required(section, key) if default is None else _optional(section, key)
    value = default if value is None else value
    if not isinstance(value, str) or not value.strip():
        raise DataError(f"{section.at(key)} is {shorten(value)}; expected a text")
    return value.strip()


def _child(section: _Section, key: str, default: str) -> Path:
    """Path of a file or folder inside the experiment's folder."""
    text = _text(section, key, default)
    path = section.path.parent / text
    try:
        path.stat()
    except FileNotFoundError:
        return path  # said where it is read, with what it should hold
    except (OSError, ValueError):
        raise DataError(f"{section.at(key)} is {shorten(text)}; expected the name of a file or folder in {section.path.parent}") from None
    return path


def _word(section: _Section, key: str, allowed: tuple[str, ...], default: str | None = None) -> str:
    """The first word of a text, which must be one of `allowed` (what follows explains it)."""
    text = _text(section, key, default)
    word = text.split()[0].rstrip(",:;")
    if word not in allowed:
        raise DataError(f"{section.at(key)} is {shorten(text)}; expected {' or '.join(allowed)}")
    return word


def _specimen(top: _Section) -> Specimen:
    """All lengths positive; the shape is checked where a mesh is made of it."""
    section = _as_section(top, "specimen", _required(top, "specimen"))
    specimen = Specimen(**{name: _number(section, key, 0.0) for name, key in _SPECIMEN_KEYS.items()})
    pairs = (("gauge_width", "grip_width", 1.0), ("parallel_length", "total_length", 1.0), ("gripped_length", "total_length", 2.0))
    for small, large, factor in pairs:
        if factor * getattr(specimen, small) > getattr(specimen, large):
            raise DataError(
                f"{section.at(_SPECIMEN_KEYS[small])} is {getattr(specimen, small):g} mm but {_SPECIMEN_KEYS[large]} only "
                f"{getattr(specimen, large):g} mm; correct one of them"
            )
    return specimen


def _points(section: _Section, key: str, n: int) -> np.ndarray:
    """Pixels (n, 2) as (row, col) from the keys p1 ... pn."""
    group = _as_section(section, key, _required(section, key))
    points = []
    for name in (f"p{i + 1}" for i in range(n)):
        value = _required(group, name)
        pair = [_finite(v) for v in value] if isinstance(value, list) else []
        if len(pair) != 2 or None in pair:
            raise DataError(f"{group.at(name)} is {shorten(value)}; expected a pixel [row, col]")
        points.append(pair)
    return np.array(points, dtype=float)


def _landmarks(ir: _Section) -> Landmarks | None:
    """Landmarks of the infrared image, if declared."""
    value = _optional(ir, "landmarks")
    if value is None:
        return None
    section = _as_section(ir, "landmarks", value)
    frame = _optional(ir, "landmarks_frame")
    frame = 0 if frame is None else frame
    if isinstance(frame, bool) or not isinstance(frame, int) or frame < 0:
        raise DataError(f"{ir.at('landmarks_frame')} is {shorten(frame)}; expected the number of a frame, counted from 0")
    length = _points(section, "length", 2)
    length_mm = _number(_as_section(section, "length", section.content["length"]), "length_mm", 0.0)
    right = _points(section, "edge_right", 1)[0]
    return Landmarks(frame, length, length_mm, _points(section, "edge_left", 2), right, _points(section, "circle", 3))


def _image_shape(ir: _Section) -> tuple[int, int] | None:
    """Declared (rows, columns), if any."""
    value = _optional(ir, "image_shape")
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 2 or any(isinstance(v, bool) or not isinstance(v, int) or v < 1 for v in value):
        raise DataError(f"{ir.at('image_shape')} is {shorten(value)}; expected [rows, columns]")
    return value[0], value[1]


def _optional_number(section: _Section, key: str, above: float = -math.inf) -> float | None:
    """A finite number larger than `above`, None where the key is absent."""
    return None if _optional(section, key) is None else _number(section, key, above)


def _numbers(section: _Section, key: str, n: int | None = None) -> tuple[float, ...]:
    """A list of finite numbers, of length `n` where it is given; empty where the key is absent."""
    value = _optional(section, key)
    found = [_finite(number) for number in value] if isinstance(value, list) else []
    if value is not None and (not found or None in found or (n is not None and len(found) != n)):
        raise DataError(f"{section.at(key)} is {shorten(value)}; expected a list of {n or 'the'} numbers")
    return tuple(number for number in found if number is not None)


def _axes(section: _Section) -> tuple[str, str, str]:
    """Axis of the file, with sign, for each axis of the specimen; x, y, z where the section does not say."""
    value = _optional(section, "axes")
    if value is None:
        return ("x", "y", "z")
    group = _as_section(section, "axes", value)
    axes = [str(group.content.get(name, name)) for name in "xyz"]
    if set(group.content) - set("xyz") or sorted(axis.lstrip("+-") for axis in axes) != ["x", "y", "z"] or any(len(a) > 2 for a in axes):
        raise DataError(f"{section.at('axes')} is {shorten(value)}; expected x, y and z of the file, each once, such as {{x: y, y: -x}}")
    return (axes[0], axes[1], axes[2])


def _native(section: _Section) -> tuple[Path | None, Rules]:
    """Pattern of native exports inside the folder, and what the section says of them; None where it names a folder instead."""
    if _optional(section, "files") is None:
        told = [key for key in ("mm_per_pixel", "origin_mm", "coordinates_of") if section.content.get(key) is not None]
        if told:
            raise DataError(f"{section.at(told[0])} is for native exports; add 'files', such as files: exports/*.csv, or remove it")
        return None, Rules()
    if section.content.get("folder") is not None:
        raise DataError(f"{section.at('files')} is given besides 'folder'; keep one of them")
    text = _text(section, "files", None)
    pattern = Path(text)
    if pattern.is_absolute() or ".." in pattern.parts:
        raise DataError(f"{section.at('files')} is {shorten(text)}; expected files inside {section.path.parent}: put or link them there")
    origin = _numbers(section, "origin_mm", 3) or (0.0, 0.0, 0.0)
    coordinates = _optional(section, "coordinates_of")
    if coordinates is not None:
        coordinates = _word(section, "coordinates_of", ("reference", "deformed"))
    return section.path.parent / pattern, Rules(
        "" if _optional(section, "unit") is None else _text(section, "unit", None),
        _optional_number(section, "mm_per_pixel", 0.0),
        _numbers(section, "times"),
        _optional_number(section, "rate", 0.0),
        _optional_number(section, "time_offset_s") or 0.0,
        _axes(section),
        (origin[0], origin[1], origin[2]),
        coordinates or "",
    )


def _source(section: _Section, name: str, side: str | None, count: str) -> FieldSource:
    """Where a field lies: its folder, or native exports."""
    files, rules = _native(section)
    sides = _word(section, "side", ("front", "back"), side)
    return FieldSource(_child(section, "folder", name), sides, _count(section, count), files, rules)


def read_description(folder: Path) -> Description:
    """Read `experiment.yaml` of a raw folder; DataError for a missing folder, file or key, a wrong unit or type."""
    folder = Path(folder)
    if not folder.is_dir():
        raise DataError(f"{folder}: the folder of the experiment does not exist; correct the path")
    path = folder / DESCRIPTION
    top = _Section(path, "", _load(path))
    if (time := _optional(top, "time")) is not None:
        _word(_as_section(top, "time", time), "unit", ("s",), "s")
    temperatures = _as_section(top, "temperatures", _required(top, "temperatures"))
    force = _as_section(top, "force", _required(top, "force"))
    dic, ir, image_shape, landmarks = None, None, None, None
    if (value := _optional(top, "dic")) is not None:
        dic = _source(_as_section(top, "dic", value), "dic", "front", "stages")
    if (value := _optional(top, "ir")) is not None:
        section = _as_section(top, "ir", value)
        ir = _source(section, "ir", None, "frames")
        if ir.files is None:
            _word(section, "unit", ("degC",))
        image_shape, landmarks = _image_shape(section), _landmarks(section)
    programme = _optional(top, "programme")
    if programme is not None and not isinstance(programme, list):
        raise DataError(f"{top.at('programme')} is {shorten(programme)}; expected a list of texts, one for each phase")
    return Description(
        folder,
        _specimen(top),
        _number(temperatures, "theta_air_degC", -CELSIUS) + CELSIUS,
        _number(temperatures, "theta_clamp_degC", -CELSIUS) + CELSIUS,
        _child(force, "file", "force.csv"),
        dic,
        ir,
        image_shape,
        landmarks,
        tuple(str(line) for line in programme or ()),
    )
