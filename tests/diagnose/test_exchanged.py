"""What is of one form may be exchanged: the same model, and intervals that hold both where nothing tells which is which."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose import whole_loop
from thermofit.diagnose.beside_source import FORM
from thermofit.diagnose.case import Case
from thermofit.diagnose.exchanged import exchanged, likelihood, with_exchanged
from thermofit.diagnose.loop import Closed
from thermofit.effects.catalogue import effect, effects
from thermofit.experiment.coupon_records import CouponTest, whole
from thermofit.experiment.coupon_sensor import shown
from thermofit.fit.budget import EXCHANGED
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult
from thermofit.point.driver import PointSettings, Programme, simulate

TAU, LAG = 2.5, 0.6
TIME = np.linspace(0.0, 6.0, 40)
NOISE = 0.01
BASE = {
    "E": 200000.0,
    "nu": 0.3,
    "M_y0": 350.0,
    "M_yinf": 480.0,
    "H_exp": 25.0,
    "beta": 0.9,
    "c0": 3.65,
    "alpha_exp": 12e-6,
    "tau": 60.0,
    "lag": LAG,
}
ON = {"ir_lag": {"ir_lag.time": 1.7}, "second_hardening": {"second_hardening.Q": 40.0, "second_hardening.b": 150.0}}


def rise(times: np.ndarray) -> np.ndarray:
    """What two sensors in series show of a ramp: they commute."""
    a, b = times
    return np.asarray(TIME - a - b + (a**2 * np.exp(-TIME / a) - b**2 * np.exp(-TIME / b)) / (a - b))


def fitted(reading: float | None = None) -> tuple[FitResult, Any]:
    """The fit of (lag, ir_lag.time) at the exchanged optimum, and its residual; with a reading of the lag, known to 0.1 s, as the last
    row."""

    def residual(p: Parameters) -> np.ndarray:
        x = np.array([p["lag"], p["ir_lag.time"]])
        r = (rise(x) - rise(np.array([LAG, TAU]))) / NOISE
        return r if reading is None else np.append(r, (x[0] - reading) / 0.1)

    names, at = ("lag", "ir_lag.time"), {"lag": TAU, "ir_lag.time": LAG}
    here = Parameters.of(at, names)
    steps = 1e-6 * np.eye(2)
    jacobian = np.stack([(residual(here.with_vector(here.vector() + d)) - residual(here)) / 1e-6 for d in steps], axis=1)
    spread = LinearModel(residual(here), jacobian).covariance(names, np.zeros(2, dtype=bool))
    said: dict[str, Any] = {"method": "", "algorithm": "", "message": "", "converged": True, "counts": None, "log": (), "optimality": None}
    r, none = residual(here), np.zeros(2, dtype=bool)
    said |= {"names": names, "x": here.vector(), "f": float(r @ r), "residual": r, "jacobian": jacobian, "at_bound": none}
    fit = FitResult(covariance=spread, sigma=spread.sigma, **said)
    return fit, residual


def closed(fit: FitResult, residual: Any, **case: Any) -> Closed:
    model: Any = SimpleNamespace(residual=residual)
    parameters = Parameters.of(dict(zip(fit.names, fit.x.tolist(), strict=True)), fit.names)
    here: Any = SimpleNamespace(case=replace(Case(model, parameters, (), (), frozenset()), **case))
    return Closed((), here, here, fit, ("ir_lag",), (), None, None)  # type: ignore[arg-type]


def test_either_of_two_values_lies_within_the_interval() -> None:
    """The fit ends with 0.6 s as the effect's and 2.5 s as the sensor's, each known to hundredths; the truth is the other way round."""
    fit, residual = fitted()
    found = with_exchanged(closed(fit, residual))
    assert fit.sigma is not None and fit.sigma.max() < 0.1
    assert found.fit.sigma == pytest.approx(np.hypot(fit.sigma, (TAU - LAG) / np.sqrt(2.0)))
    both = found.fit.covariance
    assert both is not None and both.correlation_parameters[0, 1] == pytest.approx(-1.0, abs=0.01), "their sum is known"
    (said,) = found.remarks
    assert said.startswith("ir_lag and what is of its form may be exchanged: lag = 0.6, ir_lag.time = 2.5 says the same; intervals hold")


def test_a_reading_of_one_of_them_tells_which_is_which() -> None:
    """At 2.4 +- 0.1 s read, 0.6 s is not in question."""
    fit, residual = fitted(2.4)
    assert with_exchanged(closed(fit, residual)) == closed(fit, residual)
    assert likelihood(fit, np.zeros(len(fit.residual))) > 0.5, "an end that fits better is the likelier one"


def test_of_a_residual_that_shows_more_than_its_noise_less_is_told() -> None:
    fit, _ = fitted()
    worse = np.append(fit.residual, 3.0)[1:]
    loud = replace(fit, residual=np.full(len(fit.residual), 3.0))
    louder = loud.residual.copy()
    louder[0] = np.sqrt(18.0)
    assert likelihood(fit, worse) == pytest.approx(1.0 / (1.0 + np.exp(4.5)), rel=1e-3)
    assert likelihood(loud, louder) > 0.37, "nine of a variance of nine"


def test_what_is_known_or_ruled_out_is_not_exchanged() -> None:
    fit, residual = fitted()
    here = closed(fit, residual).last.case
    assert exchanged(here, effect("ir_lag"), fit) is not None
    assert exchanged(here, effect("ir_lag"), replace(fit, names=("ir_lag.time",))) is None, "a lag that is not fitted is known"
    assert exchanged(here, effect("ir_drift"), fit) is None, "nothing is of its form"
    assert exchanged(replace(here, parameters=here.parameters.replace(lag=LAG)), effect("ir_lag"), fit) is None, "they are equal"
    narrow = replace(here, bounds=lambda name: (2.0, 3.0) if name == "lag" else (0.0, 60.0))
    assert exchanged(narrow, effect("ir_lag"), fit) is None, "the study says that the sensor is slow"


def test_a_run_that_fails_is_told() -> None:
    fit, _ = fitted()

    def fails(_: Parameters) -> np.ndarray:
        raise NumericsError("no equilibrium")

    found = with_exchanged(closed(fit, fails))
    assert found.fit is fit
    assert found.remarks == (
        "whether ir_lag may be exchanged with what is of its form is not known: the run for it failed (no equilibrium)",
    )


def test_the_end_of_the_loop_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    same = ("with_stand_ins", "with_combined", "with_held_exponents", "with_form_of_heat", "with_pulled", "with_slowest_rate")
    for name in same:
        monkeypatch.setattr(whole_loop, name, lambda c: c)
    for name in ("with_held_law", "with_quiet"):
        monkeypatch.setattr(whole_loop, name, lambda c, _: c)
    monkeypatch.setattr(whole_loop, "with_other_forms", lambda c, _: c)
    fit, residual = fitted()
    assert whole_loop.with_all_errors(closed(fit, residual), None, "auto").fit.sigma[0] > 1.0  # type: ignore[index]
    assert EXCHANGED in FORM


@pytest.mark.parametrize("name", [e.name for e in effects() if e.twin is not None])
def test_a_twin_says_the_same(name: str) -> None:
    """Stress and shown temperature of a coupon that is pulled and unloaded, with the values exchanged; other values say something else."""
    parameters = Parameters.of({**BASE, **dict.fromkeys(("theta_air", "theta_ref", "theta_clamp"), 296.15), **ON[name]})
    time, strain = np.linspace(0.0, 60.0, 241), np.interp(np.linspace(0.0, 60.0, 241), [0.0, 40.0, 44.0, 60.0], [0.0, 0.04, 0.037, 0.06])

    def seen(p: Parameters) -> np.ndarray:
        history = simulate(p, Programme.by_strain(time, strain, 296.15), PointSettings(model=1))
        test = CouponTest("one", time, strain, history.stress, None, 296.15, 296.15, {}, whole(time))
        return np.concatenate([history.stress, 1e3 * (shown(history.theta_sensor, test, p) - 296.15)])

    twin = effect(name).twin
    assert twin is not None
    there = parameters.replace(**twin(parameters))
    assert there != parameters and there.replace(**twin(there)) == parameters
    known = seen(parameters)
    apart, size = (np.abs(seen(p) - known).max() for p in (there, parameters.replace(**{effect(name).amplitude.name: 0.0})))
    assert apart < 1e-9 * size, (apart, size)
