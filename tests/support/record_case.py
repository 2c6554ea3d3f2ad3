"""A case of the loop on one record of a virtual coupon, with heat or stress that no effect of the catalogue has."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import yaml

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case
from thermofit.effects.catalogue import effect
from thermofit.experiment.coupon_check import record_spans
from thermofit.experiment.coupon_model import coupon_model
from thermofit.experiment.coupon_records import CouponData, CouponTest
from thermofit.experiment.fields import TestPhase
from thermofit.experiment.missing_coupon import lumped
from thermofit.point.driver import PointSettings, Programme, simulate
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


def case_of(folder: Path, seed: int, pulse: bool = False, bump: bool = False, late: float = 0.0) -> Case:
    """A record with noise; a pulse of heat that nothing explains, 10 MPa more within a window of Lambda, and a clock of temperatures
    that is right at first and `late` s late at the end."""
    stress, theta, accumulated = clean()
    rng = np.random.default_rng(seed)
    if pulse:
        power = ((TIME >= PULSE[0]) & (TIME < PULSE[1])).astype(float) * POWER
        theta = theta + lumped(TIME, power[:, None], TRUTH["c0"], TRUTH["tau"])[:, 0]
    theta = np.interp(TIME + late * TIME / TIME[-1], TIME, theta)
    if bump:
        stress = stress + 10.0 * ((accumulated >= BUMP[0]) & (accumulated < BUMP[1]))
    seen = (stress + NOISE["stress"] * rng.normal(size=len(TIME)), theta + NOISE["theta"] * rng.normal(size=len(TIME)))
    test = CouponTest(
        "pull", TIME, STRAIN, *seen, 293.0, 293.0, NOISE, (TestPhase(0.0, 60.0, "loading"), TestPhase(60.0, 120.0, "unloading"))
    )
    made, data = study(folder), CouponData((test,), "strain")
    model = coupon_model(made, data, made.stage("thermal"), TRUTH.with_free(FREE))
    return Case(model, TRUTH.with_free(FREE), KNOWN, record_spans(data), frozenset(n for e in KNOWN if e.slot == "sensor" for n in e.names))
