"""Drifts of air and jaws on a rod of few numbers: at the optimum without them contact conducts nothing, and one step misleads."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Case, HeatFit, Refit
from thermofit.diagnose.loop import close_loop
from thermofit.diagnose.refit import EXPONENTS
from thermofit.diagnose.rescored import hidden, missed, refitted, rescored
from thermofit.diagnose.trace import Traced, traced
from thermofit.effects.catalogue import effect
from thermofit.experiment.model import StageModel
from thermofit.experiment.prediction import Errors
from thermofit.experiment.residuals import Span
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.fit.result import FitResult
from thermofit.fit.settings import Settings
from thermofit.observe.comparison import plain
from thermofit.observe.observation import FieldObservation

N_S, SIGMA = 24, 0.02
TIME = np.linspace(0.0, 180.0, 61)
Y = np.linspace(-25.0, 25.0, N_S)
NEAR = (Y / 25.0) ** 4
"""How much a point feels the jaws."""
KNOWN = tuple(effect(name) for name in ("air_drift", "clamp_drift", "ir_drift", "ir_clock", "ir_reflection"))
TRUTH = Parameters.of({"alpha_air": 15.0, "alpha_clamp": 400.0, "beta": 0.8, "c0": 2.3})
FREE = ("alpha_air", "alpha_clamp", "beta", "c0")


def field(p: Parameters) -> np.ndarray:
    """Temperature (n_t, n_s) K of points that are warmed up to 60 s and give heat to air and jaws: backward Euler."""
    theta, out, dt = np.zeros(N_S), [np.zeros(N_S)], TIME[1]
    air, jaws = 1e-3 * p["alpha_air"] / 0.6, 1e-3 * p["alpha_clamp"] / 10.0 * NEAR
    for t in TIME[1:]:
        power = 0.12 * p["beta"] * (t < 60.0) + air * p["air_drift.rate"] * t + jaws * p["clamp_drift.rate"] * t
        theta = (theta + dt / p["c0"] * power) / (1.0 + dt / p["c0"] * (air + jaws))
        out.append(theta)
    warm = np.array(out)
    shift = p["ir_drift.rate"] + 0.01 * p["ir_reflection.strength"]
    late = np.gradient(warm, TIME, axis=0) * p["ir_clock.offset"]
    return np.asarray(297.0 + warm + late + shift * TIME[:, None])


def case_of(seed: int, **planted: float) -> Case:
    value = field(TRUTH.replace(**planted)) + SIGMA * np.random.default_rng(seed).normal(size=(len(TIME), N_S))
    shape = (len(TIME), N_S, 1)
    xy = np.stack([np.zeros(N_S), Y], axis=1)
    seen = FieldObservation("theta", TIME, xy, value[:, :, None], np.full(shape, SIGMA), np.ones(shape[:2], dtype=bool), "K")

    def errors(p: Parameters) -> Errors:
        return {"theta": field(p)[:, :, None] - seen.value}

    def linearise(p: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
        steps = {n: 1e-4 * param(n).scale for n in names}
        columns = [(field(p.replace(**{n: p[n] + h})) - field(p.replace(**{n: p[n] - h}))) / (2.0 * h) for n, h in steps.items()]
        return errors(p), {"theta": np.stack(columns, axis=-1)[:, :, None, :]}

    model = StageModel(errors, (plain(seen),), {"theta": seen}, "", linearise=linearise)
    spans = (Span("loading", 0.0, 60.0), Span("cooling", 60.0, 180.0))
    instruments = frozenset(("ir_drift.rate", "ir_clock.offset", "ir_reflection.strength"))
    return Case(model, TRUTH.with_free(FREE), KNOWN, spans, instruments, heated=lambda _: warmed(model))


def refit_of(model: StageModel) -> Refit:
    """Least squares in a trust region, as bilinear problems need it."""

    def refit(start: Parameters, label: str, **_: Any) -> tuple[Parameters, FitResult]:
        names, at = start.free, start.with_vector
        limits = [np.array([getattr(param(n), word) for n in names]) for word in ("lower", "upper", "scale")]
        problem = Problem(lambda x: model.residual(at(x)), start.vector(), *limits, names, lambda x: model.linearised(at(x), names))
        fit = minimise(problem, "trust-region", Settings(f_tolerance=0.01))
        spread = LinearModel(fit.residual, fit.jacobian).covariance(names, fit.at_bound)
        return at(fit.x), replace(fit, covariance=spread, sigma=spread.sigma)

    return refit


def warmed(model: StageModel) -> HeatFit:
    """The better of two fits, from where the parameters are and from usual ones."""

    def minimised(start: Parameters, label: str) -> Parameters:
        first = {n: TRUTH[n] * 1.3 for n in FREE}
        ends = [refit_of(model)(begin, label) for begin in (start, start.replace(**first))]
        return min(ends, key=lambda end: end[1].f)[0]

    return HeatFit(model, minimised)


def traces(seed: int, **planted: float) -> tuple[Traced, Traced]:
    """The trace by one linear step, and by refits."""
    case = case_of(seed, **planted)
    parameters, _ = refit_of(case.model)(case.parameters, "joint")
    here = traced(replace(case, parameters=parameters))
    return here, rescored(here)


@pytest.mark.parametrize(("name", "coefficient"), [("clamp_drift", "alpha_clamp"), ("air_drift", "alpha_air")])
def test_a_drift_that_nothing_is_felt_of_is_named_first(name: str, coefficient: str) -> None:
    """The fit without it lets the coefficient, through which it acts, go to nothing."""
    step, refitted = traces(1, **{f"{name}.rate": 0.03})
    assert step.case.parameters[coefficient] < 0.01 * TRUTH[coefficient]
    assert name not in [s.effect for s in step.promising()]
    first = refitted.promising()[0]
    assert first.effect == name and name in refitted.warmed and first.family == (name,)
    assert first.estimate[f"{name}.rate"] == pytest.approx(0.03, rel=0.02)
    assert name not in refitted.ranking.unfelt and refitted.proofs[name].gain > 0.99


def test_what_refits_cannot_tell_apart_is_one_family() -> None:
    _, refitted = traces(1, **{"ir_drift.rate": 0.005})
    first = refitted.promising()[0]
    assert set(first.family) == {"ir_drift", "ir_reflection"} and {"ir_drift", "air_drift"} <= set(refitted.warmed)


def test_noise_that_frames_share_makes_a_refit_less_sure() -> None:
    """Of nine times the variance along any change: the same fall is a third as many standard errors."""
    here, plain = traces(1, **{"clamp_drift.rate": 0.03})
    noisy = replace(here, problem=replace(here.problem, model=replace(here.problem.model, noise=lambda v: 9.0 * v)))
    one, nine = (next(s for s in r.ranking.scores if s.effect == "clamp_drift") for r in (plain, rescored(noisy)))
    assert nine.z == pytest.approx(one.z / 3.0, rel=0.05) and nine.predicted_drop == pytest.approx(one.predicted_drop)


def test_so_it_does_where_the_fall_of_the_squares_tells_the_score() -> None:
    """From a start with the effect in it."""
    here, _ = traces(1, **{"clamp_drift.rate": 0.03})
    noisy = replace(here, problem=replace(here.problem, model=replace(here.problem.model, noise=lambda v: 9.0 * v)))
    begin = TRUTH.replace(**{"clamp_drift.rate": 0.02}).with_free(FREE)
    fit, score = warmed(here.case.model), hidden("clamp_drift")
    one, nine = (refitted(h, (score,), fit, {}, begin) for h in (here, noisy))
    assert one is not None and nine is not None and one.score.predicted_drop > 1e4
    assert one.score.z == pytest.approx(np.sqrt(one.score.predicted_drop), rel=0.05)
    assert nine.score.z == pytest.approx(one.score.z / 3.0, rel=0.05)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_predicts_held_out_data_alike_is_one_family_though_it_looks_otherwise(seed: int) -> None:
    """The jaws drift. A clock and a drift of the air answer to nothing in common, and each takes equally little of it away."""
    _, refitted = traces(seed, **{"clamp_drift.rate": 0.04})
    found = {s.effect: s.family for s in refitted.ranking.scores}
    assert found["clamp_drift"] == ("clamp_drift",) and "air_drift" in found["ir_clock"]
    assert abs(refitted.proofs["air_drift"].gain - refitted.proofs["ir_clock"].gain) < 0.05


def test_the_trace_stays_where_one_step_is_enough() -> None:
    for planted in ({}, {"clamp_drift.rate": 0.003}):
        step, refitted = traces(1, **planted)
        assert refitted is step
    hidden, _ = traces(1, **{"clamp_drift.rate": 0.03})
    plain_case = replace(hidden, case=replace(hidden.case, heated=None))
    assert rescored(plain_case) is plain_case


def test_the_loop_adds_what_the_refits_name() -> None:
    step, _ = traces(1, **{"clamp_drift.rate": 0.03})
    refit = refit_of(step.case.model)
    _, fit = refit(step.case.parameters, "joint")
    start = replace(step.case, heated=step.case.heated)
    closed = close_loop(start, fit, usual_first(step.case.model), 3, None)
    assert closed.accepted == ("clamp_drift",) and closed.first.promising()[0].effect == "clamp_drift"


def usual_first(model: StageModel) -> Refit:
    """A refit from usual values too, as the joint fit of a body goes."""
    return lambda start, label, **_: refit_of(model)(warmed(model).minimised(start, label), label)


def test_a_product_that_is_known_stands_off_neutral() -> None:
    """A weak film and a strong drift: the data know what they do together, and the rate has a standard error larger than itself."""
    case = case_of(1, **{"alpha_air": 0.05, "air_drift.rate": 0.4})
    start = case.parameters.replace(**{"alpha_air": 0.05, "air_drift.rate": 0.4}).with_free((*FREE, "air_drift.rate"))
    parameters, fit = refit_of(case.model)(start, "air_drift")
    there = traced(replace(case, parameters=parameters))
    assert fit.sigma is not None and parameters["air_drift.rate"] < 2.0 * fit.sigma[fit.names.index("air_drift.rate")]
    assert missed(there, "air_drift", fit) > 10.0
    assert missed(replace(there, case=replace(there.case, heated=None)), "air_drift", fit) == 0.0


def test_an_effect_that_is_not_there_is_not_missed() -> None:
    case = case_of(1)
    start = case.parameters.replace(**{"air_drift.rate": 1e-3}).with_free((*FREE, "air_drift.rate"))
    parameters, fit = refit_of(case.model)(start, "air_drift")
    assert missed(traced(replace(case, parameters=parameters)), "air_drift", fit) < 2.5


@pytest.mark.parametrize("settles", [True, False])
def test_on_coupons_exponents_that_do_not_settle_are_held(settles: bool) -> None:
    """However far the objective has fallen by them."""
    start = traces(1, **{"clamp_drift.rate": 0.003})[0].case
    case, refit = replace(start, known=KNOWN[1:2], cheap=True), refit_of(start.model)
    _, fit = refit(case.parameters, "joint")

    def wandering(begin: Parameters, label: str, **_: Any) -> tuple[Parameters, FitResult]:
        parameters, found = refit(begin.with_free(tuple(n for n in begin.free if n != "clamp_drift.time")), label)
        if not label.endswith(EXPONENTS):
            return parameters, found
        return parameters.replace(**{"clamp_drift.time": 77.0}), replace(found, f=found.f - 1e3, converged=settles)

    closed = close_loop(case, fit, wandering, 1, None)
    (trial,) = closed.rounds[0].trials
    assert closed.accepted == ("clamp_drift",) and trial.estimate["clamp_drift.rate"] == pytest.approx(0.003, rel=0.05)
    assert ("with them free the fit does not settle" in trial.exponents) is not settles
    assert settles or closed.last.case.parameters["clamp_drift.time"] != 77.0
