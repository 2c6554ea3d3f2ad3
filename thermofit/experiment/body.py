"""One specimen under cameras: a finite element model, driven by its force, by the motion of its ends, or by the crosshead."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from thermofit.body.solve.history import History
from thermofit.core.errors import NumericsError
from thermofit.core.parameters import AT, Parameters, bare_name
from thermofit.effects.catalogue import Effect
from thermofit.experiment.body_check import checked
from thermofit.experiment.compiling import compiled
from thermofit.experiment.computed_motion import refuse_identified, told_by_temperatures
from thermofit.experiment.discretisation import corrected, telling_mesh
from thermofit.experiment.drive import SECTIONS, near_maximum, with_driven_force, with_force_channel
from thermofit.experiment.fields import (
    INTERPOLATE,
    LoadSteps,
    Measured,
    displacement_of,
    measured,
    start_parameters,
    temperature_of,
)
from thermofit.experiment.forward import nodal_gauge
from thermofit.experiment.joint import Joint, JointParts, diagnosis_mesh, joint_free, joint_settings
from thermofit.experiment.joint_errors import told
from thermofit.experiment.known_effects import effects_of_data
from thermofit.experiment.model import StageModel, needs_drive, needs_stress, stage_model
from thermofit.experiment.planned import planned, simulated
from thermofit.experiment.prescribed import Moved, of_specimen
from thermofit.experiment.priors import effect_priors, pose_bounds
from thermofit.experiment.programmes import NAMES, OWN, programme_named
from thermofit.experiment.protocol import Carried, JointProblem, Kept, PlannedMotion, PlannedTest
from thermofit.experiment.residuals import Span, named_phases
from thermofit.experiment.several import own_names
from thermofit.experiment.stage_errors import StageErrors, stage_errors
from thermofit.experiment.start import feasible_start, other_starts
from thermofit.experiment.verification import Checked, KnownErrors
from thermofit.experiment.window import window_times
from thermofit.observe.observation import FieldObservation
from thermofit.records.artefact import Record
from thermofit.records.staging import artefact_path
from thermofit.study.models import FROM_EXPERIMENT
from thermofit.study.search import CLOCK, THICKNESS
from thermofit.study.section import MeshSize
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study


@dataclass(frozen=True)
class BodyExperiment:
    """One specimen under cameras; `name` among several. `given`: what was measured, where it is not that of the artefact. `turned`: the
    motion of sections drives it, although the study says that the force should."""

    study: Study
    name: str = ""
    given: Measured | None = None
    turned: bool = False
    held: tuple[UnseenBody, ...] | None = None
    """The held-out experiments, where they are not those of the artefacts."""

    @cached_property
    def data(self) -> Measured:
        """What was measured. StudyError that names the command where it has not been interpolated."""
        found = measured(self.study) if self.given is None else self.given
        return with_driven_force(found) if self.study.force.drives == "dic" else found

    @property
    def drive(self) -> str:
        """As the study says, or by its sections."""
        return SECTIONS if self.turned else self.study.force.drives

    @property
    def sections(self) -> str:
        """The two heights."""
        if self.data.gauge is None:
            return "" if self.data.stretched is None else "the ends of the model"
        return "the sections y = {:.1f} and {:.1f} mm".format(*self.data.gauge.sections)

    @property
    def by_sections(self) -> BodyExperiment | None:
        """The same study with that drive."""
        if self.study.force.drives != "force" or self.data.stretched is None:
            return None
        return replace(self, study=_with_drive(self.study, "dic"), turned=True)

    @property
    def near_maximum(self) -> str:
        """By the growth of its force at the end of loading."""
        return near_maximum(self.data) if self.study.force.drives == "force" else ""

    @property
    def spans(self) -> tuple[Span, ...]:
        """Phases of the test; they bear the name of a test that is one of several."""
        found = named_phases(self.data.phases)
        return tuple(replace(s, name=f"{self.name} {s.name}", experiment=self.name) for s in found) if self.name else found

    @property
    def inputs(self) -> dict[str, Path]:
        """The artefact of `interpolate`; of one of several it is called by its name."""
        return {f"{INTERPOLATE}{AT}{self.name}" if self.name else INTERPOLATE: artefact_path(self.study.run_dir, INTERPOLATE)}

    @property
    def fields(self) -> tuple[BodyExperiment, ...]:
        """Itself."""
        return (self,)

    @property
    def tests(self) -> tuple[BodyExperiment, ...]:
        """Itself."""
        return (self,)

    @cached_property
    def unseen(self) -> tuple[UnseenBody, ...]:
        """The declared held-out experiments of the study."""
        if self.held is not None:
            return self.held
        return unseen_bodies(_with_drive(self.study, "force") if self.turned else self.study)

    def compile(self) -> None:
        """The drivers of specimen and machine, side by side."""
        compiled()

    def no_use(self, stage: str) -> str:
        """Why a stage has nothing to do: there is nothing to simulate, or the cameras have not seen what it takes."""
        study = self.study
        if stage == "simulate" and not study.virtual:
            return "the experiment is measured"
        if stage in ("identify-plastic", "refine") and study.static is not None:
            return "the experiment is one elastic load step"
        if stage in ("calibrate-ir", "identify-thermal") and study.experiment.is_dir() and not (study.experiment / "ir").is_dir():
            return "the experiment has no infrared frames"
        return ""

    @property
    def last_stage(self) -> str:
        """The temperatures come last."""
        return "thermal"

    @property
    def programmes(self) -> tuple[str, ...]:
        """The programme of the study, and those made from it."""
        return (OWN, *NAMES)

    @property
    def plan_inputs(self) -> dict[str, Path]:
        """Nothing measured: a plan is that of the section `simulate`."""
        return {}

    def planned(self, settings: StageSettings, programme: str) -> PlannedTest:
        """The virtual test of that programme, with the declared noise and nothing drawn."""
        assumed = self.study.truth_parameters().with_free(settings.free)
        test = planned(self.study, programme_named(programme, simulated(self.study)), assumed)
        motion = PlannedMotion(displacement_of(test.data).time, test.motion)
        return PlannedTest(replace(self, given=test.data), assumed, motion, f"{test.duration:.4g} s, at most {test.force:.4g} N")

    @property
    def scalable(self) -> bool:
        """A mesh of a file is as it is."""
        return self.study.geometry.shape != "file"

    def finer(self, size: MeshSize) -> MeshSize:
        """That of its specimen."""
        return telling_mesh(self.study, self.data.specimen, size)

    def stage(self, key: str) -> tuple[StageSettings, Kept]:
        """Settings as the study gives them; without displacements nothing mechanical is free."""
        settings = self.study.stage(key)
        return (settings, Kept()) if self.data.displacement is not None else told_by_temperatures(self.study, settings, key)

    def earlier_estimates(self, key: str) -> Mapping[str, tuple[float, float]]:
        """None: a stage on fields tells what it frees."""
        return {}

    def start(self) -> Parameters:
        """Start values; boundary temperatures are those of the thermocouples where the study gives none."""
        return start_parameters(self.study, self.data)

    def feasible(self, start: Parameters) -> tuple[Parameters, str]:
        """A start whose largest force lies above the measured one."""
        return feasible_start(self.study, self.data, start)

    def again(self, start: Parameters) -> Iterator[tuple[str, Parameters]]:
        """A little stronger, then from the mean curve."""
        return other_starts(self.study, self.data, start)

    def model(self, settings: StageSettings, base: Parameters, size: MeshSize) -> StageModel:
        """The finite element model of the stage on a mesh; where it has turned to its sections, the force is compared as well.

        StudyError where nothing that is compared tells a stress."""
        settings = with_force_channel(settings) if self.turned else settings
        needs_stress(self.study, settings)
        times = window_times(settings.window, self.data, self.data.steps["displacement"])
        return stage_model(self.study, self.data, settings, base, size, times)

    def seen_by(self, parameters: Parameters, test: str) -> Parameters:
        """The parameters as they are."""
        return parameters

    def spread(self, values: Mapping[str, float]) -> dict[str, float]:
        """The values as they are."""
        return dict(values)

    def prescribed(self, quantity: str) -> float:
        """Thickness in mm; the clock of the camera is that of the machine, 0 s."""
        return self.data.specimen.thickness if quantity == THICKNESS else 0.0

    def with_prescribed(self, quantity: str, value: float) -> BodyExperiment:
        """Another thickness, or the infrared frames that many seconds later."""
        if quantity == THICKNESS:
            return replace(self, given=replace(self.data, specimen=replace(self.data.specimen, thickness=value)))
        assert quantity == CLOCK
        return replace(self, given=_clocked(self.data, value))

    def prescribed_errors(self, parameters: Parameters) -> dict[str, Moved]:
        """Calibration of force and cameras, area, thermocouples."""
        return of_specimen(self.study, self.data.specimen, parameters)

    def stage_errors(self, settings: StageSettings, parameters: Parameters, earlier: tuple[str, ...]) -> StageErrors:
        """By runs on the coarse mesh."""
        prescribed = self.prescribed_errors(parameters)

        def model_of(data: Measured, own: StageSettings, base: Parameters, size: MeshSize) -> StageModel:
            return replace(self, given=data).model(own, base, size)

        return stage_errors(self.study, self.data, settings, parameters, earlier, prescribed, model_of)

    def with_steps(self, parts: int) -> BodyExperiment:
        """Every load step in parts."""
        return replace(self, given=replace(self.data, steps={name: steps.divided(parts) for name, steps in self.data.steps.items()}))

    def planted(self, before: Parameters, after: Parameters) -> BodyExperiment:
        """By two coupled runs on the mesh of the joint fit."""
        held = tuple(one.planted(before, after) for one in self.unseen)
        return replace(self, given=planted(self.study, self.data, self.joint_settings(), before, after), held=held)

    def joint_settings(self, free: Sequence[str] = ()) -> StageSettings:
        """du, the force where it does not drive the model, dtheta where there are frames."""
        own = free or self.study.diagnosis.free or joint_free(self.study, [self.data])
        if self.data.displacement is None:
            refuse_identified(self.study, own, "diagnosis.free")
        return self.joint_settings_of(tuple(own))

    def joint_settings_of(self, free: Sequence[str]) -> StageSettings:
        """The same with just these parameters free."""
        settings = joint_settings(self.study, free, self.data)
        return with_force_channel(settings) if self.turned else settings

    def _mesh(self) -> MeshSize:
        """The mesh of the joint model."""
        return diagnosis_mesh(self.study, self.data.specimen)

    def joint(self, settings: StageSettings, base: Parameters, size: MeshSize | None = None) -> JointProblem:
        """One coupled run through all observations."""
        needs_drive(self.study, settings.channels)
        size = size or self._mesh()
        return self._problem(settings, base, Joint(self.study, self.data, settings, size), size)

    def diagnosed(self, base: Parameters, free: Sequence[str] = ()) -> JointProblem:
        """With the errors of mesh and steps at the optimum of the stages taken into the data."""
        settings = self.joint_settings(free)
        pose = pose_bounds(self.study, self.data.registration) if self.data.registration else {}
        settings = settings.model_copy(update={"free": (*settings.free, *pose)})
        base, size = base.with_free(settings.free), self._mesh()
        plain = Joint(self.study, self.data, settings, size, beside=effect_priors(self.study, self.data.registration))
        found = told(plain, base)
        return replace(
            self._problem(settings, base, found.parts, size),
            plain=plain,
            errors=found,
            numerical=lambda _: found.left,
            largest_strain=found.largest_strain,
            told=pose,
        )

    def _problem(self, settings: StageSettings, base: Parameters, parts: JointParts, size: MeshSize) -> JointProblem:
        return JointProblem(
            settings=settings,
            base=base,
            model=parts.model,
            spans=named_phases(self.data.phases),
            size=size,
            parts=parts,
            known=effects_of_data(self.data, self.study.yield_surface),
            correlation_length=self.data.correlation_length,
        )

    def checked(
        self, parameters: Parameters, thermal: Record | None = None, word: str = "verified", known: KnownErrors | None = None
    ) -> Checked:
        """One coupled run on the mesh of the study."""
        return checked(self.study, self.data, parameters, thermal, word, known)


def _with_drive(study: Study, drive: str) -> Study:
    """The study with another drive."""
    return study.model_copy(update={"force": study.force.model_copy(update={"drives": drive})})


def _clocked(data: Measured, seconds: float) -> Measured:
    """The infrared frames that many seconds later, the load steps with them. Before the record of the force the specimen rests, so that
    earlier frames show its beginning; frames that lie after its end go."""
    theta = temperature_of(data)
    steps = data.steps["all"].time
    first, last = float(steps[0]), float(steps[-1])
    moved = replace(theta, time=np.maximum(theta.time + seconds, first)).between(first, last)
    kept = {name: _stepping(known, theta.time, moved.time) for name, known in data.steps.items() if name != "displacement"}
    return replace(data, temperature=moved, steps={**data.steps, **kept})


def _stepping(steps: LoadSteps, old: np.ndarray, new: np.ndarray) -> LoadSteps:
    """Load steps that hit the new times instead of the old ones; the first and the last stay."""
    gone = np.isin(np.round(steps.time, 6), np.round(old, 6))
    gone[[0, -1]] = False
    time = np.unique(np.round(np.concatenate([steps.time[~gone], new]), 9))
    return steps.at(time)


@dataclass(frozen=True)
class UnseenBody:
    """A held-out experiment of the study `whole`.

    The material is that of the fit, temperatures are those of its own thermocouples. Its own boundary and measurement parameters are those
    that the study gives for it, else what was identified on the fitted experiment, or its mean over several of them. An effect of boundary
    or instruments that a diagnosis adds belongs to the test that shows it: this one is predicted without.
    """

    whole: Study
    experiment: BodyExperiment

    @property
    def name(self) -> str:
        """Name of the experiment."""
        return self.experiment.name

    @property
    def label(self) -> str:
        """What it is called in words."""
        return f"experiment {self.name}"

    @property
    def fit_own(self) -> tuple[str, ...]:
        """Its own parameters that are fitted on its own data, as the study says."""
        return self.whole.experiments[self.name].fit_own

    @property
    def by_sections(self) -> UnseenBody | None:
        """The same with that drive."""
        other = self.experiment.by_sections
        return None if other is None else replace(self, experiment=other)

    @cached_property
    def own(self) -> frozenset[str]:
        """Parameters that every experiment has for itself."""
        return own_names(self.whole)

    def taken_over(self, identified: Sequence[str]) -> dict[str, tuple[str, ...]]:
        """Own parameters that are taken from the fitted ones, each with the identified names of which it is the mean."""
        given = self.whole.experiments[self.name].parameters
        return {
            name: tuple(n for n in identified if bare_name(n) == name)
            for name in dict.fromkeys(bare_name(name) for name in identified)
            if name in self.own and name not in given and name not in FROM_EXPERIMENT
        }

    def predicted(self, found: Parameters, identified: Sequence[str]) -> Parameters:
        """Parameters that predict it from fitted ones."""
        taken, here = self.taken_over(identified), self.experiment.start()
        values = {name: value for name, value in found.values.items() if AT not in name}
        for name in self.own | frozenset(FROM_EXPERIMENT):
            values[name] = float(np.mean([found[n] for n in taken[name]])) if name in taken else here[name]
        return Parameters.of(values)

    def taken(self, found: Parameters, identified: Sequence[str]) -> tuple[str, ...]:
        """What is taken from the fitted experiments, in words."""
        said = []
        for name, of in self.taken_over(identified).items():
            how = "identified on the fitted experiment" if len(of) == 1 else f"the mean of {len(of)} fitted experiments"
            said.append(f"{name} = {np.mean([found[n] for n in of]):.4g} is {how}")
        return tuple(sorted(said))

    def carried(self, free: Sequence[str], identified: Sequence[str]) -> Carried:
        """Shared parameters as they are, own ones as the mean that they are taken over as."""
        taken = self.taken_over(identified)
        names = tuple(dict.fromkeys(bare_name(n) for n in free if bare_name(n) in taken or not self._stays(n)))
        weights = np.zeros((len(names), len(free)))
        for k, n in enumerate(free):
            if bare_name(n) in names:
                weights[names.index(bare_name(n)), k] = 1.0 / len(taken[bare_name(n)]) if bare_name(n) in taken else 1.0
        return names, weights

    def _stays(self, name: str) -> bool:
        """True for a parameter that it does not take from the fitted ones."""
        return bare_name(name) in self.own or bare_name(name) in FROM_EXPERIMENT

    def problem(self, settings: StageSettings, base: Parameters, known: Sequence[Effect]) -> JointProblem:
        """All that its own cameras have seen, on the mesh of the joint fit."""
        part = self.experiment
        return part.joint(part.joint_settings_of(()), base, diagnosis_mesh(self.whole, part.data.specimen))

    def corrected(self, problem: JointProblem, parameters: Parameters) -> JointProblem:
        """With the errors of mesh and force at given parameters."""
        assert problem.parts is not None
        joint = corrected(problem.parts.each[""], parameters).joint
        return replace(problem, model=joint.model, parts=joint)

    def planted(self, before: Parameters, after: Parameters) -> UnseenBody:
        """The same with what an effect of the material changes of it; one of boundary or instruments belongs to another test."""
        there = [self.predicted(p, p.free) for p in (before, after)]
        if there[0].values == there[1].values:
            return self
        try:
            return replace(self, experiment=self.experiment.planted(*there))
        except NumericsError:
            other = self.by_sections  # which is how the loop will drive it
            if other is None:
                raise
            return replace(other, experiment=other.experiment.planted(*there))

    def judges(self, known: Sequence[Effect]) -> frozenset[str]:
        """Effects that all tests share: those of the material."""
        return frozenset(e.name for e in known if e.amplitude.name not in self.own)


def unseen_bodies(study: Study) -> tuple[UnseenBody, ...]:
    """The declared held-out experiments of a study."""
    return tuple(UnseenBody(study, BodyExperiment(study.one_of(name), name)) for name in study.held_out)


def planted(study: Study, data: Measured, settings: StageSettings, before: Parameters, after: Parameters) -> Measured:
    """Measured fields with the difference of two predictions added: displacements mm, temperatures K, the force N where it does not drive
    the model, and the elongation mm of the sections where it does. NumericsError where a run fails."""
    joint = Joint(study, data, settings, diagnosis_mesh(study, data.specimen))
    new, old = (joint.run(parameters) for parameters in (after, before))
    shown = [joint.prediction.of(history, parameters) for history, parameters in ((new, after), (old, before))]

    def changed(observation: FieldObservation) -> FieldObservation:
        return replace(observation, value=observation.value + (shown[0][observation.name] - shown[1][observation.name]))

    out = data if data.displacement is None else replace(data, displacement=changed(data.displacement))
    if data.temperature is not None:
        out = replace(out, temperature=changed(data.temperature))
    if "force" in shown[0]:
        out = replace(out, force=changed(data.force))
    return _stretched(out, joint, new, old) if study.force.drives == "force" else out


def _stretched(data: Measured, joint: Joint, new: History, old: History) -> Measured:
    """The data with the elongation that DIC saw changed as two runs under the same force say: should the sections drive the model later."""
    mesh = joint.run.body.mesh
    if data.gauge is not None:
        weights = nodal_gauge(mesh, data.gauge)
    else:
        y = mesh.nodes[:, 1]
        ends = [np.isclose(y, end).astype(float) for end in (y.max(), y.min())]
        weights = ends[0] / ends[0].sum() - ends[1] / ends[1].sum()
    longer = (new.u[:, :, 1] - old.u[:, :, 1]) @ weights
    longer -= longer[0]

    def at(time: np.ndarray) -> np.ndarray:
        return np.interp(time, new.time, longer)

    def stepped(steps: LoadSteps) -> LoadSteps:
        return steps if steps.elongation is None else replace(steps, elongation=steps.elongation + at(steps.time))

    seen = data.stretched
    moved = None if seen is None else replace(seen, elongation=seen.elongation + at(seen.time))
    return replace(data, stretched=moved, steps={name: stepped(steps) for name, steps in data.steps.items()})
