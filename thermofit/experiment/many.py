"""Several specimens under cameras in one fit: shared material parameters, every test with its own boundary and measurement parameters.

The own parameters of a test are called <param>@<test>. The residual of the joint fit is that of all tests, one after the other; every
test is modelled as if it were alone, with the parameters as they read for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.parameters import AT, Parameters
from thermofit.effects.catalogue import Effect, effect
from thermofit.experiment.body import BodyExperiment, UnseenBody, unseen_bodies
from thermofit.experiment.compiling import compiled
from thermofit.experiment.computed_motion import told_by_temperatures
from thermofit.experiment.discretisation import MESH, SHEET, STEPS
from thermofit.experiment.drive import SECTIONS, with_force_channel
from thermofit.experiment.fields import start_parameters
from thermofit.experiment.joint import Joint, JointParts, diagnosis_mesh, joint_free, joint_settings
from thermofit.experiment.joint_errors import told
from thermofit.experiment.known_effects import effects_of_data, effects_of_fields, load_turns
from thermofit.experiment.model import Prior, StageModel, needs_drive
from thermofit.experiment.prescribed import Moved, of_test
from thermofit.experiment.priors import effect_priors, pose_bounds
from thermofit.experiment.protocol import JointProblem, Kept, PlannedTest
from thermofit.experiment.residuals import Span
from thermofit.experiment.several import JointSeveral, free_in, joined, own_names, seen_by
from thermofit.experiment.stage_errors import StageErrors
from thermofit.experiment.verification import Checked, KnownErrors, together
from thermofit.records.artefact import Record
from thermofit.records.staging import as_one, named
from thermofit.study.section import MeshSize
from thermofit.study.stages import Stages, StageSettings
from thermofit.study.study import Study


@dataclass(frozen=True)
class SeveralExperiments:
    """All fitted experiments of a study. `given`: these, where they are not those of the artefacts."""

    study: Study
    given: tuple[BodyExperiment, ...] = ()
    name: str = ""
    held: tuple[UnseenBody, ...] | None = None
    """The held-out experiments, where they are not those of the artefacts."""

    @cached_property
    def tests(self) -> tuple[BodyExperiment, ...]:
        """The experiments, each as it reads for itself."""
        return self.given or tuple(BodyExperiment(self.study.one_of(name), name) for name in self.study.fitted)

    @property
    def fields(self) -> tuple[BodyExperiment, ...]:
        """All of them."""
        return self.tests

    @property
    def drive(self) -> str:
        """That of those which have turned to their sections, else the common one."""
        drives = {test.drive for test in self.tests}
        return SECTIONS if SECTIONS in drives else self.tests[0].drive

    @property
    def sections(self) -> str:
        """Those of each."""
        return "; ".join(f"{test.sections} of {test.name}" for test in self.tests if test.sections)

    @property
    def by_sections(self) -> SeveralExperiments | None:
        """All whose sections are known driven by them; None where none is."""
        turned = [test.by_sections for test in self.tests]
        if all(test is None for test in turned):
            return None
        return replace(self, given=tuple(new or old for new, old in zip(turned, self.tests, strict=True)))

    @property
    def near_maximum(self) -> str:
        """Of the first one near it."""
        return next((f"{test.name}: {why}" for test in self.tests if (why := test.near_maximum)), "")

    def again(self, start: Parameters) -> Iterator[tuple[str, Parameters]]:
        """What the first one that the force drives would try: the material is common."""
        first = next((test for test in self.tests if test.study.force.drives == "force"), None)
        if first is None:
            return
        here = seen_by(start, first.name).with_free(n for n in start.free if AT not in n)
        for words, other in first.again(here):
            yield words, start.replace(**{name: other[name] for name in here.free})

    @cached_property
    def own(self) -> frozenset[str]:
        """Names of the parameters that each has for itself."""
        return own_names(self.study)

    @property
    def spans(self) -> tuple[Span, ...]:
        """Phases of all experiments, each in the time of its own."""
        return tuple(span for test in self.tests for span in test.spans)

    @property
    def inputs(self) -> dict[str, Path]:
        """The artefacts of `interpolate`, by <stage>@<experiment>."""
        return {name: path for test in self.tests for name, path in test.inputs.items()}

    @cached_property
    def unseen(self) -> tuple[UnseenBody, ...]:
        """The declared held-out experiments."""
        if self.held is not None:
            return self.held
        return unseen_bodies(self.study)

    def compile(self) -> None:
        """The drivers of specimens and machine, side by side."""
        compiled()

    def no_use(self, stage: str) -> str:
        """Why a stage has nothing to do on any of them."""
        reasons = [test.no_use(stage) for test in self.tests]
        return reasons[0] if all(reasons) else ""

    @property
    def last_stage(self) -> str:
        """That of the first one."""
        return self.tests[0].last_stage

    @property
    def programmes(self) -> tuple[str, ...]:
        """Those of one test."""
        return self.tests[0].programmes

    @property
    def plan_inputs(self) -> dict[str, Path]:
        """Nothing measured."""
        return {}

    def planned(self, settings: StageSettings, programme: str) -> PlannedTest:
        """A test of the study itself: what the experiments have for themselves is left out."""
        return BodyExperiment(self.study).planned(settings, programme)

    @property
    def scalable(self) -> bool:
        """As each of them: they have the geometry of the study."""
        return self.tests[0].scalable

    def finer(self, size: MeshSize) -> MeshSize:
        """The finest of those of their specimens."""
        return max((test.finer(size) for test in self.tests), key=lambda mesh: mesh.n_y)

    def stage(self, key: str) -> tuple[StageSettings, Kept]:
        """Settings of the study, what each has for itself free in each."""
        settings, kept = self.study.stage(key), Kept()
        if all(test.data.displacement is None for test in self.tests):
            settings, kept = told_by_temperatures(self.study, settings, key)
        return settings.model_copy(update={"free": self.expanded(settings.free), **_ALONE.get(key, {})}), kept

    def earlier_estimates(self, key: str) -> Mapping[str, tuple[float, float]]:
        """None: a stage on fields tells what it frees."""
        return {}

    def expanded(self, free: Sequence[str]) -> tuple[str, ...]:
        """Free parameters of the joint fit: one for every experiment of those that each has for itself."""
        out: list[str] = []
        for name in free:
            out += [f"{name}{AT}{test.name}" for test in self.tests] if name in self.own else [name]
        return tuple(dict.fromkeys(out))

    def start(self) -> Parameters:
        """The common start values, and for every experiment its own where they differ."""
        values = dict(start_parameters(self.study, self.tests[0].data).values)
        for test in self.tests:
            here = test.start()
            values |= {f"{name}{AT}{test.name}": here[name] for name in self.own if here[name] != values.get(name, here[name])}
        return Parameters.of(values)

    def feasible(self, start: Parameters) -> tuple[Parameters, str]:
        """A start that can carry the measured force of every experiment."""
        said = []
        for test in self.tests:
            here = seen_by(start, test.name).with_free(n for n in start.free if AT not in n)
            found, remark = test.feasible(here)
            start = start.replace(**{name: found[name] for name in here.free})
            said += [named(test.name, remark)] if remark else []
        return start, as_one(said)

    def model(self, settings: StageSettings, base: Parameters, size: MeshSize) -> StageModel:
        """The models of all experiments as one; channels and fields are called du@first, u@first."""
        models = {}
        key = next(name for name, field in Stages.model_fields.items() if field.annotation is type(settings))
        for test in self.tests:
            own = getattr(test.study.stages, key)
            here = settings.model_copy(update={"free": tuple(free_in(settings.free, test.name).values()), "window": own.window})
            models[test.name] = test.model(here, seen_by(base, test.name).with_free(here.free), size)
        return joined(models)

    def seen_by(self, parameters: Parameters, test: str) -> Parameters:
        """The parameters as they read for one experiment, without names of any."""
        return seen_by(parameters, test)

    def spread(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values by the names of the joint fit: what each experiment has for itself gets the value in each."""
        return {full: value for name, value in values.items() for full in self.expanded([name])}

    def prescribed(self, quantity: str) -> float:
        """Every one has its own: none of the study."""
        raise self._several_of(quantity)

    def with_prescribed(self, quantity: str, value: float) -> SeveralExperiments:
        """As `prescribed`."""
        raise self._several_of(quantity)

    def _several_of(self, quantity: str) -> StudyError:
        return StudyError(
            f"{self.study.source.name}: key 'sensitivity.quantity' is {quantity}, which every experiment has for itself; expected a "
            "parameter or weight.<channel>"
        )

    def prescribed_errors(self, parameters: Parameters) -> dict[str, Moved]:
        """Those of each, independent of each other: every test has its own instruments and its own specimen."""
        found: dict[str, Moved] = {}
        for test in self.tests:
            here = seen_by(parameters, test.name).with_free(free_in(parameters.free, test.name).values())
            found |= of_test(test.prescribed_errors(here), test.name, self.own)
        return found

    def stage_errors(self, settings: StageSettings, parameters: Parameters, earlier: tuple[str, ...]) -> StageErrors:
        """Those of each in its own rows; mesh, steps and parameters that they share err alike in all."""
        key = next(name for name, field in Stages.model_fields.items() if field.annotation is type(settings))
        found: list[tuple[str, StageErrors]] = []
        for test in self.tests:
            acting_here = free_in((*settings.free, *earlier), test.name)
            free = tuple(acting_here[n] for n in settings.free if n in acting_here)
            here = settings.model_copy(update={"free": free, "window": getattr(test.study.stages, key).window})
            own = tuple(acting_here[n] for n in earlier if n in acting_here)
            told = test.stage_errors(here, seen_by(parameters, test.name).with_free(free), own)
            slopes = np.zeros((len(told.slopes), len(earlier)))
            slopes[:, [k for k, n in enumerate(earlier) if n in acting_here]] = told.slopes
            alike = {MESH, STEPS, SHEET, *(set(self.study.uncertainty.parameters) - self.own)}
            causes = {c if c in alike else f"{c}{AT}{test.name}": rows for c, rows in told.causes.items()}
            found.append((test.name, StageErrors(causes, slopes)))
        names = dict.fromkeys(c for _, told in found for c in told.causes)
        widths = {c: next(t.causes[c].shape[1] for _, t in found if c in t.causes) for c in names}
        causes = {c: np.concatenate([t.causes.get(c, np.zeros((len(t.slopes), widths[c]))) for _, t in found]) for c in names}
        return StageErrors(causes, np.concatenate([t.slopes for _, t in found]))

    def with_steps(self, parts: int) -> SeveralExperiments:
        """Those of each."""
        return replace(self, given=tuple(test.with_steps(parts) for test in self.tests))

    def planted(self, before: Parameters, after: Parameters) -> SeveralExperiments:
        """Those of each, by the parameters as they read for it; one that does not know the effect stays as it is."""
        found = []
        for test in self.tests:
            there = [seen_by(p, test.name) for p in (before, after)]
            found.append(test if there[0].values == there[1].values else replace(test.planted(*there), held=None))
        return replace(self, given=tuple(found), held=tuple(one.planted(before, after) for one in self.unseen))

    def joint_settings(self, free: Sequence[str] = ()) -> StageSettings:
        """Those of the first experiment, what each has for itself free in each."""
        own = free or self.study.diagnosis.free or joint_free(self.study, [test.data for test in self.tests])
        return joint_settings(self.study, self.expanded(own), self.tests[0].data)

    def _mesh(self) -> MeshSize:
        """One mesh for all tests, with the layers that the thickest needs."""
        return diagnosis_mesh(self.study, *(test.data.specimen for test in self.tests))

    def joint(self, settings: StageSettings, base: Parameters, size: MeshSize | None = None) -> JointProblem:
        """The joint problem of each as if it were alone, shared parameters common, one residual after the other."""
        size = size or self._mesh()
        return self._problem(settings, base, self._joint(settings, size), size)

    def diagnosed(self, base: Parameters, free: Sequence[str] = ()) -> JointProblem:
        """With the errors of every mesh and its steps at the optimum of the stages taken into the data."""
        settings, size = self.joint_settings(free), self._mesh()
        pose = self.poses()
        settings = settings.model_copy(update={"free": (*settings.free, *pose)})
        base, priors = base.with_free(settings.free), self._priors_of_each()
        plain = self._joint(settings, size)
        plain = JointSeveral({name: replace(part, beside=priors[name]) for name, part in plain.each.items()})
        found = told(plain, base)
        return replace(
            self._problem(settings, base, found.parts, size),
            plain=plain,
            errors=found,
            numerical=lambda _: found.left,
            largest_strain=found.largest_strain,
            told=pose,
        )

    def poses(self) -> dict[str, tuple[float, float]]:
        """Bounds of the pose of the infrared camera of every experiment, none of those that the study shares."""
        found: dict[str, tuple[float, float]] = {}
        for test in self.tests:
            each = pose_bounds(test.study, test.data.registration) if test.data.registration else {}
            found |= {f"{name}{AT}{test.name}": ends for name, ends in each.items() if name in self.own}
        return found

    def _joint(self, settings: StageSettings, size: MeshSize) -> JointSeveral:
        needs_drive(self.study, settings.channels)
        parts = {}
        for test in self.tests:
            own = joint_settings(test.study, tuple(free_in(settings.free, test.name).values()), test.data)
            parts[test.name] = Joint(test.study, test.data, with_force_channel(own) if test.turned else own, size)
        return JointSeveral(parts)

    def _problem(self, settings: StageSettings, base: Parameters, parts: JointParts, size: MeshSize) -> JointProblem:
        return JointProblem(
            settings=settings,
            base=base,
            model=parts.model,
            spans=self.spans,
            size=size,
            parts=parts,
            known=self.known(),
            correlation_length=max(test.data.correlation_length for test in self.tests),
        )

    def known(self) -> tuple[Effect, ...]:
        """Effects that they could show: those of the material once, those of boundary and measurement for every experiment on its own."""
        shown = {test.name: effects_of_data(test.data, self.study.yield_surface) for test in self.tests}
        out: list[Effect] = []
        for e in effects_of_fields(
            displacements=any(test.data.displacement is not None for test in self.tests),
            infrared=any(test.data.temperature is not None for test in self.tests),
            yields=self.study.yield_surface,
            turns=any(load_turns(test.data) for test in self.tests),
        ):
            if e.amplitude.name not in self.own:
                out.append(e)
                continue
            out += [effect(f"{e.name}{AT}{name}") for name, own in shown.items() if any(e.name == k.name for k in own)]
        return tuple(out)

    def _priors_of_each(self) -> dict[str, tuple[Prior, ...]]:
        """Priors of effects by experiment: each has those of its own readings, the first also those of the material, which count once."""
        out: dict[str, tuple[Prior, ...]] = {}
        for test in self.tests:
            every = effect_priors(self.study, test.data.registration)
            out[test.name] = tuple(p for p in every if not out or p.name in self.own or p.name in self.study.shared)
        return out

    def checked(
        self, parameters: Parameters, thermal: Record | None = None, word: str = "verified", known: KnownErrors | None = None
    ) -> Checked:
        """All experiments, channels and phases of each under its name."""
        found = {test.name: test.checked(seen_by(parameters, test.name), None, word) for test in self.tests}
        return together(found, word)


_ALONE = {"elastic": {"beside": ()}}
"""What of the settings of a stage is of one experiment alone: other measures of the displacement side by side."""
