"""Information of a Jacobian: flat directions of known products, detectability, sets to fix, correlated noise."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.fit.information import Information, criteria, detectability, fixing_sets, information, relative_sigma, spectrum
from thermofit.fit.linear_model import LinearModel

TIME = np.linspace(0.1, 3.0, 60)
NAMES = ("alpha_exp", "kappa", "c0", "beta")
X = np.array([2e-5, 130.0, 2.2, 0.8])


def scale_free(x: np.ndarray) -> np.ndarray:
    """A quantity that depends on ratios to the last parameter only, as a heat balance with its source in front of every term does."""
    a, k, c, b = x
    return np.asarray(b / c * np.exp(-k / (60.0 * c) * TIME) + 3e4 * a / c * np.sin(TIME))


def slopes(x: np.ndarray) -> np.ndarray:
    """Complex-step derivatives (n, n_p)."""
    out = np.empty((len(TIME), len(x)))
    for i in range(len(x)):
        z = x.astype(complex)
        z[i] += 1e-30j * x[i]
        a, k, c, b = z
        out[:, i] = (b / c * np.exp(-k / (60.0 * c) * TIME) + 3e4 * a / c * np.sin(TIME)).imag / (1e-30 * x[i])
    return out


def scaled(x: np.ndarray = X, sigma: float = 1e-3) -> Information:
    return information(slopes(x) / sigma, NAMES, x, np.abs(x))


def test_valley_of_constant_ratios() -> None:
    """All four can grow by one factor: the direction is that of equal exponents, and the ratios to the reference are what the data give."""
    found = spectrum(scaled(), "beta")
    assert len(found.flat) == 1
    flat = found.flat[0]
    assert flat.exact and flat.members == NAMES and flat.reference == "beta"
    assert np.abs(flat.direction) == pytest.approx(0.5, rel=1e-9)
    assert {i.name: i.plain for i in flat.invariants} == {"alpha_exp": 1, "kappa": 1, "c0": 1}
    assert all(i.drift < 1e-9 and 0.0 < i.sigma < 0.02 for i in flat.invariants)
    # Along the direction nothing changes, to all orders.
    assert scale_free(1.7 * X) == pytest.approx(scale_free(X), rel=1e-12)
    assert sorted(fixing_sets(scaled())) == [("alpha_exp",), ("beta",), ("c0",), ("kappa",)]


def test_sigma_of_an_invariant_is_that_of_the_fit_with_the_reference_given() -> None:
    """ln(kappa/beta) has the standard error of ln(kappa) where beta is fixed."""
    flat = spectrum(scaled(), "beta").flat[0]
    fixed = relative_sigma(scaled().of([0, 1, 2]))
    assert [i.sigma for i in flat.invariants] == pytest.approx(list(fixed), rel=1e-6)


def test_products_and_powers() -> None:
    """y = a b^2: the data give the product, whose exponent is found."""
    x = np.array([2.0, 3.0])
    jacobian = np.stack([TIME * x[1] ** 2, TIME * 2.0 * x[0] * x[1]], axis=1)
    flat = spectrum(information(jacobian, ("a", "b"), x, x)).flat[0]
    assert flat.members == ("a", "b") and flat.reference == "a"
    assert flat.invariants[0].exponent == pytest.approx(-0.5) and flat.invariants[0].plain is None
    jacobian[:, 1] = TIME * x[0]
    jacobian[:, 0] = TIME * x[1]
    assert spectrum(information(jacobian, ("a", "b"), x, x)).flat[0].invariants[0].plain == -1


def test_unique_where_a_term_breaks_the_scale() -> None:
    """One more column that is no multiple makes all four known; the standard errors are those of the covariance."""
    jacobian = slopes(X) / 1e-4
    jacobian[:, 3] += 100.0 * TIME**2
    info = information(jacobian, NAMES, X, X)
    found = spectrum(info, "beta")
    assert not found.flat and fixing_sets(info) == ((),)
    spread = LinearModel(np.zeros(len(jacobian)), jacobian).covariance(NAMES)
    assert relative_sigma(info) * X == pytest.approx(spread.sigma_unit, rel=1e-8)
    assert found.sigma.max() == pytest.approx(criteria(info).e)
    # D-criterion: geometric mean of the axes, from the determinant of the covariance.
    unit = spread.matrix_unit / np.outer(X, X)
    assert criteria(info).d == pytest.approx(np.linalg.det(unit) ** (1.0 / 8.0), rel=1e-6)
    assert criteria(info).a == pytest.approx(np.sqrt(np.trace(unit) / 4.0), rel=1e-6)


def test_correlated_noise_widens_as_the_sandwich_does() -> None:
    jacobian = slopes(X)[:, :3] / 1e-3
    lag = np.abs(np.arange(len(TIME))[:, None] - np.arange(len(TIME)))
    matrix = 0.9**lag

    def noise(v: np.ndarray) -> np.ndarray:
        return np.asarray(matrix @ v)

    info = information(jacobian, NAMES[:3], X[:3], X[:3], noise, 4.0)
    spread = LinearModel(np.zeros(len(jacobian)), jacobian, noise).covariance(NAMES[:3])
    assert relative_sigma(info) * X[:3] == pytest.approx(2.0 * spread.sigma_unit, rel=1e-8)
    assert relative_sigma(info)[0] > 1.5 * 2.0 * relative_sigma(information(jacobian, NAMES[:3], X[:3], X[:3]))[0]


def test_a_parameter_without_effect_is_alone_in_its_direction() -> None:
    jacobian = np.column_stack([slopes(X)[:, :2] / 1e-4, np.zeros(len(TIME))])
    info = information(jacobian, ("a", "b", "dead"), X[:3], X[:3])
    found = spectrum(info)
    assert [flat.members for flat in found.flat] == [("dead",)] and found.flat[0].sigma == np.inf
    assert detectability(info)[2] == 0.0 and relative_sigma(info)[2] == np.inf
    assert fixing_sets(info) == (("dead",),)


def test_detectability_is_the_sine_to_the_others() -> None:
    """Two unit columns at 30 degrees: half of either is its own."""
    jacobian = np.zeros((3, 2))
    jacobian[0, 0] = 1.0
    jacobian[:2, 1] = np.cos(np.pi / 6.0), np.sin(np.pi / 6.0)
    info = information(jacobian, ("a", "b"), np.ones(2), np.ones(2))
    assert detectability(info) == pytest.approx([0.5, 0.5])


def test_two_flat_directions_need_two_numbers() -> None:
    """a/b and c/d are seen, nothing else: one of each pair must be given."""
    rng = np.random.default_rng(0)
    u, v = rng.normal(size=(2, 50)) * 1e3
    jacobian = np.stack([u, -u, v, -v], axis=1)
    info = information(jacobian, ("a", "b", "c", "d"), np.ones(4), np.ones(4))
    found = spectrum(info)
    assert sorted(flat.members for flat in found.flat) == [("a", "b"), ("c", "d")]
    assert set(fixing_sets(info)) == {("a", "c"), ("a", "d"), ("b", "c"), ("b", "d")}
    assert criteria(info).d == np.inf
