"""The residual of a stage: forward model, observations and weights put together (2.24)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters, bare_name, param
from thermofit.experiment.channels import FIELDS, comparisons_of, field_of
from thermofit.experiment.fields import LoadSteps, Measured, displacement_of, temperature_of
from thermofit.experiment.forward import march_settings, run_of, sampler
from thermofit.experiment.held import AnyRun, LastRun, held_run, thermal_names
from thermofit.experiment.instruments import Instruments, JointPrediction, looks_through_effects, station_names
from thermofit.experiment.missing import Missing
from thermofit.experiment.prediction import Errors, Linearise, PlainPrediction
from thermofit.experiment.shared_noise import SharedNoise
from thermofit.law.hardening.catalogue import hardening
from thermofit.observe.comparison import Comparison
from thermofit.observe.observation import FieldObservation
from thermofit.study.section import MeshSize
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study


@dataclass(frozen=True)
class Prior:
    """What is known of a parameter before the test: value and standard error."""

    name: str
    value: float
    sigma: float
    firm: bool = True
    """True where nothing but an error of the reading explains another value. A camera may have been moved since it was calibrated: then a
    far value is no error of the calibration, but what happened."""


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
    missing: Missing | None = None
    """What it would show of terms that no law names; None where that is not worked out."""
    common: tuple[SharedNoise, ...] = ()
    """Noise that comparisons have in common: what one tells of it, the others know."""
    cheap: bool = False
    """True where a run costs next to nothing: that of a point."""
    directed: Callable[[Parameters, Sequence[tuple[str, Mapping[str, float]]]], np.ndarray] | None = None
    """Columns (n, n_d) along directions of the heat equation, each a Param and values of the others of its effect, on a motion that is
    known; None where that is not worked out."""

    @property
    def places(self) -> dict[str, slice]:
        """Where the rows of every channel are in the residual."""
        ends = np.cumsum([c.n for c in self.comparisons])
        return {c.channel: slice(int(end) - c.n, int(end)) for c, end in zip(self.comparisons, ends, strict=True)}

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
        return self.assembled(parameters, names, *self.linearise(parameters, names))

    def assembled(
        self, parameters: Parameters, names: tuple[str, ...], errors: Errors, slopes: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """The residual (n,) and its Jacobian (n, n_p) of error fields and their derivatives at parameters."""
        jacobian = self.with_priors(self.assemble_jacobian(errors, slopes), names)
        return np.append(self.assemble(errors), self.departures(parameters)), jacobian

    def with_priors(self, columns: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Columns (n, n_p) by the named parameters with the rows of the priors below them."""
        rows = [[float(_is_of(prior, name, names)) / prior.sigma for name in names] for prior in self.priors]
        return np.concatenate([columns, np.array(rows).reshape(len(self.priors), columns.shape[1])])

    def assemble(self, errors: Errors) -> np.ndarray:
        """The residual (n,) of error fields."""
        return np.concatenate(self.parts(errors))

    def parts(self, errors: Errors) -> list[np.ndarray]:
        """The residual (n_i,) of every comparison, without what those before tell of their common noise."""
        return self._apart([c.residual(errors[field_of(c)]) for c in self.comparisons])

    def columns(self, shown: Mapping[str, np.ndarray]) -> dict[int, np.ndarray]:
        """Columns (n_i, m) of the comparisons that feel m terms, by their number: by what these add to observed fields (n_t, n_s, n_c, m).

        They are without what other comparisons tell of their common noise: an error of displacements is taken for one of the force, and
        for the heat of its flow.
        """
        m = next(iter(shown.values())).shape[-1]
        parts: dict[int, np.ndarray] = {}
        for k, c in enumerate(self.comparisons):
            if field_of(c) in shown:
                parts[k] = c.columns(shown[field_of(c)])
            elif parts:  # those before the first tell nothing of it
                parts[k] = np.zeros((c.n, m))
        for one in self.common:
            parts = one.innovations_of(parts)
        return {k: part for k, part in parts.items() if field_of(self.comparisons[k]) in shown or part.any()}

    def _apart(self, parts: list[np.ndarray]) -> list[np.ndarray]:
        """Residuals or columns (n_i, ...) of every comparison without what the others tell of their common noise."""
        for one in self.common:
            parts = one.innovations(parts)
        return parts

    def common_columns(self) -> np.ndarray:
        """What the errors that comparisons have in common make of the residual (n, k), each of unit variance: a part of its noise."""
        counts = [c.n for c in self.comparisons]
        blocks = []
        for one in self.common:
            k = len(next(iter(one.shown.values())).modes)
            shown = {place: s.columns @ s.modes.T for place, s in one.shown.items()}
            parts = [shown.get(place, np.zeros((n, k))) for place, n in enumerate(counts)]
            blocks.append(np.concatenate([*self._apart(parts), np.zeros((len(self.priors), k))]))
        return np.concatenate([np.zeros((sum(counts) + len(self.priors), 0)), *blocks], axis=1)

    def assemble_jacobian(self, errors: Errors, slopes: Mapping[str, np.ndarray]) -> np.ndarray:
        """The Jacobian (n, n_p) at error fields, of derivative fields (n_t, n_s, n_c, n_p)."""
        n_p = next(iter(slopes.values())).shape[-1]
        out, at = np.empty((sum(c.n for c in self.comparisons), n_p), order="F"), 0
        parts = []
        for c in self.comparisons:
            out[at : at + c.n] = c.slopes(errors[field_of(c)], slopes[field_of(c)])
            parts.append(out[at : at + c.n])
            at += c.n
        for part, apart in zip(parts, self._apart(parts), strict=True):
            if apart is not part:
                part[:] = apart
        return out

    @property
    def spread(self) -> np.ndarray:
        """Standard deviation (n,) that the noise gives each entry of the residual, priors included: one where weights are 1/sigma^2."""
        return np.concatenate([*(c.spread for c in self.comparisons), np.ones(len(self.priors))])

    @property
    def white(self) -> bool:
        """True where the noise of the residual is white and of one size."""
        return all(c.noise is None for c in self.comparisons) and bool(np.allclose(self.spread, 1.0))

    def noise(self, v: np.ndarray) -> np.ndarray:
        """Covariance of the residual's noise, in units of its mean square, applied to columns (n, k)."""
        spread = self.spread
        size = spread / np.sqrt(np.mean(spread**2))
        scaled = size[:, None] * v
        out, at = np.empty_like(v), 0
        for c in self.comparisons:
            part = slice(at, at + c.n)
            out[part] = scaled[part] if c.noise is None else c.noise(scaled[part])
            at += c.n
        out[at:] = scaled[at:]
        return size[:, None] * out


def _is_of(prior: Prior, name: str, names: Sequence[str]) -> bool:
    """True where a prior is one of that parameter; one of an experiment is one of the common parameter where that is free instead."""
    return name == prior.name or (prior.name not in names and name == bare_name(prior.name))


def steps_for(data: Measured, fields: set[str]) -> LoadSteps:
    """The load steps that hit every observation time of the given fields."""
    if "theta" not in fields:
        return data.steps["displacement"]
    return data.steps["temperature" if fields == {"theta"} else "all"]


def observed(data: Measured, name: str) -> FieldObservation:
    """The observed field u, theta or force. DataError where the experiment does not have it."""
    if name == "theta":
        return temperature_of(data)
    return displacement_of(data) if name == "u" else data.force


def needs_drive(study: Study, channels: Iterable[str]) -> None:
    """StudyError where the force is compared, but prescribed."""
    compared = [channel for channel in channels if FIELDS[channel] == "force"]
    if compared and study.force.drives == "force":
        raise StudyError(
            f"{study.source.name}: channel {compared[0]} needs force.drives: crosshead or dic; a force that is prescribed as a load has no "
            "residual"
        )


def needs_stress(study: Study, settings: StageSettings) -> None:
    """StudyError where a displacement drives, displacements alone are compared and no stress is known: E is free, and so are all stresses
    of the hardening law, or nothing flows."""
    free, fields = set(settings.free), {FIELDS[channel] for channel in settings.channels}
    stresses = {name for name in hardening(study.hardening_law).fitted if param(name).unit == "MPa"}
    unknown = "E" in free and (free >= stresses or free <= {"E", "nu"})
    if study.force.drives != "force" and fields == {"u"} and unknown:
        raise StudyError(
            f"{study.source.name}: E is free where {' and '.join(settings.channels)} alone are compared, but force.drives is "
            f"{study.force.drives}, and displacements under a displacement tell no stress; add 'force: {{}}' to the channels of the stage"
        )


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
    for name in dict.fromkeys(FIELDS[channel] for channel in settings.channels):
        start = min(t0, data.load_start) if name == "theta" else t0
        observations[name] = observed(data, name).between(start, t1)
    needs_drive(study, settings.channels)
    end = max(float(o.time[-1]) for o in observations.values())
    steps = steps_for(data, set(observations)).until(end)
    elastic_only = set(settings.free) <= {"E", "nu"}
    whole = run_of(study, data, size, steps, march_settings(study, settings.coupling, plastic=not elastic_only))
    samplers = {name: sampler(whole.body, o, steps) for name, o in observations.items()}
    comparisons = comparisons_of(settings, observations, study, data)
    run: AnyRun = whole
    one_way = settings.coupling == "one-way" and set(observations) == {"theta"} and set(settings.free) <= thermal_names() | station_names()
    if one_way:
        kept = replace(whole, settings=march_settings(study, "full", keep_points=True))
        run = held_run(kept.body, kept(base), kept.settings)
    prediction: PlainPrediction | JointPrediction = PlainPrediction(run, samplers, observations)
    if looks_through_effects(base):
        prediction = JointPrediction(Instruments(LastRun(run, station_names()), samplers, observations, data.theta_air))
    return StageModel(prediction.errors, comparisons, observations, remark, one_way, prediction.linearise)
