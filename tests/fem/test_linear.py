"""Band and sparse solvers against dense algebra: ties, skipped dofs, wide bands, indefinite and singular matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermofit.core.errors import NumericsError
from thermofit.fem.linear import BandPattern, Factor, band_pattern, multiply_symmetric, scatter, slots


def assembled(equation: np.ndarray, matrices: np.ndarray, n: int) -> tuple[BandPattern, np.ndarray, np.ndarray]:
    """Pattern, stored non-zeros, and the dense sum of all element matrices; equations below zero are left out."""
    pattern = band_pattern(equation, n)
    data = np.zeros(pattern.n_slots)
    scatter(matrices, slots(pattern, equation), data)
    dense = np.zeros((n, n))
    for e, local in zip(equation, matrices, strict=True):
        used = np.flatnonzero(e >= 0)
        for i in used:
            for j in used:
                dense[e[i], e[j]] += local[i, j]
    return pattern, data, dense


def chain(n: int, seed: int, *, width: int = 6, shift: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Overlapping elements of a long body with some dofs skipped (-1) and some tied (twice in one element); positive definite."""
    random = np.random.default_rng(seed)
    starts = np.arange(0, n - width + 1)
    equation = starts[:, None] + random.permuted(np.tile(np.arange(width), (len(starts), 1)), axis=1)
    inner = np.arange(1, len(starts) - 1, 3)
    equation[inner, 1] = equation[inner, 0]
    equation[inner, 3] = -1
    factor = random.standard_normal((len(starts), width, width))
    return equation, factor @ factor.transpose(0, 2, 1) + shift * np.eye(width)


@given(st.integers(8, 60), st.integers(0, 1000), st.integers(0, 3))
def test_factor_solves_what_was_assembled(n: int, seed: int, columns: int) -> None:
    """Ties count with both their pairs on the diagonal; one or many right-hand sides."""
    pattern, data, dense = assembled(*chain(n, seed), n)
    random = np.random.default_rng(seed)
    x = random.standard_normal(n)
    assert multiply_symmetric(pattern.row, pattern.column, data, x) == pytest.approx(dense @ x, abs=1e-11)
    b = random.standard_normal((n, columns)) if columns else random.standard_normal(n)
    factor = Factor(pattern, data)
    assert factor.positive
    assert factor.solve(b) == pytest.approx(np.linalg.solve(dense, b), rel=1e-7, abs=1e-9)


def test_a_tie_counts_twice_on_the_diagonal() -> None:
    equation = np.array([[0, 1, 1, -1]])
    local = np.array([[5.0, 1.0, 2.0, 9.0], [1.0, 7.0, 3.0, 9.0], [2.0, 3.0, 11.0, 9.0], [9.0, 9.0, 9.0, 9.0]])
    pattern, data, dense = assembled(equation, local[None], 2)
    assert dense == pytest.approx(np.array([[5.0, 3.0], [3.0, 7.0 + 11.0 + 2 * 3.0]]))
    assert dict(zip(zip(pattern.row, pattern.column, strict=True), data, strict=True)) == {(0, 0): 5.0, (1, 0): 3.0, (1, 1): 24.0}
    assert Factor(pattern, data).solve(np.array([1.0, 2.0])) == pytest.approx(np.linalg.solve(dense, [1.0, 2.0]))


def test_bandwidth_is_the_largest_distance_of_coupled_equations() -> None:
    pattern = band_pattern(np.array([[0, 3, -1], [1, 2, 2], [5, 3, 4]]), 6)
    assert pattern.bandwidth == 3
    assert set(zip(pattern.row, pattern.column, strict=True)) >= {(3, 0), (2, 1), (5, 3), (5, 4), (4, 3)}
    assert np.all(pattern.row >= pattern.column)


@pytest.mark.parametrize("seed", range(3))
def test_a_wide_band_goes_to_sparse_lu(seed: int) -> None:
    n = 150
    random = np.random.default_rng(seed)
    equation = np.stack([random.permutation(n)[:5] for _ in range(300)])
    factor = random.standard_normal((300, 5, 5))
    pattern, data, dense = assembled(equation, factor @ factor.transpose(0, 2, 1) + np.eye(5), n)
    assert pattern.bandwidth > 0.15 * n + 50
    solver = Factor(pattern, data)
    assert not solver.positive
    b = random.standard_normal((n, 2))
    assert solver.solve(b) == pytest.approx(np.linalg.solve(dense, b), rel=1e-7, abs=1e-9)


def test_an_indefinite_matrix_falls_back_to_lu() -> None:
    n = 40
    equation, matrices = chain(n, 1)
    pattern, data, dense = assembled(equation, matrices, n)
    data[(pattern.row == pattern.column) & (pattern.row == 20)] -= 90.0
    dense[20, 20] -= 90.0
    eigenvalues = np.linalg.eigvalsh(dense)
    assert eigenvalues[0] < -1.0 and eigenvalues[1] > 0.0
    solver = Factor(pattern, data)
    assert not solver.positive
    b = np.random.default_rng(0).standard_normal(n)
    assert solver.solve(b) == pytest.approx(np.linalg.solve(dense, b), rel=1e-7, abs=1e-9)


def test_a_singular_matrix_is_told() -> None:
    """A row of zeros: a body that is not held."""
    n = 20
    pattern, data, _ = assembled(*chain(n, 2), n)
    data[(pattern.row == 7) | (pattern.column == 7)] = 0.0
    with pytest.raises(NumericsError, match=r"singular.*held"):
        Factor(pattern, data).solve(np.ones(n))


def test_every_solve_is_checked_by_its_residual() -> None:
    """A slightly wrong factor is refined away; a wrong one is told, never returned."""
    n = 30
    pattern, data, dense = assembled(*chain(n, 3, shift=20.0), n)
    b = np.random.default_rng(0).standard_normal(n)
    for error, good in ((1e-6, True), (0.5, False)):
        factor = Factor(pattern, data)
        assert factor.positive
        factor._band *= 1.0 + error
        if good:
            assert factor.solve(b) == pytest.approx(np.linalg.solve(dense, b), rel=1e-8, abs=1e-10)
        else:
            with pytest.raises(NumericsError, match="relative residual"):
                factor.solve(b)
    assert np.array_equal(Factor(pattern, data).solve(np.zeros(n)), np.zeros(n))


def test_a_matrix_with_nan_never_gives_an_answer() -> None:
    pattern, data, _ = assembled(*chain(20, 4), 20)
    data[5] = np.nan
    with pytest.raises(NumericsError):
        Factor(pattern, data).solve(np.ones(20))
