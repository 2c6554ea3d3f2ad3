"""The Taylor test of exact derivatives tells right from wrong columns."""

import dataclasses

import numpy as np
import pytest
from fit_models import BAR_NAMES, bar_problem, decay_problem, exact, problem
from jacobian_check import check_jacobian

from thermofit.core.errors import StudyError

NEAR = [69000.0, 125.0, 310.0, 12.0, 0.30, 0.5]


def test_right_derivatives_leave_a_remainder_of_second_order():
    found = check_jacobian(exact(decay_problem()))
    assert found.passed.all() and found.text().startswith("derivatives are right")
    # Two of the four parameters enter linearly: there the remainder is rounding and has no order.
    assert found.order[[1, 3]] == pytest.approx(2.0, abs=0.01)


@pytest.mark.parametrize("relative", [1e-3, 1e-1])
def test_wrong_column_is_named(relative):
    base = exact(bar_problem(NEAR))

    def linearise(x):
        residual, jacobian = base.linearise(x)
        return residual, jacobian * np.where(np.array(BAR_NAMES) == "H_exp", 1.0 + relative, 1.0)

    found = check_jacobian(dataclasses.replace(base, linearise=linearise), tolerance=1e-4)
    assert list(np.array(BAR_NAMES)[~found.passed]) == ["H_exp"]
    assert found.error[3] == pytest.approx(relative / (1.0 + relative), rel=0.01)
    assert "with respect to H_exp" in found.text()


def test_steps_turn_inward_at_a_bound_and_a_dead_column_passes():
    seen = []

    def residual(x):
        seen.append(np.real(x[0]))
        return np.array([np.exp(x[0]), 1.0 + 0.0 * x[1]])

    found = check_jacobian(exact(problem(residual, [1.0, 0.5], [0.0, 0.0], [1.0, 1.0])))
    assert found.passed.all() and max(seen) <= 1.0 and len(set(seen)) == 3


def test_without_exact_derivatives_there_is_nothing_to_check():
    with pytest.raises(StudyError, match="no exact derivatives"):
        check_jacobian(decay_problem())
