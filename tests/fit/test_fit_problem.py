"""Problem and Settings: what does not fit together is refused with the name; scaling is exact at the start."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermofit.core.errors import StudyError
from thermofit.fit.problem import Problem, from_scaled, scaled_bounds, to_scaled
from thermofit.fit.settings import Settings


def _problem(start=1.0, lower=0.0, upper=2.0, scale=1.0) -> Problem:
    one = np.array
    return Problem(lambda x: x, one([start]), one([lower]), one([upper]), one([scale]), ("E",))


@pytest.mark.parametrize(
    "change", [{"start": 3.0}, {"start": np.nan}, {"lower": 2.0}, {"scale": 0.0}, {"scale": np.inf}, {"lower": np.nan}]
)
def test_contradictions_name_the_parameter(change):
    with pytest.raises(StudyError, match="'E'"):
        _problem(**change)


def test_no_free_parameter_and_wrong_length():
    empty = np.zeros(0)
    with pytest.raises(StudyError, match="no parameter is free"):
        Problem(lambda x: x, empty, empty, empty, empty, ())
    with pytest.raises(StudyError, match="'lower' has shape"):
        Problem(lambda x: x, np.ones(2), np.zeros(1), np.ones(2) * 2, np.ones(2), ("E", "nu"))


def test_settings_name_the_key():
    with pytest.raises(StudyError, match="x_tolerance"):
        Settings(x_tolerance=0.0)
    with pytest.raises(StudyError, match="differences"):
        Settings(differences="backward")


finite = st.floats(-1e6, 1e6)


@given(start=finite, scale=st.floats(1e-7, 1e7), move=st.floats(-50.0, 50.0))
def test_scaling_round_trip_and_exact_start(start, scale, move):
    problem = _problem(start, start - 10.0 * scale - 1.0, start + 10.0 * scale + 1.0, scale)
    assert from_scaled(problem, to_scaled(problem, problem.start)) == start
    x = from_scaled(problem, np.array([1.0 + move]))
    assert problem.lower <= x <= problem.upper
    expected = np.clip(start + scale * move, problem.lower, problem.upper)
    assert np.allclose(x, expected, rtol=1e-12, atol=2e-11 * scale)


def test_scaled_variables_ignore_the_last_bits():
    problem = _problem(1.0, -5.0, 5.0, 0.7)
    assert from_scaled(problem, np.array([1.3])) == from_scaled(problem, np.array([1.3 + 1e-15]))
    assert from_scaled(problem, np.array([1.3])) != from_scaled(problem, np.array([1.3 + 1e-9]))


def test_infinite_bounds_stay_infinite():
    low, up = scaled_bounds(_problem(1.0, -np.inf, np.inf))
    assert low == -np.inf and up == np.inf
