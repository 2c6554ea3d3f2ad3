"""What a native file holds, as every reader of this package hands it over. Nothing is interpreted that the file does not say.

A reader is a module with `NAME` (what users call the format), `recognises(head) -> bool` and `read(path) -> Content`; `registry` lists
them. Units after reading: mm or px, s, N, MPa, K, strains without unit; what the file had is in `Column.unit`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Head:
    """What recognition may look at: the path (its suffix says nothing certain), the size and the first bytes of the file."""

    path: Path
    size: int
    first: bytes


@dataclass(frozen=True)
class Column:
    """A column or field of a file: `name` as written there, `meaning` (time, force, strain, x, u, temperature, ...; empty: not used),
    `unit` as written, `source` of the unit: "file" (written there), "format" (fixed by the format) or "unknown"."""

    name: str
    meaning: str = ""
    unit: str = ""
    source: str = "unknown"


@dataclass(frozen=True)
class Traits:
    """What was detected: `missing` counts cells or points without value; `remarks` are repairs (counted) and suspicions, in words."""

    format: str
    path: Path
    encoding: str = ""
    separator: str = ""
    decimal: str = ""
    columns: tuple[Column, ...] = ()
    missing: int = 0
    remarks: tuple[str, ...] = ()
    header: Mapping[str, str] = field(default_factory=dict)
    """Lines of the header worth keeping, as written."""


@dataclass(frozen=True)
class DicStage:
    """Points of one DIC stage (or of one component of it).

    `point_id` (n,), `reference` (n, 3) and `displacement` (n, 3) in `length_unit`, NaN where the file says that a point was not
    correlated or a component is not in it; `displacement` is None where the file has coordinates only, which are then `deformed`.
    `time` s, `stage` number and `signals` (name: value, unit as in the file) are None or empty where the file does not say.
    """

    traits: Traits
    point_id: np.ndarray
    reference: np.ndarray | None
    displacement: np.ndarray | None
    length_unit: str
    deformed: np.ndarray | None = None
    strain: Mapping[str, np.ndarray] = field(default_factory=dict)
    time: float | None = None
    stage: int | None = None
    signals: Mapping[str, tuple[float, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class DicSequence:
    """All stages that one file holds (Ncorr)."""

    traits: Traits
    stages: tuple[DicStage, ...]


@dataclass(frozen=True)
class ThermalFrames:
    """Images of an infrared camera: `values` (n_f, n_row, n_col) in K where `unit` is "K", else as in the file (lock-in amplitude: mK).

    `time` (n_f,) s relative to the first stamp of the file or to `date`, None where the file has none.
    """

    traits: Traits
    values: np.ndarray
    unit: str
    time: np.ndarray | None = None
    date: str = ""


@dataclass(frozen=True)
class ScalarField:
    """One field on a grid without coordinates (MatchID matrix): `values` (n_row, n_col), NaN where missing, in `unit`."""

    traits: Traits
    quantity: str
    values: np.ndarray
    unit: str


@dataclass(frozen=True)
class ChannelRecord:
    """Channels over rows of a testing machine or coupon record: name as in the file -> values (n,) in the fixed unit of `units`.

    `about` holds what the header says of the specimen and the test: area mm^2, gauge_length mm, diameter mm, temperature K, rate 1/s.
    """

    traits: Traits
    channels: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    about: Mapping[str, float] = field(default_factory=dict)
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Columns of text (n,), by which rows can be told apart."""


@dataclass(frozen=True)
class Records:
    """Several tests in one file (MATLAB cell arrays, workbooks with several value sheets), by name."""

    traits: Traits
    tests: Mapping[str, ChannelRecord]


Content = DicStage | DicSequence | ThermalFrames | ScalarField | ChannelRecord | Records
