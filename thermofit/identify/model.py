"""The residual of a stage: forward model, observations and weights put together (2.24)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.core.study import Study
from thermofit.core.study_section import MeshSize
from thermofit.core.study_stages import ChannelSettings, StageSettings
from thermofit.identify.forward import march_settings, run_of, sampler
from thermofit.identify.held import AnyRun, LastRun, held_run, thermal_names
from thermofit.identify.inputs import LoadSteps, Measured, temperature_of
from thermofit.identify.instruments import Instruments, JointPrediction, looks_through_effects, station_names
from thermofit.identify.prediction import Errors, Linearise, PlainPrediction
from thermofit.measure.comparison import Comparison, RelativeScheme, Weight, plain, relative_displacements, temperature_change
from thermofit.measure.observation import FieldObservation

MECHANICAL_CHANNELS = ("u", "du")


@dataclass(frozen=True)
class Prior:
    """What is known of a parameter before the test: value and standard error."""

    name: str
    value: float
    sigma: float


@dataclass(frozen=True)
class StageModel:
    """What a stage minimises: error fields of given parameters, and the comparisons that make the residual of them.

    `one_way`: the mechanics in it was solved once, for the parameters that the model was made with. `linearise`: the error fields with
    their exact derivatives, None where there are none. `segments`: lengths of the parts of the residual that are records over time,
    within which the misfit is correlated (coupons); None where the noise of the comparisons says it all.
    """

    errors: Callable[[Parameters], Errors]
    comparisons: tuple[Comparison, ...]
    observations: dict[str, FieldObservation]
    remark: str
    one_way: bool = False
    linearise: Linearise | None = None
    segments: tuple[int, ...] | None = None
    priors: tuple[Prior, ...] = ()

    def residual(self, parameters: Parameters) -> np.ndarray:
        """Whitened residual (n,) of all channels, one after the other (2.24), (2.27); then one entry for each prior."""
        return np.append(self.assemble(self.errors(parameters)), self.departures(parameters))

    def departures(self, parameters: Parameters) -> np.ndarray:
        """Departure of the parameters from their priors in standard errors (n_priors,)."""
        return np.array([(parameters[prior.name] - prior.value) / prior.sigma for prior in self.priors])

    def linearised(self, parameters: Parameters, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
        """The residual (n,) and its Jacobian (n, n_p) from one forward run. ValueError where the model has no exact derivatives."""
        if self.linearise is None:
            raise ValueError("this model has no exact derivatives")
        errors, slopes = self.linearise(parameters, names)
        of_priors = [[float(name == prior.name) / prior.sigma for name in names] for prior in self.priors]
        return np.append(self.assemble(errors), self.departures(parameters)), self.with_priors(self.assemble_jacobian(slopes), of_priors)

    def with_priors(self, columns: np.ndarray, of_priors: list[list[float]] | None = None) -> np.ndarray:
        """Columns (n, n_p) with the rows of the priors below them, zeros where none are given."""
        if not self.priors:
            return columns
        return np.concatenate([columns, np.array(of_priors) if of_priors else np.zeros((len(self.priors), columns.shape[1]))])

    def assemble(self, errors: Errors) -> np.ndarray:
        """The residual (n,) of error fields."""
        return np.concatenate([c.residual(errors[field_of(c.channel)]) for c in self.comparisons])

    def assemble_jacobian(self, slopes: Mapping[str, np.ndarray]) -> np.ndarray:
        """The Jacobian (n, n_p) of derivative fields (n_t, n_s, n_c, n_p): a comparison is linear, so that it maps each one as an error."""
        n_p = next(iter(slopes.values())).shape[-1]
        out, at = np.empty((sum(c.n for c in self.comparisons), n_p), order="F"), 0
        for c in self.comparisons:
            slope = slopes[field_of(c.channel)]
            for i in range(n_p):
                out[at : at + c.n, i] = c.residual(slope[..., i])
            at += c.n
        return out

    def noise(self, v: np.ndarray) -> np.ndarray:
        """Correlation of the residual's noise applied to columns (n, k)."""
        out, at = np.empty_like(v), 0
        for c in self.comparisons:
            part = slice(at, at + c.n)
            out[part] = v[part] if c.noise is None else c.noise(v[part])
            at += c.n
        out[at:] = v[at:]
        return out


def field_of(channel: str) -> str:
    """The observed field behind a channel."""
    if channel in ("force", "stress", "strain"):
        return channel
    return "u" if channel in MECHANICAL_CHANNELS else "theta"


def reference_times(observation: FieldObservation, study: Study, load_start: float) -> np.ndarray:
    """True (n_t,) at the times that dtheta refers to: the one that the study names, else all before loading (2.22)."""
    wanted = study.evaluation.reference_time
    if wanted is None:
        return np.asarray(observation.time <= load_start + 1e-9)
    return np.asarray(np.arange(len(observation.time)) == int(np.argmin(np.abs(observation.time - wanted))))


def comparison(channel: str, observation: FieldObservation, settings: StageSettings, study: Study, load_start: float) -> Comparison:
    """The comparison of one channel as a stage asks for it."""
    weight = _weight(settings.channels[channel])  # type: ignore[index]
    if channel == "u":
        return plain(observation, weight)
    if channel == "du":
        du = settings.du
        return relative_displacements(observation, RelativeScheme(du.scheme, du.components, du.distance), weight)
    if channel in ("theta", "force"):
        return plain(observation, weight)
    return temperature_change(observation, reference_times(observation, study, load_start), weight)


def _weight(settings: ChannelSettings) -> Weight:
    weight = settings.weight
    if isinstance(weight, float | str):
        return weight
    return (weight.x, weight.y)


def steps_for(data: Measured, fields: set[str]) -> LoadSteps:
    """The load steps that hit every observation time of the given fields."""
    if "theta" not in fields:
        return data.steps["displacement"]
    return data.steps["temperature" if fields == {"theta"} else "all"]


def stage_model(
    study: Study, data: Measured, settings: StageSettings, base: Parameters, size: MeshSize, times: tuple[float, float, str]
) -> StageModel:
    """StageModel of a stage on a mesh; `times` = (t0, t1, remark) is its window in s, `base` its parameters to start from.

    Where only temperatures are compared, only parameters of the heat equation and of the instruments are free and the coupling is
    one-way, the mechanics is solved once (coupled, at `base`) and an evaluation is a heat run on it. DataError where the window holds
    no observation.
    """
    t0, t1, remark = times
    observations: dict[str, FieldObservation] = {}
    for channel in settings.channels:
        if field_of(channel) == "u":
            observations["u"] = data.displacement.between(t0, t1)
        elif field_of(channel) == "force":
            observations["force"] = data.force.between(t0, t1)
        else:
            observations["theta"] = temperature_of(data).between(min(t0, data.load_start), t1)
    if "force" in settings.channels and study.force.drives == "force":
        raise StudyError(
            f"{study.source.name}: channel force needs force.drives: crosshead or dic; a force that is prescribed as a load has no residual"
        )
    end = max(float(o.time[-1]) for o in observations.values())
    steps = steps_for(data, set(observations)).until(end)
    elastic_only = set(settings.free) <= {"E", "nu"}
    whole = run_of(study, data, size, steps, march_settings(study, settings.coupling, plastic=not elastic_only))
    samplers = {name: sampler(whole.body, o, steps) for name, o in observations.items()}
    comparisons = tuple(comparison(c, observations[field_of(c)], settings, study, data.load_start) for c in settings.channels)
    run: AnyRun = whole
    one_way = settings.coupling == "one-way" and set(observations) == {"theta"} and set(settings.free) <= thermal_names() | station_names()
    if one_way:
        kept = replace(whole, settings=march_settings(study, "full", keep_points=True))
        run = held_run(kept.body, kept(base), kept.settings)
    prediction: PlainPrediction | JointPrediction = PlainPrediction(run, samplers, observations)
    if looks_through_effects(base):
        prediction = JointPrediction(Instruments(LastRun(run, station_names()), samplers, observations, data.theta_air))
    return StageModel(prediction.errors, comparisons, observations, remark, one_way, prediction.linearise)
