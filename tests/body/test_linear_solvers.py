"""Band and sparse solvers against dense algebra: ties, skipped dofs, every solver, many right-hand sides, indefinite and singular."""

from __future__ import annotations

import pickle
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermofit.body.solve import band
from thermofit.body.solve.linear import SOLVER_VARIABLE, BandPattern, Factor, band_pattern, multiply_symmetric, scatter, slots
from thermofit.core.errors import NumericsError, StudyError

SCIPY_SOLVERS = ("band", "sparse")


@pytest.fixture(params=SCIPY_SOLVERS)
def solver(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Every solver that needs nothing but scipy, asked for by the environment."""
    monkeypatch.setenv(SOLVER_VARIABLE, request.param)
    return str(request.param)


@pytest.fixture
def pardiso(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pypardiso", reason="the optional package pypardiso (thermofit[mkl]) is not installed")
    monkeypatch.setenv(SOLVER_VARIABLE, "pardiso")


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


def stored(dense: np.ndarray) -> tuple[BandPattern, np.ndarray]:
    """Pattern and stored non-zeros of a dense symmetric matrix."""
    row, column = np.nonzero(np.tril(dense))
    return BandPattern(len(dense), int((row - column).max(initial=0)), row, column), dense[row, column]


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


def band_matrix(n: int, width: int, seed: int) -> np.ndarray:
    """Dense positive definite matrix of half bandwidth `width` at most, well conditioned."""
    random = np.random.default_rng(seed)
    lower = np.tril(np.triu(random.uniform(-1.0, 1.0, (n, n)), -width), -1) / (width + 1) + np.diag(random.uniform(1.0, 2.0, n))
    return lower @ lower.T


def indefinite(n: int, seed: int) -> tuple[BandPattern, np.ndarray, np.ndarray]:
    """A chain with one negative eigenvalue."""
    pattern, data, dense = assembled(*chain(n, seed), n)
    data[(pattern.row == pattern.column) & (pattern.row == n // 2)] -= 90.0
    dense[n // 2, n // 2] -= 90.0
    eigenvalues = np.linalg.eigvalsh(dense)
    assert eigenvalues[0] < -1.0 and eigenvalues[1] > 0.0
    return pattern, data, dense


class Wrong:
    """A solver whose answer in one column is twice what it should be."""

    def __init__(self, solver: object, column: int) -> None:
        self.solver, self.column, self.calls = solver, column, 0

    def solve(self, b: np.ndarray) -> np.ndarray:
        x = self.solver.solve(b)
        x[:, self.column] *= 2.0
        self.calls += 1
        return x


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


@given(st.integers(1, 70), st.integers(0, 70), st.integers(0, 20), st.booleans(), st.integers(0, 1000))
def test_every_size_band_width_number_of_columns_and_memory_order(n: int, width: int, m: int, columns_first: bool, seed: int) -> None:
    """Blocks that end inside, at and beyond the matrix and its band; the right-hand side stays as it was, the answer is in C order."""
    dense = band_matrix(n, width, seed)
    b = np.random.default_rng(seed).standard_normal((n, m))
    b = np.asfortranarray(b) if columns_first else b
    before = b.copy()
    factor = Factor(*stored(dense))
    assert factor.method == "band Cholesky"
    x = factor.solve(b)
    assert x.shape == (n, m) and x.flags.c_contiguous and np.array_equal(b, before)
    assert x == pytest.approx(np.linalg.solve(dense, b), rel=1e-10, abs=1e-11)


@pytest.mark.parametrize(("n", "width"), [(1, 0), (7, 2), (8, 7), (9, 8), (33, 9), (64, 23), (101, 100), (203, 71), (500, 430)])
def test_panels_and_lapack_give_the_same_factor(n: int, width: int) -> None:
    """Panels that end inside, at and beyond the matrix and its band; beyond the band, where solves read on, all stays zero."""
    dense = band_matrix(n, width, 1)
    pattern, data = stored(dense)
    made = band.BandCholesky(n, width, pattern.row, pattern.column, data).band
    factor = sum(np.diag(made[: n - k, k], -k) for k in range(min(n, width + 1)))
    assert not made[:, width + 1 :].any() and not any(made[n - k :, k].any() for k in range(1, min(n, width + 1)))
    assert factor @ factor.T == pytest.approx(dense, rel=1e-13, abs=1e-13)
    assert factor == pytest.approx(np.linalg.cholesky(dense), rel=1e-11, abs=1e-12)


@pytest.mark.parametrize("bad", [-1.0, 0.0, np.nan])
@pytest.mark.parametrize("equation", [0, 5, 7, 8, 20])
def test_panels_notice_a_pivot_that_is_not_positive(equation: int, bad: float) -> None:
    diagonal = np.ones(21)
    diagonal[equation] = bad
    with pytest.raises(band.NotPositiveError):
        band.BandCholesky(21, 0, np.arange(21), np.arange(21), diagonal)


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


@pytest.mark.parametrize("shape", [(150,), (150, 1), (150, 2), (150, 17)])
def test_all_solvers_agree_on_a_wide_band(solver: str, shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(0)
    equation = np.stack([random.permutation(150)[:5] for _ in range(300)])
    factor = random.standard_normal((300, 5, 5))
    pattern, data, dense = assembled(equation, factor @ factor.transpose(0, 2, 1) + np.eye(5), 150)
    made = Factor(pattern, data)
    assert (made.method, made.positive) == {"band": ("band Cholesky", True), "sparse": ("SuperLU", False)}[solver]
    b = random.standard_normal(shape)
    x = made.solve(b)
    assert x.shape == shape and x == pytest.approx(np.linalg.solve(dense, b), rel=1e-7, abs=1e-9)
    assert not pattern.fallbacks


@pytest.mark.parametrize("shape", [(40,), (40, 3)])
def test_an_indefinite_matrix_falls_back_to_lu(solver: str, shape: tuple[int, ...]) -> None:
    pattern, data, dense = indefinite(40, 1)
    made = Factor(pattern, data)
    assert (made.method, made.positive) == ({"band": "band LU", "sparse": "SuperLU"}[solver], False)
    b = np.random.default_rng(0).standard_normal(shape)
    assert made.solve(b) == pytest.approx(np.linalg.solve(dense, b), rel=1e-7, abs=1e-9)
    Factor(pattern, data)
    assert list(pattern.fallbacks.values()) == ([2] if solver == "band" else [])
    assert all("not positive definite" in sentence for sentence in pattern.fallbacks)


@given(st.integers(8, 40), st.integers(0, 500))
def test_an_indefinite_band_is_solved(n: int, seed: int) -> None:
    """Eigenvalues of both signs, away from zero."""
    dense = band_matrix(n, 4, seed)
    dense -= np.diag(np.where(np.random.default_rng(seed).uniform(size=n) < 0.3, 2.0 * dense.diagonal(), 0.0))
    if np.abs(np.linalg.eigvalsh(dense)).min() < 1e-3:
        dense += 0.01 * np.eye(n)
    if np.linalg.cond(dense) > 1e6:
        return
    b = np.random.default_rng(seed).standard_normal((n, 3))
    assert Factor(*stored(dense)).solve(b) == pytest.approx(np.linalg.solve(dense, b), rel=1e-6, abs=1e-8)


def test_a_singular_matrix_is_told(solver: str) -> None:
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
    for shape in ((n,), (n, 5)):
        b = np.random.default_rng(0).standard_normal(shape)
        for error, good in ((1e-6, True), (0.5, False)):
            factor = Factor(pattern, data)
            assert factor.positive
            factor._solver.band *= 1.0 + error
            if good:
                assert factor.solve(b) == pytest.approx(np.linalg.solve(dense, b), rel=1e-8, abs=1e-10)
            else:
                with pytest.raises(NumericsError, match="relative residual"):
                    factor.solve(b)


@pytest.mark.parametrize("column", range(4))
def test_every_column_is_judged_by_its_own_size(column: int) -> None:
    """A wrong column is found beside others that are 10^20 times larger; refinement is tried twice."""
    n = 30
    pattern, data, _ = assembled(*chain(n, 3), n)
    b = np.random.default_rng(0).standard_normal((n, 4)) * [1e20, 1e-20, 1.0, 1e-10]
    factor = Factor(pattern, data)
    factor._solver = wrong = Wrong(factor._solver, column)
    with pytest.raises(NumericsError, match="relative residual"):
        factor.solve(b)
    assert wrong.calls == 3


def test_solves_of_a_band_factor_are_checked_by_sample_and_others_always(solver: str) -> None:
    """A solver that turns wrong after the first solve is found out: at once, or by a band Cholesky factor within eight solves."""
    n = 30
    pattern, data, _ = assembled(*chain(n, 3), n)
    b = np.random.default_rng(0).standard_normal((n, 1))
    factor = Factor(pattern, data)
    factor.solve(b)
    factor._solver = Wrong(factor._solver, 0)
    noticed = []
    for _ in range(8):
        try:
            factor.solve(b)
        except NumericsError:
            noticed.append(True)
        else:
            noticed.append(False)
    assert noticed == ([False] * 7 + [True] if factor.method == "band Cholesky" else [True] * 8)


def test_a_zero_column_has_the_answer_zero(solver: str) -> None:
    n = 30
    pattern, data, dense = assembled(*chain(n, 3), n)
    b = np.random.default_rng(0).standard_normal((n, 5))
    b[:, [1, 4]] = 0.0
    x = Factor(pattern, data).solve(b)
    assert np.array_equal(x[:, [1, 4]], np.zeros((n, 2)))
    assert x == pytest.approx(np.linalg.solve(dense, b), rel=1e-7, abs=1e-9)
    assert np.array_equal(Factor(pattern, data).solve(np.zeros(n)), np.zeros(n))
    assert Factor(pattern, data).solve(np.zeros((n, 0))).shape == (n, 0)


@given(st.integers(3, 14), st.integers(0, 200))
def test_an_ill_conditioned_matrix_never_gives_a_bad_residual(digits: int, seed: int) -> None:
    """Condition 10^digits: solved up to 10^7; beyond that either the residual is small or the failure is told."""
    n = 20
    random = np.random.default_rng(seed)
    q, _ = np.linalg.qr(random.standard_normal((n, n)))
    dense = (q * np.logspace(0, -digits, n)) @ q.T
    dense = 0.5 * (dense + dense.T)
    b = random.standard_normal((n, 2))
    try:
        x = Factor(*stored(dense)).solve(b)
    except NumericsError as err:
        assert digits > 7 and "residual" in str(err)
        return
    rounding = 1e-15 * (np.abs(dense) @ np.abs(x)).max(axis=0)  # of the product itself
    assert np.all(np.abs(b - dense @ x).max(axis=0) <= 2e-8 * np.abs(b).max(axis=0) + rounding)


def soft(n: int, stiff: float) -> np.ndarray:
    """Dense matrix of a chain of springs of 1 N/mm that is held at one end, with one far stiffer in its middle."""
    springs = np.where(np.arange(n) == n // 2, stiff, 1.0)
    return np.diag(springs + np.append(springs[1:], 0.0)) - np.diag(springs[1:], 1) - np.diag(springs[1:], -1)


@pytest.mark.parametrize("columns", [1, 6])
def test_a_residual_of_rounding_alone_is_no_error(columns: int, solver: str) -> None:
    """A stiff spring that moves by millimetres: rounding of its force is more than 10^-8 of the load, and the displacement is right."""
    n, load = 30, np.zeros((30, columns))
    load[-1] = np.logspace(0, -3, columns)
    dense = soft(n, 1e8)
    right = (np.cumsum(1.0 / np.where(np.arange(n) == n // 2, 1e8, 1.0))[:, None]) * load[-1]
    factor = Factor(*stored(dense))
    x = factor.solve(load)
    assert np.abs(dense @ x - load).max() > 1e-8 * load.max(), "else this is no test"
    assert x == pytest.approx(right, rel=1e-6)


def test_a_residual_above_rounding_is_an_error_however_small() -> None:
    n = 30
    factor = Factor(*stored(soft(n, 1.0)))
    good = factor._solver.solve
    factor._solver.solve = lambda b: good(b) + 3e-8 * (np.arange(n) == n - 1)[:, None]  # type: ignore[method-assign]
    with pytest.raises(NumericsError, match=r"relative residual 3\.0e-08"):
        factor.solve(np.ones((n, 1)))


def test_where_rounding_is_large_beside_the_load_there_is_no_answer() -> None:
    """A spring 10^12 times stiffer than the others: 2e-4 of the load are lost in it."""
    load = np.zeros(30)
    load[-1] = 1.0
    with pytest.raises(NumericsError, match="nearly singular"):
        Factor(*stored(soft(30, 1e12))).solve(load)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_never_give_an_answer(solver: str, bad: float) -> None:
    pattern, data, _ = assembled(*chain(20, 4), 20)
    with pytest.raises(NumericsError, match="residual nan"):
        Factor(pattern, data).solve(np.where(np.arange(20) == 3, bad, 1.0))
    data[5] = bad
    for b in (np.ones(20), np.ones((20, 3))):
        with pytest.raises(NumericsError, match=r"residual nan|not finite"):
            Factor(pattern, data).solve(b)


@given(st.integers(30, 80), st.integers(0, 500), st.integers(0, 4))
def test_a_scattered_numbering_is_made_narrow_inside(n: int, seed: int, columns: int) -> None:
    """The band is that of the long body again, and no caller sees the permutation."""
    equation, matrices = chain(n, seed)
    scattered = np.random.default_rng(seed).permutation(n)
    equation = np.where(equation >= 0, scattered[equation], -1)
    pattern, data, dense = assembled(equation, matrices, n)
    assert pattern.bandwidth > 15
    assert pattern.plan.order is not None and pattern.plan.bandwidth <= 11
    assert np.array_equal(np.sort(pattern.plan.order), np.arange(n))
    b = np.random.default_rng(seed).standard_normal((n, columns) if columns else n)
    factor = Factor(pattern, data)
    assert factor.method == "band Cholesky"
    assert factor.solve(b) == pytest.approx(np.linalg.solve(dense, b), rel=1e-7, abs=1e-9)


def test_bodies_in_several_parts_and_single_equations_are_numbered_too() -> None:
    """Two chains and three equations that touch nothing, all mixed up."""
    n = 83
    dense = np.diag(np.full(n, 2.0))
    dense[:40, :40], dense[40:80, 40:80] = band_matrix(40, 3, 0), band_matrix(40, 5, 1)
    mixed = np.random.default_rng(2).permutation(n)
    dense = dense[np.ix_(mixed, mixed)]
    pattern, data = stored(dense)
    assert pattern.plan.bandwidth <= 12 < pattern.bandwidth
    b = np.random.default_rng(0).standard_normal((n, 3))
    assert Factor(pattern, data).solve(b) == pytest.approx(np.linalg.solve(dense, b), rel=1e-10)


def test_an_unknown_solver_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SOLVER_VARIABLE, "mumps")
    with pytest.raises(StudyError, match=r"THERMOFIT_SOLVER is 'mumps'; expected auto, band, sparse, pardiso"):
        Factor(*stored(np.eye(3)))


def test_pardiso_that_is_not_installed_is_told_and_not_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pypardiso", None)
    pattern, data = stored(band_matrix(30, 4, 0))
    pattern.plan.seconds["PARDISO Cholesky"] = 0.0
    assert Factor(pattern, data).method == "band Cholesky"
    monkeypatch.setenv(SOLVER_VARIABLE, "pardiso")
    with pytest.raises(StudyError, match=r"pardiso.*could not be loaded.*thermofit\[mkl\]"):
        Factor(pattern, data)


def test_pardiso_solves_and_serves_several_factors_of_one_pattern(pardiso: None) -> None:
    n = 60
    pattern, data, dense = assembled(*chain(n, 5), n)
    first, second = Factor(pattern, data), Factor(pattern, 3.0 * data)
    assert first.method == "PARDISO Cholesky" and first.positive
    b = np.random.default_rng(0).standard_normal((n, 4))
    expected = np.linalg.solve(dense, b)
    for _ in range(2):
        assert first.solve(b) == pytest.approx(expected, rel=1e-7, abs=1e-9)
        assert second.solve(b[:, 0]) == pytest.approx(expected[:, 0] / 3.0, rel=1e-7, abs=1e-9)
    assert not pattern.fallbacks


def test_pardiso_on_an_indefinite_matrix_falls_back(pardiso: None) -> None:
    pattern, data, dense = indefinite(40, 1)
    made = Factor(pattern, data)
    assert made.method == "SuperLU"
    assert list(pattern.fallbacks) == [
        "linear solve: PARDISO Cholesky was replaced by SuperLU, because the matrix is not positive definite"
    ]
    b = np.ones(40)
    assert made.solve(b) == pytest.approx(np.linalg.solve(dense, b), rel=1e-7, abs=1e-9)


def test_a_large_residual_of_pardiso_is_noticed_counted_and_replaced(pardiso: None) -> None:
    pattern, data, dense = assembled(*chain(40, 5), 40)
    made = Factor(pattern, data)
    made._solver = Wrong(made._solver, 0)
    b = np.ones((40, 2))
    assert made.solve(b) == pytest.approx(np.linalg.solve(dense, b), rel=1e-7, abs=1e-9)
    assert made.method == "SuperLU" and not made.positive
    assert list(pattern.fallbacks.items()) == [
        ("linear solve: PARDISO Cholesky was replaced by SuperLU, because a residual stayed large", 1)
    ]


def test_a_pattern_travels_to_another_process_without_what_was_found() -> None:
    pattern, data = stored(band_matrix(30, 4, 0))
    x = Factor(pattern, data).solve(np.ones(30))
    assert "plan" in vars(pattern)
    copy = pickle.loads(pickle.dumps(pattern))
    assert "plan" not in vars(copy)
    assert np.array_equal(Factor(copy, data).solve(np.ones(30)), x)


@pytest.mark.parametrize("column", range(6))
def test_one_bad_column_among_many_does_not_pass(column: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The columns are checked together first: an error of 1e-6 in one of them, small beside the others, is found and mended."""
    n = 40
    dense = np.diag(np.full(n, 4.0)) + np.diag(np.full(n - 1, -1.0), 1) + np.diag(np.full(n - 1, -1.0), -1)
    factor = Factor(*stored(dense))
    right = np.random.default_rng(2).standard_normal((n, 6)) * 10.0 ** -np.arange(6)
    good, calls = factor._solver.solve, []

    def bad_at_first(b: np.ndarray) -> np.ndarray:
        x = good(b)
        if not calls:
            x[7, column] *= 1.0 + 1e-6
        calls.append(b.shape)
        return x

    monkeypatch.setattr(factor._solver, "solve", bad_at_first)
    x = factor.solve(right)
    assert len(calls) == 2
    assert np.all(np.abs(dense @ x - right).max(axis=0) < 1e-8 * np.abs(right).max(axis=0))
