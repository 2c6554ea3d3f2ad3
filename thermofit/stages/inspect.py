"""`inspect`: what is this file or folder? Format, units, points, gaps, noise, suspicions, and lines to start a study from."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from thermofit.core.errors import DataError
from thermofit.core.jsonable import jsonable
from thermofit.read.file_groups import ARTEFACT, FRAME, STAGE, UNKNOWN, FileGroup, Known, group_files, own_file, visible_files
from thermofit.read.formats.registry import head_of, read_native
from thermofit.read.formats.text import SEPARATOR_WORDS
from thermofit.read.look import look_at, look_at_group, look_at_raw
from thermofit.read.look_record import Part
from thermofit.read.raw_description import DESCRIPTION
from thermofit.read.study_lines import field_lines, joined_lines
from thermofit.records.artefact import open_record

NAME = "inspect"


def inspect(path: Path) -> dict[str, Any]:
    """Describe a file or folder: `format`, `units`, `points`, `missing`, `parts` or `groups`, `remarks`, `suggestion`, `verdict`.

    DataError, with the first line quoted, where nothing is recognised, and for every defect of a recognised file.
    """
    if not path.exists():
        raise DataError(f"{path}: no such file or folder; correct its name")
    if path.is_dir():
        return _raw_folder(path) if (path / DESCRIPTION).is_file() else _folder(path)
    if not os.access(path, os.R_OK) or not path.is_file():
        raise DataError(f"{path}: cannot be read, expected a regular file; correct its rights or name another")
    head = head_of(path)
    known = own_file(head)
    return _file(path) if known is None else _own(path, known)


def _result(path: Path, what: str, **more: Any) -> dict[str, Any]:
    """The common keys."""
    empty = {"remarks": [], "suggestion": "", "units": [], "missing": 0, "points": 0}
    made: dict[str, Any] = jsonable({"stage": NAME, "path": path, "what": what, **empty, **more})
    return made


def _file(path: Path) -> dict[str, Any]:
    content = read_native(path)
    finding = look_at(content)
    traits, parts = finding.traits, finding.parts
    points, missing = sum(part.points for part in parts), sum(part.missing for part in parts)
    written = {
        "encoding": traits.encoding,
        "separator": SEPARATOR_WORDS.get(traits.separator, traits.separator),
        "decimal sign": {".": "point", ",": "comma"}.get(traits.decimal, traits.decimal),
    }
    suggestion = next((part.lines for part in parts if part.lines), "") or field_lines(content, path.parent, path.name)
    return _result(
        path,
        f"{traits.format}, {finding.kind}",
        format=traits.format,
        kind=finding.kind,
        written={key: value for key, value in written.items() if value},
        header=traits.header,
        units=finding.units,
        points=points,
        missing=missing,
        parts=[_part(part) for part in parts],
        remarks=list(dict.fromkeys(remark if len(parts) == 1 else f"{part.name}: {remark}" for part in parts for remark in part.remarks)),
        suggestion=suggestion,
        verdict=f"{traits.format}: {_count(finding.kind, points)}, {missing} without a value; units {_units(finding.units)}",
    )


def _count(kind: str, points: int) -> str:
    word = "rows" if "record" in kind else "pixels" if "frames" in kind else "cells" if "matrix" in kind else "points"
    return f"{points} {word}"


def _units(units: tuple[str, ...]) -> str:
    return ", ".join(units) if units else "not written in the file"


def _part(part: Part) -> dict[str, Any]:
    return {
        "name": part.name or part.kind,
        "kind": part.kind,
        "points": part.points,
        "missing": part.missing,
        "facts": part.facts,
        "columns": [vars(column) for column in part.columns],
    }


def _own(path: Path, known: Known) -> dict[str, Any]:
    """A file of thermofit, or a picture."""
    advice = known.advice.replace("FILE", str(path))
    if known is ARTEFACT:
        record = open_record(path)
        return _result(path, known.format, format=known.format, verdict=f"{known.format} of stage '{record.stage}': {advice}")
    return _result(path, known.format, format=known.format, verdict=f"{known.format}: {advice}")


def _raw_folder(path: Path) -> dict[str, Any]:
    parts, questions = look_at_raw(path)
    refused = next((question.text for question in questions if question.nonsense), "")
    names = ", ".join(f"{part.name} ({part.points})" for part in parts)
    suggestion = f"experiment: {path}     # key of a study; `thermofit new study.yaml --raw {path}` writes one"
    return _result(
        path,
        "thermofit raw experiment folder",
        format="thermofit raw folder",
        units=["mm", "N", "s", "degC"],
        points=sum(part.points for part in parts),
        missing=sum(part.missing for part in parts),
        parts=[_part(part) for part in parts],
        remarks=[*(remark for part in parts for remark in part.remarks), *(question.text for question in questions)],
        questions=[vars(question) for question in questions],
        suggestion="" if refused else suggestion,
        trustworthy=not refused,
        verdict=f"thermofit raw folder with {names} values: "
        + (f"not ready for a study: {refused}" if refused else f"ready for a study; next: `thermofit new study.yaml --raw {path}`"),
    )


def _folder(path: Path) -> dict[str, Any]:
    groups = group_files(visible_files(path))
    if all(group.format == UNKNOWN for group in groups):
        names = ", ".join(group.pattern for group in groups[:3])
        raise DataError(f"{path}: no known format recognised in any of its files ({names}); docs/formats.md lists the formats")
    found = [_group(path, group) for group in groups]
    native = sum(group["count"] for group in found if group["native"])
    remarks = _by_remark([(group["files"], remark) for group in found for remark in group["remarks"]])
    lines = dict.fromkeys(group["lines"] for group in found if group["lines"])
    return _result(
        path,
        f"folder, {len(groups)} groups of files",
        format="folder",
        groups=found,
        units=list(dict.fromkeys(unit for group in found for unit in group["units"])),
        points=sum(group["points"] for group in found),
        missing=sum(group["missing"] for group in found),
        remarks=remarks,
        suggestion=joined_lines(list(lines)),
        verdict=f"{sum(g['count'] for g in found)} files in {len(groups)} groups, {native} of native formats; {_next(path, groups, found)}",
    )


def _next(path: Path, groups: list[FileGroup], found: list[dict[str, Any]]) -> str:
    """What to do with a folder that has no experiment.yaml."""
    fields = any(group.format in (STAGE.format, FRAME.format) for group in groups) or any(
        entry["native"] and ("DIC" in entry["summary"] or "infrared" in entry["summary"]) for entry in found
    )
    if fields:
        return f"next: `thermofit new study.yaml --raw {path}`, which writes experiment.yaml and says what is missing in it"
    return "inspect one of them for more"


def _by_remark(found: list[tuple[str, str]]) -> list[str]:
    """Each remark once, behind the files that it is about."""
    about: dict[str, list[str]] = {}
    for files, remark in found:
        about.setdefault(remark, []).append(files)
    return [f"{files[0]}{f' and {len(files) - 1} more' if len(files) > 1 else ''}: {remark}" for remark, files in about.items()]


def _group(root: Path, group: FileGroup) -> dict[str, Any]:
    """One line of a folder."""
    where = group.folder.relative_to(root)
    files = str(where / group.pattern) if str(where) != "." else group.pattern
    entry = {"files": files, "format": group.format, "count": len(group.paths), "native": group.native}
    if not group.native:
        return {**entry, "summary": group.advice, "points": 0, "missing": 0, "units": [], "remarks": [], "lines": ""}
    found = look_at_group(group)
    facts = ", ".join(f"{key} {value}" for key, value in found.facts.items())
    summary = f"{found.kind}; {facts}; {found.missing} without a value; units {_units(found.units)}" if found.read else "cannot be read"
    kept = {"points": found.points, "missing": found.missing, "units": found.units, "remarks": found.remarks, "lines": found.lines}
    return {**entry, "summary": summary, **kept}
