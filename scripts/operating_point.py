"""Virtual coupon records for the operating figures: the point driver with a planted effect, and the loop on what it leaves.

Steps of the data are FINER times finer than those of the fit, which knows nothing of what was planted.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.core.staging import job
from thermofit.core.study import Study
from thermofit.diagnose.case import Case, slots_of
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.prepared import coupon_joint_settings, coupon_spans
from thermofit.diagnose.refit import JointFit
from thermofit.diagnose.trace import traced
from thermofit.identify.coupon_inputs import CouponData, CouponTest
from thermofit.identify.coupon_model import coupon_model
from thermofit.identify.coupon_sensor import SENSOR, shown
from thermofit.identify.inputs import TestPhase
from thermofit.identify.joint import station_names
from thermofit.point.driver import PointSettings, Programme, simulate

TRUTH = {
    **{"E": 200000.0, "nu": 0.3, "M_y0": 350.0, "M_yinf": 480.0, "H_exp": 25.0, "alpha_exp": 12e-6, "beta": 0.9, "c0": 3.65},
    **{"tau": 60.0, "lag": 0.6},
}
NOISE = {"strain": 1e-7, "stress": 0.8, "theta": 0.015}
FINER = 4
STUDY = """
name: operating-figures
model: 1
coupon: {control: strain, records: [{file: none.csv, time: t, strain: e, stress: s, initial_temperature_degC: 23}]}
parameters:
  nu: 0.3
  c0: 3.65
  E: {start: 195000, bounds: [100000, 300000]}
  M_y0: {start: 340, bounds: [50, 1500], scale: 100}
  M_yinf: {start: 470, bounds: [100, 3000], scale: 100}
  H_exp: {start: 22, bounds: [0.1, 500], scale: 10}
  alpha_exp: {start: 11.0e-6, bounds: [0, 5.0e-5]}
  beta: {start: 0.8, bounds: [0, 5]}
  tau: {start: 50, bounds: [1, 1.0e+5], scale: 50}
  lag: {start: 0.5, bounds: [0, 20], scale: 0.5}
stages:
  elastic: {free: [E]}
  plastic: {free: [M_y0, M_yinf, H_exp]}
  thermal: {free: [alpha_exp, beta, tau, lag], channels: {dtheta: {}}}
diagnosis: {max_effects: 2}
"""


def programme() -> tuple[np.ndarray, np.ndarray, tuple[TestPhase, ...]]:
    """Time s and strain of a test that moves everything once: rest, loading, change of rate, hold, unloading, reverse flow, cooling."""
    legs = [
        (0.0, 3.0, "rest"),
        (0.015, 30.0, "loading 5e-4/s"),
        (0.030, 3.0, "loading 5e-3/s"),
        (0.030, 30.0, "hold"),
        (0.022, 8.0, "unloading"),
        (0.010, 12.0, "reverse"),
        (0.045, 35.0, "loading 1e-3/s"),
        (0.0435, 3.0, "unloading"),
        (0.0435, 80.0, "hold"),
    ]
    time_, strain, phases = [0.0], [0.0], []
    for target, duration, label in legs:
        n = max(4, int(duration / 0.4))
        start, t0 = strain[-1], time_[-1]
        part = np.linspace(0.0, 1.0, n + 1)[1:]
        strain += list(start + (target - start) * part)
        time_ += list(t0 + duration * part)
        phases.append(TestPhase(t0, time_[-1], label))
    return np.array(time_), np.array(strain), tuple(phases)


def measured(study: Study, planted: dict[str, float], seed: int) -> CouponData:
    """A virtual record of the truth with planted Params, from steps FINER times finer, with noise."""
    t, strain, phases = programme()
    index = np.arange((len(t) - 1) * FINER + 1) / FINER
    fine = np.interp(index, np.arange(len(t)), t), np.interp(index, np.arange(len(t)), strain)
    parameters = Parameters.of({**TRUTH, "theta_air": 296.15, "theta_ref": 296.15, **planted})
    history = simulate(parameters, Programme.by_strain(*fine, 296.15), PointSettings(model=1)).every(FINER)
    random = np.random.default_rng(seed)
    bare = CouponTest("virtual", t, strain, history.stress, None, 296.15, 296.15, NOISE, phases)
    theta = shown(history.theta_sensor, bare, parameters) + NOISE["theta"] * random.normal(size=len(t))
    stress = history.stress + NOISE["stress"] * random.normal(size=len(t))
    return CouponData((replace(bare, stress=stress, theta=theta),), "strain")


def closed(study: Study, data: CouponData, folder: Path) -> Closed:
    """The loop on a record, from the fit of the base model on."""
    settings = coupon_joint_settings(study, data)
    base = study.start_parameters(data).with_free(settings.free)  # type: ignore[arg-type]
    model = coupon_model(study, data, settings, base)
    refit = JointFit(study, settings, model, job(Path(tempfile.mkdtemp(dir=folder)), "operating", {}, {}))
    parameters, fit = refit(base, "joint")
    case = Case(model, parameters, slots_of("point", SENSOR), coupon_spans(data), station_names(), cheap=True)
    fine = study.model_copy(update={"numerics": study.numerics.model_copy(update={"steps_per_interval": 2})})
    numerical = (model.residual(parameters) - coupon_model(fine, data, settings, base).residual(parameters)) / 0.5
    return close_loop(case, fit, refit, study.diagnosis.max_effects, numerical)


def detectable(study: Study) -> dict[str, float]:
    """Smallest amplitude of every effect that passes the threshold, from a record with nothing planted."""
    data = measured(study, {}, 1)
    settings = coupon_joint_settings(study, data)
    base = Parameters.of({**TRUTH, "theta_air": 296.15, "theta_ref": 296.15, "theta_clamp": 296.15}, settings.free)
    case = Case(coupon_model(study, data, settings, base), base, slots_of("point", SENSOR), coupon_spans(data), station_names())
    return {s.effect: s.detectable for s in traced(case).ranking.scores}
