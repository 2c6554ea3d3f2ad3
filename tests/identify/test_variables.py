"""The contact coefficient as a resistance: the same optimum and standard error, from far away too."""

import dataclasses

import numpy as np
import pytest

from thermofit.core.parameters import Parameters
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.fit.result import FitResult
from thermofit.fit.settings import Settings
from thermofit.identify.variables import FitVariables, fit_variables

NAMES = ("kappa", "alpha_clamp")
DEPTH = np.linspace(0.0, 1.0, 40)


def residual(x: np.ndarray) -> np.ndarray:
    """A wall of conductivity kappa behind a contact: temperature drop depth/kappa + 1/alpha."""
    noise = 1e-5 * np.sin(37.0 * DEPTH)
    return ((DEPTH / x[0] + 1.0 / x[1]) - (DEPTH / 130.0 + 1.0 / 236.0) + noise) / 1e-5


def test_isothermal_start_finds_the_contact_coefficient() -> None:
    change = fit_variables(NAMES, Parameters.of({}))
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
    change = fit_variables(NAMES, Parameters.of({}))
    x = np.array([133.0, 236.3])
    assert change.parameters(change.variables(x)) == pytest.approx(x, rel=1e-15)
    assert change.variables(x)[0] == x[0]


def test_an_amplitude_and_its_exponent_are_fitted_by_their_logarithms() -> None:
    """Overstress K ((1 + z)^m - 1), m = 0.05: what data tell is K m. From m = 0.6 few steps in the logarithms reach it, none in K and m."""
    names, rate = ("rate_power.K", "rate_power.m"), np.linspace(1.0, 9.0, 60)
    truth = Parameters.of({"rate_power.K": 400.0, "rate_power.m": 0.05}, names)

    def off(x: np.ndarray) -> np.ndarray:
        return np.asarray((x[0] * ((1.0 + rate) ** x[1] - 1.0) - 400.0 * ((1.0 + rate) ** 0.05 - 1.0)) / 0.01)

    def fitted(change: FitVariables) -> FitResult:
        def linearise(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            x = change.parameters(y)
            columns = np.stack([off(x + 1e-30j * unit).imag / 1e-30 for unit in np.eye(2)], axis=1)
            return off(x), change.by_variables(columns, x)

        lower, upper = change.bounds(np.array([0.0, 0.02]), np.array([2000.0, 1.0]))
        start, scales = change.variables(np.array([25.0, 0.6])), change.scales(np.array([5.0, 0.1]))
        problem = Problem(lambda y: off(change.parameters(y)), start, lower, upper, scales, names, linearise)
        return change.converted(minimise(problem, settings=Settings(max_evaluations=12)))

    change = fit_variables(names, truth)
    assert change.is_log.all()
    assert fitted(change).x == pytest.approx([400.0, 0.05], rel=1e-3)
    plain = FitVariables(np.zeros(2, bool), np.zeros(2, bool), np.zeros(2))
    assert fitted(plain).f > 100.0 * fitted(change).f + 1.0


@pytest.mark.parametrize(
    ("names", "at", "expected"),
    [
        (("rate_power.K", "rate_power.m"), {}, (True, True)),
        (("rate_power.K",), {}, (False,)),
        (("rate_power.K", "rate_power.m"), {"rate_power.K": 0.0}, (False, True)),
        (("backstress_first.C", "backstress_first.gamma"), {"backstress_first.gamma": 0.0}, (False, False)),
        (("second_hardening.Q", "second_hardening.b"), {}, (False, False)),
        (("rate_power.K@second", "rate_power.m@second"), {}, (True, True)),
    ],
)
def test_what_is_fitted_by_its_logarithm(names: tuple[str, ...], at: dict[str, float], expected: tuple[bool, ...]) -> None:
    """Not an amplitude without its exponent, nor one that begins at nothing or that may have either sign."""
    values = Parameters.of({**dict.fromkeys(names, 0.5), **at})
    assert tuple(fit_variables(names, values).is_log) == expected


def test_a_bound_of_zero_is_a_millionth_of_the_usual_size() -> None:
    change = fit_variables(("rate_power.K", "rate_power.m"), Parameters.of({"rate_power.K": 3.0, "rate_power.m": 0.2}))
    lower, _ = change.bounds(np.array([0.0, 0.02]), np.array([2000.0, 1.0]))
    assert change.parameters(lower) == pytest.approx([5e-6, 0.02])


def test_second_derivatives_follow_the_variables() -> None:
    """J^T J changes as what second derivatives add to it does, there and back: 1/alpha and ln K."""
    names = ("alpha_clamp", "kappa", "rate_power.K", "rate_power.m")
    change, x = fit_variables(names, Parameters.of(dict.fromkeys(names, 0.3))), np.array([236.0, 130.0, 40.0, 0.3])
    assert change.is_reciprocal.any() and change.is_log.any() and not (change.is_reciprocal | change.is_log).all()
    slopes = np.random.default_rng(1).normal(size=(9, 4))
    by_variables = change.by_variables(slopes, x)
    assert change.curvature_by_variables(slopes.T @ slopes, x) == pytest.approx(by_variables.T @ by_variables, rel=1e-12)
    fields = dict.fromkeys(f.name for f in dataclasses.fields(FitResult))
    fit = FitResult(**fields | {"x": change.variables(x), "log": (), "curvature": by_variables.T @ by_variables})  # type: ignore[arg-type]
    assert change.converted(fit).curvature == pytest.approx(slopes.T @ slopes, rel=1e-12)
