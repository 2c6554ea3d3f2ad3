"""Second derivatives that Gauss-Newton leaves out: the secant update, the quadratic model, and searches whose residual stays large."""

import dataclasses

import numpy as np
import pytest
from fit_models import BAR_TRUE, bar_problem, complex_step, exact, problem
from hypothesis import given, settings
from hypothesis import strategies as st

from thermofit.fit import secant
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.minimise import minimise
from thermofit.fit.secant import Curvature, augmented, learnt, updated
from thermofit.fit.settings import Settings


def symmetric(rng, size):
    matrix = rng.standard_normal((size, size))
    return matrix + matrix.T


@settings(max_examples=100)
@given(seed=st.integers(0, 10**6), size=st.integers(1, 6))
def test_update_is_symmetric_and_explains_the_step(seed, size):
    rng = np.random.default_rng(seed)
    S, d, curving, turning = symmetric(rng, size), *rng.standard_normal((3, size))
    result = updated(S, d, curving, turning if turning @ d > 0.0 else -turning)
    assert np.allclose(result, result.T) and np.allclose(result @ d, curving, atol=1e-9 * np.abs(result).max())


def test_update_is_refused_where_the_gradient_does_not_rise():
    S = symmetric(np.random.default_rng(1), 3)
    assert updated(S, np.ones(3), np.ones(3), np.array([1.0, -1.0, 0.0])) is S
    assert updated(S, np.ones(3), np.ones(3), -np.ones(3)) is S


def test_what_was_learnt_where_the_residual_was_larger_does_not_outlive_it():
    """Sized by the curvature along the step: across it S = 100 falls to 1 as well."""
    assert updated(100.0 * np.eye(2), np.array([1.0, 0.0]), np.array([1.0, 0.0]), np.array([1.0, 0.0])) == pytest.approx(np.eye(2))


def parabolas(z):
    """Residual of one variable with constant second derivatives 2, -1, 3."""
    return np.array([1.0 + z[0] + z[0] ** 2, 4.0 - 2.0 * z[0] - 0.5 * z[0] ** 2, 5.0 + 1.5 * z[0] ** 2])


@pytest.mark.parametrize("moved", [True, False])
def test_one_variable_is_learnt_from_one_trial(moved):
    """S = sum r_i r_i'' at the point that the search goes on from: 2 - 4 + 15 at z = 0."""
    here, there = (LinearModel(parabolas(z), complex_step(parabolas, z)) for z in (np.array([0.0]), np.array([0.1])))
    S = learnt(Curvature(np.zeros((1, 1))), here, there, np.array([0.1]), moved).S
    at = there if moved else here
    assert S == pytest.approx(np.array([[at.residual @ [2.0, -1.0, 3.0]]]))


def test_quadratic_model_is_used_where_it_is_right_and_gauss_newton_is_wrong():
    here, there = (LinearModel(parabolas(z), complex_step(parabolas, z)) for z in (np.array([0.0]), np.array([0.7])))
    assert learnt(Curvature(np.array([[13.0]])), here, there, np.array([0.7]), False).used
    assert not learnt(Curvature(np.array([[-13.0]])), here, there, np.array([0.7]), False).used
    # A small residual: Gauss-Newton is right within a few per cent, and stays, unless the other one is used already.
    small = [LinearModel(1e-2 * np.array([1.0, 2.0]) + [z - 0.5, 0.02 * z**2], np.array([[1.0], [0.04 * z]])) for z in (0.0, 0.4)]
    right = np.array([[0.02 * 0.04]])
    assert not learnt(Curvature(right), *small, np.array([0.4]), True).used
    assert learnt(Curvature(right, used=True), *small, np.array([0.4]), True).used


@settings(max_examples=60)
@given(seed=st.integers(0, 10**6), badly=st.floats(0.0, 5.0))
def test_step_of_the_quadratic_model(seed, badly):
    """J^T J + S is its matrix where that is positive definite, whatever the scales; its minimum is Newton's step."""
    rng = np.random.default_rng(seed)
    scales = 10.0 ** (badly * rng.uniform(-1, 1, 4))
    jacobian, residual = rng.standard_normal((12, 4)) * scales, rng.standard_normal(12)
    S = 0.1 * symmetric(rng, 4) * np.outer(scales, scales)
    model = augmented(LinearModel(residual, jacobian), S)
    hessian, gradient = jacobian.T @ jacobian + S, jacobian.T @ residual
    assert np.allclose((model.columns.T @ model.columns) / np.outer(scales, scales), hessian / np.outer(scales, scales), atol=1e-8)
    step = model.step
    assert step.d * scales == pytest.approx(-np.linalg.solve(hessian / np.outer(scales, scales), gradient / scales), rel=1e-5, abs=1e-8)
    assert step.drop == pytest.approx(-(2.0 * gradient @ step.d + step.d @ hessian @ step.d), rel=1e-6)


def test_step_of_the_quadratic_model_along_a_weak_direction():
    """Columns that agree but for 1e-3: the share of the smallest curvature is 1e-6, and counts."""
    rng = np.random.default_rng(3)
    jacobian, residual = rng.standard_normal((20, 2)), rng.standard_normal(20)
    jacobian[:, 1] = jacobian[:, 0] + 1e-3 * jacobian[:, 1]
    S = 1e-7 * np.eye(2)
    step = augmented(LinearModel(residual, jacobian), S).step
    assert step.d == pytest.approx(-np.linalg.solve(jacobian.T @ jacobian + S, jacobian.T @ residual), rel=1e-4)


def test_negative_curvature_goes_down():
    model = augmented(LinearModel(np.array([1.0, 0.1]), np.eye(2)), np.diag([0.0, -3.0]))
    assert model.step.d == pytest.approx([-1.0, -0.05])


T = np.arange(1, 21) / 5.0
SCALE = np.array([0.5, 2.0, 1.0, 0.1])


def brown_dennis(start, off=0.0, scale=(1.0, 1.0, 1.0, 1.0)):
    """Brown and Dennis' function (J. J. More, B. S. Garbow, K. E. Hillstrom, ACM Trans. Math. Softw. 7, 1981, no. 16), with data `off`."""

    def residual(x):
        return (x[0] + T * x[1] - np.exp(T)) ** 2 + (x[2] + x[3] * np.sin(T) - np.cos(T)) ** 2 + off * np.cos(3.0 * T)

    return exact(problem(residual, start, [-100.0] * 4, [100.0] * 4, scale))


@pytest.mark.parametrize("start", [[25.0, 5.0, -5.0, -1.0], [2.5, 5.0, -5.0, -1.0], [-10.0, 12.0, -1.0, 1.0]])
def test_large_residual(start):
    """The minimum is 85822.2; steps of Gauss-Newton alone take 53, 35 and 30 runs."""
    fit = minimise(brown_dennis(start), settings=Settings(x_tolerance=1e-6, f_tolerance=1e-9))
    assert fit.converged and fit.f == pytest.approx(85822.2016, rel=1e-8)
    assert fit.x == pytest.approx([-11.594440, 13.203630, -0.403439, 0.236779], abs=1e-4)
    assert fit.counts.forward < 24


def exponentials(seed):
    """exp(3 B x) - exp(3 B x_true) - e with a misfit e, and a start far off: trials overshoot by orders of magnitude."""
    rng = np.random.default_rng([seed, 4])
    p = int(rng.integers(2, 5))
    n = int(rng.integers(2 * p + 3, 40))
    B, _ = rng.standard_normal((n, p)), rng.standard_normal(n)
    true = 0.5 * rng.standard_normal(p)
    start = true + rng.standard_normal(p)
    misfit = 10 ** rng.uniform(-1, 1.5) * rng.standard_normal(n)
    return exact(problem(lambda x: np.exp(3.0 * B @ x) - np.exp(3.0 * B @ true) - misfit, start, start - 20.0, start + 20.0))


@pytest.mark.parametrize(("seed", "f"), [(99, 45.7), (148, 0.298), (308, 3.89), (340, 3.67)])
def test_a_wild_trial_does_not_end_the_search(seed, f):
    """It teaches a curvature that leaves no step; the linear model, which must agree to an end, knows better."""
    fit = minimise(exponentials(seed), settings=Settings(covariance=False))
    assert fit.converged and fit.f < 1.01 * f


def softer_bar(seed):
    """A bar whose force strays from its model by hundreds of times the noise, on a random way along the record; a start far off."""
    rng = np.random.default_rng(seed)
    base = bar_problem(BAR_TRUE)
    n = base.residual(BAR_TRUE).size
    misfit = 3000.0 * np.cumsum(rng.standard_normal(n)) / np.sqrt(n)
    start = np.clip(BAR_TRUE * np.exp(0.4 * rng.standard_normal(6)), 1.01 * base.lower, 0.99 * base.upper)
    start[2] = max(start[2], 300.0)
    return exact(problem(lambda x: base.residual(x) + misfit, start, base.lower, base.upper, base.scale, base.names))


@pytest.mark.parametrize("seed", [13, 4])
def test_a_trial_of_one_model_does_not_end_the_search_of_the_other(seed):
    """The end is that of a search which goes on to a hundredth of the tolerance."""
    wrong = softer_bar(seed)
    fit = minimise(wrong, settings=Settings(x_tolerance=1e-5, f_tolerance=1e-2, max_evaluations=300))
    sharp = minimise(wrong, settings=Settings(x_tolerance=1e-8, f_tolerance=1e-6, max_evaluations=900))
    assert fit.converged and sharp.converged
    assert fit.f - sharp.f < 0.05 * fit.f / (fit.residual.size - 6)


def test_a_rejected_trial_teaches_too():
    """The first trial overshoots and is rejected; the second one, based on what it taught, is nearly right. Without it: six runs."""
    curved = problem(lambda x: np.array([x[0] ** 2 + 30.0, x[0] - 1.0, 5.0, 5.0]), [0.1], [-9.0], [9.0])
    fit = minimise(exact(curved), settings=Settings(f_tolerance=1e-6))
    assert fit.converged and fit.x == pytest.approx([1.0 / 61.0], rel=1e-3)
    assert fit.counts.forward == 4


@pytest.mark.parametrize(("p", "n"), [(2, 9), (1, 3)])
def test_second_derivatives_are_not_asked_where_the_data_say_nothing(p, n, monkeypatch):
    """A parameter without effect, or fewer data than twice the parameters: steps are those of the linear model."""
    monkeypatch.setattr(secant, "augmented", lambda here, S: pytest.fail("quadratic model"))
    rest = np.full(n - 2, 5.0)
    curved = problem(lambda x: np.array([x[0] ** 2 + 30.0, x[0] - 1.0, *rest]) + 0.0 * x[-1], [0.1, 2.0][:p], [-9.0] * p, [9.0] * p)
    fit = minimise(exact(curved), settings=Settings(f_tolerance=1e-6))
    assert fit.x[0] == pytest.approx(1.0 / 61.0, rel=0.05) and (p == 1 or fit.x[1] == 2.0)


@pytest.mark.parametrize("seed", range(6))
def test_noise_of_the_residual_ends_a_search_whose_second_derivatives_outweigh(seed):
    """J^T J is 1, S is 60: a gradient of noise promises the linear model sixty times what there is to gain."""

    def noisy(x):
        noise = np.random.default_rng([seed, *np.real(x).tobytes()]).standard_normal(4)
        return np.array([x[0] ** 2 + 30.0, x[0] - 1.0, 5.0, 5.0]) + 0.01 * noise

    fit = minimise(exact(problem(noisy, [0.1], [-9.0], [9.0])), settings=Settings(f_tolerance=1e-4))
    assert fit.converged, fit.message
    assert 61.0 * (fit.x[0] - 1.0 / 61.0) ** 2 < 0.01 * fit.f / 3


def test_second_derivatives_known_near_by_spare_runs():
    """A fit tells those at its end, by the parameters, and one beside it begins with them: 2, 3 and 5 runs for 11, 11 and 10."""
    sharp = Settings(x_tolerance=1e-6, f_tolerance=1e-6)
    first = minimise(brown_dennis([25.0, 5.0, -5.0, -1.0], scale=SCALE), settings=sharp)
    one, zero = np.ones(20), np.zeros(20)
    sides = np.stack([one, T, zero, zero], 1), np.stack([zero, zero, one, np.sin(T)], 1)
    S = sum(2.0 * (side.T * first.residual) @ side for side in sides)
    assert first.curvature == pytest.approx(S, rel=0.05, abs=60.0)
    for off in (5.0, 50.0, 300.0):
        near = dataclasses.replace(brown_dennis(first.x, off, 3.0 * SCALE), first_jacobian=first.jacobian)
        plain = minimise(near, settings=sharp)
        told, wrong = (minimise(dataclasses.replace(near, first_curvature=by * first.curvature), settings=sharp) for by in (1.0, -1.0))
        assert told.counts.linearised < 0.7 * plain.counts.linearised, "they outweigh J^T J"
        assert [f.f for f in (told, wrong)] == pytest.approx([plain.f] * 2, rel=1e-7) and wrong.converged


def test_second_derivatives_are_kept_where_the_derivative_is_computed_anew():
    """The first trial with those of another model leads uphill, so that the derivative at the start is computed."""
    sharp = Settings(x_tolerance=1e-6, f_tolerance=1e-6)
    first = minimise(brown_dennis([25.0, 5.0, -5.0, -1.0], scale=SCALE), settings=sharp)
    near = dataclasses.replace(brown_dennis(first.x, 300.0, SCALE), first_jacobian=-first.jacobian)
    counts = [minimise(dataclasses.replace(near, first_curvature=S), settings=sharp).counts.linearised for S in (None, first.curvature)]
    assert counts[1] < 0.7 * counts[0]


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_nothing_is_learnt_between_a_derivative_of_another_model_and_the_own_one(factor):
    """They differ by half or by twice, and by what they curve, 4 runs; were that taken for second derivatives: 6 and 8."""
    sharp = Settings(x_tolerance=1e-6, f_tolerance=1e-6)
    first = minimise(brown_dennis([25.0, 5.0, -5.0, -1.0], scale=SCALE), settings=sharp)
    near = dataclasses.replace(brown_dennis(first.x, 50.0, SCALE), first_jacobian=factor * first.jacobian, first_curvature=first.curvature)
    assert minimise(near, settings=sharp).counts.linearised <= 4


def test_none_are_told_that_predicted_no_better():
    """The residual is linear: there are none to learn."""
    fit = minimise(exact(problem(lambda x: np.array([x[0] - 1.0, 2.0 * x[0], 3.0, 4.0]), [0.1], [-9.0], [9.0])))
    assert fit.converged and fit.curvature is None
