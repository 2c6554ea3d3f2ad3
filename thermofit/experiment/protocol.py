"""One test, whatever drives the law: what was measured, how it is predicted, what can be asked of it.

The rooms above ask an `Experiment` and never which form it has: a specimen under cameras (`body`), records of coupons (`coupon`), or
several specimens that share their material (`many`). `forms.experiment_of` makes it from a study. Nothing is read before it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.effects.catalogue import Effect
from thermofit.experiment.fields import Measured
from thermofit.experiment.flow_conditions import FlowConditions
from thermofit.experiment.joint import JointParts
from thermofit.experiment.joint_errors import JointWithErrors
from thermofit.experiment.model import StageModel
from thermofit.experiment.prescribed import Moved
from thermofit.experiment.residuals import Span
from thermofit.experiment.stage_errors import StageErrors
from thermofit.experiment.verification import Checked, KnownErrors
from thermofit.records.artefact import Record
from thermofit.study.section import MeshSize
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study


@dataclass(frozen=True)
class Kept:
    """Parameters that a stage leaves as the study gives them, `why` no datum tells them, and what the user may do about it (`mend`)."""

    names: tuple[str, ...] = ()
    why: str = ""
    mend: str = ""


Carried = tuple[tuple[str, ...], np.ndarray]
"""Names of parameters in a held-out test, and weights (n_there, n_fitted) with which the fitted ones make them."""


@dataclass(frozen=True)
class JointProblem:
    """The joint fit of all channels of an experiment, before it is made: settings, start (`free` names the fitted parameters) and model.

    `spans`: phases in the time of the model. `size`: the mesh. `parts`: where displacements and temperatures can be fitted on their own;
    None where there is nothing to gain. What follows is known of a problem that is to be diagnosed only.
    """

    settings: StageSettings
    base: Parameters
    model: StageModel
    spans: tuple[Span, ...]
    size: MeshSize
    parts: JointParts | None = None
    known: tuple[Effect, ...] = ()
    """Effects that the experiment could show."""
    numerical: Callable[[Parameters], np.ndarray] | None = None
    """Error (n,) of the discretisation that is left in the residual at given parameters; None: it is not known."""
    largest_strain: float = 0.1
    """Largest Lambda of the test."""
    plain: JointParts | None = None
    """The same before errors of mesh and prescribed force were told; None where there are none to tell."""
    errors: JointWithErrors | None = None
    """These errors, told at `base`."""
    flow: FlowConditions | None = None
    """At which rates and temperatures the material flows; None where that varies over the specimen."""
    correlation_length: float = 0.0
    """Distance in mm over which the noise of neighbouring points hangs together; 0: it is not known, or there is one point."""
    told: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Lower and upper end within which an earlier stage, or the calibration of a camera, has told parameters: what is missing does not draw
    them farther off."""

    @property
    def each(self) -> Mapping[str, StageModel]:
        """Models of the tests in it by name; that of a test which is alone has no name."""
        return {"": self.model} if self.parts is None else {name: part.model for name, part in self.parts.each.items()}


@dataclass(frozen=True)
class PlannedMotion:
    """Rigid-body motion of a planned test: what it adds to displacements (n_t, n_s, 2) mm at times (n_t,) s."""

    time: np.ndarray
    added: np.ndarray


@dataclass(frozen=True)
class PlannedTest:
    """A test that is only planned, as if it had been measured: parameters of the assumed material, the motion that its machine would add
    (None: it moves nothing), and in words how long it takes."""

    experiment: Experiment
    assumed: Parameters
    motion: PlannedMotion | None
    words: str


class FieldTest(Protocol):
    """One specimen under cameras."""

    @property
    def name(self) -> str:
        """Name among several; empty: it is alone."""
        ...

    @property
    def study(self) -> Study:
        """The study as it reads for this test."""
        ...

    @property
    def data(self) -> Measured:
        """What was measured."""
        ...


class UnseenTest(Protocol):
    """A test that no fit sees, and how fitted parameters predict it."""

    @property
    def experiment(self) -> Experiment:
        """What was measured."""

    @property
    def label(self) -> str:
        """What it is called in words: "experiment second", "record a"."""

    @property
    def fit_own(self) -> tuple[str, ...]:
        """Its own parameters that are fitted on its own data before it is predicted."""

    @property
    def by_sections(self) -> UnseenTest | None:
        """The same driven by the motion of its sections, with the force as a channel; None where that cannot be."""

    def predicted(self, found: Parameters, identified: Sequence[str]) -> Parameters:
        """Parameters that predict it from fitted ones, of which the names are `identified`."""

    def taken(self, found: Parameters, identified: Sequence[str]) -> tuple[str, ...]:
        """In words which of its own parameters are taken from the fitted tests."""

    def carried(self, free: Sequence[str], identified: Sequence[str]) -> Carried:
        """How fitted parameters `free` make those there."""

    def problem(self, settings: StageSettings, base: Parameters, known: Sequence[Effect]) -> JointProblem:
        """Its joint problem beside a fit with these settings, whose tests could show the `known` effects; `base`: parameters that predict
        it."""

    def corrected(self, problem: JointProblem, parameters: Parameters) -> JointProblem:
        """The same that knows the errors of its mesh and force at given parameters. NumericsError where a run fails."""

    def planted(self, before: Parameters, after: Parameters) -> UnseenTest:
        """The same with what an effect changes of it (`Experiment.planted`), where the effect is one of all tests; `before` and `after` are
        parameters of the fit."""

    def judges(self, known: Sequence[Effect]) -> frozenset[str]:
        """Names of the effects that it can speak of: those that all tests share."""


class Experiment(Protocol):
    """All that a study fits: one test, or several that share their material.

    StudyError where an artefact of `interpolate` is missing (names the command), DataError for data that are wrong.
    """

    @property
    def name(self) -> str:
        """Name among several experiments; empty where it is alone."""

    @property
    def study(self) -> Study:
        """The study as it reads for it."""

    @property
    def spans(self) -> tuple[Span, ...]:
        """Phases of the test, or of all tests and records in it, in the time of the joint model, s."""

    @property
    def inputs(self) -> dict[str, Path]:
        """Artefacts of `interpolate` that a fit reads, by name."""

    @property
    def fields(self) -> Sequence[FieldTest]:
        """The specimens under cameras; empty where only records of coupons were measured."""

    @property
    def tests(self) -> Sequence[Experiment]:
        """The tests that are checked, and reported, one by one."""

    @property
    def unseen(self) -> Sequence[UnseenTest]:
        """Tests that are held out."""

    # Before anything is measured

    def no_use(self, stage: str) -> str:
        """Why a stage of the chain has nothing to do here; empty where it has."""

    def compile(self) -> None:
        """Compile the kernels of its runs where that is worth doing at once; otherwise they are compiled when they are called."""

    @property
    def last_stage(self) -> str:
        """Key of the stage that is analysed where none is named."""

    @property
    def programmes(self) -> tuple[str, ...]:
        """Names of the tests that can be planned: the study's own, and those made by name."""

    @property
    def plan_inputs(self) -> dict[str, Path]:
        """Measured files on which a plan rests, by name."""

    def planned(self, settings: StageSettings, programme: str) -> PlannedTest:
        """The test of that programme. StudyError where the study plans none or the name is unknown; NumericsError where it cannot be
        carried out."""

    # One stage

    @property
    def scalable(self) -> bool:
        """True where a coarser mesh can be made of it, whose optimum is a good start."""

    def finer(self, size: MeshSize) -> MeshSize:
        """The mesh that tells the error of one of that size, finer in the jaws too; asked where `scalable`."""

    def stage(self, key: str) -> tuple[StageSettings, Kept]:
        """Settings of an identification stage on these data, and what it leaves as the study gives it because no datum tells it."""

    def earlier_estimates(self, key: str) -> Mapping[str, tuple[float, float]]:
        """Parameters that an earlier stage has told and this stage of that key tells again, and within which bounds."""

    def start(self) -> Parameters:
        """Start values; temperatures of air and jaws in K are the measured ones where the study gives none."""

    def feasible(self, start: Parameters) -> tuple[Parameters, str]:
        """A start that can carry the measured force, and a remark where it is not the given one. NumericsError where there is none."""

    def again(self, start: Parameters) -> Iterator[tuple[str, Parameters]]:
        """Other starts in turn for a mesh on which the model fails at the given one, each with what it is in words."""

    # What drives it

    @property
    def drive(self) -> str:
        """What drives it: force, sections, crosshead, dic; of records strain or stress."""

    @property
    def sections(self) -> str:
        """The sections whose motion could drive it, or does, in words; empty where none is known."""

    @property
    def by_sections(self) -> Experiment | None:
        """The same driven by the motion of sections that DIC saw, with the force as a channel; None where the force does not drive it, or
        no such motion is known."""

    @property
    def near_maximum(self) -> str:
        """Why the force says too little about the strain at the end of the test to drive it, in words; empty where it may."""

    def model(self, settings: StageSettings, base: Parameters, size: MeshSize) -> StageModel:
        """StageModel of a stage within its window, on a mesh (where it has one); `base`: the parameters to start from."""

    def seen_by(self, parameters: Parameters, test: str) -> Parameters:
        """The parameters as they read for the test of that name."""

    def spread(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values by the names of the fit: what each test has for itself gets the value in each."""

    def prescribed(self, quantity: str) -> float:
        """The value of a quantity that is measured and no parameter: thickness mm, clock of the camera s. StudyError where it has none."""

    def with_prescribed(self, quantity: str, value: float) -> Experiment:
        """The same with another value of it. StudyError as `prescribed`."""

    def prescribed_errors(self, parameters: Parameters) -> Mapping[str, Moved]:
        """By how much one standard error of everything that it prescribes moves parameters that stand for it, by cause; not what is free in
        the fit (`parameters.free`)."""

    def stage_errors(self, settings: StageSettings, parameters: Parameters, earlier: tuple[str, ...]) -> StageErrors:
        """What one standard error of everything that a stage takes for exact makes of its residual, and its derivatives by parameters that
        earlier stages told. NumericsError where a run fails."""

    def with_steps(self, parts: int) -> Experiment:
        """The same with every step in time cut into so many equal ones."""

    def planted(self, before: Parameters, after: Parameters) -> Experiment:
        """The same test as if it held an effect: what the model predicts with parameters `after` less what it predicts with `before` is
        added to everything that was measured and does not drive it, in mm, K, N or MPa; noise, scatter and what else the data hold stay as
        they are. Held-out tests are changed alike. Equal parameters leave it as it is. NumericsError where a run fails."""

    # All channels at once

    def joint_settings(self, free: Sequence[str] = ()) -> StageSettings:
        """Settings of the joint fit: all channels over the whole test; `free`: names that are fitted, empty: all that the stages identify,
        and readings of thermocouples, held by their priors."""

    def joint(self, settings: StageSettings, base: Parameters, size: MeshSize | None = None) -> JointProblem:
        """The joint problem with the data as they are; None: on the mesh of a diagnosis."""

    def diagnosed(self, base: Parameters, free: Sequence[str] = ()) -> JointProblem:
        """The joint problem that is to be diagnosed: declared readings as priors, with the errors of mesh, steps and prescribed force told
        at `base`, and what it could show besides; `free` as in `joint_settings`. NumericsError where a run fails."""

    # With given parameters

    def checked(
        self, parameters: Parameters, thermal: Record | None = None, word: str = "verified", known: KnownErrors | None = None
    ) -> Checked:
        """The prediction with given parameters beside all data of one test; `thermal`: record of the thermal stage, of which the one-way
        coupling is told; `word` is the verdict; `known`: what is known to be wrong with the prediction, which is taken off.
        NumericsError where the model cannot follow the test."""
