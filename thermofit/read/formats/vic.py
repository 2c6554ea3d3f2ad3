"""VIC-3D and VIC-2D (Correlated Solutions): CSV, one file for each stage.

Case matters: `X Y Z U V W` are metric (reference coordinates and displacements), `x y u v q r` are pixels; VIC-2D calls its calibrated
columns `x_c y_c u_c v_c`. `sigma` = -1 marks a point that was not correlated: its metric columns are 0. A displacement of 0 is a value. The
file names no unit and not the measure of strain; `gamma` is an angle in rad.
Sources: MarcG-LBMC-Lyos/PCR_Vic3D, lm2-poly/PeriPyDIC.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import Column, DicStage, Head, Traits
from thermofit.read.formats.table import header_cells, read_named
from thermofit.read.formats.text import head_lines, read_text

NAME = "VIC-3D / VIC-2D CSV"
METRIC = (("X", "Y", "Z"), ("U", "V", "W"))
CALIBRATED = (("x_c", "y_c"), ("u_c", "v_c"))
PIXEL = (("x", "y"), ("u", "v"))
STRAINS = {"exx": "exx", "eyy": "eyy", "exy": "exy", "e1": "e1", "e2": "e2", "e_vonmises": "mises"}
Names = tuple[tuple[str, ...], tuple[str, ...]]
"""Columns of the coordinates and of the displacements, two or three each."""
_WHAT = "a VIC-3D or VIC-2D export with a line of column names"


def recognises(head: Head) -> bool:
    """Whether the first line names coordinates and displacements of VIC and its correlation confidence; metric ones may do without it.

    `x, y, u, v` alone are columns of anybody's table.
    """
    line = next((line for line in head_lines(head) if line.strip()), "")
    names = header_cells(line, _separator(line))
    chosen = vic_columns(names)
    return chosen is not None and ("sigma" in names or (chosen[0] != PIXEL[0] and any(name in names for name in ("exx", "q"))))


def vic_columns(names: Collection[str]) -> Names | None:
    """Names of the coordinates and displacements to take, metric before pixels; None where there are none."""
    for position, moved in (METRIC, CALIBRATED, PIXEL):
        if {*position[:2], *moved[:2]} <= set(names):
            depth = len(position) if {*position, *moved} <= set(names) else 2
            return position[:depth], moved[:depth]
    return None


def vic_column(name: str, chosen: Names) -> Column:
    """The meaning and unit of a column, given those that are taken."""
    unit = "px" if chosen[0] == PIXEL[0] else "mm"
    if name in (*chosen[0], *chosen[1]):
        meaning = "xyz"[chosen[0].index(name)] if name in chosen[0] else "uvw"[chosen[1].index(name)]
        return Column(name, meaning, unit, "format")
    if name in STRAINS:
        return Column(name, STRAINS[name], "1", "format")
    return Column(name, "sigma", "px", "format") if name == "sigma" else Column(name)


def read(path: Path) -> DicStage:
    """Points of the stage in the order of the file, NaN where `sigma` < 0; `point_id` is the row. DataError for every defect."""
    text = read_text(path, _WHAT)
    header = next(k for k, line in enumerate(text.lines) if line.strip())
    separator = _separator(text.lines[header])
    names = header_cells(text.lines[header], separator)
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise DataError(
            f"{path}, line {header + 1}: two columns are called {twice[:30]!r}, expected each name once; export the stage again"
        )
    chosen = vic_columns(names)
    if chosen is None:
        raise DataError(
            f"{path}, line {header + 1}: found no columns X, Y, U, V nor x_c, y_c, u_c, v_c nor x, y, u, v, expected {_WHAT}; export again"
        )
    named = read_named(text, path, header, separator, lambda name, unit: vic_column(name, chosen))
    columns = {column.name: named.values[:, k] for k, column in enumerate(named.columns)}
    return vic_stage(columns, chosen, replace(named.traits, format=NAME))


def vic_stage(columns: Mapping[str, np.ndarray], chosen: Names, traits: Traits) -> DicStage:
    """The stage of columns (n,) by their names in VIC; `traits` are completed by the missing points and remarks."""
    position, moved = (_vectors(columns, names) for names in chosen)
    depth = len(chosen[0])
    missing = ~np.isfinite(position[:, :depth]).all(axis=1) | ~np.isfinite(moved[:, :depth]).all(axis=1)
    remarks = list(traits.remarks)
    if "sigma" in columns:
        missing |= ~(columns["sigma"] >= 0)
    else:
        zero = (position[:, :depth] == 0).all(axis=1) & (moved[:, :depth] == 0).all(axis=1)
        missing |= zero
        remarks.append(f"no column sigma: points with all coordinates and displacements 0 count as missing ({int(zero.sum())})")
    if missing.all():
        raise DataError(f"{traits.path}: none of the {len(missing)} points was correlated (sigma < 0), expected some; export another stage")
    is_pixel = chosen[0] == PIXEL[0]
    moved[missing] = np.nan
    if is_pixel:
        remarks.append("in px of the image: the file has no complete set of metric columns (X, Y, U, V or x_c, y_c, u_c, v_c)")
    else:
        # Pixels of a point that was not correlated are known; its metric coordinates are not, VIC writes 0.
        position[missing] = np.nan
        remarks.append("the file names no unit: metric columns are taken as mm, the unit of the calibration")
    strain = {key: np.where(missing, np.nan, columns[name]) for name, key in STRAINS.items() if name in columns}
    if strain:
        remarks.append("the measure of strain was chosen at export and is not in the file")
    return DicStage(
        traits=replace(traits, missing=int(missing.sum()), remarks=tuple(remarks)),
        point_id=np.arange(len(missing)),
        reference=position,
        displacement=moved,
        length_unit="px" if is_pixel else "mm",
        strain=strain,
    )


def _separator(line: str) -> str:
    return ";" if line.count(";") > line.count(",") else ","


def _vectors(columns: Mapping[str, np.ndarray], names: tuple[str, ...]) -> np.ndarray:
    """Columns as vectors (n, 3), NaN in a component that the file lacks."""
    vectors = np.full((len(columns[names[0]]), 3), np.nan)
    for k, name in enumerate(names):
        vectors[:, k] = columns[name]
    return vectors
