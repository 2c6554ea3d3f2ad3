"""Columns of a coupon record: what their names mean, units, repeated names, and the way into a `Record`."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.units import known_unit, to_fixed
from thermofit.measure.formats.contents import Column, Record, Traits
from thermofit.measure.formats.text import name_and_unit

MISSING_MARK = -1000000.0
"""What machine software writes for a channel that is not connected."""

_WORDS: tuple[tuple[str, str], ...] = (
    ("plastic_strain", r"plastic.?strain"),
    ("true_stress", r"true.?stress|stress.?true|sigma.?true|wahre spannung"),
    ("true_strain", r"true.?strain|strain.?true|^e.?true|log.*strain|umformgrad"),
    ("stress", r"stress|sigma|spannung|contrainte"),
    ("temperature", r"temp(?!s)|pyrometer|thermocouple|pt100"),
    ("time", r"^t$|time|temps|zeit"),
    ("force", r"^f$|force|kraft|load(?!ing)|charge"),
    ("strain", r"strain|epsilon|^eps|dehnung"),
    ("extension", r"^ext|exten|elong|^dl$|^u$|deform|verlangerung|clip"),
    ("displacement", r"displ|deplac|travel|weg|traverse|crosshead|position|separation|stroke|^utr$|course"),
)
_BY_QUANTITY: Mapping[str, tuple[str, ...]] = {
    "time": ("time",),
    "force": ("force",),
    "temperature": ("temperature",),
    "stress": ("true_stress", "stress"),
    "strain": ("plastic_strain", "true_strain", "strain"),
    "length": ("extension", "displacement"),
}
_ABOUT: tuple[tuple[str, str, str], ...] = (
    ("gauge_length", "mm", r"L0|[Gg]au?ge.?length.*|Messl\u00e4nge.*|.*extensometer.*base.*"),
    ("diameter", "mm", r"[Dd]0?|[Dd]iameter.*|Durchmesser.*"),
    ("thickness", "mm", r"a0|[Ss]pecimen thickness|[Tt]hickness.*|Probendicke.*|Dicke.*"),
    ("width", "mm", r"b0|[Ss]pecimen width|[Ww]idth.*|Probenbreite.*|Breite.*"),
    ("area", "mm^2", r"A0?|S0|[Cc]ross.?section.*|[Aa]rea.*|.*[Qq]uerschnitt.*"),
    ("temperature", "K", r"[Tt]emperature|[Tt]est temperature|Temperatur|Pr\u00fcftemperatur"),
)


@dataclass(frozen=True)
class Block:
    """Rows of a table before they become channels: `columns` with unit as written, `values` (n, m) NaN where no number stands."""

    columns: tuple[Column, ...]
    values: np.ndarray
    remarks: tuple[str, ...] = ()


def plain(name: str) -> str:
    """A name in lower case, without accents and with single blanks."""
    folded = unicodedata.normalize("NFKD", name)
    return re.sub(r"\s+", " ", "".join(c for c in folded if not unicodedata.combining(c))).strip().lower()


def meaning_of(name: str, unit: str) -> str:
    """What a column measures, by its unit and then its name; empty where both say nothing."""
    word = re.sub(r"^c_?\d+_", "", plain(name))
    found = [meaning for meaning, pattern in _WORDS if re.search(pattern, word)]
    quantity = known_unit(unit)
    if quantity is None:
        return found[0] if found and not unit else ""
    allowed = _BY_QUANTITY.get(quantity.quantity, ())
    fitting = [meaning for meaning in found if meaning in allowed]
    if fitting:
        return fitting[0]
    if quantity.quantity == "length":
        return "extension" if "strain" in found else ""
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
    if not unit and (tail := _unit_behind_underscore(cell)):
        bare, written, unit = cell.rpartition("_")[0], tail, tail
    unit = re.sub(r"^[\[(<](.*)[\])>]$", r"\1", unit).strip()
    return Column(cell, meaning_of(bare if written else cell, unit), unit, "file" if unit else "unknown")


def _unit_behind_underscore(name: str) -> str:
    """Unit of names such as `force_kN`, where what is before it measures that very quantity; empty where there is none."""
    bare, _, tail = name.rpartition("_")
    known = known_unit(tail)
    if not bare or known is None or known.quantity == "strain":
        return ""
    allowed = _BY_QUANTITY.get(known.quantity, ())
    return tail if any(meaning in allowed and re.search(pattern, plain(bare)) for meaning, pattern in _WORDS) else ""


def about_of(name: str, value: float, unit: str) -> dict[str, float]:
    """What a line of the header (name, value, unit) says of the specimen, in fixed units; empty where it says nothing of use."""
    name = name.strip().rstrip(":").strip()
    for key, fixed, pattern in _ABOUT:
        if re.fullmatch(pattern, name) and known_unit(unit) is not None:
            converted, found = to_fixed(value, unit)
            positive = np.isfinite(converted) and float(converted) > 0.0
            return {key: float(converted)} if found == fixed and positive else {}
    return {}


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


def make_record(traits: Traits, block: Block, about: Mapping[str, float]) -> Record:
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
    channels: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    missing = 0
    for column, raw in zip(columns, values.T, strict=True):
        if not np.isfinite(raw).any():
            remarks.append(f"column '{column.name}' holds no numbers and is no channel")
            continue
        channels[column.name], units[column.name] = to_fixed(raw, column.unit) if known_unit(column.unit) else (raw, column.unit)
        missing += int(np.isnan(raw).sum())
    if not channels:
        raise DataError(f"{traits.path}: no column holds numbers, expected the channels of a test; export it again")
    about = _checked(traits.path, about)
    return Record(replace(traits, columns=tuple(columns), missing=missing, remarks=(*traits.remarks, *remarks)), channels, units, about)


def _checked(path: Path, about: Mapping[str, float]) -> dict[str, float]:
    """Numbers of the header; DataError for one that is not finite."""
    for name, value in about.items():
        if not np.isfinite(value):
            raise DataError(f"{path}: the header gives {name} = {value}, expected a finite number; correct the header")
    return dict(about)
