"""What `inspect` finds in a measured file: plain data that prints as a table and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from thermofit.read.formats.contents import Column, Traits

Fact = str | int | float


@dataclass(frozen=True)
class ColumnFinding:
    """A column: name and unit as written, meaning, where the unit is from, range in the fixed unit, cells without value, noise.

    `low`, `high` and `noise` are None where the column was not read or holds nothing that they could be taken from.
    """

    name: str
    meaning: str
    unit: str
    unit_from: str
    fixed_unit: str = ""
    low: float | None = None
    high: float | None = None
    missing: int | None = None
    noise: float | None = None


@dataclass(frozen=True)
class Part:
    """A file, or one test or stage of it: `points` rows, points or pixels, `missing` of them (or of the cells) without a value."""

    name: str
    kind: str
    points: int
    missing: int
    facts: Mapping[str, Fact]
    columns: tuple[ColumnFinding, ...] = ()
    remarks: tuple[str, ...] = ()
    lines: str = ""
    """YAML to start a study or an experiment.yaml from."""


@dataclass(frozen=True)
class Finding:
    """A whole file: its format and how it is written, and its parts."""

    traits: Traits
    kind: str
    parts: tuple[Part, ...]
    units: tuple[str, ...] = field(default=())
    """Units as the file writes them, each once."""


def column_finding(column: Column, values: np.ndarray | None, fixed_unit: str = "", noise: float | None = None) -> ColumnFinding:
    """A column with the range of its values (any shape; None: not read)."""
    if values is None:
        return ColumnFinding(column.name, column.meaning, column.unit, column.source)
    known = np.asarray(values, dtype=float)
    finite = known[np.isfinite(known)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (None, None)
    missing = int(known.size - finite.size)
    return ColumnFinding(column.name, column.meaning, column.unit, column.source, fixed_unit, low, high, missing, noise)


def units_of(columns: Sequence[Column]) -> tuple[str, ...]:
    """Units of the columns as written, each once, in their order."""
    return tuple(dict.fromkeys(column.unit for column in columns if column.unit))
