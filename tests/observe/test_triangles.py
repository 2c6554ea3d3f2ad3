"""Linear interpolation between scattered points: exact for linear fields, safe at collinear points, never outside."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermofit.observe.triangles import GAP_FACTOR, point_spacing, triangle_weights


def grid(n_x: int, n_y: int, jitter: float = 0.0, seed: int = 0) -> np.ndarray:
    x, y = np.meshgrid(np.arange(n_x, dtype=float), np.arange(n_y, dtype=float))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    return points + np.random.default_rng(seed).uniform(-jitter, jitter, points.shape)


def linear(xy: np.ndarray) -> np.ndarray:
    return 3.0 + 2.0 * xy[:, 0] - 0.7 * xy[:, 1]


@given(st.integers(0, 2**31), st.floats(0.0, 0.25))
def test_linear_field_is_reproduced_with_convex_weights(seed: int, jitter: float) -> None:
    """Scatter of a quarter of the spacing: beyond that a pair of points can be so far apart that the gap between them counts as one."""
    points = grid(9, 12, jitter, seed)
    targets = np.random.default_rng(seed + 1).uniform(1.0, 7.0, (50, 2))
    w = triangle_weights(points, targets)
    assert w.inside.all()
    assert w.weight.min() >= -1e-9
    np.testing.assert_allclose(w.weight.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose((linear(points)[w.index] * w.weight).sum(axis=1), linear(targets), atol=1e-11)


def test_regular_grid_whose_three_nearest_points_are_collinear() -> None:
    """At a point, on a grid line, at the centre of a cell, on the rim: the three nearest points of Algorithm 2 can be collinear."""
    stretch = np.array([1.0, 2.0])
    points = grid(6, 8) * stretch
    targets = np.array([[2.0, 3.0], [2.5, 3.0], [2.5, 3.5], [2.1, 3.0], [0.0, 0.0], [5.0, 7.0], [2.3, 0.0], [5.0, 3.2]]) * stretch
    nearest = np.argsort(np.linalg.norm(points - targets[3], axis=1), kind="stable")[:3]
    assert np.ptp(points[nearest, 1]) == 0.0
    w = triangle_weights(points, targets)
    assert w.inside.all()
    np.testing.assert_allclose((linear(points)[w.index] * w.weight).sum(axis=1), linear(targets), atol=1e-12)


def test_targets_outside_are_flagged_and_not_extrapolated() -> None:
    w = triangle_weights(grid(6, 8, 0.2), np.array([[-0.6, 3.0], [2.0, 9.0], [100.0, 100.0], [2.0, 3.0]]))
    assert w.inside.tolist() == [False, False, False, True]
    assert np.isnan(w.weight[:3]).all()


def test_holes_are_not_bridged() -> None:
    points = grid(20, 20, 0.1)
    hole = np.linalg.norm(points - 10.0, axis=1) < 4.0
    targets = np.array([[10.0, 10.0], [3.0, 3.0]])
    assert triangle_weights(points, targets, ~hole).inside.tolist() == [False, True]
    assert triangle_weights(points, targets, ~hole, max_distance=20.0).inside.all()
    one_lost = np.linalg.norm(points - 10.0, axis=1) > 0.3
    assert triangle_weights(points, targets, one_lost).inside.all()
    used = points[triangle_weights(points, targets, one_lost).index[0]]
    assert np.linalg.norm(used - np.roll(used, 1, axis=0), axis=1).max() < GAP_FACTOR * point_spacing(points)


def test_target_on_the_edge_between_a_flat_and_a_sound_triangle() -> None:
    """A rim point 0.01 inside the hull makes a flat triangle 0 1 2 along the rim; a target on its edge 0 1 lies in 0 1 3 as well."""
    points = np.array([[0.0, 0.0], [1.0, 0.01], [2.0, 0.0], [1.0, 1.5]])
    along = np.linspace(0.1, 0.9, 33)
    for rounding in (0.0, -1e-12, 1e-12):
        w = triangle_weights(points, np.stack([along, 0.01 * along + rounding], axis=1), max_distance=3.0)
        assert w.inside.all() and (w.index == 3).any(axis=1).all()
    assert not triangle_weights(points, np.array([[1.0, 0.005]]), max_distance=3.0).inside[0]


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 2)), np.zeros((1, 2)), np.array([[0.0, 0.0], [1.0, 1.0]]), np.stack([np.arange(5.0)] * 2, axis=1), np.zeros((4, 2))],
)
def test_too_few_or_collinear_points_give_no_triangle(points: np.ndarray) -> None:
    w = triangle_weights(points, np.array([[0.5, 0.5]]))
    assert not w.inside.any() and np.isnan(w.weight).all()


def test_no_targets() -> None:
    assert triangle_weights(grid(4, 4), np.zeros((0, 2))).index.shape == (0, 3)
