"""Files of a folder by format and sequence: one group is what one line of `inspect FOLDER` says. What is no native export is recognised."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from thermofit.core.errors import DataError
from thermofit.core.yaml_text import parse_yaml
from thermofit.read.formats.contents import Head
from thermofit.read.formats.naming import number_order
from thermofit.read.formats.registry import head_of, recogniser
from thermofit.read.formats.text import head_lines
from thermofit.read.raw_description import DESCRIPTION

HDF5 = b"\x89HDF\r\n\x1a\n"
_PICTURES = {b"II*\x00": "TIFF", b"MM\x00*": "TIFF", b"\x89PNG\r\n\x1a\n": "PNG", b"BM": "BMP", b"\xff\xd8\xff": "JPEG"}


@dataclass(frozen=True)
class Known:
    """What a file is, and what to do with it."""

    format: str
    advice: str


ARTEFACT = Known("thermofit artefact", "`thermofit show FILE` describes it")
STUDY = Known("thermofit study", "`thermofit run FILE` runs it")
EXPERIMENT = Known("thermofit experiment.yaml", "it describes a raw folder: inspect the folder")
STAGE = Known("thermofit DIC stage", "it belongs to a raw folder: inspect the folder with experiment.yaml")
FRAME = Known("thermofit infrared frame", "it belongs to a raw folder: inspect the folder with experiment.yaml")
FORCE = Known("thermofit force record", "it belongs to a raw folder: inspect the folder with experiment.yaml")


def own_file(head: Head) -> Known | None:
    """What a file of thermofit or a picture is, None for anything else."""
    for magic, name in _PICTURES.items():
        if head.first.startswith(magic):
            return Known(f"picture ({name})", "thermofit reads no pictures: correlate them with a DIC program and inspect its export")
    if head.first.startswith(HDF5) and b"thermofit" in head.first:
        return ARTEFACT
    lines = head_lines(head)
    if not lines:
        return None
    if lines[0].startswith("# time_s:"):
        return STAGE if len(lines) > 1 and lines[1].startswith("id,") else FRAME
    if lines[0].replace(" ", "").startswith("time_s,force_N"):
        return FORCE
    return _yaml(head, lines)


def _yaml(head: Head, lines: list[str]) -> Known | None:
    """A study or a description of an experiment: a YAML mapping with the keys that each must have."""
    if head.path.suffix.lower() not in (".yaml", ".yml"):
        return None
    try:
        tree = parse_yaml("\n".join(lines), str(head.path), DataError, text_keys=False)
    except DataError:
        tree = None
    keys = set(tree) if isinstance(tree, dict) else set()
    if head.path.name == DESCRIPTION or {"specimen", "temperatures"} <= keys:
        return EXPERIMENT
    return STUDY if "name" in keys and keys & {"parameters", "experiment", "simulate", "coupon"} else None


UNKNOWN = "not recognised"
_NUMBER = re.compile(r"(\d+(?:\.\d+)?)")


@dataclass(frozen=True)
class FileGroup:
    """Files of one folder and one format whose names differ by one number, in the order of that number."""

    folder: Path
    format: str
    paths: tuple[Path, ...]
    advice: str = ""
    native: bool = False

    @property
    def pattern(self) -> str:
        """The common name, with * for what differs."""
        names = [path.name for path in self.paths]
        if len(names) == 1:
            return names[0]
        start = _common([list(name) for name in names])
        end = _common([list(reversed(name[start:])) for name in names])
        return f"{names[0][:start]}*{names[0][len(names[0]) - end :] if end else ''}"


def _common(rows: Sequence[Sequence[str]]) -> int:
    """How many leading letters all rows share."""
    shortest = min(len(row) for row in rows)
    return next((k for k in range(shortest) if len({row[k] for row in rows}) > 1), shortest)


def visible_files(folder: Path) -> list[Path]:
    """All files below a folder but those whose path holds a name that starts with a dot. DataError where there is none."""
    try:
        found = sorted(path for path in folder.rglob("*") if path.is_file() and not _hidden(path.relative_to(folder)))
    except OSError as error:
        raise DataError(f"{folder}: {(error.strerror or 'cannot be read').lower()}; correct the rights of the folder") from None
    if not found:
        raise DataError(f"{folder}: no files in the folder, expected exports of a camera, a DIC system or a testing machine")
    return found


def _hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)


def group_files(paths: Iterable[Path]) -> list[FileGroup]:
    """Groups by folder, format and, for stages and frames, by sequence; in the order of folder and name."""
    by_kind: dict[tuple[Path, str, str, bool], list[Path]] = {}
    for path in paths:
        name, advice, native = _format_of(path)
        by_kind.setdefault((path.parent, name, advice, native), []).append(path)
    groups = []
    for (folder, name, advice, native), members in by_kind.items():
        for sequence in _sequences(members) if native else [members]:
            groups.append(FileGroup(folder, name, tuple(sorted(sequence, key=number_order)), advice, native))
    return sorted(groups, key=lambda group: (group.folder, group.paths[0].name))


def _format_of(path: Path) -> tuple[str, str, bool]:
    """Format of a file, advice, and whether a reader of native formats takes it."""
    try:
        head: Head = head_of(path)
    except DataError as error:
        return UNKNOWN, str(error), False
    if known := own_file(head):
        return known.format, known.advice, False
    found = recogniser(head)
    return (str(found.NAME), "", True) if found else (UNKNOWN, "", False)


def _sequences(paths: list[Path]) -> list[list[Path]]:
    """Files whose names are equal but for one number, the last one that varies; names that are equal in nothing else are one group each."""
    by_skeleton: dict[str, list[Path]] = {}
    for path in paths:
        by_skeleton.setdefault(_NUMBER.sub("#", path.name), []).append(path)
    found: list[list[Path]] = []
    for members in by_skeleton.values():
        numbers = [_NUMBER.findall(path.name) for path in members]
        varying = [k for k in range(len(numbers[0])) if len({row[k] for row in numbers}) > 1]
        last = varying[-1] if varying else 0
        split: dict[tuple[str, ...], list[Path]] = {}
        for path, row in zip(members, numbers, strict=True):
            split.setdefault(tuple(n for k, n in enumerate(row) if k != last), []).append(path)
        found += split.values()
    return found
