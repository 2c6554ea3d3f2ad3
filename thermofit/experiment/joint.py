"""All stages at once: every free parameter, every channel, both fields coupled, and the instruments that look at them.

The stages of the identification fit one group of parameters after the other. What they leave is judged here with all of them together:
a parameter that an earlier stage froze still takes part, else its error would look like an effect that the model lacks. Readings of
thermocouples are data with an error (errata 13): their parameters are free, held by a prior.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from thermofit.body.solve.history import History
from thermofit.core.experiment import Specimen
from thermofit.core.parameters import Parameters
from thermofit.experiment.channels import FIELDS, comparisons_of, field_of
from thermofit.experiment.fields import LoadSteps, Measured, temperature_of
from thermofit.experiment.forward import MechanicalRun, Sampler, march_settings, run_of, sampler
from thermofit.experiment.held import AnyRun, LastRun, held_run
from thermofit.experiment.instruments import Instruments, JointPrediction, station_names
from thermofit.experiment.known_motion import Direction, acting_on_temperatures, along, freely_expanding, keeping_points
from thermofit.experiment.missing import MissingTerm
from thermofit.experiment.missing_body import BodyMissing
from thermofit.experiment.model import Prior, StageModel, steps_for
from thermofit.experiment.prediction import Errors
from thermofit.experiment.priors import THERMOCOUPLE, priors_of
from thermofit.experiment.shared_noise import Modes, shared
from thermofit.fit.linear_model import LinearModel
from thermofit.observe.comparison import Comparison
from thermofit.observe.observation import FieldObservation, ReadsFace, face_operator, smooth_operator
from thermofit.study.models import THERMOCOUPLES
from thermofit.study.section import MeshSize, mesh_size
from thermofit.study.stages import Channel, ChannelSettings, StageSettings
from thermofit.study.study import Study

__all__ = ["NUISANCES", "THERMOCOUPLE", "joint_free", "joint_settings", "station_names"]
NUISANCES = THERMOCOUPLES
FORCE_NOISE = "force noise"
"""Cause of uncertainty: what is left of the noise of the load cell in the smoothed force."""
KEPT = 3
"""Differentiated runs that are remembered."""
KeptLoads = OrderedDict[tuple[Any, ...], tuple[Mapping[str, LoadSteps], Errors, dict[str, np.ndarray]]]
"""By mesh, fields, parameters and names: the load steps, the fields that the instruments show, and their derivatives by the names."""


def joint_free(study: Study, data: Sequence[Measured]) -> tuple[str, ...]:
    """What the stages of a study identify on the data of its tests, each once, and the readings of thermocouples: a test that stays elastic
    tells no plasticity, without temperatures nothing tells the heat balance, and without displacements nothing tells the mechanics."""
    moved = [one for one in data if one.displacement is not None]
    flows = any(phase.label != "elastic" for one in moved for phase in one.phases)
    elastic, plastic = study.stages.elastic.free if moved else (), study.stages.plastic.free if flows else ()
    thermal = (*study.stages.thermal.free, *NUISANCES) if any(one.temperature is not None for one in data) else ()
    return tuple(dict.fromkeys((*elastic, *plastic, *thermal)))


def diagnosis_mesh(study: Study, *specimens: Specimen) -> MeshSize:
    """Mesh of the joint model of tests on these specimens: the one of section `diagnosis`, else that of the study, but not finer than the
    coarse preset. Of that it has as few layers as keep every element no thicker than it is wide.

    Beside what elements in the plane leave, whose error the joint model knows, a second layer adds a hundredth on a specimen 1.2 mm thick
    and 25 mm wide, a tenth as if it were at the limit of 4.1 mm, and a third as if it were 8 mm thick (`scripts/layers.py`)."""
    if study.diagnosis.mesh is not None:
        return mesh_size(study.diagnosis.mesh)
    size = coarse_mesh(study)
    if size != study.mesh_size.coarse:
        return size
    thick = max(int(np.ceil(size.n_x * one.thickness / one.gauge_width)) for one in specimens)
    return size.with_counts({"n_z": min(thick, size.n_z)})


def coarse_mesh(study: Study) -> MeshSize:
    """The mesh of the study, but not finer than the coarse preset; of a sheet a sheet."""
    own = study.mesh_size
    return own if own.elements <= own.coarse.elements else own.coarse


def joint_settings(study: Study, free: Sequence[str], data: Measured) -> StageSettings:
    """Settings of the joint stage: du where there are displacements, the force where it does not drive the model, dtheta where there are
    frames."""
    channels: dict[str, ChannelSettings] = {} if data.displacement is None else {"du": ChannelSettings()}
    if study.force.drives != "force":
        channels["force"] = ChannelSettings()
    if data.temperature is not None:
        channels["dtheta"] = ChannelSettings()
    if study.diagnosis.channels is not None:
        channels = {c: ChannelSettings() for c in study.diagnosis.channels}
    return StageSettings.model_construct(
        **{**study.stages.plastic.__dict__, "free": tuple(free), "channels": channels, "window": "all", "coupling": "full"}
    )


Known = tuple[Errors, Mapping[str, np.ndarray]]
"""Error fields of a joint problem and their derivatives, at some parameters."""


@dataclass(frozen=True)
class ForceModes:
    """Fields (n_t, n_s, n_c, k) that modes of the error of the prescribed force make, each of unit variance, and these modes (n_e, k) in
    those of the smoothed force."""

    fields: np.ndarray
    turned: np.ndarray


@dataclass(frozen=True)
class Joint:
    """The joint stage of a study on a mesh, whole and by the two fields that hardly act on each other."""

    study: Study
    data: Measured
    settings: StageSettings
    size: MeshSize
    force_error: Mapping[str, ForceModes] | None = None
    """What the error of the prescribed force makes of the fields "u" and "theta", or that of the elongation of "force" and "theta"; None:
    it is not known."""
    beside: tuple[Prior, ...] = ()
    """Priors of parameters that are not free, but may become so: those of effects that a diagnosis adds."""
    substeps: int = 1
    """Equal parts into which every load step is divided."""
    kept: KeptLoads = field(default_factory=OrderedDict, compare=False, repr=False)
    """What the last differentiated runs have shown, common to all problems that `replace` makes of this one: whether its data hold the
    error of the mesh, and whether that of the force is noise, changes no run."""

    @property
    def steps(self) -> LoadSteps:
        """The load steps through all that is observed."""
        return self._steps(self._observations(heat=True))

    @property
    def each(self) -> Mapping[str, Joint]:
        """Itself: a test that is alone has no name."""
        return {"": self}

    def rebuilt(self, each: Mapping[str, Joint]) -> Joint:
        """The one of `each`."""
        return each[""]

    def seen_by(self, parameters: Parameters, test: str) -> Parameters:
        """The parameters as they are."""
        return parameters

    def stacked(self, of: Mapping[str, np.ndarray]) -> np.ndarray:
        """Rows (n, ...) of the residual as they are."""
        return of[""]

    def sampler_of(self, name: str) -> Sampler:
        """The sampler of an observed field at the steps of the coupled run."""
        return self.prediction.instruments.samplers[name]

    @cached_property
    def run(self) -> MechanicalRun:
        """The coupled run through all times that are observed."""
        return self._run(self._observations(heat=True))

    @cached_property
    def prediction(self) -> JointPrediction:
        """All that is observed, by one coupled run."""
        return self._looking_at(LastRun(self.run, station_names()), self.run, self._observations(heat=True))

    @cached_property
    def model(self) -> StageModel:
        """StageModel of all channels."""
        whole = self._model(self.prediction, tuple(self.settings.channels))
        return replace(whole, missing=BodyMissing(self.prediction.instruments, self.run, {}), linearise=self._linearised_once)

    def _linearised_once(self, parameters: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
        """Error fields and their derivatives, not run again where they were asked for lately: by the fit that ends there, by the error of
        the force that is told there."""
        observed = self.prediction.instruments.observations
        key, steps = (self.size, self.substeps, tuple(observed), tuple(sorted(parameters.values.items())), names), self.data.steps
        if key not in self.kept or self.kept[key][0] is not steps:
            errors, slopes = self.prediction.linearise(parameters, names)
            self.kept[key] = steps, {name: errors[name] + o.value for name, o in observed.items()}, slopes
            while len(self.kept) > KEPT:
                self.kept.popitem(last=False)
        _, shown, slopes = self.kept[key]
        return {name: shown[name] - o.value for name, o in observed.items()}, slopes

    @cached_property
    def mechanics(self) -> StageModel | None:
        """StageModel of displacements and force alone, at their own times; None where neither is compared."""
        channels = tuple(c for c in self.settings.channels if FIELDS[c] != "theta")
        if not channels:
            return None
        observations = self._observations(heat=False)
        run = self._run(observations)
        return self._model(self._looking_at(run, run, observations), channels)

    def heat(self, parameters: Parameters) -> StageModel | None:
        """StageModel of the temperatures alone, on the motion of a run with given parameters; None where they are not compared."""
        channels = tuple(c for c in self.settings.channels if FIELDS[c] == "theta")
        if not channels:
            return None
        kept = keeping_points(self.run)
        history = kept(parameters)
        held = held_run(kept.body, history, kept.settings)
        prediction = self._looking_at(held, self.run, {"theta": temperature_of(self.data)})
        warm = self._given(self._model(prediction, channels), history, parameters)
        problem = freely_expanding(kept, history)

        def directed(there: Parameters, directions: Sequence[Direction]) -> np.ndarray:
            slopes = {"theta": along(prediction.instruments, problem, held(there), there, directions)}
            return warm.with_priors(warm.assemble_jacobian(prediction.errors(there), slopes), [name for name, _ in directions])

        return replace(warm, one_way=True, missing=BodyMissing(prediction.instruments, self.run, {}), directed=directed)

    def _given(self, warm: StageModel, history: History, parameters: Parameters) -> StageModel:
        """The model of the temperatures with what the displacements of a history tell of the error of the force, as in the whole model."""
        whole = self.model
        if not whole.common:
            return warm
        (common,) = whole.common
        errors = self.prediction.of(history, parameters)
        moved = {k: c.residual(errors[field_of(c)]) for k, c in enumerate(whole.comparisons) if field_of(c) != "theta"}
        places = {k: n for n, k in enumerate(k for k, c in enumerate(whole.comparisons) if field_of(c) == "theta")}
        given = common.given(common.told(moved), places)
        comparisons = tuple(given.without(new, whole.comparisons[old]) for old, new in places.items())
        return replace(warm, comparisons=comparisons, common=(given.rest,) if given.rest.shown else ())

    def shown(self, parameters: Parameters) -> tuple[History, Errors]:
        """A coupled run that keeps its points, and its error fields. NumericsError where it fails."""
        whole = keeping_points(self.run)
        history = whole(parameters)
        return history, self._looking_at(whole, whole, self._observations(heat=True)).of(history, parameters)

    def smoothed(self, history: History, parameters: Parameters) -> Errors:
        """Error fields of a history of the parameters, read off smoothly between the nodes of the mesh."""
        return self._looking_at(self.run, self.run, self._observations(heat=True), smooth_operator).of(history, parameters)

    def warmed_by(self, term: MissingTerm, history: History, parameters: Parameters, operator: ReadsFace = face_operator) -> np.ndarray:
        """What a term that heats adds to the temperatures (n_t, n_s, 1) on the motion of a history of the parameters, as an operator reads
        them off."""
        instruments = self._looking_at(self.run, self.run, self._observations(heat=True), operator).instruments
        missing = BodyMissing(instruments, self.run, {}).on(history, parameters)
        return np.asarray(term.shown(missing, parameters)["theta"][..., 0])

    def histories(self, parameters: Parameters) -> tuple[History, ...]:
        """The coupled run, with its points kept."""
        return (keeping_points(self.run)(parameters),)

    def scored(
        self, parameters: Parameters, names: tuple[str, ...], directions: Sequence[Direction]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residual (n,), its Jacobian (n, n_p) by named parameters, and its derivatives (n, n_d) along directions of the heat equation on
        the motion of the same run."""
        whole = keeping_points(self.run) if directions else self.run
        last = LastRun(whole, station_names())
        prediction = self._looking_at(last, self.run, self._observations(heat=True))
        residual, jacobian = replace(self.model, linearise=prediction.linearise).linearised(parameters, names)
        shapes = {name: o.value.shape for name, o in self.model.observations.items()}
        heated = {name: np.zeros((*shape, len(directions))) for name, shape in shapes.items()}
        if directions:
            history = last(parameters)
            heated["theta"] = along(prediction.instruments, freely_expanding(whole, history), history, parameters, directions)
        along_heat = self.model.assemble_jacobian(prediction.errors(parameters), heated)
        return residual, jacobian, self.model.with_priors(along_heat, [name for name, _ in directions])

    def _observations(self, *, heat: bool) -> dict[str, FieldObservation]:
        observations: dict[str, FieldObservation] = {} if self.data.displacement is None else {"u": self.data.displacement}
        if heat and self.data.temperature is not None:
            observations["theta"] = self.data.temperature
        if any(FIELDS[c] == "force" for c in self.settings.channels):
            observations["force"] = self._force()
        return observations

    def _force(self) -> FieldObservation:
        """The force that is compared: with its own noise where that of the elongation is known to be noise of all its values together."""
        force, seen = self.data.force, self.data.stretched
        if seen is None or seen.counted is None or "force" not in (self.force_error or {}):
            return force
        return replace(force, sigma=np.sqrt(force.sigma**2 - seen.counted[:, None, None] ** 2))

    def _steps(self, names: Iterable[str]) -> LoadSteps:
        return steps_for(self.data, set(names)).divided(self.substeps)

    def _run(self, observations: Mapping[str, FieldObservation]) -> MechanicalRun:
        return run_of(self.study, self.data, self.size, self._steps(observations), march_settings(self.study, "full"))

    def _looking_at(
        self, run: AnyRun, whole: MechanicalRun, observations: dict[str, FieldObservation], operator: ReadsFace = face_operator
    ) -> JointPrediction:
        """Instruments that look at a run, which goes through the steps of a whole one."""
        times = LoadSteps(whole.loading.time, whole.loading.value, np.zeros_like(whole.loading.time))
        samplers = {name: sampler(whole.body, o, times, operator) for name, o in observations.items()}
        return JointPrediction(Instruments(run, samplers, observations, self.data.theta_air))

    def _model(self, prediction: JointPrediction, channels: tuple[Channel, ...]) -> StageModel:
        """StageModel of some channels, with the priors of what takes part."""
        observations = prediction.instruments.observations
        own = self.settings.model_copy(update={"channels": {c: self.settings.channels[c] for c in channels}})
        comparisons = comparisons_of(own, observations, self.study, self.data)
        comparisons, common = shared(comparisons, self._modes(comparisons, observations))
        read = {"theta_air": self.data.theta_air, "theta_clamp": self.data.theta_clamp}
        priors = (*priors_of(self.study, {n: read[n] for n in NUISANCES if n in self.settings.free}), *self.beside)
        whole = StageModel(prediction.errors, comparisons, observations, "", False, prediction.linearise, priors=priors)
        return whole if common is None else replace(whole, common=(common,))

    @property
    def knows_force_error(self) -> bool:
        """Whether the error of the prescribed force is known."""
        return self.force_error is not None

    def without_force_error(self) -> Joint:
        """The same with a force that is taken as exact."""
        return replace(self, force_error=None)

    def force_misfit(self, parameters: Parameters, known: Mapping[str, Known] | None = None) -> float:
        """Mean square of what the residual shows of the modes of the force's error, over what their noise and that of the cameras would
        make: about one where the model is right; `known`: its fields at these parameters. NumericsError where the run fails.

        The residual is that after a joint step of the free parameters: where the force was taken as exact they follow its error. Where
        displacements show the error, or the force that of an elongation, they alone are asked: they tell most of it, and a heat that is
        missing is none of it.
        """
        model, shown = self.model, []
        names = parameters.free or self.settings.free
        residual, columns = model.linearised(parameters, names) if known is None else model.assembled(parameters, names, *known[""])
        ends = np.cumsum([c.n for c in model.comparisons])
        rows = {k: slice(ends[k] - c.n, ends[k]) for k, c in enumerate(model.comparisons)}
        telling = {place: one for common in model.common for place, one in common.shown.items()}
        moving = {place: one for place, one in telling.items() if field_of(model.comparisons[place]) != "theta"}
        seen, moved = np.ones(len(residual), dtype=bool), np.ones(len(names), dtype=bool)
        if moving:
            telling, warm = moving, acting_on_temperatures(names)
            seen[:], moved = False, np.array([n not in warm for n in names], dtype=bool)
            for place in moving:
                seen[rows[place]] = True
        left = np.zeros(len(residual))
        left[seen] = LinearModel(residual[seen], columns[np.ix_(seen, moved)]).left
        for place, one in telling.items():
            shown.append((one.basis.T @ left[rows[place]])[one.left > 1.0] ** 2)
        every = np.concatenate([*shown, np.zeros(0)])
        return float(every.mean()) if len(every) else 0.0

    def _modes(self, comparisons: Sequence[Comparison], observations: Mapping[str, FieldObservation]) -> dict[int, Modes]:
        """What every comparison shows of the error of what is prescribed, by its place: temperatures last, which tell least of it."""
        acting = {place: name for place, c in enumerate(comparisons) if (name := field_of(c)) in (self.force_error or {})}
        found = {}
        for place in sorted(acting, key=lambda p: acting[p] == "theta"):
            modes, right = (self.force_error or {})[acting[place]], np.zeros_like(observations[acting[place]].value)
            columns = [comparisons[place].slope(right, field) for field in np.moveaxis(modes.fields, 3, 0)]
            found[place] = Modes(np.stack(columns, axis=1), modes.turned)
        return found


class JointParts(Protocol):
    """A joint problem of bodies, whole and by the two fields that hardly act on each other: a `Joint`, or those of several tests."""

    @property
    def each(self) -> Mapping[str, Joint]:
        """The problems of the tests in it, by name."""

    def rebuilt(self, each: Mapping[str, Joint]) -> JointParts:
        """The same with other problems of the tests."""

    def seen_by(self, parameters: Parameters, test: str) -> Parameters:
        """The parameters, and the free ones, as they read for one test."""

    def stacked(self, of: Mapping[str, np.ndarray]) -> np.ndarray:
        """Rows (n, ...) of the residual from those of each test."""

    @property
    def model(self) -> StageModel:
        """StageModel of all channels."""

    @property
    def mechanics(self) -> StageModel | None:
        """StageModel of displacements and force alone; None where neither is compared."""

    def heat(self, parameters: Parameters) -> StageModel | None:
        """StageModel of the temperatures alone, on the motion of given parameters; None where they are not compared."""

    def histories(self, parameters: Parameters) -> tuple[History, ...]:
        """The coupled runs, with their points kept."""

    def scored(
        self, parameters: Parameters, names: tuple[str, ...], directions: Sequence[Direction]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residual (n,), its Jacobian (n, n_p) by named parameters, and its derivatives (n, n_d) along directions of the heat equation."""

    @property
    def knows_force_error(self) -> bool:
        """Whether the error of a prescribed force is known."""

    def without_force_error(self) -> JointParts:
        """The same with forces that are taken as exact."""

    def force_misfit(self, parameters: Parameters, known: Mapping[str, Known] | None = None) -> float:
        """Mean square of what the residual shows of the force's error, over its noise: about one where the model is right; `known`: fields
        of the tests at these parameters."""
