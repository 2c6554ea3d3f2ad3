"""Finite differences: order, bounds, failing sides."""

import numpy as np
import pytest
from fit_models import problem

from thermofit.core.errors import NumericsError
from thermofit.fit.evaluate import Evaluations
from thermofit.fit.jacobian import jacobian_at
from thermofit.fit.settings import Settings


def _curve(x):
    return np.array([np.exp(0.7 * x[0]) * x[1] ** 3, np.sin(x[0] * x[1]), x[0] ** 4])


def _exact(x):
    e = np.exp(0.7 * x[0])
    c = np.cos(x[0] * x[1])
    return np.array([[0.7 * e * x[1] ** 3, 3 * e * x[1] ** 2], [c * x[1], c * x[0]], [4 * x[0] ** 3, 0.0]])


X = np.array([0.8, 1.3])


def _error(kind, step, lower=None, upper=None):
    evaluations = Evaluations(problem(_curve, X, lower, upper))
    found = jacobian_at(evaluations, X, Settings(differences=kind, difference_step=step))
    return np.linalg.norm(found - _exact(X)), evaluations.counts().forward


@pytest.mark.parametrize(("kind", "order", "runs"), [("forward", 1, 3), ("central", 2, 5)])
@pytest.mark.parametrize("bounds", [(None, None), (None, X), (X, None)])
def test_order_of_convergence(kind, order, runs, bounds):
    """Also at a bound, where the difference must lean inward."""
    coarse, forward = _error(kind, 1e-2, *bounds)
    fine, _ = _error(kind, 1e-3, *bounds)
    assert np.log10(coarse / fine) == pytest.approx(order, abs=0.1)
    assert forward == runs


def test_never_outside_the_bounds():
    lower, upper = X - 1e-6, X + 2e-6
    evaluations = Evaluations(problem(_curve, X, lower, upper))
    for kind in ("forward", "central"):
        found = jacobian_at(evaluations, X, Settings(differences=kind, difference_step=1e-3))
        assert np.allclose(found, _exact(X), rtol=1e-4)
    assert all((lower <= e.x).all() and (e.x <= upper).all() for e in evaluations.log)


@pytest.mark.parametrize("kind", ["forward", "central"])
def test_failing_side_is_replaced_and_counted(kind):
    def half(x):
        if x[1] > X[1]:
            raise NumericsError("too far")
        return _curve(x)

    evaluations = Evaluations(problem(half, X))
    assert np.allclose(jacobian_at(evaluations, X, Settings(differences=kind)), _exact(X), rtol=1e-3, atol=1e-12)
    assert evaluations.counts().failed == 1


def test_both_sides_failing_names_the_parameter():
    def only_here(x):
        if x[1] != X[1]:
            raise NumericsError("too far")
        return _curve(x)

    with pytest.raises(NumericsError, match="'p1'"):
        jacobian_at(Evaluations(problem(only_here, X)), X, Settings())


def test_exact_jacobian_is_used_once_and_checked():
    evaluations = Evaluations(problem(_curve, X, jacobian=_exact))
    for _ in range(2):
        assert np.array_equal(jacobian_at(evaluations, X, Settings()), _exact(X))
    assert (evaluations.counts().forward, evaluations.counts().linearised, evaluations.counts().repeated) == (1, 1, 1)
    wrong = Evaluations(problem(_curve, X, jacobian=lambda x: _exact(x).T))
    with pytest.raises(ValueError, match="expected \\(3, 2\\)"):
        jacobian_at(wrong, X, Settings())
    broken = Evaluations(problem(_curve, X, jacobian=lambda x: _exact(x) * np.nan))
    with pytest.raises(NumericsError, match="not finite"):
        jacobian_at(broken, X, Settings())
