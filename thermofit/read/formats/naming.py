"""Stage number and time of a file as its name says, for the many exports that write one file per stage and no number inside."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

_TIME = re.compile(r"[_\s](\d+(?:[.,]\d+)?)\s*s$")
_IMAGE = r"\.(?:bmp|tiff?|png|jpe?g)"
_STAGES = (
    re.compile(r"(\d{1,7})(?:\.\w{1,4})?_\d" + _IMAGE, re.IGNORECASE),  # MatchID: <image number>_<camera>.tif_U[mm]
    re.compile(r"[_-](?:\d{1,7})-(\d{1,7})$"),  # ARAMIS: _<reference>-<stage>, -Stage-<reference>-<stage>
    re.compile(r"(?<![\d.,])(\d{1,7})$"),  # <anything>_0001, MatchID: <image>.bmp 1
)


def stage_time(path: Path) -> tuple[int | None, float | None]:
    """Stage number and time in s that the name of a file says: `.._21.555 s.csv`, `.._0-12.txt`, `.._0001.csv`; None where it does not."""
    stem = path.stem
    if match := _TIME.search(stem):
        return None, float(match.group(1).replace(",", "."))
    found = next((match for pattern in _STAGES if (match := pattern.search(stem))), None)
    return (int(found.group(1)) if found else None), None


def number_order(path: Path) -> tuple[tuple[int, float, str], ...]:
    """Key that sorts files by the numbers in their names as numbers: frame 2 before frame 10."""
    pieces = re.split(r"(\d+(?:\.\d+)?)", path.name)
    return tuple((1, float(piece), "") if k % 2 else (0, 0.0, piece) for k, piece in enumerate(pieces))


_LOST = 0.5
"""Share of a series that may be missing before its numbers count as those of something else."""


def lost_numbers(numbers: Sequence[int], word: str) -> str:
    """In words, which numbers of a series of stages or frames (`word`) are not there; empty where its numbers go on evenly."""
    known = sorted(set(numbers))
    if len(known) < 3:
        return ""
    step = Counter(b - a for a, b in pairwise(known)).most_common(1)[0][0]
    there = set(known)
    lost = [n for n in range(known[0], known[-1] + 1, step) if n not in there]
    if not lost or len(lost) > _LOST * len(known) or any((n - known[0]) % step for n in known):
        return ""
    shown = ", ".join(str(n) for n in lost[:5]) + (", ..." if len(lost) > 5 else "")
    return f"{len(lost)} {word}s are missing between number {known[0]} and {known[-1]}: {shown}; were they lost in the export?"
