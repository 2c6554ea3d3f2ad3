"""One line on a group of files: how many points, which stages and times, what is missing, which files are broken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.file_groups import FileGroup
from thermofit.read.findings import Finding
from thermofit.read.formats.contents import DicStage, Record
from thermofit.read.formats.naming import stage_time
from thermofit.read.formats.registry import read_native
from thermofit.read.look import look_at
from thermofit.read.look_record import clock_facts
from thermofit.read.study_lines import field_lines, series_lines

MOST_BYTES = 200_000_000
"""Of a group with more than this only some files are read."""
_SAMPLE = 20


@dataclass(frozen=True)
class GroupFinding:
    """A group: `points` and `missing` over the files that were read, `units` as written, `remarks`, counted where they repeat."""

    kind: str
    points: int
    missing: int
    read: int
    units: tuple[str, ...]
    facts: Mapping[str, Any]
    remarks: tuple[str, ...]
    lines: str = ""


def look_at_group(group: FileGroup) -> GroupFinding:
    """Read the files of a native group (all, or some of very many bytes) and say what they hold together."""
    findings, stages, broken = [], [], []
    lines = ""
    chosen = _chosen(group)
    for path in chosen:
        try:
            content = read_native(path)
        except DataError as error:
            broken.append(str(error))
            continue
        findings.append(look_at(content))
        lines = lines or field_lines(content, group.folder, group.pattern)
        if not lines and isinstance(content, Record) and len(chosen) > 1:
            lines = series_lines(content, group.folder, group.pattern)
        if isinstance(content, DicStage):
            stages.append(content)
    remarks = _counted([remark for finding in findings for part in finding.parts for remark in part.remarks], len(findings))
    if broken:
        remarks.append(f"{len(broken)} of {len(chosen)} files cannot be read; the first: {broken[0]}")
    if len(chosen) < len(group.paths):
        remarks.append(f"{len(chosen)} of {len(group.paths)} files were read, evenly taken: all are more than {MOST_BYTES / 1e6:.0f} MB")
    facts, more = _sequence(stages) if len(stages) > 1 else ({}, [])
    return GroupFinding(
        findings[0].kind if findings else "",
        sum(part.points for finding in findings for part in finding.parts),
        sum(part.missing for finding in findings for part in finding.parts),
        len(findings),
        tuple(dict.fromkeys(unit for finding in findings for unit in finding.units)),
        _shared(findings) | facts,
        (*remarks, *more),
        lines,
    )


def _chosen(group: FileGroup) -> list[Any]:
    size = sum(path.stat().st_size for path in group.paths)
    if size <= MOST_BYTES or len(group.paths) <= _SAMPLE:
        return list(group.paths)
    return [group.paths[k] for k in np.unique(np.linspace(0, len(group.paths) - 1, _SAMPLE).astype(int))]


def _shared(findings: Sequence[Finding]) -> dict[str, Any]:
    """Facts of the first part that all files agree upon, and the range of their points."""
    if not findings:
        return {}
    counts = [part.points for finding in findings for part in finding.parts]
    low, high = min(counts), max(counts)
    return {"points of each": f"{low}" if low == high else f"{low} to {high}"}


def _counted(remarks: Sequence[str], files: int) -> list[str]:
    """Each remark once, with the number of files where it was made by some only."""
    found = []
    for remark in dict.fromkeys(remarks):
        n = remarks.count(remark)
        found.append(remark if n == files else f"{remark} ({n} of {files} files)")
    return found


def _sequence(stages: Sequence[DicStage]) -> tuple[dict[str, Any], list[str]]:
    """Numbers and times of the stages: range, numbers left out, repeated times."""
    facts: dict[str, Any] = {}
    remarks = []
    numbers = [stage.stage if stage.stage is not None else stage_time(stage.traits.path)[0] for stage in stages]
    known = sorted(n for n in numbers if n is not None)
    if known:
        facts["stages"] = f"{known[0]} to {known[-1]}"
        gone = sorted(set(range(known[0], known[-1] + 1)) - set(known))
        regular = len(known) > 2 and len({b - a for a, b in pairwise(known)}) == 1
        if gone and not regular:
            shown = ", ".join(str(n) for n in gone[:5])
            remarks.append(f"{len(gone)} stages are left out between {known[0]} and {known[-1]}: {shown}{', ...' if len(gone) > 5 else ''}")
        if len(set(known)) < len(known):
            remarks.append("two files have the same stage number: exports of different tests in one folder?")
    times = np.array([stage.time for stage in stages if stage.time is not None], dtype=float)
    if len(times) == len(stages):
        clock, found = clock_facts(times)
        facts["times s"] = clock.get("time s", "")
        remarks += found
    elif not len(times):
        remarks.append("the files have no times: experiment.yaml must give them")
    ids = {stage.point_id.tobytes() for stage in stages}
    if len(ids) > 1:
        remarks.append("the stages do not hold the same points; they are joined by their ids")
    return facts, remarks
