"""Unlisted effects of coupons: a pulse of heat and a bump of the yield stress that the catalogue does not know, and files of both."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from strip import refitting

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case
from thermofit.diagnose.loop import close_loop
from thermofit.diagnose.trace import Traced, traced
from thermofit.diagnose.unlisted import Unlisted, unlisted
from thermofit.diagnose.unlisted_loop import ended
from thermofit.effects.catalogue import effect, load_effect
from thermofit.experiment.coupon_check import record_spans
from thermofit.experiment.coupon_model import coupon_model
from thermofit.experiment.coupon_records import CouponData, CouponTest
from thermofit.experiment.fields import TestPhase
from thermofit.experiment.missing_coupon import lumped
from thermofit.point.driver import PointSettings, Programme, simulate
from thermofit.report.unlisted import effect_file, summary_of
from thermofit.study.study import Study, load_study

TRUTH = Parameters.of(
    {
        **{"E": 200e3, "nu": 0.3, "M_y0": 300.0, "M_yinf": 500.0, "H_exp": 30.0, "alpha_exp": 12e-6, "c0": 3.65, "beta": 1.2},
        **{"tau": 40.0, "theta_air": 293.0, "theta_ref": 293.0},
    }
)
FREE = ("E", "M_y0", "M_yinf", "H_exp", "alpha_exp", "beta", "tau")
KNOWN = tuple(effect(name) for name in ("ir_drift", "ir_gain", "ir_lag", "linear_hardening"))
TIME = np.linspace(0.0, 120.0, 361)
STRAIN = np.interp(TIME, [0.0, 60.0, 70.0, 120.0], [0.0, 0.03, 0.026, 0.05])
NOISE = {"strain": 1e-7, "stress": 0.3, "theta": 0.01}
PULSE, POWER = (30.0, 50.0), 0.15
BUMP = (0.022, 0.032)


@lru_cache(maxsize=1)
def clean() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stress, temperature and Lambda of the truth."""
    found = simulate(TRUTH, Programme.by_strain(TIME, STRAIN, 293.0), PointSettings(model=1))
    return found.stress, found.theta_sensor, found.accumulated


def study(folder: Path) -> Study:
    tree = {
        "name": "coupons",
        "model": 1,
        "coupon": {"records": [{"file": "a.csv", "time": "t", "strain": "e", "stress": "s", "initial_temperature_degC": 20.0}]},
        "parameters": {name: TRUTH[name] for name in ("E", "nu", "M_y0", "M_yinf", "H_exp", "alpha_exp", "c0", "beta", "tau", "F")},
        "stages": {"thermal": {"free": list(FREE), "channels": {"stress": {}, "dtheta": {}}}},
    }
    path = folder / "coupons.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return load_study(path)


def case_of(folder: Path, seed: int, pulse: bool = False, bump: bool = False) -> Case:
    """A record with noise; a pulse of heat that nothing explains, and 10 MPa more within a window of Lambda."""
    stress, theta, accumulated = clean()
    rng = np.random.default_rng(seed)
    if pulse:
        power = ((TIME >= PULSE[0]) & (TIME < PULSE[1])).astype(float) * POWER
        theta = theta + lumped(TIME, power[:, None], TRUTH["c0"], TRUTH["tau"])[:, 0]
    if bump:
        stress = stress + 10.0 * ((accumulated >= BUMP[0]) & (accumulated < BUMP[1]))
    seen = (stress + NOISE["stress"] * rng.normal(size=len(TIME)), theta + NOISE["theta"] * rng.normal(size=len(TIME)))
    test = CouponTest(
        "pull", TIME, STRAIN, *seen, 293.0, 293.0, NOISE, (TestPhase(0.0, 60.0, "loading"), TestPhase(60.0, 120.0, "unloading"))
    )
    made, data = study(folder), CouponData((test,), "strain")
    model = coupon_model(made, data, made.stage("thermal"), TRUTH.with_free(FREE))
    return Case(model, TRUTH.with_free(FREE), KNOWN, record_spans(data), frozenset(n for e in KNOWN if e.slot == "sensor" for n in e.names))


def found_in(case: Case) -> tuple[Traced, Unlisted | None]:
    parameters, fit = refitting(case.model)(case.parameters, "joint")
    assert fit.converged
    here = traced(replace(case, parameters=parameters))
    return here, unlisted(here, None, [s.effect for s in here.promising()])


def test_nothing_planted_is_nothing_unlisted(tmp_path: Path) -> None:
    assert [found_in(case_of(tmp_path, seed))[1] for seed in range(3)] == [None] * 3


def test_a_pulse_of_heat(tmp_path: Path) -> None:
    """A drift of the camera resembles it and is taken back; window, power per volume, and a file that loads, fits to a scale of one and
    takes the misfit to the noise."""
    case = case_of(tmp_path, 1, pulse=True)
    refit = refitting(case.model)
    parameters, fit = refit(case.parameters, "joint")
    first = close_loop(replace(case, parameters=parameters), fit, refit, 3, None)
    closed, found = ended(first, refit, None, "auto")
    here = closed.last
    assert "ir_drift" in first.accepted and closed.accepted == ()
    assert found is not None and found.channel == "dtheta" and found.place is not None
    said = summary_of(here, found, None)
    assert said["where"] == {"record": "pull"} and said["unit"] == "mW/mm^3"
    assert said["when_s"] == pytest.approx(PULSE, abs=3.0)
    assert said["mean_in_window"] == pytest.approx(POWER, rel=0.15)
    assert said["after"]["held_out"]["dtheta"] < 0.5 * said["before"]["held_out"]["dtheta"]
    file = effect_file("a test", here, found)
    assert file is not None
    path = tmp_path / f"{file.name}.py"
    path.write_text(file.text, encoding="utf-8")
    added = load_effect(path)
    again = case_of(tmp_path, 1, pulse=True)
    parameters, fit = refitting(again.model)(here.case.parameters.with_free((*FREE, added.amplitude.name)), "with the file")
    assert fit.converged and parameters[added.amplitude.name] == pytest.approx(1.0, abs=0.1)
    rows = here.rows.channel == here.case.channels.index("dtheta")
    assert np.mean(again.model.residual(parameters)[rows] ** 2) < 1.3 < 0.25 * np.mean(here.columns.residual[rows] ** 2)


def test_a_bump_of_the_yield_stress(tmp_path: Path) -> None:
    """The missing stress is a table over Lambda, and the file holds it."""
    here, found = found_in(case_of(tmp_path, 2, bump=True))
    assert found is not None and found.channel == "stress" and found.field is not None
    file = effect_file("a test", here, found)
    assert file is not None and "accumulated plastic strain" in file.words
    assert file.proof.gain > 0.5 * found.field.proof.gain > 0.2
    path = tmp_path / f"{file.name}.py"
    path.write_text(file.text, encoding="utf-8")
    act = load_effect(path).act
    inside, outside = (act(v, 1e-3, 293.0, None, 1.0) for v in (np.mean(BUMP), 0.5 * BUMP[0]))
    root = np.sqrt(TRUTH["F"] + TRUTH["H"])
    assert inside - outside == pytest.approx(10.0 * root * 1.04, rel=0.3)
    assert act(0.03, 1e-3, 293.0, None, 0.0) == 0.0
    assert act(0.03 + 1e-30j, 1e-3, 293.0, None, 1.0).imag != 0.0
