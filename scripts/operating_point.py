"""Virtual coupon records for the operating figures: the point driver with a planted effect, and the loop on what it leaves.

Steps of the data are FINER times finer than those of the fit, which knows nothing of what was planted. Programme, peak, rate and noise
are drawn by the seed; a study without a temperature is given the thermal parameters.
"""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from operating_draw import World, worlds

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case, not_identifiable
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.prepared import within
from thermofit.diagnose.refit import JointFit
from thermofit.diagnose.trace import Traced, traced
from thermofit.diagnose.unlisted import Unlisted
from thermofit.diagnose.whole_loop import finished
from thermofit.experiment.coupon import CouponExperiment
from thermofit.experiment.coupon_check import record_spans
from thermofit.experiment.coupon_model import coupon_model, coupon_run
from thermofit.experiment.coupon_records import CouponData, CouponTest, whole
from thermofit.experiment.coupon_sensor import shown
from thermofit.experiment.fields import TestPhase
from thermofit.experiment.flow_conditions import flow_conditions
from thermofit.experiment.joint import station_names
from thermofit.experiment.known_effects import effects_of_point
from thermofit.experiment.model import StageModel
from thermofit.point.driver import PointSettings, Programme, simulate
from thermofit.point.programmes import Usual, programme
from thermofit.records.staging import job
from thermofit.study.study import Study, load_study

AIR = 296.15
TRUTH = {
    **{"E": 200000.0, "nu": 0.3, "M_y0": 350.0, "M_yinf": 480.0, "H_exp": 25.0, "alpha_exp": 12e-6, "beta": 0.9, "c0": 3.65},
    **{"tau": 60.0, "lag": 0.6, "theta_air": AIR, "theta_ref": AIR, "theta_clamp": AIR},
}
NOISE = {"strain": 1e-7, "stress": 0.8, "theta": 0.015}
FINER = 4
SETTINGS = PointSettings(model=1)
_HEAD = """
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
"""
_HOT = """
  alpha_exp: {start: 11.0e-6, bounds: [0, 5.0e-5]}
  beta: {start: 0.8, bounds: [0, 5]}
  tau: {start: 50, bounds: [1, 1.0e+5], scale: 50}
  lag: {start: 0.5, bounds: [0, 20], scale: 0.5}
stages:
  elastic: {free: [E]}
  plastic: {free: [M_y0, M_yinf, H_exp]}
  thermal: {free: [alpha_exp, beta, tau, lag], channels: {dtheta: {}}}
"""
_COLD = f"""
  alpha_exp: {TRUTH["alpha_exp"]}
  beta: {TRUTH["beta"]}
  tau: {TRUTH["tau"]}
stages:
  elastic: {{free: [E]}}
  plastic: {{free: [M_y0, M_yinf, H_exp]}}
"""
ELASTIC = 0.0015, 12
"""Strain within which a record begins, and samples of that at least: a record that does not show its E is not asked for it."""
RATES = (1e-4, 1e-3, 1e-2)
"""1/s, of which the rate of a record is one."""


@dataclass(frozen=True)
class Kind:
    """A kind of test: named programme of its records, range of the largest strain, samples of a record, whether the temperature is
    measured, how many records, whether each has a rate of its own, and by how many kelvin each is above the one before, as declared."""

    named: str
    peaks: tuple[float, float]
    samples: int = 300
    hot: bool = False
    records: int = 1
    of_each_rate: bool = False
    warmer: float = 0.0


ALL_IN_ONE = "all-in-one"
KINDS: Mapping[str, Kind] = {
    ALL_IN_ONE: Kind("", (0.045, 0.045), hot=True),
    "monotonic": Kind("monotonic", (0.04, 0.12)),
    "load-unload": Kind("load-unload", (0.03, 0.08), 400),
    "load-unload-cool": Kind("load-unload-cool", (0.03, 0.08), 400, hot=True),
    "cycles": Kind("cycles", (0.012, 0.03), 480),
    "three-rates": Kind("monotonic", (0.04, 0.12), 200, records=3, of_each_rate=True),
    "repeats": Kind("monotonic", (0.04, 0.12), 200, records=3),
    "three-temperatures": Kind("monotonic", (0.04, 0.12), 200, records=3, warmer=60.0),
}
Path_ = tuple[str, np.ndarray, np.ndarray, tuple[TestPhase, ...]]
"""Name, time s, strain, and phases of a record."""


def all_in_one() -> Path_:
    """A test that moves everything once: rest, loading, change of rate, hold, unloading, reverse flow, cooling."""
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
    return "virtual", np.array(time_), np.array(strain), tuple(phases)


def paths(world: World) -> list[Path_]:
    """The records of a test, with the strain that the truth shows in its programme."""
    if world.programme == ALL_IN_ONE:
        return [all_in_one()]
    kind, random = KINDS[world.programme], world.random("truth")
    peak = float(random.uniform(*kind.peaks))
    own = RATES[1:] if kind.hot else RATES  # what is slow stays as warm as the air
    usual = float(random.choice(own))
    out = []
    for number in range(kind.records):
        rate = RATES[number] if kind.of_each_rate else usual
        truth = Parameters.of(TRUTH)
        driven = programme(kind.named, Usual(peak, rate, AIR), truth, SETTINGS, kind.samples)
        strain = simulate(truth, driven, SETTINGS).strain
        first = int(np.argmax(strain > ELASTIC[0])) + 1
        begin = np.linspace(0.0, float(np.interp(ELASTIC[0], strain[:first], driven.time[:first])), ELASTIC[1])
        moments = np.union1d(begin, driven.time)
        out.append((f"record {number + 1}", moments, np.interp(moments, driven.time, strain), whole(moments)))
    return out


def candidates(seed: int) -> tuple[World, ...]:
    """The tests of a seed, see `worlds`."""
    return worlds(seed, tuple(KINDS), ("stress", "theta"))


def measured(world: World, planted: Mapping[str, float]) -> CouponData:
    """Virtual records of the truth with planted Params, from steps FINER times finer, with noise, and with the declared one in it."""
    parameters = Parameters.of({**TRUTH, **planted})
    random, hot = world.random("noise"), KINDS[world.programme].hot
    true = {"strain": NOISE["strain"], **{name: world.noise * NOISE[name] for name in ("stress", "theta")}}
    declared = {name: sigma * world.declared.get(name, 1.0) for name, sigma in true.items()}
    tests = []
    for number, (name, t, strain, phases) in enumerate(paths(world)):
        air = AIR + number * KINDS[world.programme].warmer
        own = parameters.replace(theta_air=air, theta_ref=air, theta_clamp=air)
        index = np.arange((len(t) - 1) * FINER + 1) / FINER
        fine = np.interp(index, np.arange(len(t)), t), np.interp(index, np.arange(len(t)), strain)
        history = simulate(own, Programme.by_strain(*fine, air), SETTINGS).every(FINER)
        bare = CouponTest(name, t, strain, history.stress, None, air, air, declared, phases)
        theta = shown(history.theta_sensor, bare, own) + true["theta"] * world.noisy(random, t.shape)
        stress = history.stress + true["stress"] * world.noisy(random, t.shape)
        tests.append(replace(bare, stress=stress, theta=theta if hot else None))
    return CouponData(tuple(tests), "strain")


@lru_cache(maxsize=2)
def _study(hot: bool) -> Study:
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "study.yaml"
        source.write_text(_HEAD.rstrip() + (_HOT if hot else _COLD), encoding="utf-8")
        return load_study(source)


def closed(world: World, data: CouponData, folder: Path, without: Collection[str] = ()) -> tuple[Closed, Unlisted | None]:
    """The loop on records, from the fit of the base model on, and what it leaves unlisted; effects `without` are not in its catalogue."""
    hot = KINDS[world.programme].hot
    study = _study(hot)
    start = study.start_parameters(data)
    experiment = CouponExperiment(study, given=data)
    slopes = [line.slope for test in data.tests if (line := test.line) is not None]
    if slopes:  # what `identify-elastic` would find
        start = start.replace(E=float(np.mean(slopes)))
        study = within(study, start, experiment.told(start))
    settings = experiment.widened(start)
    base = start.with_free(settings.free)  # type: ignore[arg-type]
    model = coupon_model(study, data, settings, base)
    refit = JointFit(study, settings, model, job(folder, "operating", {}, {}))
    parameters, fit = refit(base, "joint")
    case = replace(_case(study, data, model, parameters, hot), cheap=True, bounds=study.bounds)
    case = replace(case, known=tuple(e for e in case.known if e.name not in without))
    fine = study.model_copy(update={"numerics": study.numerics.model_copy(update={"steps_per_interval": 2})})
    numerical = 2.0 * (model.residual(parameters) - coupon_model(fine, data, settings, base).residual(parameters))
    found = close_loop(case, fit, refit, study.diagnosis.max_effects, numerical)
    found, missing, _ = finished(found, study.diagnosis.held_out)
    return found, missing


def _case(study: Study, data: CouponData, model: StageModel, parameters: Parameters, hot: bool) -> Case:
    run = coupon_run(study, data, parameters.free)
    strain = max(float(run.history(parameters, test).accumulated.max()) for test in data.tests)
    there = flow_conditions(data.tests, lambda test: run.history(parameters, test))
    known, _ = not_identifiable(effects_of_point(sensor=hot), parameters, there)
    return Case(model, parameters, known, record_spans(data), station_names(), largest_strain=strain)


def at_truth(world: World) -> Traced:
    """The trace of a test with nothing planted and its noise as it is, at the truth: what smallest amplitudes are told by."""
    data = measured(replace(world, declared={}), {})
    hot = KINDS[world.programme].hot
    study = _study(hot)
    settings = CouponExperiment(study, given=data).joint_settings()
    truth = Parameters.of(TRUTH, settings.free)
    return traced(_case(study, data, coupon_model(study, data, settings, truth), truth, hot))
