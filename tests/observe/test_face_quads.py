"""Points on the face of any mesh: linear fields are exact, mirror images, distances from edges, points off the body."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.body.mesh.shapes import bar_mesh, plate_with_hole_mesh
from thermofit.core.errors import DataError, StudyError
from thermofit.core.experiment import DicField, Specimen
from thermofit.experiment.static import turned
from thermofit.observe.end_motion import end_motion
from thermofit.observe.face_quads import distance_to_edge, face_quads
from thermofit.observe.noise import local_scatter
from thermofit.observe.observation import face_operator
from thermofit.study.section import MeshSize

PLATE = Specimen(20.0, 3.0, 80.0, 0.0, 20.0, 80.0, 0.0)
RNG = np.random.default_rng(4)
POINTS = RNG.uniform([-9.9, -39.9], [9.9, 39.9], (800, 2))
POINTS = POINTS[np.hypot(*POINTS.T) > 4.05]
SIZE = MeshSize(n_x=4, n_y=24, n_z=1)


@pytest.mark.parametrize("full", [False, True])
def test_linear_fields_are_exact(full: bool) -> None:
    mesh = plate_with_hole_mesh(PLATE, 4.0, SIZE, full=full)
    gradient = np.array([[2e-3, 0.0 if not full else 3e-4, 0.0], [0.0 if not full else 1e-3, 5e-3, 0.0], [0.0, 0.0, 1e-3]])
    operator = face_operator(mesh, POINTS)
    u = operator.displacement((mesh.nodes @ gradient.T)[None])[0]
    assert np.allclose(u, POINTS @ gradient[:2, :2].T, atol=1e-12)
    assert np.allclose(operator.weight.sum(axis=1), 1.0) and operator.weight.min() >= 0.0


def test_the_other_half_of_a_quarter_model_is_its_mirror_image() -> None:
    """A field that is even in u_y and odd in u_x about x = 0 is the same on both models."""
    quarter, full = (plate_with_hole_mesh(PLATE, 4.0, SIZE, full=f) for f in (False, True))

    def field(x: np.ndarray) -> np.ndarray:
        return np.stack([x[:, 0] * (1.0 + 0.1 * x[:, 1]), x[:, 0] ** 2 + x[:, 1], np.zeros(len(x))], axis=1)

    values = [face_operator(m, POINTS).displacement(field(m.nodes)[None])[0] for m in (quarter, full)]
    assert np.allclose(*values, atol=1e-10)
    assert np.abs(values[0][POINTS[:, 0] < 0.0, 0]).max() > 1.0


def test_rows_and_quadrilaterals_say_the_same_on_a_bar() -> None:
    """The face of a bar is a grid of rows too: both ways of finding a point must agree."""
    mesh = bar_mesh(PLATE, MeshSize(n_x=3, n_y=7, n_z=1))
    values = RNG.normal(size=(1, mesh.n_nodes, 3))
    by_rows = face_operator(mesh, POINTS).displacement(values)
    full = bar_mesh(PLATE, MeshSize(n_x=3, n_y=7, n_z=1), full=True)
    keys = {tuple(np.round(x, 6)): k for k, x in enumerate(mesh.nodes)}
    index = [keys[tuple(np.round(np.abs(x) * [1, np.sign(x[1]), 1], 6) + 0.0)] for x in full.nodes]
    spread = values[:, index].copy()
    spread[0, full.nodes[:, 0] < -1e-9, 0] *= -1.0
    spread[0, np.abs(full.nodes[:, 0]) < 1e-9, 0] = 0.0
    values[0, np.abs(mesh.nodes[:, 0]) < 1e-9, 0] = 0.0
    by_rows = face_operator(mesh, POINTS).displacement(values)
    assert np.allclose(face_operator(full, POINTS).displacement(spread), by_rows, atol=1e-9)


@pytest.mark.parametrize("full", [False, True])
def test_distance_from_outline_and_hole(full: bool) -> None:
    face = face_quads(plate_with_hole_mesh(PLATE, 4.0, MeshSize(n_x=16, n_y=96, n_z=1), full=full))
    where = RNG.uniform([-12.0, -42.0], [12.0, 42.0], (1500, 2))
    exact = np.minimum(np.minimum(10.0 - np.abs(where[:, 0]), 40.0 - np.abs(where[:, 1])), np.hypot(*where.T) - 4.0)
    found = distance_to_edge(face, where)
    clear = np.abs(exact) > 0.01
    assert np.array_equal(np.sign(found[clear]), np.sign(exact[clear]))
    inside = exact > 0.01
    assert np.allclose(found[inside], exact[inside], atol=0.006)


def test_a_point_off_the_body_is_refused() -> None:
    with pytest.raises(StudyError, match=r"1 observation points lie off the face, the first at \(15.000, 0.000\)"):
        face_operator(plate_with_hole_mesh(PLATE, 4.0, SIZE), np.array([[8.0, 0.0], [15.0, 0.0]]))


def test_local_scatter_finds_the_noise_of_a_curved_field() -> None:
    xy = RNG.uniform([-10.0, -40.0], [10.0, 40.0], (4000, 2))
    smooth = np.stack([1e-3 * xy[:, 0] + 1e-5 * xy[:, 1] ** 2, 2e-3 * xy[:, 1]], axis=1)
    noise = RNG.normal(size=smooth.shape) * [3e-4, 6e-4]
    assert local_scatter(xy, smooth + noise) == pytest.approx([3e-4, 6e-4], rel=0.06)


def test_turned_axes_are_a_rotation() -> None:
    assert np.array_equal(turned(np.array([[1.0, 0.0], [0.0, 1.0]])), np.array([[0.0, 1.0], [-1.0, 0.0]]))


def dic_of(elongation: np.ndarray, *, noise: float = 0.0, rotation: float = 0.0) -> DicField:
    """Uniform extension of a gauge of 40 mm with rigid motion, on scattered points that lie more on one side."""
    points = RNG.uniform([-9.0, -25.0, 0.0], [10.0, 25.0, 0.0], (3000, 3))
    strain = elongation / 40.0
    u = np.zeros((len(elongation), len(points), 3))
    u[:, :, 1] = 0.3 + points[:, 1] * strain[:, None] + rotation * points[:, 0] * np.linspace(0.0, 1.0, len(elongation))[:, None]
    u[:, :, :2] += noise * RNG.normal(size=(*u.shape[:2], 2))
    return DicField(np.arange(len(elongation), dtype=float), np.arange(len(points)), points, u)


def test_elongation_of_the_ends_is_free_of_rigid_motion() -> None:
    true = np.linspace(0.0, 0.4, 6)
    exact = end_motion(dic_of(true, rotation=0.01), (-20.0, 20.0), 2.0)
    assert np.allclose(exact.elongation, true, atol=1e-12)
    noisy = end_motion(dic_of(true, rotation=0.01, noise=0.002), (-20.0, 20.0), 2.0)
    expected = 0.002 * np.sqrt(2.0 / (3000 * 4.0 / 50.0))
    assert noisy.noise == pytest.approx(expected, rel=0.4)
    assert np.abs(noisy.elongation - true).max() < 6.0 * expected
    assert noisy.at(np.array([0.0, 2.5]), 0.0)[1] == pytest.approx(0.2, abs=6.0 * expected)


def test_elongation_that_cannot_be_known_is_refused() -> None:
    field = dic_of(np.linspace(0.0, 0.4, 6))
    with pytest.raises(DataError, match=r"0 DIC points are measured within 2 mm of the model's end y = -60 mm at 0 s"):
        end_motion(field, (-60.0, 60.0), 2.0)
    motion = end_motion(field, (-20.0, 20.0), 2.0)
    with pytest.raises(DataError, match="last DIC stage is at 5 s and 9 s is asked for"):
        motion.at(np.array([0.0, 9.0]), 0.0)
    with pytest.raises(DataError, match="loading begins at -1 s, before the first DIC stage"):
        motion.at(np.array([0.0]), -1.0)
