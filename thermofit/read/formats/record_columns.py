"""Columns of a coupon record: what their names mean, units, repeated names, and the way into a `ChannelRecord`."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.units import known_unit, to_fixed
from thermofit.read.formats.contents import ChannelRecord, Column, Traits
from thermofit.read.formats.record_dates import CLOCK, DAY, seconds_of
from thermofit.read.formats.record_words import ABOUT, BY_QUANTITY, NOT_ABOUT, kind_of, meanings_of
from thermofit.read.formats.text import name_and_unit

_LEAST_ROWS = 10
"""In a table of so many rows a column with a single number speaks of the test and not of its course."""
MISSING_MARK = -1000000.0
"""What machine software writes for a channel that is not connected."""

_NO_UNITS = ("strain", "none", "abs")
"""Spellings of the unit 1 that are names where they stand behind a name without brackets."""
_UNIT_PLACES = re.compile(r"\s*[,/]\s*|\s+in\s+|[_\s]+|(?=%$)")
"""What may stand between a name and its unit where there are no brackets: `Force, kN`, `Stress / MPa`, `Strain in %`, `force_kN`."""


@dataclass(frozen=True)
class ColumnBlock:
    """Rows of a table before they become channels: `columns` with unit as written, `values` (n, m) NaN where no number stands."""

    columns: tuple[Column, ...]
    values: np.ndarray
    remarks: tuple[str, ...] = ()
    texts: Mapping[int, Sequence[str]] = field(default_factory=dict)
    """Cells of the columns that hold texts, by the number of the column."""


def meaning_of(name: str, unit: str) -> str:
    """What a column measures, by its unit and then its name; empty where both say nothing."""
    found = meanings_of(name)
    quantity = known_unit(unit)
    if quantity is None:
        return found[0] if found and not unit else ""
    allowed = BY_QUANTITY.get(quantity.quantity, ())
    if quantity.quantity == "length" and "lateral_strain" in found:
        return "lateral_extension"
    fitting = [meaning for meaning in found if meaning.removeprefix("true_") in allowed]
    if fitting:
        return fitting[0]
    if quantity.quantity == "length":
        return "extension" if "strain" in found else ""
    if quantity.quantity == "stress" and kind_of(name) == "true":
        return "true_stress"
    return allowed[-1] if quantity.quantity in ("time", "force", "temperature", "stress") else ""


def column_of(cell: str, unit: str = "") -> Column:
    """Column of a header cell, whose unit stands in a row of its own (`unit`) or in brackets behind the name.

    The name is the cell as written. Words in round brackets that are no known unit belong to the name; `force_kN` has a unit, too, as
    the name before it agrees.
    """
    cell = unicodedata.normalize("NFC", re.sub(r"\s+", " ", cell.strip().strip('"')).strip())
    unit = unit.strip()
    bare, written = name_and_unit(cell)
    if not unit and written and (known_unit(written) is not None or cell.endswith("]")):
        unit = written
    if not unit and (inside := [text for text in re.findall(r"[\[(]([^\[\]()]+)[\])]", cell) if known_unit(text) is not None]):
        bare, written, unit = cell, inside[0], inside[0]
    if not unit and (tail := _unit_at_end(cell)):
        bare, written = tail
        unit = written
    unit = re.sub(r"^[\[(<](.*)[\])>]$", r"\1", unit).strip()
    return Column(cell, meaning_of(bare if written else cell, unit), unit, "file" if unit else "unknown")


def _unit_at_end(cell: str) -> tuple[str, str] | None:
    """Name and unit of a cell such as `force_kN` or `Strain in %`, where the name measures that very quantity; None where there is none.

    A bare 1 at the end is a number of a channel, no unit.
    """
    for border in _UNIT_PLACES.finditer(cell):
        bare, tail = cell[: border.start()], cell[border.end() :]
        known = known_unit(tail)
        if known is None or not bare or not re.search(r"[^\W\d]|%", tail) or tail.lower() in _NO_UNITS:
            continue
        allowed = (*BY_QUANTITY.get(known.quantity, ()), *(("lateral_strain",) if known.quantity == "length" else ()))
        if any(meaning.removeprefix("true_") in allowed for meaning in meanings_of(bare)):
            return bare, tail
    return None


def about_of(name: str, value: float, unit: str) -> dict[str, float]:
    """What a line of the header (name, value, unit) says of the specimen, in fixed units; empty where it says nothing of use."""
    key = about_key(name)
    if key is None or known_unit(unit) is None or (key == "rate" and unit.strip().lower() == "hz"):
        return {}
    fixed = next(fixed for known, fixed, _ in ABOUT if known == key)
    converted, found = to_fixed(value, unit)
    positive = np.isfinite(converted) and float(converted) > 0.0
    return {key: float(converted)} if found == fixed and positive else {}


def about_key(name: str) -> str | None:
    """What the name of a header line is about (`area`, `rate`, ...), None for nothing that is used."""
    name = re.sub(r"\s+", " ", name.strip().rstrip(":=").strip())
    if re.fullmatch(NOT_ABOUT, name):
        return None
    return next((key for key, _, pattern in ABOUT if re.fullmatch(pattern, name)), None)


def with_dates(
    columns: Sequence[Column], values: np.ndarray, cells: Callable[[int], Sequence[object]]
) -> tuple[list[Column], np.ndarray, tuple[str, ...]]:
    """Columns and `values` (n, m) in which dates and times of day are seconds, and remarks; `cells(k)` are the cells of column k.

    A column of times of day is an absolute clock (`date`) where another column holds the day, else a clock (`time`).
    """
    found = {k: read for k in range(len(columns)) if not np.isfinite(values[:, k]).any() and (read := seconds_of(cells(k))) is not None}
    if not found:
        return list(columns), values, ()
    values, made, remarks = values.copy(), list(columns), []
    days = [k for k, (_, what) in found.items() if what == DAY]
    clocks = [k for k, (_, what) in found.items() if what == CLOCK]
    for k, (seconds, what) in found.items():
        joined = what == CLOCK and len(days) == len(clocks) == 1
        values[:, k] = seconds + found[days[0]][0] if joined else seconds
        absolute = joined or what != CLOCK
        made[k] = replace(columns[k], meaning="date" if absolute else "time", unit="s", source="format")
        text = f"{what}{f' of the day in {columns[days[0]].name!r}' if joined else ''}"
        remarks.append(f"column '{columns[k].name}' holds {text}, read as seconds {'since 1970' if absolute else 'since midnight'}")
    return made, values, tuple(remarks)


def texts_of(values: np.ndarray, cells: Callable[[int], Sequence[object]]) -> dict[int, Sequence[str]]:
    """Cells of the columns without any number, as texts, by the number of the column; `values` (n, m), `cells(k)` those of column k."""
    empty = np.flatnonzero(~np.isfinite(values).any(axis=0))
    return {int(k): [cell.strip() if isinstance(cell, str) else "" for cell in cells(int(k))] for k in empty}


def kind_remarks(columns: Sequence[Column], lines: Sequence[str]) -> tuple[str, ...]:
    """A remark where a line above the names speaks of true or nominal stress or strain, which the names themselves leave open."""
    if any(kind_of(column.name) for column in columns):
        return ()
    for line in lines:
        if kind_of(line) and any(meaning.removeprefix("true_") in ("stress", "strain") for meaning in meanings_of(line)):
            shown = " ".join(line.strip("#% ").split())[:80]
            return (f"a line above the names speaks of {kind_of(line)} quantities ('{shown}'), the names do not: the study must say it",)
    return ()


def _unique(columns: Sequence[Column]) -> tuple[list[Column], list[str]]:
    """Columns whose repeated names are numbered, empty ones named after their place, and remarks on the repeated ones."""
    seen: dict[str, int] = {}
    unique, repeated = [], []
    for k, column in enumerate(columns, start=1):
        name = column.name or f"column {k}"
        seen[name] = seen.get(name, 0) + 1
        if seen[name] > 1:
            repeated.append(name)
            number = seen[name]
            while f"{name} ({number})" in seen:
                number += 1
            name = f"{name} ({number})"
            seen[name] = 1
        unique.append(replace(column, name=name))
    named = sorted(set(repeated))
    return unique, [f"column '{name}' occurs more than once: the later ones are called '{name} (2)' and so on" for name in named]


def _missing_marks(values: np.ndarray) -> tuple[np.ndarray, int]:
    """Values without the mark of channels that are not connected, and how many cells held it."""
    marked = values == MISSING_MARK
    return np.where(marked, np.nan, values), int(marked.sum())


def make_record(traits: Traits, block: ColumnBlock, about: Mapping[str, float]) -> ChannelRecord:
    """A record in fixed units. Rows without any number are dropped and counted; columns without any number are no channels.

    DataError where no column holds numbers or fewer than two rows are left.
    """
    values, marks = _missing_marks(np.asarray(block.values, dtype=float))
    columns, remarks = _unique(block.columns)
    remarks = [*block.remarks, *remarks]
    if marks:
        remarks.append(f"{marks} cells hold {MISSING_MARK:.0f}, the mark of a channel without value, and count as missing")
    kept = np.isfinite(values).any(axis=1)
    if not kept.all():
        remarks.append(f"{int((~kept).sum())} rows without any number dropped")
    values = values[kept]
    if len(values) < 2:
        raise DataError(f"{traits.path}: found {len(values)} rows of numbers, expected a record of at least two; export it again")
    labels = {columns[k].name: tuple(text for text, keep in zip(texts, kept, strict=True) if keep) for k, texts in block.texts.items()}
    labels = {name: texts for name, texts in labels.items() if any(texts)}
    channels: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    missing = 0
    held = np.isfinite(values).sum(axis=0)
    single = (held == 1) & (len(values) >= _LEAST_ROWS)
    stated: dict[str, float] = {}
    for column, raw, alone in zip(columns, values.T, single, strict=True):
        if not np.isfinite(raw).any():
            several = f", but {len(set(labels[column.name]))} texts" if column.name in labels else ""
            remarks.append(f"column '{column.name}' holds no numbers{several} and is no channel")
            continue
        if alone:
            value = float(raw[np.isfinite(raw)][0])
            found = about_of(name_and_unit(column.name)[0], value, column.unit)
            stated |= {key: value for key, value in found.items() if key not in stated}
            silent = (
                ", without a known unit it is not taken,"
                if about_key(name_and_unit(column.name)[0]) and not known_unit(column.unit)
                else ""
            )
            use = f"and says the {next(iter(found)).replace('_', ' ')} of the test" if found else f"{silent} and is no channel".strip()
            remarks.append(f"column '{column.name}' holds one number, {value:g}{f' {column.unit}' if column.unit else ''}, {use}")
            continue
        channels[column.name], units[column.name] = to_fixed(raw, column.unit) if known_unit(column.unit) else (raw, column.unit)
        missing += int(np.isnan(raw).sum())
    if not channels:
        raise DataError(f"{traits.path}: no column holds numbers, expected the channels of a test; export it again")
    about = _checked(traits.path, {**stated, **about})
    return ChannelRecord(
        replace(traits, columns=tuple(columns), missing=missing, remarks=(*traits.remarks, *remarks)), channels, units, about, labels
    )


def _checked(path: Path, about: Mapping[str, float]) -> dict[str, float]:
    """Numbers of the header; DataError for one that is not finite."""
    for name, value in about.items():
        if not np.isfinite(value):
            raise DataError(f"{path}: the header gives {name} = {value}, expected a finite number; correct the header")
    return dict(about)
