"""Covariance with the factor of the errata, against Monte Carlo; correlations; what is not determined."""

import numpy as np
import pytest
import scipy.linalg
from fit_models import TIMES, decay_problem

from thermofit.core.errors import UntrustworthyError
from thermofit.fit.covariance import correlation
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.minimise import minimise

RNG = np.random.default_rng(7)
J = RNG.standard_normal((60, 3)) @ np.array([[1.0, 0.6, 0.0], [0.0, 1.0, -0.4], [0.0, 0.0, 1.0]]) * np.array([1.0, 1.0, 1e-5])
NAMES = ("E", "nu", "c0")


def test_linear_model_has_the_textbook_covariance():
    residual = RNG.standard_normal(60)
    found = LinearModel(residual, J).covariance(NAMES)
    s2 = residual @ residual / 57
    assert found.s2 == pytest.approx(s2)
    assert np.allclose(found.matrix_unit, np.linalg.inv(J.T @ J), rtol=1e-8)
    assert np.allclose(found.sigma, np.sqrt(s2 * np.diag(np.linalg.inv(J.T @ J))))
    # The thesis's (2.36) taken literally, s2 H_lin^-1 with H_lin = 2 J^T J, is half of it.
    assert np.allclose(found.matrix, 2.0 * s2 * np.linalg.inv(2.0 * J.T @ J), rtol=1e-8)


def test_sigma_agrees_with_monte_carlo():
    """Scatter of 600 fits of two exponentials: 3 % sure, so that an error of sqrt(2) is far outside 10 %."""
    design = np.column_stack([np.exp(-1.5 * TIMES), np.exp(-0.3 * TIMES), TIMES])
    truth, noise = np.array([2.0, 1.0, 0.1]), 0.05
    estimates, sigmas = [], []
    for _ in range(600):
        data = design @ truth + noise * RNG.standard_normal(TIMES.size)
        x = np.linalg.lstsq(design, data, rcond=None)[0]
        estimates.append(x)
        sigmas.append(LinearModel((design @ x - data) / (3.0 * noise), design / (3.0 * noise)).covariance(NAMES).sigma)
    scatter = np.std(estimates, axis=0, ddof=1)
    # The whitening above is wrong by 3 on purpose: the reduced chi-square mends it.
    assert np.allclose(np.sqrt(np.mean(np.square(sigmas), axis=0)), scatter, rtol=0.1)


def test_sigma_of_a_nonlinear_fit_agrees_with_monte_carlo():
    fits = [minimise(decay_problem(seed)) for seed in range(200)]
    assert all(fit.converged for fit in fits)
    scatter = np.std([fit.x for fit in fits], axis=0, ddof=1)
    sigma = np.sqrt(np.mean([fit.covariance.sigma_unit**2 for fit in fits], axis=0))
    assert np.allclose(sigma, scatter, rtol=0.2)  # 200 fits: 5 % sure


def test_sandwich_for_correlated_residuals_agrees_with_monte_carlo():
    n = 80
    C = scipy.linalg.toeplitz(0.8 ** np.arange(n))
    root = np.linalg.cholesky(C)
    design = np.column_stack([np.ones(n), np.linspace(-1.0, 1.0, n)])
    names = ("a", "b")
    estimates = []
    s2 = []
    for _ in range(1500):
        noise = root @ RNG.standard_normal(n)
        x = np.linalg.lstsq(design, noise, rcond=None)[0]
        estimates.append(x)
        s2.append(LinearModel(design @ x - noise, design, lambda v: C @ v).covariance(names).s2)
    found = LinearModel(noise, design, lambda v: C @ v).covariance(names)
    assert np.allclose(found.sigma_unit, np.std(estimates, axis=0), rtol=0.08)
    naive = LinearModel(noise, design).covariance(names).sigma_unit
    assert (found.sigma_unit > 2.0 * naive).all()
    assert np.mean(s2) == pytest.approx(1.0, rel=0.05)
    white = LinearModel(noise, design, lambda v: v).covariance(names)
    assert np.allclose(white.sigma, LinearModel(noise, design).covariance(names).sigma)


def test_correlation_matrices():
    found = LinearModel(np.ones(60), J).covariance(NAMES)
    unit = J / np.linalg.norm(J, axis=0)
    assert np.allclose(found.correlation_sensitivity, unit.T @ unit)
    inverse = np.linalg.inv(unit.T @ unit)
    assert np.allclose(found.correlation_parameters, correlation(inverse))
    assert np.allclose(np.diag(found.correlation_parameters), 1.0)
    # Two parameters: C^P is minus C^S.
    two = LinearModel(np.ones(60), J[:, :2]).covariance(NAMES[:2])
    assert two.correlation_parameters[0, 1] == pytest.approx(-two.correlation_sensitivity[0, 1])


def test_dependent_and_effectless_parameters_are_named():
    a, b, c = J.T
    dependent = np.column_stack([a, 1e4 * a, b, -2.0 * b, c, 0.0 * a])
    names = ("E", "H_lin", "nu", "F", "c0", "beta")
    found = LinearModel(np.ones(60), dependent).covariance(names)
    assert not found.identifiable
    assert sorted(tuple(sorted(d.names)) for d in found.null) == [("E", "H_lin"), ("F", "nu"), ("beta",)]
    assert np.array_equal(np.isinf(found.sigma), [True, True, True, True, False, True])
    assert np.isfinite(found.matrix).all() and np.isfinite(found.correlation_sensitivity).all()
    # What is determined keeps the error that it would have with one of each pair fixed.
    assert found.sigma_unit[4] == pytest.approx(LinearModel(np.ones(60), J).covariance(NAMES).sigma_unit[2], rel=1e-6)
    assert LinearModel(np.ones(60), J).covariance(NAMES).identifiable


def test_dependence_of_three_is_one_direction():
    a, b, c = (column / np.linalg.norm(column) for column in J.T)
    found = LinearModel(np.ones(60), np.column_stack([a, b, a + b, c])).covariance(("x", "y", "z", "w"))
    assert [set(d.names) for d in found.null] == [{"x", "y", "z"}]
    assert np.isfinite(found.sigma[3])


def test_units_do_not_matter():
    factor = np.array([1e-9, 1e3, 1e12])
    plain, scaled = LinearModel(np.ones(60), J).covariance(NAMES), LinearModel(np.ones(60), J * factor).covariance(NAMES)
    assert scaled.identifiable
    assert np.allclose(plain.sigma, scaled.sigma * factor)
    assert plain.condition == pytest.approx(scaled.condition)


def test_parameter_at_a_bound_is_held_for_the_others():
    found = LinearModel(np.ones(60), J).covariance(NAMES, at_bound=np.array([False, True, False]))
    rest = LinearModel(np.ones(60), J[:, [0, 2]]).covariance(("E", "c0"))
    assert np.allclose(found.sigma_unit[[0, 2]], rest.sigma_unit)
    assert found.degrees_of_freedom == 58
    assert found.sigma_unit[1] == pytest.approx(LinearModel(np.ones(60), J).covariance(NAMES).sigma_unit[1])
    assert not found.matrix[1].any()


def test_all_at_bounds():
    found = LinearModel(np.ones(60), J).covariance(NAMES, at_bound=np.ones(3, dtype=bool))
    assert np.allclose(found.sigma_unit, 1.0 / np.linalg.norm(J, axis=0))


def test_too_few_data():
    with pytest.raises(UntrustworthyError, match="3 residuals cannot determine 3 parameters"):
        LinearModel(np.ones(3), J[:3]).covariance(NAMES)
