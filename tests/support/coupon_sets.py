"""Sets of coupon records as people have them, made by the point driver with a law that the base model is not, and the loop on them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case, not_identifiable
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.refit import JointFit
from thermofit.experiment.coupon import CouponExperiment
from thermofit.experiment.coupon_model import coupon_model, coupon_run
from thermofit.experiment.coupon_records import CouponData, CouponTest, whole
from thermofit.experiment.flow_conditions import flow_conditions
from thermofit.experiment.joint import station_names
from thermofit.experiment.known_effects import effects_of_point
from thermofit.point.driver import PointSettings, Programme, simulate
from thermofit.records.staging import job
from thermofit.study.study import Study, load_study

TRUTH = {"E": 200e3, "nu": 0.3, "M_y0": 350.0, "M_yinf": 520.0, "H_exp": 20.0, "alpha_exp": 12e-6, "beta": 0.9, "c0": 3.65, "tau": 1e6}
STRAIN_NOISE = 1e-7


def study_of(folder: Path, **more: object) -> Study:
    """A study that identifies E and Voce's curve from stresses."""
    record = {"file": "none.csv", "time": "t", "strain": "e", "stress": "s", "initial_temperature_degC": 20}
    tree = {
        "name": "set",
        "run_dir": str(folder / "run"),
        "model": 1,
        "coupon": {"control": "strain", "records": [record]},
        "parameters": {
            **{name: TRUTH[name] for name in ("nu", "alpha_exp", "beta", "c0", "tau")},
            "E": {"start": 190e3, "bounds": [1e5, 3e5]},
            "M_y0": {"start": 300.0, "bounds": [50.0, 1500.0], "scale": 100.0},
            "M_yinf": {"start": 480.0, "bounds": [100.0, 3000.0], "scale": 100.0},
            "H_exp": {"start": 25.0, "bounds": [0.1, 500.0], "scale": 10.0},
        },
        "stages": {"elastic": {"free": ["E"]}, "plastic": {"free": ["M_y0", "M_yinf", "H_exp"]}},
        "diagnosis": {"max_effects": 3},
        **more,
    }
    path = folder / "set.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return load_study(path)


def pulled_record(
    name: str,
    rate: float,
    theta: float,
    seed: int,
    sigma: float,
    strain: float = 0.1,
    samples: int = 80,
    **law: float,
) -> CouponTest:
    """Monotonic tension at one rate in 1/s from a temperature in K: half of the samples up to a tenth of the strain."""
    early = np.linspace(0.0, 0.1 * strain, samples // 2)
    e = np.concatenate([early, np.linspace(0.1 * strain, strain, samples - samples // 2 + 1)[1:]])
    return followed_record(name, e, rate, theta, seed, sigma, **law)


def followed_record(name: str, e: np.ndarray, rate: float, theta: float, seed: int, sigma: float, **law: float) -> CouponTest:
    """The record of a path of strain (n,) from zero on, at one rate in 1/s."""
    time = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(e)))]) / rate
    parameters = Parameters.of({**TRUTH, "theta_air": theta, "theta_ref": theta, **law})
    index = np.arange(4 * (len(e) - 1) + 1) / 4
    fine = np.interp(index, np.arange(len(e)), time), np.interp(index, np.arange(len(e)), e)
    history = simulate(parameters, Programme.by_strain(*fine, theta), PointSettings(model=1)).every(4)
    stress = history.stress + sigma * np.random.default_rng(seed).normal(size=len(e))
    return CouponTest(name, time, e, stress, None, theta, theta, {"strain": STRAIN_NOISE, "stress": sigma}, whole(time))


def drifting_record(name: str, seed: int, sigma: float, *, jump: float, bump: float, **law: float) -> CouponTest:
    """Tension at 1e-3 1/s, four times as fast around a strain of 0.031, into which it drifts, or, where `jump` is not 1, that many times as
    fast from a strain of 0.031 on; `bump` MPa of stress around 0.031 that no law has."""
    e = np.concatenate([np.linspace(0.0, 0.004, 60), np.linspace(0.004, 0.08, 141)[1:]])
    around = np.exp(-0.5 * (np.log(np.maximum(e, 1e-6) / 0.031) / 0.5) ** 2)
    rate = 1e-3 * (4.0**around if jump == 1.0 else np.where(e > 0.031, jump, 1.0))
    time = np.append(0.0, np.cumsum(np.diff(e) / rate[1:]))
    parameters = Parameters.of({**TRUTH, "theta_air": 293.15, "theta_ref": 293.15, **law})
    history = simulate(parameters, Programme.by_strain(time, e, 293.15), PointSettings(model=1))
    stress = history.stress + bump * around + sigma * np.random.default_rng(seed).normal(size=len(e))
    return CouponTest(name, time, e, stress, None, 293.15, 293.15, {"strain": STRAIN_NOISE, "stress": sigma}, whole(time))


def cooled_record(name: str, seed: int, strain: float, power: float, sigma: float) -> CouponTest:
    """Tension to 0.1 at 1e-2 1/s without loss of heat, with a sensor; what flow releases falls as 1 - (Lambda / strain)^power, and is taken
    up from `strain` on, as by a coolant that opens with it. Noise of `sigma` MPa, and of a hundredth of it in K."""
    e = np.concatenate([np.linspace(0.0, 0.004, 40), np.linspace(0.004, 0.1, 121)[1:]])
    time = e / 1e-2
    parameters = Parameters.of({**TRUTH, "theta_air": 293.15, "theta_ref": 293.15})
    history = simulate(parameters, Programme.by_strain(time, e, 293.15), PointSettings(model=1))
    gone = np.diff(history.dissipated, prepend=0.0) * (history.accumulated / strain) ** power
    random = np.random.default_rng(seed)
    theta = history.theta - np.cumsum(gone) / TRUTH["c0"] + 0.01 * sigma * random.normal(size=len(e))
    stress = history.stress + sigma * random.normal(size=len(e))
    noise = {"strain": STRAIN_NOISE, "stress": sigma, "theta": 0.01 * sigma}
    return CouponTest(name, time, e, stress, theta, 293.15, 293.15, noise, whole(time))


def looped(study: Study, tests: tuple[CouponTest, ...], folder: Path) -> Closed:
    """The loop on records, from the joint fit of the base model on."""
    data = CouponData(tests, "strain")
    experiment = CouponExperiment(study, given=data)
    settings = experiment.joint_settings()
    base = study.start_parameters(data).with_free(settings.free)  # type: ignore[arg-type]
    model = coupon_model(study, data, settings, base)
    refit = JointFit(study, settings, model, job(folder, "set", {}, {}))
    parameters, fit = refit(base, "joint")
    run = coupon_run(study, data, settings.free)
    there = flow_conditions(tests, lambda test: run.history(parameters, test))
    known, _ = not_identifiable(effects_of_point(sensor=any(test.theta is not None for test in tests)), parameters, there)
    case = Case(model, parameters, known, experiment.spans, station_names(), cheap=True, bounds=study.bounds)
    return close_loop(case, fit, refit, study.diagnosis.max_effects, None)


def equal_records(count: int, sigma: float, **law: float) -> tuple[CouponTest, ...]:
    """The same test of equal specimens, each with noise of its own."""
    one = pulled_record("0", 1e-3, 293.15, 0, sigma, samples=40, **law)
    clean = pulled_record("0", 1e-3, 293.15, 0, 0.0, samples=40, **law).stress
    noise = [sigma * np.random.default_rng(k).normal(size=len(clean)) for k in range(count)]
    return tuple(replace(one, name=str(k), stress=clean + own) for k, own in enumerate(noise))
