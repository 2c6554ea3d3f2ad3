"""Named sets of a mesh file: Abaqus NSET, ELSET and SURFACE, Gmsh physical groups, marks on the points of a VTK file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from thermofit.core.errors import DataError

ABAQUS_FACES = np.array([[0, 1, 2, 3], [4, 7, 6, 5], [0, 4, 5, 1], [1, 5, 6, 2], [2, 6, 7, 3], [3, 7, 4, 0]])
"""Local nodes of the faces S1 to S6 of C3D8 (Abaqus Analysis User's Guide, three-dimensional solid element library)."""


@dataclass(frozen=True)
class FileSet:
    """`nodes` (n_np,) True for the nodes of the set; `facets` (n_f, 4) where the file names faces, else None."""

    nodes: np.ndarray
    facets: np.ndarray | None = None

    def renumbered(self, number: np.ndarray) -> FileSet:
        """The set after nodes were removed; `number` (n_np,) is the new number of a node, -1 for one that is gone."""
        kept = number >= 0
        if self.facets is None:
            return FileSet(self.nodes[kept])
        facets = number[self.facets]
        return FileSet(self.nodes[kept], facets[(facets >= 0).all(axis=1)])


def sets_of(path: Path, raw: meshio.Mesh) -> dict[str, FileSet]:
    """All named sets of a file that meshio has read; surfaces of an Abaqus file are read here. DataError for a wrong surface."""
    n = len(raw.points)
    found = {name: FileSet(_mask(n, ids)) for name, ids in (raw.point_sets or {}).items()}
    for name, parts in (raw.cell_sets or {}).items():
        if not name.startswith("gmsh:"):
            pairs = [(raw.cells[k], np.asarray(ids, dtype=int)) for k, ids in enumerate(parts) if ids is not None and len(ids)]
            found[name] = _of_cells(n, [(block.type, block.data[ids]) for block, ids in pairs])
    physical = (raw.cell_data or {}).get("gmsh:physical")
    if physical is not None:
        for name, entry in (raw.field_data or {}).items():
            tag, dimension = int(entry[0]), int(entry[1])
            pairs = [(b.type, b.data[np.asarray(tags) == tag]) for b, tags in zip(raw.cells, physical, strict=True) if b.dim == dimension]
            found[name] = _of_cells(n, pairs)
    for name, values in (raw.point_data or {}).items():
        marks = np.asarray(values)
        if marks.ndim == 1 and np.isin(marks, (0, 1)).all():
            found[name] = FileSet(marks.astype(bool))
    if path.suffix.lower() == ".inp":
        found |= _surfaces(path, raw, found)
    return found


def _mask(n: int, ids: np.ndarray) -> np.ndarray:
    mask = np.zeros(n, dtype=bool)
    mask[np.asarray(ids, dtype=int)] = True
    return mask


def _of_cells(n: int, parts: list[tuple[str, np.ndarray]]) -> FileSet:
    """Set of the nodes of some cells; of quadrilaterals the facets too."""
    nodes = np.unique(np.concatenate([data.ravel() for _, data in parts])) if parts else np.empty(0, dtype=int)
    quads = [data for kind, data in parts if kind == "quad" and len(data)]
    return FileSet(_mask(n, nodes), np.concatenate(quads) if quads else None)


def _surfaces(path: Path, raw: meshio.Mesh, found: dict[str, FileSet]) -> dict[str, FileSet]:
    """The *SURFACE blocks (TYPE=ELEMENT, the default, and NODE) of an Abaqus file."""
    hexes = np.concatenate([b.data for b in raw.cells if b.type == "hexahedron"])
    offset = np.cumsum([0] + [len(b.data) if b.type == "hexahedron" else 0 for b in raw.cells])
    members = {
        name.lower(): np.concatenate(
            [np.asarray(ids, dtype=int) + offset[k] for k, ids in enumerate(parts) if ids is not None and len(ids)]
        )
        for name, parts in (raw.cell_sets or {}).items()
        if any(ids is not None and len(ids) for ids in parts)
    }
    blocks, labels = _keyword_blocks(path)
    index = {label: k for k, label in enumerate(labels)}
    by_lower = {name.lower(): here for name, here in found.items()}
    out = {}
    for number, options, lines in blocks:
        name, kind = options.get("name", ""), options.get("type", "element").lower()
        facets, nodes = [], np.zeros(len(raw.points), dtype=bool)
        for line in lines:
            what, _, face = (part.strip() for part in line.partition(","))
            if kind == "node":
                if what.lower() not in by_lower:
                    raise DataError(f"{path}, line {number}: surface '{name}' names node set '{what}', which is not there; correct it")
                nodes |= by_lower[what.lower()].nodes
                continue
            ids = members.get(what.lower(), np.array([index[what]]) if what in index else None)
            if ids is None or face.upper() not in ("S1", "S2", "S3", "S4", "S5", "S6"):
                raise DataError(
                    f"{path}, line {number}: surface '{name}' holds '{line}', expected an element or element set and a face S1 to S6"
                )
            facets.append(hexes[ids][:, ABAQUS_FACES[int(face[1]) - 1]])
        if facets:
            nodes[np.concatenate(facets).ravel()] = True
        out[name] = FileSet(nodes, np.concatenate(facets) if facets else None)
    return out


def _keyword_blocks(path: Path) -> tuple[list[tuple[int, dict[str, str], list[str]]], list[str]]:
    """The *SURFACE blocks (line, options, data lines) of an Abaqus file and the labels of its hexahedra in their order."""
    blocks: list[tuple[int, dict[str, str], list[str]]] = []
    labels: list[str] = []
    keyword, pending = "", False
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), start=1):
        text = line.strip()
        if text.startswith("**") or not text:
            continue
        if text.startswith("*"):
            keyword, *rest = (part.strip() for part in text[1:].split(","))
            options = {key.strip().lower(): value.strip() for key, _, value in (part.partition("=") for part in rest)}
            keyword, pending = keyword.lower(), False
            solid = keyword == "element" and options.get("type", "").upper().startswith("C3D8")
            keyword = "hexes" if solid else keyword
            if keyword == "surface":
                blocks.append((number, options, []))
        elif keyword == "surface":
            blocks[-1][2].append(text)
        elif keyword == "hexes":
            if not pending:
                labels.append(text.split(",")[0].strip())
            pending = text.endswith(",")  # an element goes on in the next line
    return blocks, labels
