"""Profile likelihood: exact for a linear model, skewed where the model is, open at a bound, resumed after a kill."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.fit.profile import Optimum, Side, profile_side
from thermofit.fit.settings import Settings
from thermofit.records.checkpoint import Checkpoint

TIME = np.linspace(0.0, 2.0, 40)
TIGHT = Settings(x_tolerance=1e-7, f_tolerance=1e-5, covariance=False)
RISE = 3.84


def line(lower: float = -50.0) -> Problem:
    noise = np.random.default_rng(3).normal(size=len(TIME))
    data = 1.0 + 2.0 * TIME + 0.2 * noise
    jacobian = np.stack([np.ones_like(TIME), TIME], axis=1) / 0.2

    def residual(x: np.ndarray) -> np.ndarray:
        return jacobian @ x - data / 0.2

    start = np.array([max(0.0, lower), 1.0])
    return Problem(residual, start, np.array([lower, -50.0]), np.full(2, 50.0), np.ones(2), ("a", "b"), lambda x: (residual(x), jacobian))


def decay() -> Problem:
    """1/(1 + t/tau): an interval of tau is skewed."""
    noise = np.random.default_rng(5).normal(size=len(TIME))
    data = 1.0 / (1.0 + TIME / 3.0) + 0.1 * noise

    def linearise(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shape = 1.0 / (1.0 + TIME / x[1])
        columns = np.stack([shape, x[0] * shape**2 * TIME / x[1] ** 2], axis=1) / 0.1
        return (x[0] * shape - data) / 0.1, columns

    return Problem(
        lambda x: linearise(x)[0], np.array([1.0, 3.0]), np.zeros(2) + 1e-3, np.array([10.0, 500.0]), np.ones(2), ("a", "tau"), linearise
    )


def optimum(problem: Problem) -> Optimum:
    fit = minimise(problem, "least-squares", Settings(x_tolerance=1e-8, f_tolerance=1e-8))
    assert fit.jacobian is not None
    return Optimum(fit.x, fit.f, fit.jacobian)


def sides(problem: Problem, i: int) -> tuple[Side, Side]:
    at = optimum(problem)
    return profile_side(problem, at, (i, -1), RISE, TIGHT), profile_side(problem, at, (i, 1), RISE, TIGHT)


def test_profile_of_a_linear_model_is_its_standard_error() -> None:
    problem = line()
    at = optimum(problem)
    sigma = LinearModel(problem.residual(at.x), at.jacobian).covariance(problem.names).sigma_unit
    for i in (0, 1):
        low, high = sides(problem, i)
        assert not low.open and not high.open
        assert (at.x[i] - low.end, high.end - at.x[i]) == pytest.approx([np.sqrt(RISE) * sigma[i]] * 2, rel=1e-3)


def test_the_others_follow() -> None:
    """At the end of the interval the other parameter is its own optimum there, not where it was."""
    problem = line()
    at = optimum(problem)
    high = profile_side(problem, at, (0, 1), RISE, TIGHT)
    shift = high.x[-1] - at.x
    assert shift[1] / shift[0] == pytest.approx(-np.mean(TIME) / np.mean(TIME**2), rel=1e-3)


def test_skewed_interval_by_brute_force() -> None:
    problem = decay()
    at = optimum(problem)
    low, high = sides(problem, 1)
    for side in (low, high):
        shape = 1.0 / (1.0 + TIME / side.end)
        data = problem.residual(np.array([0.0, 3.0])) * -0.1
        best = shape @ data / (shape @ shape)
        r = (best * shape - data) / 0.1
        assert r @ r - at.f == pytest.approx(RISE, rel=0.06)
    assert high.end - at.x[1] > 1.2 * (at.x[1] - low.end)


def test_bound_leaves_the_interval_open() -> None:
    free = optimum(line())
    bounded = line(float(free.x[0]) - 0.02)
    low, high = sides(bounded, 0)
    assert low.open and low.end == pytest.approx(free.x[0] - 0.02) and "bound" in low.remark
    assert not high.open


def test_a_model_that_fails_ends_the_interval_open() -> None:
    problem = decay()
    exact = problem.linearise
    assert exact is not None

    def failing(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if x[1] > 3.3:
            raise NumericsError("the bar tears")
        return exact(x)

    broken = Problem(lambda x: failing(x)[0], problem.start, problem.lower, problem.upper, problem.scale, problem.names, failing)
    at = optimum(problem)
    side = profile_side(broken, Optimum(np.array([at.x[0], min(at.x[1], 3.2)]), at.f, at.jacobian), (1, 1), RISE, TIGHT)
    assert side.open and "the bar tears" in side.remark and side.end <= 3.3


def test_a_lower_objective_on_the_way_is_said() -> None:
    problem = line()
    at = optimum(problem)
    wrong = at.x + np.array([0.3, 0.0])
    r = problem.residual(wrong)
    side = profile_side(problem, Optimum(wrong, float(r @ r), at.jacobian), (0, -1), RISE, TIGHT)
    assert "the optimum was none" in side.remark


def test_profile_resumes(tmp_path: Path) -> None:
    """The second time nothing is computed, and the answer is the same bit by bit."""
    problem, at = decay(), optimum(decay())
    first = profile_side(problem, at, (1, 1), RISE, TIGHT, Checkpoint(tmp_path, "k"))
    again = profile_side(problem, at, (1, 1), RISE, TIGHT, Checkpoint(tmp_path, "k"))
    assert first.forward > 0 and again.forward == 0 and again.replayed == first.forward
    assert again.end == first.end
    # The other variable has places of its own in the same store.
    other = profile_side(problem, at, (0, 1), RISE, TIGHT, Checkpoint(tmp_path, "k"))
    assert other.forward > 0
