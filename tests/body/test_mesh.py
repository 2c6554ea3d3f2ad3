"""Meshes: topology, orientation, geometry of the dogbone, sentences for impossible input."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from small_bodies import SPECIMEN, area_vectors, bar_mesh

from thermofit.body.element.hex8 import reference_gradients
from thermofit.body.mesh.dogbone import dogbone_mesh, half_width, plane_positions, shoulder_length
from thermofit.body.mesh.mesh import HEX_FACES, Mesh, boundary_facets, check_mesh, structured_hexes
from thermofit.body.mesh.planes import split_at
from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.experiment import Specimen


@given(st.tuples(*[st.integers(1, 4)] * 3))
def test_boundary_of_a_block(counts: tuple[int, int, int]) -> None:
    """Every inner face is shared by two elements; the outer ones point outward: their area vectors and x . da / 3 give 0 and the volume."""
    n_x, n_y, n_z = counts
    mesh = bar_mesh(counts, (2.0, 3.0, 0.5), distortion=0.3)
    facets = boundary_facets(mesh.hexes)
    assert len(facets) == 2 * (n_x * n_y + n_y * n_z + n_z * n_x)
    area = area_vectors(mesh.nodes, facets)
    assert area.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-13)
    assert np.sum(area * mesh.nodes[facets].mean(axis=1)) / 3.0 == pytest.approx(3.0, rel=1e-13)
    _, volume = reference_gradients(mesh.nodes, mesh.hexes)
    assert np.all(volume > 0.0) and volume.sum() == pytest.approx(3.0, rel=1e-13)


def test_nodes_are_numbered_plane_by_plane_along_y() -> None:
    """What keeps the band narrow: an element never spans more than two planes of nodes."""
    hexes = structured_hexes(3, 5, 2)
    plane = 4 * 3
    assert hexes.max() == 6 * plane - 1
    assert np.all(hexes.max(axis=1) // plane - hexes.min(axis=1) // plane == 1)
    with pytest.raises(StudyError, match="at least 1"):
        structured_hexes(3, 0, 2)


def test_local_faces_point_outward() -> None:
    mesh = bar_mesh((1, 1, 1), (1.0, 1.0, 1.0))
    faces = mesh.hexes[0][HEX_FACES]
    outward = mesh.nodes[faces].mean(axis=1) - 0.5
    assert np.sum(area_vectors(mesh.nodes, faces) * outward, axis=1) == pytest.approx(0.5 * np.ones(6))


def test_half_width_is_a_circle_that_leaves_the_gauge_tangentially() -> None:
    y = np.array([0.0, 50.0, 57.0, 65.0, 75.0])
    assert half_width(SPECIMEN, y) == pytest.approx([12.5, 12.5, 37.5 - np.sqrt(25.0**2 - 7.0**2), 17.5, 17.5])
    assert half_width(SPECIMEN, -y) == pytest.approx(half_width(SPECIMEN, y))
    assert shoulder_length(SPECIMEN) == pytest.approx(15.0)
    assert half_width(SPECIMEN, np.array([50.0 + 1e-4]))[0] - 12.5 < 1e-9


@pytest.mark.parametrize("counts", [(2, 8, 1), (6, 40, 2)])
def test_dogbone(counts: tuple[int, int, int]) -> None:
    mesh = dogbone_mesh(SPECIMEN, *counts)
    n_x, n_y, n_z = counts
    assert mesh.n_nodes == (n_x + 1) * (n_y + 1) * (n_z + 1) and mesh.n_elements == n_x * n_y * n_z
    nodes = mesh.nodes
    assert (nodes.min(axis=0), nodes.max(axis=0)) == (pytest.approx([0.0, -75.0, 0.0]), pytest.approx([17.5, 75.0, 0.6]))
    sets = {name: nodes[ids] for name, ids in mesh.node_sets.items()}
    assert np.all(sets["x0"][:, 0] == 0.0) and len(sets["x0"]) == (n_y + 1) * (n_z + 1)
    assert np.all(sets["z0"][:, 2] == 0.0) and len(sets["z0"]) == (n_y + 1) * (n_x + 1)
    assert np.all(sets["face"][:, 2] == 0.6) and len(sets["face"]) == (n_y + 1) * (n_x + 1)
    assert np.all(sets["bottom"][:, 1] == -75.0) and np.all(sets["top"][:, 1] == 75.0)
    assert np.sort(nodes[:, 1]) == pytest.approx(np.sort(-nodes[:, 1]))


def test_dogbone_films_cover_all_but_the_symmetry_planes() -> None:
    """Area of face, edges and ends, the curved edges as polygons; jaws: the last 10 mm of both ends."""
    mesh = dogbone_mesh(SPECIMEN, 3, 40, 2)
    area = {name: np.linalg.norm(area_vectors(mesh.nodes, facets), axis=1).sum() for name, facets in mesh.facets.items()}
    assert area["clamp"] == pytest.approx(2 * (10.0 * 17.5 + 10.0 * 0.6 + 17.5 * 0.6), rel=1e-12)
    y = np.unique(mesh.nodes[:, 1].round(9))
    width = half_width(SPECIMEN, y)
    face = np.trapezoid(width, y)
    edge = np.hypot(np.diff(width), np.diff(y)).sum() * 0.6
    assert area["air"] + area["clamp"] == pytest.approx(face + edge + 2 * 17.5 * 0.6, rel=1e-12)
    centre = mesh.nodes[np.concatenate(list(mesh.facets.values()))].mean(axis=1)
    assert centre[:, [0, 2]].max(axis=1).min() > 0.0
    assert np.all((centre[:, 0] > 1e-9) & (centre[:, 2] > 1e-9))


def test_dogbone_volume_converges_with_order_2() -> None:
    exact = 0.6 * 2.0 * (quad(lambda y: half_width(SPECIMEN, np.array([y]))[0], 50.0, 65.0)[0] + 12.5 * 50.0 + 17.5 * 10.0)
    errors = []
    for n_y in (40, 80, 160):
        mesh = dogbone_mesh(SPECIMEN, 1, n_y, 1)
        errors.append(abs(reference_gradients(mesh.nodes, mesh.hexes)[1].sum() - exact))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 2.0) < 0.2), orders


@given(st.integers(4, 60))
def test_planes_are_symmetric_increasing_and_hold_the_ends_of_gauge_and_shoulder(half: int) -> None:
    y = plane_positions(SPECIMEN, 2 * half)
    assert len(y) == 2 * half + 1 and np.all(np.diff(y) > 0.0)
    assert y == pytest.approx(-y[::-1])
    for mark in (0.0, 50.0, 65.0, 75.0):
        assert np.abs(y - mark).min() < 1e-12


@given(st.floats(135.0, 220.0), st.floats(1.0, 60.0), st.integers(5, 60))
def test_jaws_hold_the_area_that_they_hold_on_every_mesh(total: float, gripped: float, half: int) -> None:
    """A node plane lies at the mouth of the jaws; in the straight grip the held area is then exact: faces, edges and end faces."""
    specimen = dataclasses.replace(SPECIMEN, total_length=total, gripped_length=gripped)
    mouth = 0.5 * total - gripped
    y = plane_positions(specimen, 2 * half)
    assert len(y) == 2 * half + 1 and np.all(np.diff(y) > 0.0) and y == pytest.approx(-y[::-1])
    for mark in (0.0, 50.0, 65.0, 0.5 * total, mouth):
        assert np.abs(y - mark).min() < 1e-6
    mesh = dogbone_mesh(specimen, 2, 2 * half, 1)
    held = mesh.nodes[mesh.facets["clamp"]][:, :, 1]
    free = mesh.nodes[mesh.facets["air"]][:, :, 1]
    assert np.abs(held).min() >= mouth - 1e-6 and np.abs(free).max() <= mouth + 1e-6
    if mouth >= 65.0:
        area = np.linalg.norm(area_vectors(mesh.nodes, mesh.facets["clamp"]), axis=1).sum()
        assert area == pytest.approx(2 * (gripped * 17.5 + gripped * 0.6 + 17.5 * 0.6), rel=1e-6)


def test_planes_that_cannot_hold_the_jaws() -> None:
    assert split_at((0.0, 50.0, 65.0, 75.0), (7, 5, 2), 65.0) == ([0.0, 50.0, 65.0, 75.0], [7, 5, 2])
    assert split_at((0.0, 50.0, 65.0, 95.0), (7, 5, 1), 70.0) == ([0.0, 50.0, 65.0, 70.0, 95.0], [6, 5, 1, 1])
    with pytest.raises(StudyError, match=r"mesh\.n_y: too few elements"):
        split_at((0.0, 50.0, 65.0, 95.0), (1, 1, 1), 70.0)
    with pytest.raises(StudyError, match=r"gripped_length .* expected between 0 and 75 mm"):
        dogbone_mesh(dataclasses.replace(SPECIMEN, gripped_length=80.0), 2, 20, 1)


@pytest.mark.parametrize("n_y", [6, 7, 41, 0, -8])
def test_impossible_number_of_planes(n_y: int) -> None:
    with pytest.raises(StudyError, match=r"mesh\.n_y.*even"):
        dogbone_mesh(SPECIMEN, 2, n_y, 1)


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"total_length": 125.0}, "total_length"), ({"grip_width": 20.0}, "grip_width"), ({"shoulder_radius": 4.0}, "radius")],
)
def test_impossible_specimen(changes: dict[str, float], words: str) -> None:
    specimen = Specimen(**{**dataclasses.asdict(SPECIMEN), **changes})
    with pytest.raises(StudyError, match=words):
        dogbone_mesh(specimen, 2, 8, 1)


def test_nearest_node() -> None:
    mesh = bar_mesh((2, 2, 2), (1.0, 1.0, 1.0))
    assert mesh.nodes[mesh.nearest_node((0.6, 0.9, 0.1))] == pytest.approx([0.5, 1.0, 0.0])


def test_broken_meshes_are_told() -> None:
    mesh = bar_mesh((2, 2, 1), (1.0, 1.0, 1.0))
    hexes = mesh.hexes.copy()
    hexes[2] = hexes[2][[4, 5, 6, 7, 0, 1, 2, 3]]
    with pytest.raises(NumericsError, match=r"1 elements.*number 2"):
        check_mesh(replace(mesh, hexes=hexes))
    with pytest.raises(NumericsError, match=r"'top'.*99"):
        check_mesh(Mesh(mesh.nodes, mesh.hexes, mesh.facets, {**mesh.node_sets, "top": np.array([99])}))
    check_mesh(mesh)
