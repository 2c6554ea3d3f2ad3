"""Drift of parameters: silent where nothing is missing; names the parameter and the variable where a dependence is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import record_case
import seen_field
import yaml

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case
from thermofit.diagnose.drift import Drifts, drifts
from thermofit.diagnose.trace import Traced, traced
from thermofit.experiment.coupon_check import record_spans
from thermofit.experiment.coupon_model import coupon_model
from thermofit.experiment.coupon_records import CouponData, CouponTest
from thermofit.experiment.fields import TestPhase
from thermofit.experiment.row_states import VARIABLES, row_states
from thermofit.fit.linear_model import LinearModel
from thermofit.point.driver import PointSettings, Programme, simulate
from thermofit.study.study import Study, load_study

FREE = ("E", "M_y0", "M_yinf", "H_exp", "beta", "tau")
TIME = np.linspace(0.0, 160.0, 401)
RATES = np.interp(TIME, [0, 40, 50, 90, 100, 130, 160], [0, 0.012, 0.03, 0.042, 0.06, 0.069, 0.1])
"""Pulled at 3e-4 and 1.8e-3 1/s in turn, so that a rate is not a strain."""
UNLOADED = np.interp(TIME, [0, 30, 40, 50, 80, 90, 100, 130, 140, 160], [0, 0.02, 0.016, 0.02, 0.045, 0.041, 0.045, 0.07, 0.066, 0.075])


def case_of(folder: Path, seed: int, strain: np.ndarray, starts: tuple[float, ...] = (293.0,), **planted: float) -> Case:
    """Records of one strain over time, pulled at these temperatures by a coupon that holds what is planted, at the optimum of the model
    without."""
    truth = record_case.TRUTH.replace(**planted)
    rng = np.random.default_rng(seed)
    tests = []
    for n, start in enumerate(starts):
        own = truth.replace(theta_air=start, theta_ref=293.0)
        found = simulate(own, Programme.by_strain(TIME, strain, start), PointSettings(model=1))
        seen = (found.stress + 0.3 * rng.normal(size=len(TIME)), found.theta_sensor + 0.01 * rng.normal(size=len(TIME)))
        phases = (TestPhase(0.0, float(TIME[-1]), "loading"),)
        tests.append(CouponTest(f"pull {n}", TIME, strain, *seen, start, start, record_case.NOISE, phases))
    made, data = study(folder), CouponData(tuple(tests), "strain")
    parameters = record_case.TRUTH.with_free(FREE)
    model = coupon_model(made, data, made.stage("thermal"), parameters)
    case = Case(model, optimum(model, parameters), (), record_spans(data), frozenset(), cheap=True)
    return case


def study(folder: Path) -> Study:
    """The study of the records, whose reference temperature is common to all of them."""
    path = record_case.study(folder).source
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    tree["parameters"]["theta_ref"] = 293.0
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return load_study(path)


def optimum(model: object, parameters: Parameters) -> Parameters:
    """Where Gauss-Newton ends."""
    for _ in range(12):
        residual, columns = model.linearised(parameters, parameters.free)  # type: ignore[attr-defined]
        step = LinearModel(residual, columns).free_step
        x = parameters.vector()
        parameters = parameters.with_vector(x + np.clip(step, -0.3 * np.abs(x), 0.3 * np.abs(x)))
    return parameters


def told(case: Case) -> tuple[Drifts, Traced]:
    here = traced(case)
    return drifts(here, row_states(case.model, case.parameters, None)), here


def test_nothing_drifts_in_twenty_coupons_that_lack_nothing(tmp_path: Path) -> None:
    spoke = [seed for seed in range(20) if told(case_of(tmp_path, seed, RATES if seed % 2 else UNLOADED))[0].found]
    assert spoke == []


def test_a_rate_law_is_a_yield_stress_that_rises_with_the_rate(tmp_path: Path) -> None:
    found, _ = told(case_of(tmp_path, 1, RATES, **{"rate_logarithmic.C": 0.01}))
    first = found.found[0]
    pairs = {(first.parameter, first.variable), *first.alike}
    assert first.variable == "rate" and first.parameter in ("M_y0", "M_yinf") and first.slope > 0.0, first.words
    # C M_y per e-fold, as far as the rate is above the reference.
    assert first.slope == pytest.approx(0.01 * 400.0, rel=0.6) and first.chance < 0.01
    assert ("E", "time") not in pairs and first.words == f"{first.parameter} wants to rise with the rate"
    centre, value, sigma = np.array(first.blocks).T
    assert np.all(np.diff(centre) >= 0.0) and value[-1] - value[0] > 2.0 * np.hypot(sigma[0], sigma[-1])


def test_a_modulus_that_is_damaged_falls_with_plastic_strain(tmp_path: Path) -> None:
    found, _ = told(case_of(tmp_path, 2, UNLOADED, **{"elastic_degradation.amount": 0.1}))
    first = found.found[0]
    assert (first.parameter, first.variable) == ("E", "plastic strain") and first.slope < 0.0, first.words
    assert first.unit == "MPa" and first.words == "E wants to fall with plastic strain"


def test_softening_is_a_yield_stress_that_falls_with_temperature(tmp_path: Path) -> None:
    found, _ = told(case_of(tmp_path, 3, RATES, (293.0, 343.0), **{"thermal_softening.slope": 0.001}))
    first = found.found[0]
    assert first.variable == "temperature" and first.parameter in ("M_y0", "M_yinf") and first.slope < 0.0, first.words
    assert first.slope == pytest.approx(-0.001 * 500.0, rel=0.4)


def field_case(seed: int, slope: float) -> tuple[Case, np.ndarray]:
    """A temperature whose conductivity changes by `slope` 1/K with its rise, and that rise (n_rows,)."""
    case = seen_field.case_of(seed)
    warm = seen_field.field(seen_field.BASE) - 297.0
    h = 1e-3
    by_kappa = (seen_field.field(seen_field.BASE.replace(kappa=120.0 + h)) - seen_field.field(seen_field.BASE.replace(kappa=120.0 - h))) / (
        2 * h
    )
    rise = warm - warm.mean()
    shown = case.model.observations["theta"]
    moved = replace(shown, value=shown.value + (by_kappa * slope * 120.0 * rise)[:, :, None])
    base = seen_field.BASE.with_free(("kappa", "c0"))
    linearise = case.model.linearise
    assert linearise is not None

    def errors(p: Parameters) -> dict[str, np.ndarray]:
        return {"theta": seen_field.field(p)[:, :, None] - moved.value}

    def with_slopes(p: Parameters, names: tuple[str, ...]) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        return errors(p), linearise(p, names)[1]

    model = replace(case.model, observations={"theta": moved}, errors=errors, linearise=with_slopes)
    made = replace(case, model=model, parameters=optimum(model, base), known=())
    row = model.comparisons[0].rows
    return made, warm[row[:, 0], row[:, 1]]


def of_field(seed: int, slope: float) -> Drifts:
    case, rise = field_case(seed, slope)
    rows = case.model.comparisons[0].rows
    states = {name: np.full(len(rows), np.nan) for name in VARIABLES}
    states |= {"time": seen_field.TIME[rows[:, 0]], "place y": seen_field.Y[rows[:, 1]], "temperature": 297.0 + rise}
    return drifts(traced(case), states)


def test_a_conductivity_that_falls_with_temperature_is_named() -> None:
    (first, *_) = of_field(1, -0.002).found
    assert (first.parameter, first.variable) == ("kappa", "temperature") and first.words == "kappa wants to fall with temperature"
    assert first.slope == pytest.approx(-0.002 * 120.0, rel=0.05) and first.unit == "mW/(mm K) per K"


def test_a_field_that_lacks_nothing_is_silent() -> None:
    assert [seed for seed in range(20) if of_field(seed, 0.0).found] == []
