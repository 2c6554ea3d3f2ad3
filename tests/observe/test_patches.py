"""Means over patches: exact for linear and quadratic fields whatever points a patch holds, of third order beyond, on any set of nodes."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.observe.comparison import RelativeScheme, neighbour_differences, rigid_free
from thermofit.observe.observation import FieldObservation
from thermofit.observe.patches import averaged, derivatives, terms

GRID = np.stack(np.meshgrid(np.linspace(-5.0, 5.0, 11), np.linspace(-10.0, 10.0, 9)), axis=-1).reshape(-1, 2)
SCATTERED = GRID + np.random.default_rng(1).uniform(-0.3, 0.3, GRID.shape)
NODES = {"grid": GRID, "stretched": GRID * np.array([1.0, 0.2]), "scattered": SCATTERED}


def quadratic(xy: np.ndarray) -> np.ndarray:
    x, y = xy[..., 0], xy[..., 1]
    return 297.0 + 0.3 * x - 0.2 * y + 0.05 * x**2 - 0.03 * x * y + 0.02 * y**2


def cloud(xy: np.ndarray, size: float, seed: int = 3) -> np.ndarray:
    """Seven points (n, 7, 2) of a patch about every node, centred on none."""
    return xy[:, None, :] + size * np.random.default_rng(seed).uniform(-0.4, 0.6, (len(xy), 7, 2))


@pytest.mark.parametrize("nodes", NODES)
def test_means_of_quadratic_fields_are_exact(nodes: str) -> None:
    xy = NODES[nodes]
    points = cloud(xy, 1.0)
    moments = terms(points - xy[:, None, :]).mean(axis=1)
    theta = quadratic(xy)[None, :, None]
    expected = quadratic(points).mean(axis=1)
    assert np.abs(averaged(theta, moments[None], xy)[0, :, 0] - expected).max() < 1e-10
    assert np.abs(theta[0, :, 0] - expected).max() > 0.1, "the means must not be the nodal values"


def test_the_error_is_of_the_third_order_in_the_size_of_the_patches() -> None:
    """A field that is no polynomial, patches and nodes half as far apart: the error falls to an eighth."""
    errors = []
    for size in (1.0, 0.5, 0.25):
        xy = size * SCATTERED
        points = cloud(xy, size)
        theta = np.exp(0.2 * points[..., 0]) * np.sin(0.3 * points[..., 1])
        nodal = np.exp(0.2 * xy[:, 0]) * np.sin(0.3 * xy[:, 1])
        shown = averaged(nodal[None, :, None], terms(points - xy[:, None, :]).mean(axis=1)[None], xy)[0, :, 0]
        errors.append(np.sqrt(np.mean((shown - theta.mean(axis=1)) ** 2)))
    rate = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (rate > 2.7).all(), rate


def test_a_constant_stays_and_every_time_has_its_own_patches() -> None:
    moments = np.random.default_rng(5).normal(size=(3, len(GRID), 5))
    np.testing.assert_allclose(averaged(np.full((3, len(GRID), 2), 7.0), moments, GRID), 7.0, atol=1e-9)
    field = np.broadcast_to(quadratic(GRID)[None, :, None], (3, len(GRID), 1))
    slopes = (derivatives(GRID) @ quadratic(GRID)).reshape(5, -1)
    expected = quadratic(GRID) + np.einsum("tsk,ks->ts", moments, slopes)
    np.testing.assert_allclose(averaged(field, moments, GRID)[:, :, 0], expected, rtol=1e-12)


@pytest.mark.parametrize("xy", [np.zeros((1, 2)), GRID[:11]])
def test_few_nodes_or_a_line_of_them(xy: np.ndarray) -> None:
    """What the nodes do not tell has no derivative; along a line the quadratic is exact."""
    moments = np.zeros((1, len(xy), 5))
    moments[..., 0] = 0.1
    shown = averaged((2.0 + 3.0 * xy[:, 0])[None, :, None], moments, xy)[0, :, 0]
    np.testing.assert_allclose(shown, 2.0 + 3.0 * (xy[:, 0] + (0.1 if len(xy) > 1 else 0.0)), atol=1e-10)


def observation(xy: np.ndarray, moments: np.ndarray) -> FieldObservation:
    shape = moments.shape[:2]
    return FieldObservation(
        "u", np.arange(float(shape[0])), xy, np.zeros((*shape, 2)), np.full((*shape, 2), 0.002), np.ones(shape, dtype=bool), "mm", moments
    )


def test_a_rigid_motion_is_no_relative_displacement() -> None:
    """Shift and small rotation of the measured points: nothing is left, neither of all points at once nor of differences between nodes."""
    points = cloud(GRID, 1.0)
    moments = terms(points - GRID[:, None, :]).mean(axis=1)[None]
    turned = 0.01 * np.stack([-points[..., 1], points[..., 0]], axis=-1) + np.array([0.3, -0.1])
    error = turned.mean(axis=1)[None]
    seen = observation(GRID, moments)
    assert np.abs(rigid_free(seen).residual(error)).max() < 1e-9
    apart = neighbour_differences(seen, RelativeScheme("neighbour"))
    assert np.abs(apart.residual(error) * apart.sigma).max() < 1e-12
    plain = neighbour_differences(observation(GRID, np.zeros_like(moments)), RelativeScheme("neighbour"))
    assert np.abs(plain.residual(error) * plain.sigma).max() > 1e-3, "the centres of the patches must matter in this test"


def test_residuals_of_many_fields_are_those_of_each() -> None:
    """Also where the noise of what is prescribed is beside, and all weights are scaled."""
    rng = np.random.default_rng(7)
    shape = (2, len(GRID), 2)
    observed = FieldObservation(
        "u", np.array([0.0, 1.0]), GRID, rng.normal(size=shape), np.full(shape, 0.1), np.ones(shape[:2], dtype=bool), "mm"
    )
    whole = rigid_free(observed)
    fields = rng.normal(size=(*shape, 3))
    for compared in (whole, whole.scaled(4.0), whole.blurred(rng.normal(size=(whole.n, 2))).scaled(4.0)):
        each = np.stack([compared.residual(fields[..., k]) for k in range(3)], axis=1)
        np.testing.assert_allclose(compared.columns(fields), each, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(compared.slopes(fields[..., 0], fields), each, rtol=1e-12, atol=1e-12)
