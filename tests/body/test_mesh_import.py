"""Meshes from files: three formats there and back, sets by name and by plane, repairs that are counted, files that are refused."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest
from small_bodies import bar_mesh, patch_error

from thermofit.body.mesh.imported import import_mesh
from thermofit.body.mesh.mesh import boundary_facets
from thermofit.body.mesh.quality import quality, symmetry_of
from thermofit.core.errors import DataError

BLOCK = bar_mesh((2, 4, 2), (5.0, 20.0, 1.0), distortion=0.3)
PLANES = {"x0": "x=0", "z0": "z=0", "bottom": "y=0", "top": "y=20", "face": "z=1"}
SUFFIX = {"abaqus": ".inp", "gmsh22": ".msh", "gmsh": ".msh", "vtk": ".vtk"}


def nodes_of(name: str) -> np.ndarray:
    axis, _, at = {**PLANES, "right": "x=5"}[name].partition("=")
    return np.flatnonzero(np.isclose(BLOCK.nodes[:, "xyz".index(axis)], float(at)))


def facets_on(name: str) -> np.ndarray:
    outer = boundary_facets(BLOCK.hexes)
    return outer[np.isin(outer, nodes_of(name)).all(axis=1)]


def written(folder: Path, kind: str, *, factor: float = 1.0, hexes: np.ndarray = BLOCK.hexes) -> Path:
    """The block in a format, with its sets in the way of that format; `factor` scales the coordinates."""
    path = folder / f"block{SUFFIX[kind]}"
    points, cells = BLOCK.nodes * factor, [("hexahedron", hexes)]
    if kind == "abaqus":
        sets = {name: nodes_of(name) for name in PLANES}
        meshio.write(path, meshio.Mesh(points, cells, point_sets=sets))
    elif kind == "vtk":
        marks = {name: np.isin(np.arange(len(points)), nodes_of(name)).astype(int) for name in PLANES}
        meshio.write(path, meshio.Mesh(points, cells, point_data=marks))
    else:
        quads = [facets_on(name) for name in PLANES]
        tags = [np.full(len(hexes), 99), *(np.full(len(q), 1 + k) for k, q in enumerate(quads))]
        names = {name: np.array([1 + k, 2]) for k, name in enumerate(PLANES)} | {"body": np.array([99, 3])}
        data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
        mesh = meshio.Mesh(points, [*cells, *(("quad", q) for q in quads)], cell_data=data, field_data=names)
        meshio.write(path, mesh, file_format="gmsh22")
    return path


@pytest.mark.parametrize("kind", ["abaqus", "gmsh22", "vtk"])
def test_round_trip(tmp_path: Path, kind: str) -> None:
    made = import_mesh(written(tmp_path, kind), "mm", {})
    assert np.allclose(made.mesh.nodes, BLOCK.nodes) and np.array_equal(made.mesh.hexes, BLOCK.hexes)
    for name in PLANES:
        assert np.array_equal(np.sort(made.mesh.node_sets[name]), nodes_of(name)), name
    assert symmetry_of(made.mesh) == 4.0
    assert quality(made.mesh).volume == pytest.approx(100.0)
    assert len(made.mesh.facets["clamp"]) == 2 * 2 * 2
    assert len(made.mesh.facets["clamp"]) + len(made.mesh.facets["air"]) == len(boundary_facets(BLOCK.hexes)) - 2 * 2 * 4
    assert made.remarks == ("no set clamp: the end faces touch the jaws", "no set air: all other free faces")
    assert patch_error(made.mesh) < 1e-10


def test_planes_and_unit(tmp_path: Path) -> None:
    path = tmp_path / "bare.vtk"
    meshio.write(path, meshio.Mesh(BLOCK.nodes * 1e-3, [("hexahedron", BLOCK.hexes)]))
    made = import_mesh(path, "m", PLANES)
    assert np.allclose(made.mesh.nodes, BLOCK.nodes)
    assert np.array_equal(made.mesh.node_sets["top"], nodes_of("top"))
    with pytest.raises(DataError, match="'top' holds no node"):
        import_mesh(path, "mm", PLANES)


def test_names_of_the_file_may_differ(tmp_path: Path) -> None:
    path = tmp_path / "named.inp"
    meshio.write(path, meshio.Mesh(BLOCK.nodes, [("hexahedron", BLOCK.hexes)], point_sets={"GRIP_HIGH": nodes_of("top")}))
    made = import_mesh(path, "mm", {**PLANES, "top": "grip_high", "clamp": "GRIP_HIGH"})
    assert np.array_equal(made.mesh.node_sets["top"], nodes_of("top"))
    assert len(made.mesh.facets["clamp"]) == 4
    with pytest.raises(DataError, match="no set 'GRIP_HIHG' in the file; did you mean 'GRIP_HIGH'"):
        import_mesh(path, "mm", {**PLANES, "top": "GRIP_HIHG"})


def test_abaqus_surfaces_and_element_sets(tmp_path: Path) -> None:
    """Surfaces by element sets and by single elements; the facets are those of the named faces, not all whose nodes are touched."""
    path = written(tmp_path, "abaqus")
    last = len(BLOCK.hexes)
    ends = [k + 1 for k in range(last) if np.isin(BLOCK.hexes[k], nodes_of("top")).any()]
    side = next(s for s in range(1, 7) if touches(ends[0] - 1, s, "top"))
    text = path.read_text() + f"*ELSET, ELSET=ENDS\n{', '.join(map(str, ends[1:]))}\n"
    text += f"*SURFACE, NAME=clamp, TYPE=ELEMENT\nENDS, S{side}\n{ends[0]}, S{side}\n"
    path.write_text(text)
    made = import_mesh(path, "mm", {})
    assert np.array_equal(np.unique(made.mesh.facets["clamp"]), nodes_of("top"))
    assert len(made.mesh.facets["clamp"]) == 4
    assert made.remarks == ("no set air: all other free faces",)
    path.write_text(text + "*SURFACE, NAME=wrong\nENDS, S7\n")
    with pytest.raises(DataError, match=r"block\.inp, line \d+: surface 'wrong' holds 'ENDS, S7'"):
        import_mesh(path, "mm", {})


@pytest.mark.parametrize("plane", [*PLANES, "right"])
def test_every_face_of_an_abaqus_element(tmp_path: Path, plane: str) -> None:
    """A surface of single elements on each side of the block holds exactly the facets of that side."""
    path = written(tmp_path, "abaqus")
    lines = [f"{k + 1}, S{s}" for k in range(len(BLOCK.hexes)) for s in range(1, 7) if touches(k, s, plane)]
    path.write_text(path.read_text() + "*SURFACE, NAME=air_side, TYPE=ELEMENT\n" + "\n".join(lines) + "\n")
    facets = import_mesh(path, "mm", {}).mesh.facets["air_side"]
    assert np.array_equal(np.unique(np.sort(facets, axis=1), axis=0), np.unique(np.sort(facets_on(plane), axis=1), axis=0))
    assert len(facets) == len(lines) >= 4


def touches(element: int, face: int, name: str) -> bool:
    """Faces of C3D8 by the geometry of the block, without the table under test: S1, S2 bottom, top; S3 to S6 the sides in turn."""
    local = {1: (0, 1, 2, 3), 2: (4, 5, 6, 7), 3: (0, 1, 4, 5), 4: (1, 2, 5, 6), 5: (2, 3, 6, 7), 6: (3, 0, 7, 4)}[face]
    return bool(np.isin(BLOCK.hexes[element][list(local)], nodes_of(name)).all())


def test_left_handed_elements_are_turned_and_counted(tmp_path: Path) -> None:
    hexes = BLOCK.hexes.copy()
    hexes[[1, 5, 7]] = hexes[[1, 5, 7]][:, [4, 5, 6, 7, 0, 1, 2, 3]]
    made = import_mesh(written(tmp_path, "abaqus", hexes=hexes), "mm", {})
    assert made.remarks[0] == "3 left-handed elements turned"
    assert quality(made.mesh).volume == pytest.approx(100.0)
    assert patch_error(made.mesh) < 1e-10


def test_nodes_without_element_are_removed_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "loose.inp"
    points = np.concatenate([[[9.0, 9.0, 9.0]], BLOCK.nodes, [[7.0, 7.0, 7.0]]])
    sets = {name: nodes_of(name) + 1 for name in PLANES}
    meshio.write(path, meshio.Mesh(points, [("hexahedron", BLOCK.hexes + 1)], point_sets=sets))
    made = import_mesh(path, "mm", {})
    assert made.remarks[0] == "2 nodes that belong to no element removed"
    assert np.allclose(made.mesh.nodes, BLOCK.nodes) and np.array_equal(made.mesh.node_sets["top"], nodes_of("top"))


def refused(path: Path, text: str, sets: dict[str, str] = PLANES) -> None:
    with pytest.raises(DataError, match=text) as error:
        import_mesh(path, "mm", sets)
    assert "\n" not in str(error.value)


def test_other_elements_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "tets.vtk"
    meshio.write(path, meshio.Mesh(BLOCK.nodes, [("hexahedron", BLOCK.hexes), ("tetra", BLOCK.hexes[:5, :4])]))
    refused(path, "5 tetra elements found, expected hexahedra")
    meshio.write(path, meshio.Mesh(BLOCK.nodes, [("quad", facets_on("top"))]))
    refused(path, "no hexahedra found")


def test_folded_elements_are_refused(tmp_path: Path) -> None:
    hexes = BLOCK.hexes.copy()
    hexes[2, [0, 1]] = hexes[2, [1, 0]]
    refused(written(tmp_path, "vtk", hexes=hexes), "1 elements are folded or flat .*the first is number 3")


def test_missing_sets_and_files(tmp_path: Path) -> None:
    path = tmp_path / "bare.vtk"
    meshio.write(path, meshio.Mesh(BLOCK.nodes, [("hexahedron", BLOCK.hexes)]))
    refused(path, "set 'face' is missing; the file has none", {k: v for k, v in PLANES.items() if k != "face"})
    refused(tmp_path / "none.inp", "does not exist")
    refused(path, "plane 'x=1e' is not understood", {**PLANES, "x0": "x=1e"})


@pytest.mark.parametrize("kind", ["abaqus", "gmsh22", "vtk"])
def test_damaged_files_are_one_sentence(tmp_path: Path, kind: str) -> None:
    """Cut anywhere, the file is refused or still a mesh; never a traceback."""
    whole = written(tmp_path, kind).read_bytes()
    path = tmp_path / f"cut{SUFFIX[kind]}"
    for share in np.linspace(0.02, 0.98, 25):
        path.write_bytes(whole[: int(share * len(whole))])
        try:
            import_mesh(path, "mm", PLANES)
        except DataError as error:
            assert "\n" not in str(error)


def test_a_torn_body_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "two.vtk"
    points = np.concatenate([BLOCK.nodes, BLOCK.nodes + np.array([0.0, 20.0, 0.0])])
    meshio.write(path, meshio.Mesh(points, [("hexahedron", np.concatenate([BLOCK.hexes, BLOCK.hexes + BLOCK.n_nodes]))]))
    refused(path, "9 pairs of nodes coincide", {**PLANES, "top": "y=40"})
