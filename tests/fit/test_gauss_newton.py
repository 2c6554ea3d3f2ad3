"""The bounded linear step against its optimality conditions."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from thermofit.fit.gauss_newton import pinned
from thermofit.fit.linear_model import LinearModel


@settings(max_examples=60)
@given(seed=st.integers(0, 10**6), size=st.integers(1, 6), badly=st.floats(0.0, 6.0))
def test_optimality_conditions_of_the_bounded_step(seed, size, badly):
    _check(seed, size, badly)


def test_bounds_are_hit_exactly():
    """A step that misses its bound by one bit would pass for a free parameter; rare, so that many seeds are needed."""
    for seed in range(200):
        _check(seed, 3, 2.0)


def _check(seed, size, badly):
    rng = np.random.default_rng(seed)
    jacobian = rng.standard_normal((12, size)) * 10.0 ** (badly * rng.uniform(-1, 1, size))
    residual = rng.standard_normal(12)
    norms = np.linalg.norm(jacobian, axis=0)
    room = (-rng.uniform(0, 0.4, size) / norms, rng.uniform(0, 0.4, size) / norms)
    step = LinearModel(residual, jacobian, bounds=room).step
    assert (room[0] <= step.d).all() and (step.d <= room[1]).all()
    gradient = jacobian.T @ (jacobian @ step.d + residual) / norms
    low, up = step.d == room[0], step.d == room[1]
    assert np.abs(gradient[~low & ~up]).max(initial=0.0) < 1e-8
    assert (gradient[low & ~up] > -1e-8).all() and (gradient[up & ~low] < 1e-8).all()
    after = jacobian @ step.d + residual
    assert np.isclose(step.drop, residual @ residual - after @ after, atol=1e-9)


def test_parameter_without_effect_stays():
    jacobian = np.array([[1.0, 0.0], [1.0, 0.0]])
    step = LinearModel(np.array([1.0, 3.0]), jacobian).step
    assert np.allclose(step.d, [-2.0, 0.0])


def test_fewer_data_than_parameters():
    step = LinearModel(np.array([3.0]), np.ones((1, 3)), bounds=(np.full(3, -9.0), np.full(3, 9.0))).step
    assert np.allclose(step.d, -1.0) and np.isclose(step.drop, 9.0)


def test_pinned_columns_keep_gradient_and_forbid_the_null_direction():
    rng = np.random.default_rng(4)
    jacobian = rng.standard_normal((40, 3)) * [1.0, 1e3, 1e-4]
    jacobian[:, 2] = (jacobian[:, 0] * 2.0 + jacobian[:, 1] * 1e-3) * 1e-4
    residual = rng.standard_normal(40)
    kept = pinned(jacobian, residual)
    norms = np.linalg.norm(jacobian, axis=0)
    assert np.allclose(kept.T @ residual / norms, jacobian.T @ residual / norms, atol=1e-12)
    null = np.linalg.svd(jacobian / norms)[2][-1]
    step = np.linalg.lstsq(kept / norms, -residual, rcond=None)[0]
    assert abs(null @ step) < 1e-12 and np.linalg.norm(step) < 5.0
    assert np.linalg.norm(kept / norms @ null) > 0.1
    assert np.allclose(jacobian / norms @ step, jacobian / norms @ np.linalg.pinv(jacobian / norms) @ -residual, atol=1e-10)


def test_pinned_leaves_correlated_columns_alone():
    rng = np.random.default_rng(5)
    jacobian = rng.standard_normal((40, 2))
    jacobian[:, 1] = jacobian[:, 0] + 1e-3 * rng.standard_normal(40)
    assert pinned(jacobian, rng.standard_normal(40)) is jacobian
