"""Ncorr (2-D correlation in MATLAB): the saved analysis, a MAT file of version 7.3 with all stages.

Fields lie on a regular grid of the reference image: node (row r, column c), one-based, sits at pixel ((c - 1) (spacing + 1) + 1,
(r - 1) (spacing + 1) + 1); x to the right, y DOWN, v positive downwards. `plot_*_ref_formatted` are multiplied by `pixtounits`; before
"Format displacements" they are empty and the raw `plot_*_dic` in px remain. Nodes outside the region of interest are zero in all of u, v
and the correlation coefficient; nodes above the cut-off of the coefficient are zeroed in u and v only. Strains are Green-Lagrange. The
masks are MATLAB class objects, which cannot be read; there is no time and no force.
Source: justinblaber/ncorr_2D_matlab, ncorr.m, ncorr_gui_formatdisp.m.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.units import known_unit
from thermofit.read.formats.contents import Column, DicSequence, DicStage, Head, Traits
from thermofit.records.foreign_hdf5 import foreign_names, read_foreign

NAME = "Ncorr MAT (version 7.3)"
ANALYSIS = "data_dic_save"
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_STRAINS = {name: f"plot_{name}_ref_formatted" for name in ("exx", "eyy", "exy")}


@dataclass(frozen=True)
class _Info:
    """The settings of an analysis: grid `step` px, `scale` units/px of the formatted fields, `length` mm/px (None: left in px)."""

    step: float
    scale: float
    unit: str
    length: float | None
    regular: bool
    cutoff: np.ndarray
    header: Mapping[str, str]


def recognises(head: Head) -> bool:
    """Whether the file is HDF5 (MATLAB puts 512 bytes before it) with the variable of an Ncorr analysis."""
    if not any(head.first[start : start + 8] == _SIGNATURE for start in (0, 512, 1024, 2048)):
        return False
    if ANALYSIS.encode() in head.first:
        return True
    try:
        return ANALYSIS in foreign_names(head.path)
    except DataError:
        return False


def read(path: Path) -> DicSequence:
    """All stages on the grid of the reference image, in mm where `units` is a length, else in px. DataError for every defect."""
    analysis = read_foreign(path, ANALYSIS, skip=lambda name: name.startswith("roi_") or name.endswith("_cur_formatted"))
    if not isinstance(analysis, dict):
        raise DataError(f"{path}: '{ANALYSIS}' is no struct, expected displacements and dispinfo; save the analysis in Ncorr again")
    info = _info(_struct(analysis, "dispinfo", path), path)
    fields = _struct(analysis, "displacements", path)
    formatted = _fields(fields, "plot_u_ref_formatted", path)
    is_formatted = bool(formatted) and all(field.size > 0 for field in formatted)
    if not is_formatted and not info.regular:
        raise DataError(
            f"{path}: backward analysis without formatted displacements, expected fields on the reference image; use "
            "'Format Displacements' in Ncorr and save again"
        )
    kind = "ref_formatted" if is_formatted else "dic"
    u, v, coefficient = (_fields(fields, name, path) for name in (f"plot_u_{kind}", f"plot_v_{kind}", "plot_corrcoef_dic"))
    _check_shapes(path, u, {f"plot_v_{kind}": v} | ({"plot_corrcoef_dic": coefficient} if info.regular else {}))
    strains = analysis.get("strains")
    strain = {key: _fields(strains, name, path) for key, name in _STRAINS.items()} if isinstance(strains, dict) else {}
    strain = {key: values for key, values in strain.items() if values and all(field.size for field in values)}
    _check_shapes(path, u, {_STRAINS[key]: values for key, values in strain.items()})
    stages = []
    for k in range(len(u)):
        missing = _missing(u[k], v[k], coefficient[k] if info.regular else None, info.cutoff[k] if k < info.cutoff.size else np.inf)
        here = _strains({key: values[k] for key, values in strain.items()}, missing)
        stages.append(_stage(path, info, is_formatted, u[k], v[k], missing, here, k + 1))
    total = sum(stage.traits.missing for stage in stages)
    if total == len(u) * u[0].size:
        raise DataError(f"{path}: no node of {len(u)} stages was correlated (u = v = 0 everywhere), expected some; correlate again")
    return DicSequence(_traits(path, info, is_formatted, total, tuple(strain)), tuple(stages))


def _info(info: Mapping[str, Any], path: Path) -> _Info:
    kind, unit = (_text(info, key, path) for key in ("type", "units"))
    if kind not in ("regular", "backward"):
        raise DataError(f"{path}: dispinfo.type is '{kind[:40]}', expected 'regular' or 'backward'; save the analysis in Ncorr again")
    spacing = _number(info, "spacing", path)
    if spacing < 0 or spacing != round(spacing) or spacing > 10_000:
        raise DataError(f"{path}: dispinfo.spacing is {spacing:g}, expected a whole number of px; save the analysis in Ncorr again")
    scale = _number(info, "pixtounits", path) if np.size(info.get("pixtounits", ())) else 1.0
    if not 1e-9 < scale < 1e9:
        raise DataError(
            f"{path}: dispinfo.pixtounits is {scale:g}, expected a positive length of a pixel; format the displacements in Ncorr again"
        )
    known = known_unit(unit)
    factor = known.factor if known is not None and known.quantity == "length" else None
    header = {"type": kind, "spacing": f"{spacing:g}", "pixtounits": f"{scale:.10g}", "units": unit}
    for key in ("radius", "lenscoef"):
        if np.size(info.get(key, ())) == 1:
            header[key] = f"{_number(info, key, path):g}"
    cutoff = info.get("cutoff_corrcoef", ())
    limits = np.ravel(np.asarray(cutoff, dtype=float)) if isinstance(cutoff, np.ndarray) and cutoff.dtype.kind in "fiu" else np.zeros(0)
    return _Info(spacing + 1.0, scale, unit, None if factor is None else factor * scale, kind == "regular", limits, header)


def _missing(u: np.ndarray, v: np.ndarray, coefficient: np.ndarray | None, cutoff: float) -> np.ndarray:
    """Nodes without a value: zero in u and v and either no coefficient (0) or one above the cut-off, and whatever is not finite.

    A backward analysis (`coefficient` is None) has its coefficient on the current image: there zeros in u and v decide.
    """
    zero = (u == 0) & (v == 0)
    if coefficient is not None:
        zero &= (coefficient == 0) | (coefficient > cutoff)
    return zero | ~np.isfinite(u) | ~np.isfinite(v)


def _strains(fields: Mapping[str, np.ndarray], missing: np.ndarray) -> dict[str, np.ndarray]:
    """Strains of a stage (n,); where all of them are 0 the node lies outside their region, which is smaller than that of u."""
    zero = np.all([values == 0 for values in fields.values()], axis=0) if fields else missing
    return {key: np.where(missing | zero | ~np.isfinite(values), np.nan, values).ravel() for key, values in fields.items()}


def _stage(
    path: Path,
    info: _Info,
    is_formatted: bool,
    u: np.ndarray,
    v: np.ndarray,
    missing: np.ndarray,
    strain: dict[str, np.ndarray],
    number: int,
) -> DicStage:
    """Stage `number`: displacements u, v and mask `missing` (n_row, n_column), strains (n,) by name."""
    length = 1.0 if info.length is None else info.length
    row, column = np.indices(u.shape)
    unknown = np.full(u.size, np.nan)
    to_length = length / info.scale if is_formatted else length
    with np.errstate(over="ignore"):  # found below
        reference = np.stack([length * (1.0 + info.step * column.ravel()), length * (1.0 + info.step * row.ravel()), unknown], axis=1)
        moved = [to_length * np.where(missing, np.nan, field).ravel() for field in (u, v)]
    if np.isinf(moved).any() or np.isinf(reference).any():
        raise DataError(f"{path}: pixtounits of {info.scale:g} makes infinite values of stage {number}; correct it in Ncorr and save again")
    traits = _traits(path, info, is_formatted, int(missing.sum()), tuple(strain))
    return DicStage(
        traits=traits,
        point_id=np.arange(u.size),
        reference=reference,
        displacement=np.stack([*moved, unknown], axis=1),
        length_unit="px" if info.length is None else "mm",
        strain=strain,
        stage=number,
    )


def _traits(path: Path, info: _Info, is_formatted: bool, missing: int, strains: tuple[str, ...]) -> Traits:
    kind = "ref_formatted" if is_formatted else "dic"
    unit, source = (info.unit, "file") if is_formatted else ("px", "format")
    columns = [Column(f"plot_{name}_{kind}", name, unit, source) for name in ("u", "v")]
    columns += [Column(_STRAINS[key], key, "1", "format") for key in strains]
    remarks = ["y and v point down (image rows)", "the file has no time and no force"]
    is_pixel = not info.unit or getattr(known_unit(info.unit), "fixed", "") == "px"
    if info.length is None and not is_pixel:
        remarks.append(f"the unit '{info.unit[:20]}' is no known length: everything is left in px")
    elif info.length is None and info.scale != 1.0:
        remarks.append(f"pixtounits is {info.scale:g}, but the unit is '{info.unit}': everything is left in px")
    if not is_formatted:
        remarks.append("the displacements were not formatted in Ncorr: raw fields were taken")
    if not info.regular:
        remarks.append("backward analysis: nodes with u = v = 0 count as missing")
    if info.header.get("lenscoef", "0") != "0":
        remarks.append("displacements are corrected for lens distortion, coordinates are not")
    return Traits(NAME, path, columns=tuple(columns), missing=missing, remarks=tuple(remarks), header=info.header)


def _struct(tree: Mapping[str, Any], name: str, path: Path) -> dict[str, Any]:
    found = tree.get(name)
    if not isinstance(found, dict):
        raise DataError(f"{path}: {ANALYSIS}.{name} is missing or empty, expected a struct; run the correlation in Ncorr and save again")
    return found


def _fields(group: Mapping[str, Any], name: str, path: Path) -> list[np.ndarray]:
    """One field for each stage (a single one is stored without references); an empty list where there is none."""
    found = group.get(name, [])
    fields = found if isinstance(found, list) else [found]
    for k, field in enumerate(fields, start=1):
        if not isinstance(field, np.ndarray) or field.ndim != 2 or field.dtype.kind not in "fiu":
            raise DataError(f"{path}: {name} of stage {k} is no matrix of numbers, expected a field on a grid; save the analysis again")
    with np.errstate(invalid="ignore"):  # a signalling NaN of damaged single precision
        return [np.asarray(field, dtype=float) for field in fields]


def _check_shapes(path: Path, u: list[np.ndarray], others: Mapping[str, list[np.ndarray]]) -> None:
    """All fields of all stages lie on one grid, or DataError."""
    if not u or u[0].size == 0:
        raise DataError(f"{path}: no displacements in {ANALYSIS}, expected at least one stage; run the correlation in Ncorr and save again")
    for name, fields in (("plot_u", u), *others.items()):
        if len(fields) != len(u):
            raise DataError(f"{path}: {name} has {len(fields)} stages, u has {len(u)}, expected as many; save the analysis again")
        wrong = next((k for k, field in enumerate(fields) if field.shape != u[0].shape), None)
        if wrong is not None:
            raise DataError(
                f"{path}: {name} of stage {wrong + 1} has the shape {fields[wrong].shape}, u of stage 1 has {u[0].shape}, expected "
                "one grid; save the analysis again"
            )


def _text(info: Mapping[str, Any], name: str, path: Path) -> str:
    found = info.get(name, "")
    if not isinstance(found, str):
        raise DataError(f"{path}: dispinfo.{name} is no text, expected one; save the analysis in Ncorr again")
    return found.strip()


def _number(info: Mapping[str, Any], name: str, path: Path) -> float:
    found = info.get(name)
    if not isinstance(found, np.ndarray) or found.size != 1 or found.dtype.kind not in "fiu" or not np.isfinite(found).all():
        raise DataError(f"{path}: dispinfo.{name} is missing or no finite number, expected one; save the analysis in Ncorr again")
    return float(found.ravel()[0])
