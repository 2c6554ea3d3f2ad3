"""Virtual full-field tests for the operating figures: fields of a body with a planted effect, and the loop on a coarser model of it.

The data come from a finer mesh and half the time steps, with noise of both cameras and of the load cell, whose record is smoothed as any
other; the fit knows nothing of what was planted. The pace of the loading and the noise of the cameras are drawn by the seed. So are the
thickness of the specimen beside the declared one and the pose of the infrared camera, whose standard errors of landmarks the fit knows.
"""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from operating_draw import World, worlds

from thermofit.body.solve.history import History
from thermofit.body.solve.march import Loading
from thermofit.core.experiment import ForceRecord, Specimen
from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.prepared import JOINT_EVALUATIONS
from thermofit.diagnose.refit import JointFit
from thermofit.diagnose.trace import Traced, traced
from thermofit.diagnose.unlisted import Unlisted
from thermofit.diagnose.whole_loop import finished
from thermofit.experiment.discretisation import corrected
from thermofit.experiment.fields import LoadSteps, Measured, TestPhase, force_observation
from thermofit.experiment.forward import MechanicalRun, march_settings, sampler, specimen_body
from thermofit.experiment.instruments import Instruments
from thermofit.experiment.joint import Joint, joint_settings, station_names
from thermofit.experiment.known_effects import effects_of_fields
from thermofit.experiment.priors import effect_priors, pose_bounds
from thermofit.experiment.residuals import named_phases
from thermofit.identify.solve import within
from thermofit.observe.force import smooth_force
from thermofit.observe.observation import FieldObservation
from thermofit.records.staging import job
from thermofit.study.section import PRESETS, MeshSize
from thermofit.study.study import Study, load_study

SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
TRUTH = {
    **{"E": 68000.0, "nu": 0.33, "M_y0": 130.0, "M_yinf": 290.0, "H_exp": 11.0, "F": 0.4, "alpha_exp": 2.2e-5, "kappa": 130.0, "c0": 2.3},
    **{"beta": 0.8, "alpha_air": 15.0, "alpha_clamp": 400.0, "theta_air": 297.4, "theta_clamp": 296.7, "theta_ref": 296.7},
}
FREE = ("E", "M_y0", "M_yinf", "H_exp", "F", "alpha_exp", "kappa", "c0", "beta", "alpha_air", "alpha_clamp", "theta_air", "theta_clamp")
NOISE = {"u": 0.002, "theta": 0.025, "force": 4.0}
REGISTRATION = {"shift_y": 0.1, "shift_x": 0.1, "rotation": 0.003, "scale": 0.003}
"""Standard errors of the pose of the infrared camera, mm, rad and 1: landmarks picked to half a pixel of 0.25 mm over 44 mm."""
THICKNESS_ERROR = 0.01
"""Standard deviation of the thickness over the declared one, which every test takes for exact."""
PACES = {"half-rate": 2.0, "usual-rate": 1.0, "twice-rate": 0.5}
"""Times of the loading over the usual ones, by the name of the programme."""
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
"""


def programme(name: str) -> tuple[np.ndarray, np.ndarray, tuple[TestPhase, ...]]:
    """Time s and force N: rest, loading at two rates with a hold between, unloading, cooling; `name` one of PACES."""
    slower = PACES[name]
    legs = [
        (0.0, 4.0, 2, "rest"),
        (3900.0, 8.0 * slower, 5, f"loading {488.0 / slower:.0f} N/s"),
        (4600.0, 20.0 * slower, 6, f"loading {35.0 / slower:.0f} N/s"),
        (4600.0, 15.0 * slower, 3, "hold"),
        (5300.0, 5.0 * slower, 6, f"loading {140.0 / slower:.0f} N/s"),
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


def _blank(t: np.ndarray, name: str, sigma: float, n_c: int, unit: str) -> FieldObservation:
    xy = _points()
    shape = (len(t), len(xy))
    return FieldObservation(name, t, xy, np.zeros((*shape, n_c)), np.full((*shape, n_c), sigma), np.ones(shape, dtype=bool), unit)


def _blank_test(world: World) -> Measured:
    """A test of a programme without its values; sigma is the declared one."""
    t, force, phases = programme(world.programme)
    steps = LoadSteps(t, force, np.zeros(len(t)))
    every = {"displacement": steps, "temperature": steps, "all": steps}
    sigma = {name: world.noise * world.declared.get(name, 1.0) * NOISE[name] for name in ("u", "theta")}
    u, theta = _blank(t, "u", sigma["u"], 2, "mm"), _blank(t, "theta", sigma["theta"], 1, "K")
    observed = force_observation(t, steps, NOISE["force"])
    registration = {f"ir_registration.{name}": sigma for name, sigma in REGISTRATION.items()}
    blank = Measured(SPECIMEN, TRUTH["theta_air"], TRUTH["theta_clamp"], u, theta, observed, every, 4.0, phases)
    return replace(blank, registration=registration)


@dataclass(frozen=True)
class Setup:
    """What a test has otherwise than is declared: thickness over the declared one, and pose of the infrared camera by Param."""

    thickness: float
    pose: Mapping[str, float]

    def seen(self, xy: np.ndarray) -> np.ndarray:
        """The points (n, 2) that the camera sees where it takes them for xy, mm (`effects.ir_registration`)."""
        p = self.pose
        x, y = xy[:, 0], xy[:, 1]
        away = (p["shift_x"] - p["rotation"] * y + p["scale"] * x, p["shift_y"] + p["rotation"] * x + p["scale"] * y)
        return np.asarray(xy + np.stack(away, axis=1))


AS_DECLARED = Setup(1.0, dict.fromkeys(REGISTRATION, 0.0))


def setup(world: World) -> Setup:
    """The specimen and the camera of a seed."""
    random = world.random("specimen")
    return Setup(1.0 + THICKNESS_ERROR * random.normal(), {name: sigma * random.normal() for name, sigma in REGISTRATION.items()})


def _recorded(world: World, random: np.random.Generator) -> LoadSteps:
    """The load as the identification knows it: a noisy record of the load cell, smoothed."""
    t, force, _ = programme(world.programme)
    time = np.arange(0.0, t[-1] + 0.05, 0.1)
    smooth = smooth_force(ForceRecord(time, np.interp(time, t, force) + NOISE["force"] * random.normal(size=len(time)), None))
    return LoadSteps(t, smooth.evaluate(t), np.zeros(len(t)), None, smooth.error_modes(t))


@lru_cache(maxsize=2)
def _study(text: str) -> Study:
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "study.yaml"
        source.write_text(text, encoding="utf-8")
        return load_study(source)


@dataclass(frozen=True)
class Problem:
    """The joint fit of a test as the command makes it: its parts, the study with the bounds of the pose, and the parameters of the pose."""

    study: Study
    joint: Joint
    pose: frozenset[str]

    def case(self, joint: Joint, data: Measured, parameters: Parameters, largest_strain: float) -> Case:
        """What the loop is asked of, at parameters."""
        return Case(
            joint.model,
            parameters,
            effects_of_fields(infrared=True),
            named_phases(data.phases),
            station_names() | self.pose,
            scored=joint.scored,
            largest_strain=largest_strain,
            bounds=self.study.bounds,
            pose=self.pose,
        )


def problem(data: Measured, base: Parameters, size: MeshSize) -> Problem:
    """The joint fit of a test with a pose of the camera that is a datum of its landmarks."""
    study = _study(STUDY)
    told = pose_bounds(study, data.registration)
    settings = joint_settings(study, (*FREE, *told), data)
    joint = Joint(study, data, settings, size, beside=effect_priors(study, data.registration))
    return Problem(within(study, base, told), joint, frozenset(told))


@dataclass(frozen=True)
class Fields:
    """Virtual tests on a body: the mesh of the fit, and the finer one of the data."""

    fit: MeshSize
    true: MeshSize

    def candidates(self, seed: int) -> tuple[World, ...]:
        """The tests of a seed, see `worlds`."""
        return worlds(seed, tuple(PACES), ("u", "theta"))

    def measured(self, world: World, planted: Mapping[str, float], its: Setup | None = None) -> Measured:
        """A virtual test of the truth with planted Params, from a finer mesh and half the time steps, with noise. Its specimen and its
        camera are those of the seed, or what is given."""
        study, its = _study(STUDY), its or setup(world)
        blank, parameters = _blank_test(world), Parameters.of({**TRUTH, **planted})
        t, force, _ = programme(world.programme)
        fine = np.interp(np.arange(2 * len(t) - 1) / 2.0, np.arange(len(t)), t)
        actual = replace(blank, specimen=replace(SPECIMEN, thickness=its.thickness * SPECIMEN.thickness))
        body = specimen_body(study, actual, self.true)
        history: History = MechanicalRun(body, Loading(fine, np.interp(fine, t, force)), march_settings(study, "full"))(parameters)
        steps = LoadSteps(fine, np.interp(fine, t, force), np.zeros(len(fine)))
        assert blank.temperature is not None
        observations = {"u": blank.displacement, "theta": replace(blank.temperature, xy=its.seen(blank.temperature.xy))}
        samplers = {name: sampler(body, o, steps) for name, o in observations.items() if o is not None}
        run = MechanicalRun(body, Loading(fine, steps.force), march_settings(study, "full"))
        look = Instruments(run, samplers, {n: o for n, o in observations.items() if o is not None}, TRUTH["theta_air"])
        random = world.random("noise")
        sigma = {name: world.noise * NOISE[name] for name in observations}
        u = look.predicted("u", history, parameters) + sigma["u"] * world.noisy(random, blank.displacement.value.shape)
        theta = look.predicted("theta", history, parameters) + sigma["theta"] * world.noisy(random, blank.temperature.value.shape)
        air, clamp = (TRUTH[name] + 0.1 * random.normal() for name in ("theta_air", "theta_clamp"))
        loaded = _recorded(world, random)
        return replace(
            blank,
            force=force_observation(t, loaded, NOISE["force"]),
            steps=dict.fromkeys(blank.steps, loaded),
            theta_air=air,
            theta_clamp=clamp,
            displacement=replace(blank.displacement, value=u),
            temperature=replace(blank.temperature, value=theta),
        )

    def closed(self, world: World, data: Measured, folder: Path, without: Collection[str] = ()) -> tuple[Closed, Unlisted | None]:
        """The loop on a test, from the fit of the base model on, and what it leaves unlisted; a first fit, which knows nothing of its mesh,
        stands for the stages. Effects `without` are not in its catalogue."""
        study = _study(STUDY)
        base = study.start_parameters(data)
        base = base.replace(theta_air=data.theta_air, theta_clamp=data.theta_clamp, theta_ref=TRUTH["theta_ref"])
        asked = problem(data, base, self.fit)
        study, joint, base = asked.study, asked.joint, base.with_free(asked.joint.settings.free)
        task = job(folder, "operating", {}, {})
        staged, _ = JointFit(study, joint.settings, joint.model, task, 2 * JOINT_EVALUATIONS, parts=joint)(base, "stages")
        corrected_ = corrected(joint, staged)
        joint = corrected_.joint
        refit = JointFit(study, joint.settings, joint.model, task, parts=joint)
        parameters, fit = replace(refit, at_most=2 * JOINT_EVALUATIONS)(staged, "joint")
        case = asked.case(joint, data, parameters, corrected_.largest_strain)
        known = tuple(e for e in case.known if e.name not in without)
        case = replace(case, known=known, heated=refit.heated, moved=refit.moved)
        found = close_loop(case, fit, refit, study.diagnosis.max_effects, corrected_.left)
        found, missing, _ = finished(found, study.diagnosis.held_out)
        return found, missing

    def at_truth(self, world: World) -> Traced:
        """The trace of a test with nothing planted and its noise as it is, at the truth: what smallest amplitudes are told by. Specimen and
        camera are as they are declared."""
        data = self.measured(replace(world, declared={}), {}, AS_DECLARED)
        asked = problem(data, Parameters.of(TRUTH, FREE), self.fit)
        truth = Parameters.of(TRUTH, asked.joint.settings.free)
        found = corrected(asked.joint, truth)
        return traced(asked.case(found.joint, data, truth, found.largest_strain))


SMALL = Fields(MeshSize(n_x=3, n_y=20, n_z=1), MeshSize(n_x=5, n_y=36, n_z=2))
FULL = Fields(PRESETS["coarse"], PRESETS["full"])
