"""Tables with a header line: columns with meaning and unit, values in fixed units, and the DIC stage that such a table holds.

Meanings that a stage is made of: `id` (point numbers that are the same in all stages), `x y z` (coordinates), `u v w` (displacements),
strains by their name (`exx`, `eyy`, ...). A stage whose columns have no `id` is joined with others by its reference positions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.units import to_fixed
from thermofit.read.formats.contents import Column, DicStage, Traits
from thermofit.read.formats.naming import stage_time
from thermofit.read.formats.text import NumberTable, Text, detect_layout, name_and_unit, read_block, split_cells

Describe = Callable[[str, str], Column]
"""From the name and the unit of a header cell to the column with its meaning."""
STRAINS = ("exx", "eyy", "exy", "e1", "e2", "e3", "mises")
_LENGTHS = ("x", "y", "z", "u", "v", "w", "other x", "other y", "other z", "deformed x", "deformed y", "deformed z")
_LARGEST_ID = 2**53


@dataclass(frozen=True)
class NamedTable:
    """`columns` of the header and `values` (n_row, n_column) in fixed units, which `units` names ("" where the file has none)."""

    path: Path
    columns: tuple[Column, ...]
    units: tuple[str, ...]
    values: np.ndarray
    table: NumberTable
    traits: Traits

    def index(self, meaning: str) -> int | None:
        """Index of the column with a meaning, None where there is none."""
        return next((k for k, column in enumerate(self.columns) if column.meaning == meaning), None)

    def vector(self, meanings: tuple[str, str, str]) -> np.ndarray | None:
        """Three columns (n_row, 3), NaN for one that is absent; None where all are."""
        found = [self.index(meaning) for meaning in meanings]
        if all(k is None for k in found):
            return None
        absent = np.full(len(self.values), np.nan)
        return np.column_stack([absent if k is None else self.values[:, k] for k in found])


@dataclass(frozen=True)
class StageFacts:
    """What a reader knows of a stage besides its table; `deformed` coordinates are those of the stage, else those of the reference.

    `lost` (n_row,) marks rows that the format declares not correlated.
    """

    deformed: bool
    time: float | None = None
    stage: int | None = None
    lost: np.ndarray | None = None
    remarks: tuple[str, ...] = ()
    signals: Mapping[str, tuple[float, str]] = field(default_factory=dict)


def header_cells(line: str, separator: str) -> list[str]:
    """Cells of a header line without the empty ones that a separator at its end leaves."""
    cells = split_cells(line.lstrip("#"), separator)
    while cells and not cells[-1]:
        cells.pop()
    return cells


def read_named(text: Text, path: Path, header: int, separator: str, describe: Describe) -> NamedTable:
    """The table below line `header` (from 0). DataError where it has no rows, too many cells, its header twice, or unknown units."""
    cells = header_cells(text.lines[header], separator)
    columns = tuple(describe(*name_and_unit(cell)) for cell in cells)
    body = text.lines[header + 1 :]
    again = next((k for k, line in enumerate(body) if line.strip() == text.lines[header].strip()), None)
    if again is not None:
        raise DataError(f"{path}, line {header + again + 2}: the header occurs a second time, expected one stage in a file; part the file")
    meanings = [column.meaning for column in columns if column.meaning]
    twice = next((meaning for meaning in meanings if meanings.count(meaning) > 1), None)
    if twice is not None:
        named = " and ".join(f"'{column.name}'" for column in columns if column.meaning == twice)
        raise DataError(f"{path}, line {header + 1}: the columns {named} both hold {twice}, expected one; export only one of them")
    layout = detect_layout(body, path, separator)
    table = read_block(body, path, header + 2, layout, len(cells))
    values, units = table.values.copy(), []
    for k, column in enumerate(columns):
        values[:, k], unit = _fixed(values[:, k], column, f"{path}, line {header + 1}")
        units.append(unit)
    remarks = (f"{table.ragged} rows shorter than the header, padded",) if table.ragged else ()
    traits = Traits("", path, text.encoding, separator, layout.decimal, columns, table.missing, remarks)
    return NamedTable(path, columns, tuple(units), values, table, traits)


def _fixed(values: np.ndarray, column: Column, where: str) -> tuple[np.ndarray, str]:
    """Values of a column that is used, in the fixed unit. DataError where its unit is unknown or of another kind than its meaning."""
    if not column.meaning or not column.unit:
        return values, column.unit
    expected = ("mm", "px") if column.meaning in _LENGTHS else ("1",) if column.meaning in STRAINS else None
    try:
        converted, unit = to_fixed(values, column.unit)
    except ValueError as error:
        raise DataError(f"{where}: column '{column.name}': {error}; correct the header") from None
    if expected is not None and unit not in expected:
        kind = "a length" if "mm" in expected else "a strain"
        raise DataError(f"{where}: column '{column.name}' is in {column.unit}, expected the unit of {kind}; correct the header")
    return converted, unit


def _ids(named: NamedTable) -> tuple[np.ndarray, np.ndarray]:
    """Point numbers of the rows that are kept, and which rows these are. DataError where one is no whole number or occurs twice."""
    k = named.index("id")
    if k is None:
        kept = np.ones(len(named.values), dtype=bool)
        return np.arange(len(kept)), kept
    ids = named.values[:, k]
    kept = ~np.isnan(ids)
    wrong = np.flatnonzero(kept & ((ids != np.floor(ids)) | (np.abs(ids) >= _LARGEST_ID)))
    name = named.columns[k].name
    if len(wrong):
        line = named.table.lines[wrong[0]]
        raise DataError(f"{named.path}, line {line}: {name} is {ids[wrong[0]]:g}, expected a whole number; correct it")
    check_unique(ids[kept], named.table.lines[kept], named.path, name)
    return ids[kept].astype(np.int64), kept


def check_unique(ids: np.ndarray, lines: np.ndarray, path: Path, name: str) -> None:
    """DataError with the line of the first number that occurs a second time."""
    _, first = np.unique(ids, return_index=True)
    if len(first) != len(ids):
        k = int(np.setdiff1d(np.arange(len(ids)), first)[0])
        raise DataError(f"{path}, line {lines[k]}: {name} {ids[k]:.0f} occurs a second time in this stage; remove one of the rows")


def _length_unit(named: NamedTable) -> str:
    """The one unit of coordinates and displacements. DataError where they differ."""
    units = {unit: column.name for column, unit in zip(named.columns, named.units, strict=True) if column.meaning in _LENGTHS}
    if len(units) > 1:
        found = " and ".join(f"'{name}' in {unit or 'no unit'}" for unit, name in units.items())
        raise DataError(f"{named.path}: found {found}, expected coordinates and displacements in one unit; export both in mm")
    return next(iter(units), "")


def make_stage(named: NamedTable, name: str, facts: StageFacts) -> DicStage:
    """The DIC stage of a table; rows without point number or without coordinates are left out and counted.

    Time and stage number that the file does not hold are taken from its name. DataError where no row has coordinates.
    """
    point_id, kept = _ids(named)
    place, moved = named.vector(("x", "y", "z")), named.vector(("u", "v", "w"))
    if place is not None:
        used = [k for k, meaning in enumerate("xyz") if named.index(meaning) is not None]
        here = ~np.isnan(place[:, used]).any(axis=1)
        if facts.lost is not None:
            here &= ~facts.lost
        if not (here & kept).any():
            raise DataError(f"{named.path}: no point has coordinates, expected a stage with correlated points; leave this stage out")
        point_id, kept = point_id[here[kept]], kept & here
        place = place[kept]
    moved = None if moved is None else moved[kept]
    dropped = len(kept) - int(kept.sum())
    void = 0 if moved is None else int(np.isnan(moved[:, [k for k, m in enumerate("uvw") if named.index(m) is not None]]).any(axis=1).sum())
    reference = place if not facts.deformed else None if place is None or moved is None else place - moved
    own = named.vector(("deformed x", "deformed y", "deformed z"))
    deformed = place if facts.deformed else None if own is None else own[kept]
    strain = {c.meaning: named.values[kept, k] for k, c in enumerate(named.columns) if c.meaning in STRAINS}
    said_stage, said_time = stage_time(named.path)
    remarks = [*named.traits.remarks, *facts.remarks]
    if dropped:
        remarks.append(f"{dropped} rows without coordinates left out")
    if void:
        remarks.append(f"{void} points without displacement")
    old = named.traits
    traits = Traits(
        name, named.path, old.encoding, old.separator, old.decimal, named.columns, dropped + void, tuple(remarks), dict(old.header)
    )
    return DicStage(
        traits,
        point_id,
        reference,
        moved,
        _length_unit(named),
        deformed,
        strain,
        said_time if facts.time is None else facts.time,
        said_stage if facts.stage is None else facts.stage,
        facts.signals,
    )
