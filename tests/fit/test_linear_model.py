"""The linearised least-squares problem against plain solvers, fits anew of every fold, and numbers by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from thermofit.fit.linear_model import LinearModel, projection

N = 40
SEEDS = st.integers(0, 10**6)
SIZES = st.integers(1, 5)


def made(seed: int, p: int, badly: float = 0.0, n: int = N) -> LinearModel:
    """Random columns, correlated, whose lengths differ by 10^badly, and a random residual."""
    random = np.random.default_rng(seed)
    mixed = random.normal(size=(n, p)) @ (np.eye(p) + 0.5 * np.triu(random.normal(size=(p, p)), 1))
    return LinearModel(random.normal(size=n), mixed * 10.0 ** (badly * random.uniform(-1.0, 1.0, p)))


def folds_of(seed: int, n: int = N) -> list[tuple[np.ndarray, np.ndarray]]:
    """Four folds of eight rows, with two rows beside each that are not seen; the last eight rows are never held out."""
    order, folds = np.random.default_rng(seed).permutation(n), []
    for k in range(4):
        held, hidden = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        held[order[8 * k : 8 * k + 8]] = True
        hidden[order[8 * k : 8 * k + 10]] = True
        folds.append((held, hidden))
    return folds


def room_of(model: LinearModel, seed: int, share: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Room in which some parameters reach an end."""
    random, p = np.random.default_rng(seed), model.columns.shape[1]
    return tuple(sign * share * random.uniform(0.0, 1.0, p) / model.size for sign in (-1.0, 1.0))  # type: ignore[return-value]


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, p=SIZES, badly=st.floats(0.0, 6.0))
def test_projection_and_free_step_are_those_of_least_squares(seed: int, p: int, badly: float) -> None:
    model = made(seed, p, badly)
    d = np.linalg.lstsq(model.unit, -model.residual, rcond=None)[0]
    assert model.left == pytest.approx(model.residual + model.unit @ d, abs=1e-10)
    assert model.free_step * model.size == pytest.approx(d, rel=1e-8, abs=1e-10)
    assert model.columns.T @ model.left / model.size == pytest.approx(0.0, abs=1e-10)
    assert model.projected(model.left) == pytest.approx(model.left, abs=1e-12), "a projection"
    assert model.basis.T @ model.basis == pytest.approx(np.eye(p), abs=1e-12)
    assert model.step.d * model.size == pytest.approx(d, rel=1e-6, abs=1e-8)
    assert model.remaining == pytest.approx(model.left, abs=1e-6)
    assert model.condition == pytest.approx(np.linalg.cond(model.unit), rel=1e-6)


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, p=SIZES)
def test_root_is_that_of_the_inverse_of_the_normal_matrix(seed: int, p: int) -> None:
    model = made(seed, p, 1.0)
    root, inverse = model.root(), np.linalg.inv(model.columns.T @ model.columns)
    scale = np.sqrt(np.outer(np.diag(inverse), np.diag(inverse)))
    assert root @ root.T / scale == pytest.approx(inverse / scale, abs=1e-7)
    assert model.columns @ root == pytest.approx(model.basis, abs=1e-8)


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, p=SIZES, badly=st.floats(0.0, 4.0))
def test_the_step_within_bounds_is_that_of_a_bounded_least_squares(seed: int, p: int, badly: float) -> None:
    model = made(seed, p, badly)
    model = LinearModel(model.residual, model.columns, bounds=room_of(model, seed))
    assert model.bounds is not None
    ends = tuple(end * model.size for end in model.bounds)
    expected = lsq_linear(model.unit, -model.residual, bounds=ends, method="bvls", tol=1e-14).x
    assert model.step.d * model.size == pytest.approx(expected, abs=1e-7)
    assert np.all((model.step.d >= model.bounds[0]) & (model.step.d <= model.bounds[1]))
    after = model.residual + model.columns @ model.step.d
    assert model.step.drop == pytest.approx(model.residual @ model.residual - after @ after, abs=1e-9)
    small = model.triangular
    assert len(small.residual) == p + 1 and small.step.d == pytest.approx(model.step.d, rel=1e-9, abs=1e-12)


def test_a_step_ends_exactly_on_its_bound() -> None:
    third = 1.0 / 3.0
    model = LinearModel(np.full(9, -1.0), np.full((9, 1), 0.7), bounds=(np.array([-third]), np.array([third])))
    assert model.step.d[0] == third


def fitted_anew(model: LinearModel, held: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Held-out rows after a fit to the rows that are seen, by a solver that knows nothing of normal equations."""
    ends = (-np.inf, np.inf) if model.bounds is None else tuple(end * model.size for end in model.bounds)
    d = lsq_linear(model.unit[~hidden], -model.residual[~hidden], bounds=ends, method="bvls", tol=1e-14).x
    return np.asarray(model.residual[held] + model.unit[held] @ d)


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, p=SIZES, badly=st.floats(0.0, 6.0))
def test_a_fold_is_predicted_as_by_a_fit_to_the_rows_that_it_sees(seed: int, p: int, badly: float) -> None:
    model, folds = made(seed, p, badly), folds_of(seed)
    found = model.predicted(folds)
    for held, hidden in folds:
        assert found[held] == pytest.approx(fitted_anew(model, held, hidden), abs=1e-7)
    assert np.count_nonzero(np.isnan(found)) == 8, "the rows that no fold holds out"


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, p=SIZES)
def test_a_fold_is_predicted_within_the_bounds(seed: int, p: int) -> None:
    """Of orthogonal columns the ends of one do not ask for others, so that one end after the other is exact."""
    random = np.random.default_rng(seed)
    columns = np.zeros((N, p))
    columns[np.arange(N), np.arange(N) % p] = random.uniform(0.5, 2.0, N)
    model = LinearModel(random.normal(size=N), columns)
    model, folds = LinearModel(model.residual, columns, bounds=room_of(model, seed)), folds_of(seed)
    found = model.predicted(folds)
    for held, hidden in folds:
        assert found[held] == pytest.approx(fitted_anew(model, held, hidden), abs=1e-8)


def test_where_one_parameter_stays_at_its_end_the_others_step_anew() -> None:
    """Columns (1, 1, 0) and (0, 1, 1), residual -(1, 2, 1) of a step (1, 1): with the first held at 0.5 the second goes to 1.25."""
    columns = np.tile(np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), (2, 1))
    held = np.repeat([False, True], 3)
    model = LinearModel(-columns.sum(axis=1), columns, bounds=(np.array([-9.0, -9.0]), np.array([0.5, 9.0])))
    assert model.predicted([(held, held)])[held] == pytest.approx([-0.5, -0.25, 0.25])
    assert model.remaining[held] == pytest.approx([-0.5, -0.25, 0.25]) and model.step.d == pytest.approx([0.5, 1.25])


def test_a_direction_that_a_fold_hardly_sees_is_not_followed() -> None:
    """Why there are two steps: two columns that differ by 1e-6 in the rows that are seen, and by one in a row that is not."""
    columns = np.ones((21, 2))
    columns[:20, 1] += 1e-6 * np.tile([1.0, -1.0], 10)
    columns[20, 1] = 2.0
    residual = np.append(np.tile([1.0, -1.0], 10), 0.0)
    held = np.arange(21) == 20
    assert abs(LinearModel(residual, columns).predicted([(held, held)])[20]) < 1e-6
    assert abs(float(columns[20] @ LinearModel(residual[:20], columns[:20]).step.d)) > 1e3


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, p=SIZES)
def test_the_residual_outside_a_block_is_that_of_a_fit_to_the_others(seed: int, p: int) -> None:
    """Of a residual at its optimum; by one formula, without a fit."""
    model = made(seed, p)
    model = LinearModel(model.left, model.columns)
    label = np.arange(N) // 8
    found = model.outside(label)
    for k in range(5):
        own = label == k
        assert found[own] == pytest.approx(fitted_anew(model, own, own), abs=1e-7)


def test_a_direction_that_one_block_alone_determines_keeps_the_residual_of_the_fit() -> None:
    columns = np.stack([np.ones(12), np.where(np.arange(12) < 3, [1.0, -1.0, 0.5] * 4, 0.0)], axis=1)
    model = LinearModel(LinearModel(np.random.default_rng(2).normal(size=12), columns).left, columns)
    found = model.outside(np.arange(12) // 3)
    alone = LinearModel(model.residual, columns[:, :1])
    assert np.all(np.isfinite(found)) and np.abs(found).max() < 10.0 * np.abs(model.residual).max()
    assert found[3:] == pytest.approx(model.outside(np.arange(12) // 3)[3:]) and len(alone.left) == 12
    assert np.linalg.norm(found[:3]) < 5.0 * np.linalg.norm(model.residual)


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, p=SIZES, k=st.integers(1, 3))
def test_the_score_of_further_columns_is_a_fit_of_all(seed: int, p: int, k: int) -> None:
    """Step, drop, and the standard errors of the whole covariance (J^T J)^-1 in the rows of the further columns."""
    random, model = np.random.default_rng((seed, 1)), made(seed, p)
    block = random.normal(size=(N, k))
    whole = model.with_columns(block)
    found = model.score(model.sensitive(block))
    d, rest = np.linalg.lstsq(whole.columns, -model.residual, rcond=None)[:2]
    assert found.step == pytest.approx(d[p:], rel=1e-7, abs=1e-9)
    assert found.drop == pytest.approx(model.left @ model.left - float(rest[0]), rel=1e-7, abs=1e-9)
    inverse = np.linalg.inv(whole.columns.T @ whole.columns)[p:, p:]
    assert found.covariance == pytest.approx(inverse, abs=1e-8) and found.inverse == pytest.approx(inverse, abs=1e-8)
    assert found.sigma == pytest.approx(np.sqrt(np.diag(inverse)), rel=1e-6)
    error = random.normal(size=N)
    assert found.drop_of(error) == pytest.approx(float(np.sum(error**2) - np.sum(LinearModel(error, found.columns).left ** 2)))


def test_correlated_noise_and_groups_widen_a_score() -> None:
    """By hand: s = (1, 1, 1, 1), r = (2, 2, -2, -2) as two groups, so that the sums of s_i r_i are 4 and -4 and 2/(2-1) of their squares
    64; noise of pairs that err as one has s.C s = 8."""
    s, r = np.ones((4, 1)), np.array([2.0, 2.0, -2.0, -2.0])
    nothing = np.zeros((4, 0))
    pairs = np.kron(np.eye(2), np.ones((2, 2)))
    assert LinearModel(r, nothing).score(s).sigma == pytest.approx([0.5])
    assert LinearModel(r, nothing, lambda v: pairs @ v).score(s).sigma == pytest.approx([np.sqrt(8.0) / 4.0])
    assert LinearModel(r, nothing).score(s, np.array([0, 0, 1, 1])).sigma == pytest.approx([8.0 / 4.0])
    assert LinearModel(0.1 * r, nothing).score(s, np.array([0, 0, 1, 1])).sigma == pytest.approx([0.5]), "never smaller than the noise"


def test_what_is_taken_up_or_only_felt_by_priors_is_not_felt() -> None:
    fitted = np.stack([np.ones(6), np.arange(6.0)], axis=1)
    line, square, last = 3.0 + 2.0 * np.arange(6.0), np.arange(6.0) ** 2, np.eye(6)[5]
    model = LinearModel(np.zeros(6), fitted)
    assert model.sensitive(np.stack([line, square, last], axis=1)).shape == (6, 2)
    assert LinearModel(np.zeros(6), np.eye(6)[:, :1], n_priors=1).sensitive(np.stack([last, square], axis=1)).shape == (6, 1)
    assert model.sensitive(np.stack([line + 1e-5 * square, line + 1e-8 * square], axis=1)).shape == (6, 1)


def test_dependent_columns_and_columns_of_zeros_span_what_is_left_of_them() -> None:
    random = np.random.default_rng(4)
    a, b, r = random.normal(size=(3, N))
    model = LinearModel(r, np.stack([a, 1e6 * b, a + b, np.zeros(N)], axis=1))
    assert model.basis.shape == (N, 2) and model.condition > 1e12
    assert model.left == pytest.approx(LinearModel(r, np.stack([a, b], axis=1)).left, abs=1e-12)
    assert model.residual + model.columns @ model.free_step == pytest.approx(model.left, abs=1e-9)
    assert model.free_step[3] == 0.0 and model.step.d[3] == 0.0
    null = model.null(("a", "b", "sum", "zero"), 1e-9)
    assert {frozenset(direction.names) for direction in null} == {frozenset(("zero",)), frozenset(("a", "b", "sum"))}
    assert LinearModel(r, np.zeros((N, 0))).left == pytest.approx(r) and projection(np.zeros((N, 0))).condition == 1.0


def test_columns_go_and_come_with_their_bounds() -> None:
    model = LinearModel(np.ones(4), np.eye(4)[:, :2], bounds=(np.array([-1.0, -2.0]), np.array([1.0, 2.0])))
    wider = model.with_columns(np.eye(4)[:, 2:], (np.full(2, -3.0), np.full(2, 3.0)))
    assert wider.bounds is not None and wider.bounds[0].tolist() == [-1.0, -2.0, -3.0, -3.0]
    one = wider.only([2])
    assert one.columns.tolist() == [[0.0], [0.0], [1.0], [0.0]] and one.bounds is not None and one.bounds[1].tolist() == [3.0]
    open_ended = LinearModel(np.ones(4), np.eye(4)[:, :2]).with_columns(np.eye(4)[:, 2:])
    assert open_ended.bounds is None and model.with_columns(np.eye(4)[:, 2:]).step.d.tolist() == pytest.approx([-1.0] * 4)


def test_covariance_of_a_line_by_hand() -> None:
    """y = a + b x at x = -1, 0, 1, 2 with residual (1, -1, -1, 1), which is orthogonal to both: J^T J = [[4, 2], [2, 6]], s2 = 4 / (4 - 2),
    so that var a = 2 x 6/20 and var b = 2 x 4/20, correlation -2 / sqrt(24). With b at its bound var a = 4 / (4 - 1) / 4."""
    x = np.array([-1.0, 0.0, 1.0, 2.0])
    model = LinearModel(np.array([1.0, -1.0, -1.0, 1.0]), np.stack([np.ones(4), x], axis=1))
    found = model.covariance(("a", "b"))
    assert found.s2 == pytest.approx(2.0) and found.sigma == pytest.approx([np.sqrt(0.6), np.sqrt(0.4)])
    assert found.matrix == pytest.approx(np.array([[0.6, -0.2], [-0.2, 0.4]])) and found.degrees_of_freedom == pytest.approx(2.0)
    assert found.correlation_parameters[0, 1] == pytest.approx(-2.0 / np.sqrt(24.0))
    held = model.covariance(("a", "b"), np.array([False, True]))
    assert held.sigma[0] == pytest.approx(np.sqrt(1.0 / 3.0)) and held.matrix[1].tolist() == [0.0, 0.0]
    assert held.sigma_unit[1] == pytest.approx(np.sqrt(0.2)), "as if it alone were released"


def test_covariance_of_a_mean_of_pairs_that_err_as_one_by_hand() -> None:
    """Six values in three pairs: A = 6, J^T C J = 12, var = 12/36 = 1/3 of s2 = 6 / (6 - 12/6)."""
    pairs = np.kron(np.eye(3), np.ones((2, 2)))
    model = LinearModel(np.array([1.0, 1.0, -1.0, -1.0, 1.0, -1.0]), np.ones((6, 1)), lambda v: pairs @ v)
    found = model.covariance(("mean",))
    assert found.sigma_unit == pytest.approx([np.sqrt(1.0 / 3.0)]) and found.s2 == pytest.approx(1.5)
    with pytest.raises(ValueError, match="noise operator returned shape"):
        LinearModel(model.residual, model.columns, lambda v: v[:3]).covariance(("mean",))
