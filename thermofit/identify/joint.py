"""All stages at once: every free parameter, every channel, both fields coupled, and the instruments that look at them.

The stages of the identification fit one group of parameters after the other. What they leave is judged here with all of them together:
a parameter that an earlier stage froze still takes part, else its error would look like an effect that the model lacks. Readings of
thermocouples are data with an error (errata 13): their parameters are free, held by a prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.core.study import Study
from thermofit.core.study_section import MeshSize
from thermofit.core.study_stages import ChannelSettings, StageSettings
from thermofit.effects.catalogue import KINEMATICS, effects
from thermofit.effects.scene import Scene
from thermofit.fem.history import History, Watch
from thermofit.fem.loading import felt_force, felt_force_rate
from thermofit.fem.sensitivity import Sensitivities, Sensitivity
from thermofit.identify.forward import Run, Sampler, march_settings, run_of, sampler
from thermofit.identify.inputs import LoadSteps, Measured
from thermofit.identify.model import Prior, StageModel, comparison, field_of, steps_for
from thermofit.identify.prediction import Errors
from thermofit.measure.observation import FieldObservation
from thermofit.measure.stations import CAMERA, INFRARED, chain, scene_of, seen, seen_along

THERMOCOUPLE = 0.1
"""Standard error of a declared temperature of air or jaws, K."""
NUISANCES = ("theta_air", "theta_clamp")
SLOTS = {"u": (*KINEMATICS, *CAMERA), "theta": INFRARED}
"""Slots between the run and an observed field, in their order."""


def station_names() -> frozenset[str]:
    """Params of effects between the run and what is observed: they change what is seen, not what happens in the run."""
    return frozenset(name for slots in SLOTS.values() for effect in effects(slots) for name in effect.names)


@dataclass(frozen=True)
class View:
    """A field on its way to an instrument: temperatures (n_steps, n_s) or displacements (n_t, n_s, 2), its scene, and which times are
    observed."""

    field: np.ndarray
    scene: Scene
    index: np.ndarray

    def taken(self, seen_field: np.ndarray) -> np.ndarray:
        """What is observed (n_t, n_s, n_c) of a field that went through the instrument."""
        taken = seen_field[self.index]
        return taken if taken.ndim == 3 else taken[:, :, None]


@dataclass(frozen=True)
class Instruments:
    """Cameras on the faces of a body and the load cell: samplers and observations by field "u", "theta", "force", and the run."""

    run: Run
    samplers: dict[str, Sampler]
    observations: dict[str, FieldObservation]
    theta_air: float

    def view(self, name: str, history: History) -> View:
        """The view on field "u" at its observed times, on "theta" at every step (a sensor may look at other times than it says)."""
        here = self.samplers[name]
        index = here.index if name == "u" else np.arange(len(history.time))
        u = here.operator.displacement(history.u[np.append(index, here.reference)])
        u = u[:-1] - u[-1]
        scene = scene_of(history.time[index], self.observations[name].xy, u, np.abs(history.force[index]), self.theta_air)
        if name == "u":
            return View(u, scene, np.arange(len(index)))
        return View(here.operator.temperature(history.theta)[:, :, 0], scene, here.index)

    def predicted(self, name: str, history: History, parameters: Parameters) -> np.ndarray:
        """What the instruments show of a history (n_t, n_s, n_c); a load cell shows the force less what effects say it shows too little."""
        if name == "force":
            recorded = self.observations[name].value
            return (
                self.samplers[name].observed(name, history) - (felt_force(recorded.ravel(), parameters) - recorded.ravel())[:, None, None]
            )
        links = chain(SLOTS.get(name, ()), parameters)
        if not links:
            return self.samplers[name].observed(name, history)
        view = self.view(name, history)
        return view.taken(seen(view.field, view.scene, links, parameters))


@dataclass(frozen=True)
class JointPrediction:
    """Error fields of all channels by one coupled run, and their derivatives by parameters of body and instruments."""

    instruments: Instruments

    def errors(self, parameters: Parameters) -> Errors:
        """Error fields of the parameters. NumericsError where the run fails."""
        return self._errors(self.instruments.run(parameters), parameters)

    def _errors(self, history: History, parameters: Parameters) -> Errors:
        observed = self.instruments.observations
        return {name: self.instruments.predicted(name, history, parameters) - o.value for name, o in observed.items()}

    def linearise(self, parameters: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
        """Error fields and their derivatives (n_t, n_s, n_c, n_p) from one differentiated run.

        The scene that the instruments look at (positions, strain) is taken as it is: its change is of second order.
        """
        stations = station_names()
        of_body = tuple(name for name in names if name not in stations)
        slopes = _Slopes(self.instruments, len(of_body))
        watch = Watch(sensitivities=Sensitivities(of_body, slopes.collect)) if of_body else Watch()
        history = self.instruments.run(parameters, watch)
        found = {}
        for name, observation in self.instruments.observations.items():
            out = np.zeros((*observation.value.shape, len(names)))
            self._fill(name, history, parameters, (names, of_body, slopes.of(name)), out)
            found[name] = out
        return self._errors(history, parameters), found

    def _fill(
        self,
        name: str,
        history: History,
        parameters: Parameters,
        asked: tuple[tuple[str, ...], tuple[str, ...], np.ndarray],
        out: np.ndarray,
    ) -> None:
        """Derivatives of one observed field into out (n_t, n_s, n_c, n_p): those of the specimen as shown, those of the instruments."""
        names, of_body, slopes = asked
        links = chain(SLOTS.get(name, ()), parameters)
        here = {n: tuple(e for e in effects(SLOTS.get(name, ())) if n in e.names or e in links) for n in names if n not in of_body}
        wanted = {n: chosen for n, chosen in here.items() if any(n in e.names for e in chosen)}
        view = self.instruments.view(name, history) if links or wanted else None
        index = self.instruments.samplers[name].index
        for k, n in enumerate(names):
            if n in of_body:
                slope = slopes[..., of_body.index(n)]
                if name == "force":
                    recorded = self.instruments.observations[name].value.ravel()
                    out[..., k] = slope - felt_force_rate(recorded, parameters, n)[:, None, None]
                elif view is not None and links:
                    flat = slope if name == "u" else slope[:, :, 0]
                    out[..., k] = view.taken(seen_along(view.field, flat, view.scene, links, parameters))
                else:
                    out[..., k] = slope[index] if name == "theta" else slope
            elif view is not None and n in wanted:
                out[..., k] = view.taken(seen_along(view.field, np.zeros_like(view.field), view.scene, wanted[n], parameters, n))


class _Slopes:
    """Collects the derivatives of a run: displacements at the times of the stages, temperatures at every step."""

    def __init__(self, instruments: Instruments, n_p: int) -> None:
        self._samplers = instruments.samplers
        n_steps = len(instruments.run.loading.time)
        self._values: dict[str, np.ndarray] = {}
        self._resting: np.ndarray | float = 0.0
        for name, observation in instruments.observations.items():
            n_t, n_s, n_c = observation.value.shape
            self._values[name] = np.zeros((n_steps if name == "theta" else n_t, n_s, n_c, n_p))

    def collect(self, n: int, at: Sensitivity) -> None:
        for name, here in self._samplers.items():
            place = np.array([n]) if name == "theta" else np.flatnonzero(here.index == n)
            if name == "u" and n == here.reference:
                self._resting = here.observed_rates("u", at)
            if place.size:
                value = here.observed_rates(name, at)
                self._values[name][place] = value - self._resting if name == "u" else value

    def of(self, name: str) -> np.ndarray:
        return self._values[name]


def joint_free(study: Study) -> tuple[str, ...]:
    """What all stages of a study identify, each once."""
    names = (*study.stages.elastic.free, *study.stages.plastic.free, *study.stages.thermal.free)
    return tuple(dict.fromkeys(names))


def joint_settings(study: Study, free: Sequence[str], data: Measured) -> StageSettings:
    """Settings of the joint stage: du, the force where it does not drive the model, and dtheta where there are frames."""
    channels: dict[str, ChannelSettings] = {"du": ChannelSettings()}
    if study.force.drives != "force":
        channels["force"] = ChannelSettings()
    if data.temperature is not None:
        channels["dtheta"] = ChannelSettings()
    if study.diagnosis.channels is not None:
        channels = {c: ChannelSettings() for c in study.diagnosis.channels}
    return StageSettings.model_construct(
        **{**study.stages.plastic.__dict__, "free": tuple(free), "channels": channels, "window": "all", "coupling": "full"}
    )


def priors_of(data: Measured, free: Sequence[str]) -> tuple[Prior, ...]:
    """Priors of the thermocouple readings that are free."""
    values = {"theta_air": data.theta_air, "theta_clamp": data.theta_clamp}
    return tuple(Prior(name, values[name], THERMOCOUPLE) for name in NUISANCES if name in free)


def joint_model(study: Study, data: Measured, settings: StageSettings, size: MeshSize) -> StageModel:
    """StageModel of the joint stage on a mesh: all observations, one coupled run."""
    observations: dict[str, FieldObservation] = {"u": data.displacement}
    if data.temperature is not None:
        observations["theta"] = data.temperature
    if "force" in settings.channels:
        observations["force"] = data.force
    steps: LoadSteps = steps_for(data, set(observations))
    run = run_of(study, data, size, steps, march_settings(study, "full"))
    samplers = {name: sampler(run.body, o, steps) for name, o in observations.items()}
    comparisons = tuple(comparison(c, observations[field_of(c)], settings, study, data.load_start) for c in settings.channels)
    prediction = JointPrediction(Instruments(run, samplers, observations, data.theta_air))
    model = StageModel(prediction.errors, comparisons, observations, "", False, prediction.linearise)
    return replace(model, priors=priors_of(data, settings.free))
