"""The contact coefficient as a resistance: the same optimum and standard error, from far away too."""

import numpy as np
import pytest

from thermofit.fit.linear_model import LinearModel
from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.identify.reciprocal import reciprocal_of

NAMES = ("kappa", "alpha_clamp")
DEPTH = np.linspace(0.0, 1.0, 40)


def residual(x: np.ndarray) -> np.ndarray:
    """A wall of conductivity kappa behind a contact: temperature drop depth/kappa + 1/alpha."""
    noise = 1e-5 * np.sin(37.0 * DEPTH)
    return ((DEPTH / x[0] + 1.0 / x[1]) - (DEPTH / 130.0 + 1.0 / 236.0) + noise) / 1e-5


def test_isothermal_start_finds_the_contact_coefficient() -> None:
    change = reciprocal_of(NAMES)
    lower, upper = change.bounds(np.array([20.0, 0.0]), np.array([600.0, 1e8]))
    start = change.variables(np.array([200.0, 4e5]))
    assert np.all(lower < upper) and np.all((lower <= start) & (start <= upper))
    problem = Problem(lambda y: residual(change.parameters(y)), start, lower, upper, change.scales(np.array([150.0, 100.0])), NAMES)
    fit = change.converted(minimise(problem))
    assert fit.converged
    assert fit.x == pytest.approx([130.0, 236.0], rel=0.01)
    assert fit.jacobian is not None
    step = 1e-3
    difference = (residual(fit.x + np.array([0.0, step])) - residual(fit.x - np.array([0.0, step]))) / (2.0 * step)
    assert fit.jacobian[:, 1] == pytest.approx(difference, rel=1e-3)
    assert np.isfinite(LinearModel(fit.residual, fit.jacobian).covariance(NAMES).sigma).all()


def test_map_is_its_own_inverse() -> None:
    change = reciprocal_of(NAMES)
    x = np.array([133.0, 236.3])
    assert change.parameters(change.variables(x)) == pytest.approx(x, rel=1e-15)
    assert change.variables(x)[0] == x[0]
