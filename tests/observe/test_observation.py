"""Predictions at points of the face: nodal values at nodes, bilinear between them, mirrored across x = 0."""

import numpy as np
import pytest

from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.core.errors import DataError
from thermofit.core.experiment import Specimen
from thermofit.observe.observation import FieldObservation, face_operator, smooth_operator

MESH = dogbone_mesh(Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0), 3, 16, 1)
FACE = MESH.node_sets["face"]


def test_operator_is_the_nodal_value_at_nodes() -> None:
    xy = MESH.nodes[FACE, :2]
    operator = face_operator(MESH, xy)
    theta = np.random.default_rng(0).normal(size=(2, MESH.n_nodes))
    assert np.allclose(operator.temperature(theta)[:, :, 0], theta[:, FACE], atol=1e-13)


def test_operator_reproduces_a_linear_field_and_mirrors_u_x() -> None:
    xy = np.array([[3.3, 7.7], [-3.3, 7.7], [0.0, -12.0], [-11.9, 1.0]])
    operator = face_operator(MESH, xy)
    u = np.zeros((1, MESH.n_nodes, 3))
    u[0, :, 0] = -0.01 * MESH.nodes[:, 0]
    u[0, :, 1] = 0.03 * MESH.nodes[:, 1] + 0.2
    expected = np.stack([-0.01 * xy[:, 0], 0.03 * xy[:, 1] + 0.2], axis=1)
    assert np.allclose(operator.displacement(u)[0], expected, atol=1e-12)


def test_smooth_values_are_nodal_at_nodes_and_exact_for_quadratics_where_bilinear_ones_have_arcs() -> None:
    """Elements of 12.5 mm in the gauge, y = 6.25 mm amid one: there theta = y^2 is off by h^2/4 = h^2/8 of its second derivative."""
    xy = MESH.nodes[FACE, :2]
    noise = np.random.default_rng(0).normal(size=(2, MESH.n_nodes))
    assert np.allclose(smooth_operator(MESH, xy).temperature(noise)[:, :, 0], noise[:, FACE], atol=1e-12)
    points = np.array([[3.3, 7.7], [-3.3, 7.7], [0.0, 6.25], [-11.9, 1.0], [5.0, -58.0], [-14.0, 71.0]])
    smooth, (x, y) = smooth_operator(MESH, points), MESH.nodes[:, :2].T
    theta = 300.0 + 0.2 * x - 0.1 * y + 0.01 * x**2 + 0.03 * x * y - 0.02 * y**2
    at = np.abs(points[:, 0])
    expected = 300.0 + 0.2 * at - 0.1 * points[:, 1] + 0.01 * at**2 + 0.03 * at * points[:, 1] - 0.02 * points[:, 1] ** 2
    assert np.allclose(smooth.temperature(theta[None])[0, :, 0], expected, atol=1e-9)
    arc = face_operator(MESH, points).temperature((y**2)[None]) - smooth.temperature((y**2)[None])
    assert abs(arc[0, 2, 0] - 12.5**2 / 4.0) < 1e-9
    u = np.zeros((1, MESH.n_nodes, 3))
    u[0, :, 0], u[0, :, 1] = -0.01 * x + 1e-4 * x * y, 0.03 * y + 1e-3 * x**2
    moved = np.stack([points[:, 0] * (-0.01 + 1e-4 * points[:, 1]), 0.03 * points[:, 1] + 1e-3 * at**2], axis=1)
    assert np.allclose(smooth.displacement(u)[0], moved, atol=1e-11)


def test_window_without_observation_is_refused() -> None:
    observation = FieldObservation(
        "u", np.array([0.0, 1.0]), np.zeros((1, 2)), np.zeros((2, 1, 2)), np.ones((2, 1, 2)), np.ones((2, 1), bool), "mm"
    )
    assert len(observation.between(0.5, 2.0).time) == 1
    with pytest.raises(DataError, match="between 2 s and 3 s"):
        observation.between(2.0, 3.0)
