"""Records of coupons: every one a run of the point driver with a lumped heat balance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.effects.catalogue import Effect
from thermofit.effects.modulus_by_temperature import SPAN
from thermofit.experiment.channels import field_of
from thermofit.experiment.coupon_check import checked_records, record_spans
from thermofit.experiment.coupon_elastic import STRAIGHT, modulus_error
from thermofit.experiment.coupon_model import answerable, coupon_model, coupon_run, point_settings
from thermofit.experiment.coupon_records import CouponData, CouponTest, coupon_data, read_tests, whole
from thermofit.experiment.fields import INTERPOLATE, start_parameters
from thermofit.experiment.flow_conditions import elastic_temperatures, flow_conditions, known_temperature
from thermofit.experiment.known_effects import effects_of_point
from thermofit.experiment.model import StageModel
from thermofit.experiment.prescribed import Moved, acting, columns, not_told, of_records
from thermofit.experiment.priors import effect_priors
from thermofit.experiment.programmes import OWN
from thermofit.experiment.protocol import Carried, JointProblem, Kept, PlannedTest
from thermofit.experiment.residuals import Span
from thermofit.experiment.stage_errors import StageErrors
from thermofit.experiment.verification import Checked, KnownErrors
from thermofit.fit.linear_model import LinearModel
from thermofit.point.driver import PointHistory, simulate
from thermofit.point.programmes import NAMES, Usual, programme
from thermofit.read.coupon import coupon_files
from thermofit.records.artefact import Record, open_record
from thermofit.records.staging import artefact_path
from thermofit.study.models import FROM_EXPERIMENT
from thermofit.study.section import MeshSize
from thermofit.study.stages import ChannelSettings, StageSettings
from thermofit.study.study import Study

POINT = MeshSize(n_x=1, n_y=1, n_z=1)
"""What stands for the mesh of a point."""
IDENTIFY_ELASTIC = "identify-elastic"
"""The stage whose record tells the elastic constants."""
KNOWN = 0.05
"""Standard error of an elastic constant over its value from which the joint fit leaves it as it is."""


@dataclass(frozen=True)
class CouponExperiment:
    """All records of a study that are fitted, or those that are held out. `given`: what was measured, where it is not that of the
    artefact."""

    study: Study
    held_out: bool = False
    given: CouponData | None = None
    name: str = ""
    held: tuple[UnseenRecords, ...] | None = None
    """The records that are held out, where they are not those of the artefact."""

    @cached_property
    def data(self) -> CouponData:
        """What was measured. StudyError that names the command where it has not been interpolated."""
        return coupon_data(self.study, held_out=self.held_out) if self.given is None else self.given

    @property
    def hot(self) -> bool:
        """True where a record holds a temperature."""
        return any(test.theta is not None for test in self.data.tests)

    @property
    def spans(self) -> tuple[Span, ...]:
        """Phases of all records on their common time axis."""
        return record_spans(self.data)

    @property
    def inputs(self) -> dict[str, Path]:
        """The artefact of `interpolate`."""
        return {INTERPOLATE: artefact_path(self.study.run_dir, INTERPOLATE)}

    @property
    def fields(self) -> tuple[()]:
        """None: there is no camera."""
        return ()

    @property
    def tests(self) -> tuple[CouponExperiment, ...]:
        """All records are checked together."""
        return (self,)

    @cached_property
    def unseen(self) -> tuple[UnseenRecords, ...]:
        """The records that are held out, all together; nothing where there are none."""
        if self.held is not None:
            return self.held
        if not self.study.coupon_section.held_out:
            return ()
        return (UnseenRecords(CouponExperiment(self.study, held_out=True)),)

    def compile(self) -> None:
        """One driver is compiled when it is called."""

    def no_use(self, stage: str) -> str:
        """Why a stage has nothing to do: nothing to simulate, no camera, no temperature."""
        if stage in ("simulate", "calibrate-ir"):
            return "the experiment is a record of coupons"
        if stage == "refine":
            return "what a law lacks in the plastic range would draw E off, which the elastic range alone tells; the rest is fitted at once"
        if stage == "identify-thermal" and not any(record.temperature for record in self.study.records):
            return "no record holds a temperature"
        return ""

    @property
    def last_stage(self) -> str:
        """The plastic one: few records hold a temperature."""
        return "plastic"

    @property
    def programmes(self) -> tuple[str, ...]:
        """Those of the records themselves, and those made by name."""
        return (OWN,) if self.study.coupon_section.rows else (OWN, *NAMES)

    @property
    def plan_inputs(self) -> dict[str, Path]:
        """The files of the records: their noise, strains and durations are those of a plan."""
        return record_files(self.study)

    def planned(self, settings: StageSettings, programme: str) -> PlannedTest:
        """The records as the assumed material would give them, or one test under a programme by name.

        Of the records only what a laboratory knows beforehand is used: noise, largest strain, duration, temperatures, whether there is a
        sensor. The measured response is not.
        """
        records = records_of(self.study)
        assumed = start_parameters(self.study, records).with_free(settings.free)
        data = planned_records(self.study, records, programme, assumed)
        words = f"{len(data.tests)} planned records, {data.tests[0].time[-1]:.4g} s"
        return PlannedTest(replace(self, given=data), assumed, None, words)

    @property
    def scalable(self) -> bool:
        """A point has no mesh."""
        return False

    def finer(self, size: MeshSize) -> MeshSize:
        """The same: a point has none."""
        return size

    def stage(self, key: str) -> tuple[StageSettings, Kept]:
        """Settings without the elastic constants where no record has an elastic range that tells them, and these."""
        settings, names = answerable(self.study.stage(key), self.data)
        why = "no record begins with an elastic range (a straight line from rest through five samples)"
        kept = Kept(names, why, "give what is known, or the window as [t0, t1] in s") if names else Kept()
        return settings.model_copy(update={"beside": ()}) if key == "elastic" else settings, kept

    def earlier_estimates(self, key: str) -> Mapping[str, tuple[float, float]]:
        """nu for a plastic stage that compares the strain across the load, within what the elastic one has told.

        Held, its error would be one of all samples of the flow: 0.2 % of nu, the error of twenty samples below half of the proof stress, is
        the noise of the strain across at the largest stress.
        """
        path = artefact_path(self.study.run_dir, IDENTIFY_ELASTIC)
        settings = self.study.stage(key)
        if key != "plastic" or "lateral" not in settings.channels or "nu" in settings.free or not path.exists():
            return {}
        nu = open_record(path).parameters.get("nu")
        if nu is None or not nu.free or nu.sigma is None:
            return {}
        return {"nu": _about(nu.value, nu.sigma / nu.value, (nu.lower, nu.upper))}

    def start(self) -> Parameters:
        """Start values; the air is that of the first record where the study gives none."""
        return start_parameters(self.study, self.data)

    @property
    def drive(self) -> str:
        """What of its records drives it."""
        return self.study.coupon_section.control

    @property
    def sections(self) -> str:
        """None: a point has no places."""
        return ""

    @property
    def by_sections(self) -> None:
        """None: see `sections`."""
        return None

    @property
    def near_maximum(self) -> str:
        """Nothing is said of it."""
        return ""

    def again(self, start: Parameters) -> Iterator[tuple[str, Parameters]]:
        """None: there is one mesh of one point."""
        return iter(())

    def feasible(self, start: Parameters) -> tuple[Parameters, str]:
        """The given start: a record can always be followed."""
        return start, ""

    def model(self, settings: StageSettings, base: Parameters, size: MeshSize) -> StageModel:
        """One run of the point driver for every record."""
        return coupon_model(self.study, self.data, settings, base)

    def seen_by(self, parameters: Parameters, test: str) -> Parameters:
        """The parameters as they are."""
        return parameters

    def spread(self, values: Mapping[str, float]) -> dict[str, float]:
        """The values as they are."""
        return dict(values)

    def prescribed(self, quantity: str) -> float:
        """There is neither a thickness nor a camera."""
        raise self._without(quantity)

    def with_prescribed(self, quantity: str, value: float) -> CouponExperiment:
        """As `prescribed`."""
        raise self._without(quantity)

    def _without(self, quantity: str) -> StudyError:
        return StudyError(
            f"{self.study.source.name}: key 'sensitivity.quantity' is {quantity}, which records of coupons do not have; expected a "
            "parameter or weight.<channel>"
        )

    def prescribed_errors(self, parameters: Parameters) -> dict[str, Moved]:
        """Calibration of the force."""
        return of_records(self.study, parameters)

    def stage_errors(self, settings: StageSettings, parameters: Parameters, earlier: tuple[str, ...]) -> StageErrors:
        """By derivatives of the point driver; its steps are those of the samples."""
        prescribed = not_told(self.prescribed_errors(parameters), earlier)
        names = tuple(dict.fromkeys((*earlier, *acting(prescribed))))
        asked = settings.model_copy(update={"free": (*settings.free, *(n for n in names if n not in settings.free))})
        model = self.model(asked, parameters, POINT)
        slopes = model.linearised(parameters, names)[1] if names else np.zeros((sum(c.n for c in model.comparisons), 0))
        return StageErrors(columns(prescribed, names, slopes), slopes[:, [names.index(n) for n in earlier]])

    def with_steps(self, parts: int) -> CouponExperiment:
        """Every step between two samples in parts."""
        numerics = self.study.numerics
        cut = numerics.model_copy(update={"steps_per_interval": parts * numerics.steps_per_interval})
        return replace(self, study=self.study.model_copy(update={"numerics": cut}), given=self.data)

    def planted(self, before: Parameters, after: Parameters) -> CouponExperiment:
        """Record by record, by the point driver."""
        run = coupon_run(self.study, self.data, before.free)
        data = replace(self.data, tests=tuple(run.planted(test, before, after) for test in self.data.tests))
        return replace(self, given=data, held=tuple(one.planted(before, after) for one in self.unseen))

    def joint_settings(self, free: Sequence[str] = ()) -> StageSettings:
        """All that the stages identify, on all that they compare; with temperatures, the air's too, held by a prior."""
        study = self.study
        own = [answerable(study.stage(key), self.data)[0] for key in ("elastic", "plastic", *(("thermal",) if self.hot else ()))]
        wanted = study.diagnosis.channels or tuple(dict.fromkeys(c for s in own for c in s.channels))
        nuisances = tuple(name for name in ("theta_air",) if {"theta", "dtheta"} & set(wanted) and name not in study.parameters)
        names = free or study.diagnosis.free or (*(name for s in own for name in s.free), *nuisances)
        channels = {c: ChannelSettings() for c in wanted}
        common = {"free": tuple(dict.fromkeys(names)), "channels": channels, "window": "all", "coupling": "full"}
        return StageSettings.model_construct(**{**own[1].__dict__, **common})

    def widened(self, base: Parameters) -> StageSettings:
        """Settings of the joint fit with the elastic constants that no elastic range told the first stage free where all of the data
        together do: unloadings and reverse flow tell E as well. A start is no prescription."""
        study, data, settings = self.study, self.data, self.joint_settings()
        kept = tuple(n for n in answerable(study.stage("elastic"), data)[1] if n not in settings.free)
        if not kept or study.diagnosis.free is not None:
            return settings
        wider = settings.model_copy(update={"free": (*kept, *settings.free)})
        residual, columns = coupon_model(study, data, wider, base).linearised(base, wider.free)
        size = max(float(np.mean(LinearModel(residual, columns).left ** 2)), 1.0) ** 0.5  # what a joint step leaves
        told = []
        for k, name in enumerate(kept):
            own = LinearModel(columns[:, k], np.delete(columns, k, axis=1)).left
            if size < KNOWN * base[name] * float(np.linalg.norm(own)):
                told.append(name)
        return settings.model_copy(update={"free": (*told, *settings.free)})

    def joint(self, settings: StageSettings, base: Parameters, size: MeshSize | None = None) -> JointProblem:
        """All records, whole."""
        model = coupon_model(self.study, self.data, settings, base)
        return JointProblem(settings=settings, base=base, model=model, spans=self.spans, size=POINT)

    def diagnosed(self, base: Parameters, free: Sequence[str] = ()) -> JointProblem:
        """With the error of the steps, which is of first order: half the steps differ by half of it."""
        study, data, settings = self.study, self.data, self.joint_settings(free) if free else self.widened(base)
        model, finer = (coupon_model(of, data, settings, base, effect_priors(study)) for of in (study, self.with_steps(2).study))
        run = coupon_run(study, data, settings.free)
        return JointProblem(
            settings=settings,
            base=base.with_free(settings.free),
            model=model,
            spans=self.spans,
            size=POINT,
            known=effects_of_point(
                sensor=self.hot and "dtheta" in settings.channels, row=any(test.section is not None for test in data.tests)
            ),
            numerical=lambda parameters: 2.0 * (model.residual(parameters) - finer.residual(parameters)),
            largest_strain=max(float(run.history(base, test).accumulated.max()) for test in data.tests),
            flow=flow_conditions(data.tests, lambda test: run.history(base, test)),
            told=self.told(base),
        )

    def told(self, base: Parameters) -> dict[str, tuple[float, float]]:
        """Within which bounds the elastic ranges of the records have told E, where that stage has identified it from their straight lines.

        What is missing of a flow curve draws E off, for its samples are the many: a fast backstress on a low yield stress makes the same
        first slope with another E. In the elastic range the model misses nothing, so that E stays within three of its standard errors
        there, or within what microplasticity and the choice of the range make of a slope (STRAIGHT). Ranges at temperatures as far apart as
        a modulus that falls with temperature needs to be told (SPAN of that effect) tell a modulus each.
        """
        study, stage = self.study, self.study.stage("elastic")
        error = modulus_error([line for test in self.data.tests if (line := test.line) is not None])
        if "E" not in stage.free or stage.window != "auto" or study.diagnosis.free is not None or error > KNOWN:
            return {}
        theta = [t for test in self.data.tests for t in elastic_temperatures(test, known_temperature(test), False)]
        if theta and max(theta) - min(theta) > SPAN:
            return {}
        return {"E": _about(base["E"], error, study.bounds("E"))}

    def checked(
        self, parameters: Parameters, thermal: Record | None = None, word: str = "verified", known: KnownErrors | None = None
    ) -> Checked:
        """Every record by the point driver."""
        return checked_records(self.study, self.data, parameters, word)


def _about(value: float, error: float, bounds: tuple[float, float]) -> tuple[float, float]:
    """Three relative standard errors about an elastic constant, STRAIGHT at least, within its bounds."""
    part = max(3.0 * error, STRAIGHT)
    return max(bounds[0], (1.0 - part) * value), min(bounds[1], (1.0 + part) * value)


def record_files(study: Study) -> dict[str, Path]:
    """Files of all records of a study, by number."""
    return {f"record {n}": path for n, path in enumerate(coupon_files(study.coupon_section, study.source.parent))}


@dataclass(frozen=True)
class UnseenRecords:
    """Held-out records of coupons: every one has its own air, all share everything else with those that are fitted."""

    experiment: CouponExperiment

    @property
    def label(self) -> str:
        """Their names."""
        names = list(dict.fromkeys(test.group for test in self.experiment.data.tests))
        return f"{'record' if len(names) == 1 else 'records'} {', '.join(names)}"

    @property
    def fit_own(self) -> tuple[str, ...]:
        """They have no parameters of their own."""
        return ()

    @property
    def by_sections(self) -> None:
        """They have none."""

    def predicted(self, found: Parameters, identified: Sequence[str]) -> Parameters:
        """The fitted parameters."""
        return found

    def taken(self, found: Parameters, identified: Sequence[str]) -> tuple[str, ...]:
        """Nothing that would be their own."""
        return ()

    def carried(self, free: Sequence[str], identified: Sequence[str]) -> Carried:
        """All but the temperatures that each has measured for itself."""
        there = tuple(n for n in free if n not in FROM_EXPERIMENT)
        return there, np.array([[float(n == f) for f in free] for n in there]).reshape(len(there), len(free))

    def problem(self, settings: StageSettings, base: Parameters, known: Sequence[Effect]) -> JointProblem:
        """The channels of the fit that they hold, each record with the air that was measured beside it."""
        data, free = self.experiment.data, tuple(n for n in settings.free if n != "theta_air")
        held = {"lateral": any(t.lateral is not None for t in data.tests), "theta": self.experiment.hot}
        channels = {c: own for c, own in settings.channels.items() if held.get(field_of(c), True)}
        own = settings.model_copy(update={"free": free, "channels": channels})
        return replace(self.experiment.joint(own, base), known=tuple(known))

    def corrected(self, problem: JointProblem, parameters: Parameters) -> JointProblem:
        """Steps of the records are those of their samples."""
        return problem

    def planted(self, before: Parameters, after: Parameters) -> UnseenRecords:
        """The same with what an effect changes of them (`Experiment.planted`): all records share it."""
        return replace(self, experiment=self.experiment.planted(before, after))

    def judges(self, known: Sequence[Effect]) -> frozenset[str]:
        """All of them."""
        return frozenset(e.name for e in known)


def records_of(study: Study) -> CouponData:
    """The records of a study, from `interpolate` where it has run, else from their files. DataError where these cannot be read."""
    if artefact_path(study.run_dir, INTERPOLATE).exists():
        return coupon_data(study)
    return CouponData(tuple(test for test, _ in read_tests(study)), study.coupon_section.control)


def planned_records(study: Study, records: CouponData, name: str, assumed: Parameters) -> CouponData:
    """The records as the assumed material would give them: under their own programmes, or one test under the programme of that name.

    StudyError for an unknown name; NumericsError where the coupon cannot be driven so.
    """
    run = coupon_run(study, records, assumed.free)
    if name == OWN:
        return replace(records, tests=tuple(_answered(test, run.history(assumed, test)) for test in records.tests))
    first = records.tests[0]
    parameters = run.parameters_of(assumed, first)
    driven = programme(name, _usual(records), parameters, point_settings(study))
    history = simulate(parameters, driven, point_settings(study))
    start = first.theta_start if driven.theta_start is None else driven.theta_start
    test = replace(first, name=name, time=history.time, theta_start=start, phases=whole(history.time))
    return replace(records, tests=(_answered(test, history),))


def _usual(records: CouponData) -> Usual:
    """Largest strain over all records, and their median rate towards it."""
    peaks = np.array([float(np.max(np.abs(test.strain))) for test in records.tests])
    paths = np.array([float(np.sum(np.abs(np.diff(test.strain)))) / float(np.ptp(test.time)) for test in records.tests])
    return Usual(float(peaks.max()), float(np.median(paths)), records.tests[0].theta_start)


def _answered(test: CouponTest, history: PointHistory) -> CouponTest:
    """The record with the response of a history instead of its own."""
    theta = None if test.theta is None else history.theta_sensor
    lateral = None if test.lateral is None else history.lateral_x
    return replace(test, strain=history.strain, stress=history.stress, theta=theta, lateral=lateral, first_loading=None)
