"""Virtual full-field tests for the operating figures: fields of a body with a planted effect, and the loop on a coarser model of it.

The data come from a finer mesh and half the time steps, with noise of both cameras and of the load
cell, whose record is smoothed as any other; the fit knows nothing of what was planted.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from thermofit.core.experiment import ForceRecord, Specimen
from thermofit.core.parameters import Parameters
from thermofit.core.staging import job
from thermofit.core.study import Study
from thermofit.core.study_section import PRESETS, MeshSize
from thermofit.diagnose.case import Case, slots_of
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.prepared import JOINT_EVALUATIONS
from thermofit.diagnose.refit import JointFit
from thermofit.diagnose.structure import named_phases
from thermofit.diagnose.trace import traced
from thermofit.fem.history import History
from thermofit.fem.march import Loading
from thermofit.identify.discretisation import corrected
from thermofit.identify.forward import Run, march_settings, sampler, specimen_body
from thermofit.identify.inputs import LoadSteps, Measured, TestPhase, force_observation
from thermofit.identify.instruments import Instruments
from thermofit.identify.joint import Joint, joint_settings, station_names
from thermofit.identify.priors import effect_priors
from thermofit.measure.force import smooth_force
from thermofit.measure.observation import FieldObservation
from thermofit.measure.stations import INFRARED

SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
TRUTH = {
    **{"E": 68000.0, "nu": 0.33, "M_y0": 130.0, "M_yinf": 290.0, "H_exp": 11.0, "F": 0.4, "alpha_exp": 2.2e-5, "kappa": 130.0, "c0": 2.3},
    **{"beta": 0.8, "alpha_air": 15.0, "alpha_clamp": 400.0, "theta_air": 297.4, "theta_clamp": 296.7, "theta_ref": 296.7},
}
FREE = ("E", "M_y0", "M_yinf", "H_exp", "F", "alpha_exp", "kappa", "c0", "beta", "alpha_air", "alpha_clamp", "theta_air", "theta_clamp")
NOISE = {"u": 0.002, "theta": 0.025, "force": 4.0}
STUDY = """
name: operating-body
experiment: raw
model: 2
mesh: coarse
parameters:
  nu: 0.33
  E: {start: 65000, bounds: [30000, 150000]}
  M_y0: {start: 125, bounds: [50, 250]}
  M_yinf: {start: 300, bounds: [251, 1000]}
  H_exp: {start: 12, bounds: [1, 60]}
  F: {start: 0.45, bounds: [0.1, 1.5]}
  alpha_exp: {start: 2.4e-5, bounds: [5.0e-6, 6.0e-5]}
  kappa: {start: 150, bounds: [20, 600]}
  c0: {start: 2.4, bounds: [0.8, 6.0]}
  beta: {start: 0.9, bounds: [0, 4]}
  alpha_air: {start: 12, bounds: [0, 100]}
  alpha_clamp: {start: 500, bounds: [10, 20000]}
diagnosis: {max_effects: 3}
"""


def programme() -> tuple[np.ndarray, np.ndarray, tuple[TestPhase, ...]]:
    """Time s and force N: rest, loading at two rates with a hold between, unloading, cooling."""
    legs = [
        (0.0, 4.0, 2, "rest"),
        (3900.0, 8.0, 5, "loading 490 N/s"),
        (4600.0, 20.0, 6, "loading 35 N/s"),
        (4600.0, 15.0, 3, "hold"),
        (5300.0, 5.0, 6, "loading 140 N/s"),
        (500.0, 8.0, 4, "unloading"),
        (500.0, 120.0, 12, "cooling"),
    ]
    moments, force, phases = [0.0], [0.0], []
    for target, duration, n, label in legs:
        part = np.linspace(0.0, 1.0, n + 1)[1:]
        start, t0 = force[-1], moments[-1]
        force += list(start + (target - start) * part)
        moments += list(t0 + duration * part)
        phases.append(TestPhase(t0, moments[-1], label))
    return np.array(moments), np.array(force), tuple(phases)


def _points() -> np.ndarray:
    x, y = np.meshgrid(np.linspace(-10.0, 10.0, 5), np.linspace(-22.0, 22.0, 12))
    return np.stack([x.ravel(), y.ravel()], axis=1)


def _blank(name: str, sigma: float, n_c: int, unit: str) -> FieldObservation:
    t, xy = programme()[0], _points()
    shape = (len(t), len(xy))
    return FieldObservation(name, t, xy, np.zeros((*shape, n_c)), np.full((*shape, n_c), sigma), np.ones(shape, dtype=bool), unit)


@lru_cache(maxsize=1)
def _blank_test() -> Measured:
    t, force, phases = programme()
    steps = LoadSteps(t, force, np.zeros(len(t)))
    every = {"displacement": steps, "temperature": steps, "all": steps}
    u, theta = _blank("u", NOISE["u"], 2, "mm"), _blank("theta", NOISE["theta"], 1, "K")
    observed = force_observation(t, steps, NOISE["force"])
    return Measured(SPECIMEN, TRUTH["theta_air"], TRUTH["theta_clamp"], u, theta, observed, every, 4.0, phases)


def _recorded(random: np.random.Generator) -> LoadSteps:
    """The load as the identification knows it: a noisy record of the load cell, smoothed."""
    t, force, _ = programme()
    time = np.arange(0.0, t[-1] + 0.05, 0.1)
    smooth = smooth_force(ForceRecord(time, np.interp(time, t, force) + NOISE["force"] * random.normal(size=len(time)), None))
    return LoadSteps(t, smooth.evaluate(t), np.zeros(len(t)), None, smooth.error_modes(t))


def _case(joint: Joint, data: Measured, parameters: Parameters, largest_strain: float) -> Case:
    spans = named_phases(data.phases)
    return Case(
        joint.model, parameters, slots_of("body", INFRARED), spans, station_names(), scored=joint.scored, largest_strain=largest_strain
    )


@dataclass(frozen=True)
class Fields:
    """Virtual tests on a body: the mesh of the fit, and the finer one of the data."""

    fit: MeshSize
    true: MeshSize
    STUDY: str = STUDY

    def measured(self, study: Study, planted: dict[str, float], seed: int) -> Measured:
        """A virtual test of the truth with planted Params, from a finer mesh and half the time steps, with noise."""
        blank, parameters = _blank_test(), Parameters.of({**TRUTH, **planted})
        t, force, _ = programme()
        fine = np.interp(np.arange(2 * len(t) - 1) / 2.0, np.arange(len(t)), t)
        body = specimen_body(study, blank, self.true)
        history: History = Run(body, Loading(fine, np.interp(fine, t, force)), march_settings(study, "full"))(parameters)
        steps = LoadSteps(fine, np.interp(fine, t, force), np.zeros(len(fine)))
        observations = {"u": blank.displacement, "theta": blank.temperature}
        assert blank.temperature is not None
        samplers = {name: sampler(body, o, steps) for name, o in observations.items() if o is not None}
        run = Run(body, Loading(fine, steps.force), march_settings(study, "full"))
        look = Instruments(run, samplers, {n: o for n, o in observations.items() if o is not None}, TRUTH["theta_air"])
        random = np.random.default_rng(seed)
        u = look.predicted("u", history, parameters) + NOISE["u"] * random.normal(size=blank.displacement.value.shape)
        theta = look.predicted("theta", history, parameters) + NOISE["theta"] * random.normal(size=blank.temperature.value.shape)
        air, clamp = (TRUTH[name] + 0.1 * random.normal() for name in ("theta_air", "theta_clamp"))
        loaded = _recorded(random)
        return replace(
            blank,
            force=force_observation(t, loaded, NOISE["force"]),
            steps=dict.fromkeys(blank.steps, loaded),
            theta_air=air,
            theta_clamp=clamp,
            displacement=replace(blank.displacement, value=u),
            temperature=replace(blank.temperature, value=theta),
        )

    def _joint(self, study: Study, data: Measured) -> Joint:
        return Joint(study, data, joint_settings(study, FREE, data), self.fit, beside=effect_priors(study))

    def closed(self, study: Study, data: Measured, folder: Path) -> Closed:
        """The loop on a test, from the fit of the base model on; a first fit, which knows nothing of its mesh, stands for the stages."""
        base = study.start_parameters(data).with_free(FREE)  # type: ignore[arg-type]
        base = base.replace(theta_air=data.theta_air, theta_clamp=data.theta_clamp, theta_ref=TRUTH["theta_ref"])
        joint, task = self._joint(study, data), job(Path(tempfile.mkdtemp(dir=folder)), "operating", {}, {})
        staged, _ = JointFit(study, joint.settings, joint.model, task, 2 * JOINT_EVALUATIONS, parts=joint)(base, "stages")
        found = corrected(joint, staged)
        joint = found.joint
        refit = JointFit(study, joint.settings, joint.model, task, parts=joint)
        parameters, fit = replace(refit, at_most=2 * JOINT_EVALUATIONS)(staged, "joint")
        case = replace(_case(joint, data, parameters, found.largest_strain), heated=refit.heated)
        return close_loop(case, fit, refit, study.diagnosis.max_effects, found.left)

    def detectable(self, study: Study) -> dict[str, float]:
        """Smallest amplitude of every effect that passes the threshold, at the truth."""
        data, truth = self.measured(study, {}, 1), Parameters.of(TRUTH, FREE)
        found = corrected(self._joint(study, data), truth)
        return {s.effect: s.detectable for s in traced(_case(found.joint, data, truth, found.largest_strain)).ranking.scores}


SMALL = Fields(MeshSize(n_x=3, n_y=20, n_z=1), MeshSize(n_x=5, n_y=36, n_z=2))
FULL = Fields(PRESETS["coarse"], PRESETS["full"])
