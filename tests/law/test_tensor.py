"""Tensor algebra against numpy and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scalar_update import exponential, exponential_derivative, gram, largest, multiply, multiply_symmetric, solve_in_place
from scipy.linalg import expm

from thermofit.law.tensor import (
    COLUMN,
    ROW,
    added,
    commuting_product,
    congruence,
    determinant,
    double_contraction,
    inverse_transpose,
    scaled,
)
from thermofit.point.lanes_tensor import MAX_TERMS

components = st.floats(-0.4, 0.4, allow_subnormal=False)
symmetric = st.tuples(*[components] * 6)
general = st.lists(components, min_size=9, max_size=9).map(lambda v: np.eye(3) + 0.5 * np.reshape(v, (3, 3)))


def full(s: tuple[float, ...]) -> np.ndarray:
    """(3, 3) of the six components."""
    a = np.empty((3, 3))
    for value, i, j in zip(s, ROW, COLUMN, strict=True):
        a[i, j] = a[j, i] = value
    return a


def six(a: np.ndarray) -> tuple[float, ...]:
    """Six components of a symmetric (3, 3)."""
    assert np.allclose(a, a.T, atol=1e-13)
    return tuple(float(a[i, j]) for i, j in zip(ROW, COLUMN, strict=True))


def test_components_are_11_22_33_12_23_13() -> None:
    assert full((1, 2, 3, 4, 5, 6)) == pytest.approx(np.array([[1, 4, 6], [4, 2, 5], [6, 5, 3]]))


@given(general, symmetric)
def test_products(a: np.ndarray, s: tuple[float, ...]) -> None:
    out = np.empty((3, 3))
    b = np.ascontiguousarray(a.T + 0.3)
    multiply(a, b, out)
    assert out == pytest.approx(a @ b, abs=1e-14)
    multiply_symmetric(a, s, out)
    assert out == pytest.approx(a @ full(s), abs=1e-14)
    assert full(gram(a)) == pytest.approx(a.T @ a, abs=1e-14)


@given(general)
def test_determinant_and_inverse(a: np.ndarray) -> None:
    det = float(np.linalg.det(a))
    assert determinant(a) == pytest.approx(det, abs=1e-14)
    if abs(det) > 0.05:
        out = np.empty((3, 3))
        inverse_transpose(a, det, out)
        assert out.T @ a == pytest.approx(np.eye(3), abs=1e-12)


@given(symmetric, symmetric)
def test_symmetric_algebra(x: tuple[float, ...], y: tuple[float, ...]) -> None:
    a, b = full(x), full(y)
    assert full(congruence(x, y)) == pytest.approx(a @ b @ a, abs=1e-14)
    assert double_contraction(x, y) == pytest.approx(np.sum(a * b), abs=1e-14)
    assert full(added(x, y, -0.7)) == pytest.approx(a - 0.7 * b, abs=1e-15)
    assert full(scaled(x, 3.0)) == pytest.approx(3.0 * a, abs=1e-15)
    assert largest(x) == np.abs(a).max()
    square = six(a @ a)
    assert full(commuting_product(x, square)) == pytest.approx(a @ a @ a, abs=1e-14)


@example((0.0, -0.375, -0.390625, -0.390625, -0.390625, -0.390625))
@given(symmetric)
def test_exponential(x: tuple[float, ...]) -> None:
    """Against scipy; det exp(D) = exp(tr D); exp(-D) is the inverse."""
    e, terms = exponential(x)
    assert 0 < terms < MAX_TERMS
    assert full(e) == pytest.approx(expm(full(x)), rel=1e-14, abs=1e-14)
    assert determinant(full(e)) == pytest.approx(np.exp(np.trace(full(x))), rel=1e-13)
    inverse, _ = exponential(scaled(x, -1.0))
    assert full(inverse) @ full(e) == pytest.approx(np.eye(3), abs=1e-13)


def test_exponential_says_when_the_series_is_too_long() -> None:
    assert exponential((9.0, -8.0, -1.0, 2.0, 0.0, 0.0))[1] == 0


@pytest.mark.parametrize("seed", range(5))
def test_exponential_derivative_to_second_order(seed: int) -> None:
    """exp(X + h dX) - exp(X) - h D exp(X)[dX] falls with h^2, for directions that do not commute with X."""
    random = np.random.default_rng(seed)
    x, dx = tuple(random.uniform(-0.3, 0.3, 6)), tuple(random.uniform(-1.0, 1.0, 6))
    e, terms = exponential(x)
    derivative = full(exponential_derivative(x, dx, terms))
    steps = np.array([1e-2, 1e-3, 1e-4])
    errors = [np.abs(expm(full(x) + h * full(dx)) - full(e) - h * derivative).max() for h in steps]
    orders = np.diff(np.log(errors)) / np.diff(np.log(steps))
    assert np.all(np.abs(orders - 2.0) < 0.05), orders


@given(st.integers(0, 10_000), st.integers(1, 7))
def test_solve_in_place(seed: int, n: int) -> None:
    random = np.random.default_rng(seed)
    a = np.eye(n) + 0.4 / n * random.uniform(-1.0, 1.0, (n, n))
    b = random.uniform(-1.0, 1.0, (n, 3))
    left, x = a.copy(), b.copy()
    solve_in_place(left, x)
    assert a @ x == pytest.approx(b, abs=1e-13)
