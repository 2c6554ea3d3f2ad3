"""Meshes from files (Abaqus .inp, Gmsh .msh, VTK, whatever meshio reads): hex8 only, with named sets, repaired where that is safe."""

from __future__ import annotations

import contextlib
import io
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from thermofit.body.element.hex8 import reference_gradients
from thermofit.body.mesh.file_sets import FileSet, sets_of
from thermofit.body.mesh.mesh import Mesh, boundary_facets
from thermofit.body.mesh.quality import check_watertight
from thermofit.body.mesh.sets import facets_within, on_plane
from thermofit.core.errors import DataError, NumericsError
from thermofit.study.errors import near_miss

MILLIMETRES: Mapping[str, float] = {"m": 1e3, "cm": 10.0, "mm": 1.0, "um": 1e-3, "in": 25.4}
"""Length in mm of the units that a study may name."""
NODE_SETS = ("x0", "z0", "bottom", "top", "face")
"""Sets that a tension test needs."""
_FLAT = ("vertex", "line", "line3", "triangle", "quad")
"""Cells that may accompany the hexahedra: geometry and the facets of named groups."""
_LEFT_HANDED = np.array([0, 3, 2, 1, 4, 7, 6, 5])
_PLANE = re.compile(r"^\s*([xyz])\s*=\s*([-+0-9.eE]+)\s*$")
_BROKEN = (RuntimeError, ValueError, KeyError, IndexError, TypeError, AttributeError, AssertionError, EOFError, struct.error, SystemExit)
"""What meshio raises for files that are not what they say."""


@dataclass(frozen=True)
class Imported:
    """A mesh in mm with all its sets, and what was repaired or completed, in words."""

    mesh: Mesh
    remarks: tuple[str, ...]


def import_mesh(path: Path, unit: str, wanted: Mapping[str, str]) -> Imported:
    """The mesh of a file whose coordinates are in `unit`; `wanted` maps sets of the model to names in the file or planes "x=0" (mm).

    A set that `wanted` does not name is taken from the set of that name in the file. Left-handed elements are turned and unused nodes
    removed, both counted. DataError for a file that cannot be read, other elements than hex8, folded elements, missing sets, a body
    that is not closed or not in one piece.
    """
    raw = _read(path)
    hexes = _hexes(path, raw)
    points = np.asarray(raw.points, dtype=float) * MILLIMETRES[unit]
    if points.shape[1] != 3 or not np.isfinite(points).all():
        raise DataError(f"{path}: coordinates of {points.shape[1]} components or not finite found, expected x, y, z; export the mesh again")
    hexes, remarks = _right_handed(path, points, hexes)
    used, inverse = np.unique(hexes, return_inverse=True)
    dropped = len(points) - len(used)
    if dropped:
        remarks.append(f"{dropped} nodes that belong to no element removed")
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))
    nodes, cells = points[used], inverse.reshape(hexes.shape)
    named = {name: found.renumbered(number) for name, found in sets_of(path, raw).items()}
    mesh = _with_sets(path, (nodes, cells), named, wanted, remarks)
    try:
        check_watertight(mesh)
    except NumericsError as error:
        raise DataError(f"{path}: {error}") from None
    return Imported(mesh, tuple(remarks))


def _read(path: Path) -> meshio.Mesh:
    if not path.is_file():
        raise DataError(f"{path}: the mesh file does not exist; correct the key geometry.file of the study")
    noise = io.StringIO()
    try:
        with contextlib.redirect_stdout(noise), contextlib.redirect_stderr(noise):
            return meshio.read(path)
    except (meshio.ReadError, OSError, *_BROKEN) as error:
        what = " ".join(str(error).split()) or type(error).__name__
        raise DataError(f"{path}: not readable as a mesh ({what}); expected Abaqus .inp, Gmsh .msh or VTK with hexahedra") from None


def _hexes(path: Path, raw: meshio.Mesh) -> np.ndarray:
    """All hexahedra (n_el, 8) in the order of the file. DataError where there are none, or other solid elements."""
    others: dict[str, int] = {}
    for block in raw.cells:
        if block.type != "hexahedron" and block.type not in _FLAT:
            others[block.type] = others.get(block.type, 0) + len(block.data)
    if others:
        found = ", ".join(f"{count} {kind}" for kind, count in others.items())
        raise DataError(f"{path}: {found} elements found, expected hexahedra of 8 nodes only; mesh the body with hex8 (extruded quads)")
    blocks = [block.data for block in raw.cells if block.type == "hexahedron"]
    if not blocks:
        raise DataError(f"{path}: no hexahedra found, expected a solid mesh of hex8; export the volume elements too")
    hexes = np.concatenate(blocks).astype(np.int64)
    if hexes.min() < 0 or hexes.max() >= len(raw.points):
        raise DataError(f"{path}: an element names node {hexes.max()} of {len(raw.points)}; export the mesh again")
    return hexes


def _right_handed(path: Path, points: np.ndarray, hexes: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Elements with positive volume: those that are wholly left-handed are turned; DataError for folded or flat ones."""
    _, volume = reference_gradients(points, hexes)
    left = (volume < 0.0).all(axis=1)
    turned = hexes.copy()
    turned[left] = hexes[left][:, _LEFT_HANDED]
    bad = np.flatnonzero(~left & (volume <= 0.0).any(axis=1))
    if bad.size:
        raise DataError(
            f"{path}: {bad.size} elements are folded or flat (their Jacobian changes its sign), the first is number {bad[0] + 1} of the "
            "file's hexahedra; repair the mesh where it was made"
        )
    return turned, [f"{int(left.sum())} left-handed elements turned"] if left.any() else []


def _with_sets(
    path: Path, body: tuple[np.ndarray, np.ndarray], named: Mapping[str, FileSet], wanted: Mapping[str, str], remarks: list[str]
) -> Mesh:
    """The mesh with the sets of a tension test and its films."""
    nodes, hexes = body
    found = {name: _resolve(path, text, nodes, named) for name, text in wanted.items()}
    for name, here in named.items():
        if name.lower() in NODE_SETS or name.lower().partition("_")[0] in ("air", "clamp"):
            found.setdefault(name.lower(), here)
    missing = [name for name in NODE_SETS if name not in found]
    if missing:
        have = ", ".join(sorted(named)) or "none"
        raise DataError(
            f"{path}: set '{missing[0]}' is missing; the file has {have}: name the set or a plane in the study, such as "
            f'geometry.sets: {{{missing[0]}: "{_EXAMPLE[missing[0]]}"}}'
        )
    empty = [name for name, here in found.items() if not here.nodes.any()]
    if empty:
        raise DataError(f"{path}: set '{empty[0]}' holds no node of the body; correct geometry.sets (planes are in mm)")
    return Mesh(
        nodes=nodes,
        hexes=hexes,
        facets=_films(hexes, found, remarks),
        node_sets={name: np.flatnonzero(found[name].nodes) for name in NODE_SETS},
    )


_EXAMPLE = {"x0": "x=0", "z0": "z=0", "bottom": "y=-50", "top": "y=50", "face": "z=1"}


def _resolve(path: Path, text: str, nodes: np.ndarray, named: Mapping[str, FileSet]) -> FileSet:
    match = _PLANE.match(text)
    if match:
        try:
            return FileSet(on_plane(nodes, "xyz".index(match.group(1)), float(match.group(2))))
        except ValueError:
            raise DataError(f"geometry.sets: the plane '{text}' is not understood; expected such as \"x=0\" in mm") from None
    by_lower = {name.lower(): here for name, here in named.items()}
    if text.lower() not in by_lower:
        raise DataError(f"{path}: no set '{text}' in the file{near_miss(text, named) if named else ''}; or give a plane such as \"x=0\"")
    return by_lower[text.lower()]


def _films(hexes: np.ndarray, found: Mapping[str, FileSet], remarks: list[str]) -> dict[str, np.ndarray]:
    """Facet sets of the films: those that are named; clamp is else the end faces, air the free facets that are left."""
    outer = boundary_facets(hexes)
    flat = np.zeros(len(outer), dtype=bool)
    for name in ("x0", "z0"):
        flat |= found[name].nodes[outer].all(axis=1)
    films = {}
    for name in sorted(found):
        if name not in NODE_SETS:
            facets = found[name].facets
            films[name] = facets_within(hexes, found[name].nodes) if facets is None else _outward(outer, facets)
    if not any(name.startswith("clamp") for name in films):
        ends = found["bottom"].nodes[outer].all(axis=1) | found["top"].nodes[outer].all(axis=1)
        films["clamp"] = outer[ends & ~flat]
        remarks.append("no set clamp: the end faces touch the jaws")
    if not any(name.startswith("air") for name in films):
        taken = {tuple(key) for facets in films.values() for key in np.sort(facets, axis=1).tolist()}
        keep = np.array([tuple(key) not in taken for key in np.sort(outer, axis=1).tolist()], dtype=bool)
        films["air"] = outer[keep & ~flat]
        remarks.append("no set air: all other free faces")
    return films


def _outward(outer: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Those boundary facets, oriented outward, that are among `facets` (n_f, 4) in any order of their nodes."""
    asked = {tuple(key) for key in np.sort(facets, axis=1).tolist()}
    return outer[np.array([tuple(key) in asked for key in np.sort(outer, axis=1).tolist()], dtype=bool)]
