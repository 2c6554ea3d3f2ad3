"""A first `experiment.yaml` for a folder of measured files: what was found in it, and what a person must fill in."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import CELSIUS
from thermofit.core.files import replacing
from thermofit.core.yaml_text import parse_yaml
from thermofit.read.file_groups import FORCE, FRAME, STAGE, FileGroup, group_files, visible_files
from thermofit.read.formats.contents import ChannelRecord, Content, DicSequence, DicStage, Records, ThermalFrames
from thermofit.read.formats.registry import read_native
from thermofit.read.look_record import channel_of, time_channel
from thermofit.read.raw_description import DESCRIPTION, SpecimenKeys, Temperatures
from thermofit.read.study_lines import field_lines
from thermofit.study.materials import class_of

_MEANING = {
    "gauge_width_mm": "width of the parallel length",
    "thickness_mm": "",
    "parallel_length_mm": "between the shoulders",
    "shoulder_radius_mm": "",
    "grip_width_mm": "width of the heads",
    "total_length_mm": "",
    "gripped_length_each_end_mm": "what one jaw holds",
    "theta_air_degC": "room",
    "theta_clamp_degC": "jaws, before the test",
}
_FILL = "# fill in"


@dataclass(frozen=True)
class Described:
    """What was written: the `file`, what was `found`, and the keys that are `missing` and must be filled in."""

    file: Path
    found: tuple[str, ...]
    missing: tuple[str, ...]


def describe(folder: Path) -> Described:
    """Write `experiment.yaml` into a folder that has none, and `force.csv` where only a record of the testing machine holds the force.

    DataError where the folder holds neither displacements nor a force, or more than one candidate for either.
    """
    if not folder.is_dir():
        raise DataError(f"{folder}: the folder does not exist; name the one that holds the files of the test")
    groups = group_files(visible_files(folder))
    contents = {id(group): _content(group) for group in groups}
    force, found_force = _force(folder, groups, contents)
    fields = [_field(folder, groups, contents, "dic"), _field(folder, groups, contents, "ir")]
    if not any(text for text, _ in fields) and not found_force:
        raise DataError(f"{folder}: neither displacements nor a force were recognised in it; `thermofit inspect {folder}` lists its files")
    lines = [
        "# Written by `thermofit new --raw` from the files beside it. Fill in what is marked, then look again: `thermofit inspect`.",
        "specimen:                             # mm; DIN 50125-H, as measured on this specimen",
        f"{'  material:':<38}# a note, such as: steel sheet DC04",
        *(_key(key) for key in SpecimenKeys.model_fields),
        "temperatures:                         # degC, thermocouples before the test",
        *(_key(key, _shown(contents.values()) if key == "theta_air_degC" else "") for key in Temperatures.model_fields),
        *force,
        *(line for text, _ in fields for line in text),
    ]
    text = "\n".join(lines) + "\n"
    path = folder / DESCRIPTION
    with replacing(path, durable=False) as temporary:
        temporary.write_text(text, encoding="utf-8")
    missing = tuple(line.split(":")[0].strip() for line in lines if _FILL in line and not line.startswith("#"))
    return Described(path, (*found_force, *(said for _, said in fields if said)), missing)


def _key(key: str, also: str = "") -> str:
    words = "; ".join(word for word in (_MEANING.get(key, ""), also) if word)
    return f"{f'  {key}:':<38}{_FILL}{f': {words}' if words else ''}"


def _content(group: FileGroup) -> Content | None:
    """Content of the first file of a native group that can be read."""
    if not group.native:
        return None
    try:
        return read_native(group.paths[0])
    except DataError:
        return None


def _shown(contents: Iterable[Content | None]) -> str:
    """What the first infrared frame shows, in words."""
    for content in contents:
        if isinstance(content, ThermalFrames) and content.unit == "K":
            return f"the first frame shows {float(np.nanmedian(content.values[0])) - CELSIUS:.1f} degC"
    return ""


def _own(folder: Path, groups: list[FileGroup], known: str) -> list[FileGroup]:
    return [group for group in groups if group.format == known]


def _one(folder: Path, found: list[FileGroup], what: str) -> FileGroup | None:
    """The only group, None where there is none. DataError where there are several."""
    if len(found) > 1:
        names = ", ".join(str(group.folder.relative_to(folder) / group.pattern) for group in found[:4])
        raise DataError(f"{folder}: {len(found)} groups of files hold {what} ({names}); keep those of one test in the folder")
    return found[0] if found else None


def _force(folder: Path, groups: list[FileGroup], contents: dict[int, Content | None]) -> tuple[list[str], list[str]]:
    """Section `force`, and what was found, in words."""
    own = _one(folder, _own(folder, groups, FORCE.format), "a force record")
    if own is not None:
        name = own.paths[0].relative_to(folder).as_posix()
        return [f"force: {{file: {name}}}"], [f"force record {name}"]
    records = [(group, record) for group in groups for record in _records(contents[id(group)])]
    usable = [(group, record) for group, record in records if channel_of(record, "force") and time_channel(record)]
    if not usable:
        return ["force:", f"{'  file: force.csv':<38}{_FILL}: no record of time and force was recognised; columns time_s,force_N"], []
    if len(usable) > 1:
        names = ", ".join(record.traits.path.name for _, record in usable[:4])
        raise DataError(f"{folder}: {len(usable)} records hold a force ({names}); keep that of one test in the folder")
    ((_, record),) = usable
    written = _write_force(folder / "force.csv", record)
    source = record.traits.path.relative_to(folder).as_posix()
    return [f"force: {{file: force.csv}}            # from {source}, columns {written}"], [f"force.csv written from {source} ({written})"]


def _records(content: Content | None) -> Iterator[ChannelRecord]:
    if isinstance(content, ChannelRecord):
        yield content
    elif isinstance(content, Records):
        yield from content.tests.values()


def _write_force(path: Path, record: ChannelRecord) -> str:
    """Time, force and, where there is one, the crosshead of a record in s, N, mm. DataError where a unit is not known."""
    time, force, travel = time_channel(record), channel_of(record, "force"), channel_of(record, "displacement")
    assert time is not None and force is not None
    for name, unit in ((time, "s"), (force, "N")):
        if record.units.get(name) != unit:
            raise DataError(
                f"{record.traits.path}: the unit of column '{name}' is not written in the file; copy time and force to force.csv with the "
                "header time_s,force_N (or time_ms, force_kN), and try again"
            )
    names = [time, force, *([travel] if travel is not None and record.units.get(travel) == "mm" else [])]
    table = np.column_stack([record.channels[name] for name in names])
    table = table[np.isfinite(table).all(axis=1)]
    table = table[np.concatenate([[True], table[1:, 0] > np.maximum.accumulate(table[:, 0])[:-1]])]
    head = ",".join(("time_s", "force_N", "crosshead_mm")[: len(names)])
    if path.exists():
        raise DataError(f"{path}: the file is there but is no force record of thermofit; rename it, or give it the header {head}")
    np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.9g")
    return ", ".join(f"'{name}'" for name in names)


def _field(folder: Path, groups: list[FileGroup], contents: dict[int, Content | None], name: str) -> tuple[list[str], str]:
    """Section `dic` or `ir`, and what was found, in words; nothing where there is no such field."""
    kinds = (DicStage, DicSequence) if name == "dic" else (ThermalFrames,)
    word = "DIC stages" if name == "dic" else "infrared frames"
    own = _own(folder, groups, (STAGE if name == "dic" else FRAME).format)
    native = [group for group in groups if isinstance(contents[id(group)], kinds)]
    group = _one(folder, [*own, *native], word)
    if group is None:
        return [], ""
    place = group.folder.relative_to(folder).as_posix()
    count = f"{len(group.paths)} {word}"
    if not group.native:
        side = "front" if name == "dic" else "back"
        unit = ["  unit: degC"] if name == "ir" else []
        check = f"{f'  side: {side}':<38}# of the sheet: front or back, check it"
        return [f"{name}:", f"  folder: {place}", *unit, check], f"{count} in {place}/"
    content = contents[id(group)]
    assert content is not None
    text = field_lines(content, group.folder, group.pattern).replace(f"{folder.absolute()}/", "")
    lines = [line.replace("#", f"{_FILL}:", 1) if line.split("#")[0].rstrip().endswith(":") else line for line in text.splitlines()]
    return lines, f"{count}, {group.format}, in {place}/{group.pattern}"


def material_of(folder: Path) -> str:
    """The class of metals that a note `material` of the experiment names (`specimen.material` or `material`); empty where none does."""
    try:
        tree = parse_yaml((folder / DESCRIPTION).read_text(encoding="utf-8"), DESCRIPTION, DataError, text_keys=False)
    except (OSError, UnicodeDecodeError, DataError):
        return ""
    notes = [tree, tree.get("specimen")] if isinstance(tree, dict) else []
    return next((found for note in notes if isinstance(note, dict) and (found := class_of(str(note.get("material", ""))))), "")
