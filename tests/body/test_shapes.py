"""Built-in shapes: closed, right-handed, volumes of second order, the patch test, the stress concentration of a hole."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from small_bodies import MISES, area_vectors, patch_error

from thermofit.body.body import tension_body
from thermofit.body.mesh.mesh import Mesh, boundary_facets
from thermofit.body.mesh.quality import check_watertight, quality, symmetry_of
from thermofit.body.mesh.shapes import bar_mesh, cruciform_arm_mesh, plate_with_hole_mesh
from thermofit.body.solve.march import Loading, MarchSettings, march
from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.experiment import Specimen
from thermofit.study.section import MeshSize

PLATE = Specimen(20.05, 3.05, 80.0, 0.0, 20.05, 80.0, 0.0)
CROSS = Specimen(20.0, 2.0, 100.0, 0.0, 20.0, 100.0, 10.0)
HOLE, FILLET = 4.0, 5.0


def size(n: int) -> MeshSize:
    return MeshSize(n_x=2 * n, n_y=12 * n, n_z=1)


def volumes(kind: str) -> tuple[float, list[float]]:
    """Exact volume of the whole body, and those of three meshes, each twice as fine as the one before."""
    if kind == "cruciform":
        area = 15.0 * 10.0 + (10.0 * FILLET + FILLET**2 - 0.25 * np.pi * FILLET**2) + 10.0 * 35.0
        meshes = [cruciform_arm_mesh(CROSS, FILLET, size(n)) for n in (2, 4, 8)]
        return 4.0 * area, [quality(m).volume * symmetry_of(m) for m in meshes]
    meshes = [plate_with_hole_mesh(PLATE, HOLE, size(n), full=kind == "full") for n in (1, 2, 4)]
    return (20.05 * 80.0 - np.pi * HOLE**2) * 3.05, [quality(m).volume * symmetry_of(m) for m in meshes]


@pytest.mark.parametrize("kind", ["quarter", "full", "cruciform"])
def test_volume_converges_with_second_order(kind: str) -> None:
    exact, found = volumes(kind)
    if kind == "cruciform":
        exact /= 2.0  # symmetry_of counts x and z; the arm is one half of the body along y
        found = [v / 2.0 for v in found]
    error = np.abs(np.array(found) - exact)
    assert error[0] > 1e-6 * exact
    rates = np.log2(error[:-1] / error[1:])
    assert np.all((rates > 1.85) & (rates < 2.15)), rates


@pytest.mark.parametrize("full", [False, True])
def test_bar_has_its_volume_and_its_sets(full: bool) -> None:
    mesh = bar_mesh(dataclasses.replace(PLATE, gripped_length=10.0), MeshSize(n_x=2, n_y=8, n_z=1), full=full)
    assert quality(mesh).volume * symmetry_of(mesh) == pytest.approx(20.05 * 3.05 * 80.0, rel=1e-12)
    assert symmetry_of(mesh) == (1.0 if full else 4.0)
    assert np.allclose(mesh.nodes[mesh.node_sets["top"], 1], 40.0) and np.allclose(mesh.nodes[mesh.node_sets["face"], 2], 1.525)
    clamp, air = (mesh.nodes[mesh.facets[name]].mean(axis=1) for name in ("clamp", "air"))
    assert np.abs(clamp[:, 1]).min() >= 30.0 and np.abs(air[:, 1]).max() <= 30.0
    n_symmetric = 0 if full else 2 * 8 + 8
    assert len(mesh.facets["clamp"]) + len(mesh.facets["air"]) == len(boundary_facets(mesh.hexes)) - n_symmetric


@pytest.mark.parametrize("n_y", [12, 14, 23, 40])
def test_jaws_hold_the_area_that_they_hold_in_every_shape(n_y: int) -> None:
    """7.3 mm at the ends of a bar, a plate and the arm of a cruciform, which no even spacing meets."""
    held, counts = 7.3, MeshSize(n_x=2, n_y=n_y, n_z=1)
    plate, cross = (dataclasses.replace(s, gripped_length=held) for s in (PLATE, CROSS))
    for mesh, specimen, ends in (
        (bar_mesh(plate, counts), plate, 2),
        (plate_with_hole_mesh(plate, HOLE, counts), plate, 2),
        (cruciform_arm_mesh(cross, FILLET, counts), cross, 1),
    ):
        a, b = 0.5 * specimen.gauge_width, 0.5 * specimen.thickness
        area = np.linalg.norm(area_vectors(mesh.nodes, mesh.facets["clamp"]), axis=1).sum()
        assert area == pytest.approx(ends * (held * (a + b) + a * b), rel=1e-9)
    with pytest.raises(StudyError, match="at least 3 are needed for a bar"):
        bar_mesh(plate, MeshSize(n_x=2, n_y=2, n_z=1))
    with pytest.raises(StudyError, match=r"gripped_length 40 mm leaves nothing between the jaws of a bar of 80 mm"):
        bar_mesh(dataclasses.replace(plate, gripped_length=40.0), counts)


def test_clamp_of_a_cruciform_is_its_loaded_end_only() -> None:
    mesh = cruciform_arm_mesh(CROSS, FILLET, size(2))
    assert mesh.nodes[mesh.facets["clamp"]][:, :, 1].min() >= 40.0 - 6.0
    assert np.allclose(mesh.nodes[mesh.node_sets["bottom"], 1], 0.0)
    assert mesh.nodes[:, 0].max() == pytest.approx(10.0 + FILLET)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: plate_with_hole_mesh(PLATE, 11.0, size(1)), "radius 11 mm"),
        (lambda: plate_with_hole_mesh(dataclasses.replace(PLATE, total_length=20.0), 4.0, size(1)), "length above the width"),
        (lambda: plate_with_hole_mesh(PLATE, 4.0, MeshSize(n_x=2, n_y=4, n_z=1)), r"mesh\.n_y: 4"),
        (lambda: cruciform_arm_mesh(CROSS, 45.0, size(1)), "leaves no arm"),
        (lambda: cruciform_arm_mesh(CROSS, 5.0, MeshSize(n_x=2, n_y=2, n_z=1)), r"mesh\.n_y: 2"),
    ],
)
def test_impossible_shapes(make, text: str) -> None:
    with pytest.raises(StudyError, match=text):
        make()


def broken(mesh: Mesh, how: str) -> Mesh:
    if how == "torn":  # one element has its own copy of a node
        nodes = np.concatenate([mesh.nodes, mesh.nodes[mesh.hexes[3, :1]]])
        hexes = mesh.hexes.copy()
        hexes[3, 0] = len(mesh.nodes)
        return dataclasses.replace(mesh, nodes=nodes, hexes=hexes)
    if how == "two":
        nodes = np.concatenate([mesh.nodes, mesh.nodes + 500.0])
        return dataclasses.replace(mesh, nodes=nodes, hexes=np.concatenate([mesh.hexes, mesh.hexes + mesh.n_nodes]))
    if how == "twice":
        return dataclasses.replace(mesh, hexes=np.concatenate([mesh.hexes, mesh.hexes[:1]]))
    return dataclasses.replace(mesh, nodes=np.concatenate([mesh.nodes, [[0.0, 0.0, 9.0]]]))


@pytest.mark.parametrize(
    ("how", "text"), [("torn", "coincide"), ("two", "2 pieces"), ("twice", "duplicate elements"), ("loose", "no element")]
)
def test_unsound_meshes_are_refused(how: str, text: str) -> None:
    mesh = bar_mesh(PLATE, MeshSize(n_x=2, n_y=4, n_z=2), full=True)
    check_watertight(mesh)
    with pytest.raises(NumericsError, match=text):
        check_watertight(broken(mesh, how))


@pytest.mark.parametrize("shape", ["plate", "cruciform"])
def test_patch_test_of_generated_meshes(shape: str) -> None:
    if shape == "plate":
        mesh = plate_with_hole_mesh(PLATE, HOLE, MeshSize(n_x=1, n_y=8, n_z=2))
    else:
        mesh = cruciform_arm_mesh(CROSS, FILLET, MeshSize(n_x=2, n_y=5, n_z=2))
    assert patch_error(mesh) < 1e-10


def concentration(full: bool, n: int) -> float:
    """Largest stress over gross stress at the hole of a thin plate, from the strain along its edge (uniaxial there)."""
    plate = dataclasses.replace(PLATE, thickness=0.4)
    mesh = plate_with_hole_mesh(plate, HOLE, MeshSize(n_x=n, n_y=6 * n, n_z=1), full=full)
    body = tension_body(mesh, symmetry=symmetry_of(mesh))
    gross = 1.0
    time = np.array([0.0, 1.0])
    p = MISES.replace(alpha_exp=0.0, alpha_air=0.0, theta_air=297.0, theta_clamp=297.0, theta_ref=297.0, E=70000.0, nu=0.3)
    u = march(body, p, Loading(time, time * gross * 20.05 * 0.4), time, MarchSettings(plastic=False)).u[-1]
    angle = np.pi / 4.0 / n
    ends = [mesh.nearest_node((HOLE * np.cos(angle), sign * HOLE * np.sin(angle), 0.2)) for sign in (1.0, -1.0)]
    x = mesh.nodes[ends]
    assert np.allclose(np.hypot(x[:, 0], x[:, 1]), HOLE)
    return float(70000.0 * (u[ends[0], 1] - u[ends[1], 1]) / (x[0, 1] - x[1, 1]) / gross)


@pytest.mark.parametrize("full", [False, True])
def test_stress_concentration_of_the_hole(full: bool) -> None:
    """Howland's finite plate (Peterson, chart 4.1): K_tn = 2 + 0.284 c - 0.6 c^2 + 1.32 c^3, c = 1 - d/W, K_tg = K_tn / c."""
    c = 1.0 - 2.0 * HOLE / 20.05
    howland = (2.0 + 0.284 * c - 0.6 * c**2 + 1.32 * c**3) / c
    assert concentration(full, 6 if full else 12) == pytest.approx(howland, rel=0.06 if full else 0.03)
