"""The measured parts as docs/performance.md, as a terminal table, and as JSON from which a stopped run goes on."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench_measure import Part, Row
from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class Measured:
    """A part with the time of its measurement, the limits of the machine beside it, and the settings it was run with."""

    part: Part
    when: str
    product: float
    gflops: float
    bandwidth: float
    settings: str

    def ratio(self, row: Row) -> str:
        """Seconds over those of the matrix product of the same section."""
        return "" if row.seconds is None else f"{row.seconds / self.product:.3g}"

    def as_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return {**self.__dict__, "part": self.part.as_dict()}

    @staticmethod
    def of(stored: Mapping[str, Any]) -> Measured:
        """The Measured of what `as_dict` gave."""
        return Measured(**{**stored, "part": Part.of(stored["part"])})


def load(path: Path) -> dict[str, Measured]:
    """Parts of earlier runs by section; none where there is no file."""
    if not path.exists():
        return {}
    return {name: Measured.of(stored) for name, stored in json.loads(path.read_text(encoding="utf-8")).items()}


def save(path: Path, parts: Mapping[str, Measured]) -> None:
    """Keep all parts; the file is replaced whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_suffix(".new")
    fresh.write_text(json.dumps({name: part.as_dict() for name, part in parts.items()}, indent=1), encoding="utf-8")
    fresh.replace(path)


def time_text(seconds: float | None) -> str:
    """Three digits in s, or in ms below half a second."""
    if seconds is None:
        return ""
    return f"{seconds:.3g} s" if seconds >= 0.5 else f"{1e3 * seconds:.3g} ms"


def show(measured: Measured) -> None:
    """The part on the terminal."""
    table = Table(title=measured.part.title, title_justify="left")
    for column in ("piece", "time", "/ product", "note"):
        table.add_column(column, justify="left" if column in ("piece", "note") else "right", overflow="fold")
    for row in measured.part.rows:
        table.add_row(row.name, time_text(row.seconds), measured.ratio(row), row.note)
    console = Console()
    console.print(table, markup=False)
    for target in measured.part.targets:
        console.print(f"  {target.name}: {target.measured}, wanted {target.limit}: {_verdict(target.met)}", markup=False)
    for remark in measured.part.remarks:
        console.print(f"  {remark}", markup=False)


def _verdict(met: bool | None) -> str:
    return "not measured" if met is None else "met" if met else "not met"


def document(parts: Mapping[str, Measured]) -> str:
    """docs/performance.md: targets with measured figures, then the tables section by section."""
    return "\n".join([*_head(), *_targets(parts), *(line for measured in parts.values() for line in _section(measured))])


def _head() -> Iterator[str]:
    yield from (
        "# Performance",
        "",
        "Written by `make bench` (`python scripts/bench.py --write docs/performance.md`): all figures of targets and tables are measured.",
        "Times are medians of CPU seconds on one thread unless a row says otherwise (wall). The ratio is that to the product of two",
        "1000 x 1000 matrices timed beside each section: it makes figures of different machines and of a busy one comparable.",
        "",
    )


def _targets(parts: Mapping[str, Measured]) -> Iterator[str]:
    yield from ("## Targets", "", "| target | wanted | measured | |", "|---|---|---|---|")
    for measured in parts.values():
        for target in measured.part.targets:
            yield f"| {target.name} | {target.limit} | {target.measured} | {_verdict(target.met)} |"
    yield ""


def _section(measured: Measured) -> Iterator[str]:
    part = measured.part
    yield from (f"## {part.title}", "")
    yield f"{measured.when}; {measured.settings}; matrix product {measured.gflops:.1f} GF/s, triad {measured.bandwidth:.1f} GB/s."
    yield from ("", "| piece | time | / matrix product | |", "|---|---:|---:|---|")
    for row in part.rows:
        yield f"| {_cell(row.name)} | {time_text(row.seconds)} | {measured.ratio(row)} | {_cell(row.note)} |"
    yield ""
    yield from (f"* {remark}" for remark in part.remarks)
    if part.remarks:
        yield ""


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
