"""From a run to what the instruments show of it: cameras with the effects of the measuring chain, load cell, and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.body.sensitivity.march import Sensitivities, StepRates
from thermofit.body.solve.history import History, Watch
from thermofit.body.solve.loading import shown_force, shown_force_rate
from thermofit.core.parameters import Parameters
from thermofit.effects.catalogue import KINEMATICS, effects
from thermofit.effects.scene import Scene
from thermofit.experiment.forward import Sampler
from thermofit.experiment.held import AnyRun
from thermofit.experiment.prediction import Errors
from thermofit.observe.observation import FieldObservation
from thermofit.observe.stations import CAMERA, INFRARED, chain, scene_of, seen, seen_along

SLOTS = {"u": (*KINEMATICS, *CAMERA), "theta": INFRARED}
"""Slots between the run and an observed field, in their order."""


def station_names() -> frozenset[str]:
    """Params of effects between the run and what is observed: they change what is seen, not what happens in the run."""
    return frozenset(name for slots in SLOTS.values() for effect in effects(slots) for name in effect.names)


def looks_through_effects(parameters: Parameters) -> bool:
    """True where an effect of the measuring chain or of the kinematics is on."""
    return any(chain(slots, parameters) for slots in SLOTS.values())


@dataclass(frozen=True)
class View:
    """A field on its way to an instrument: temperatures (n_steps, n_s) or displacements (n_t, n_s, 2), its scene, which times are observed,
    and the displacements (n_steps or n_t, n_s, 2) of its points."""

    field: np.ndarray
    scene: Scene
    index: np.ndarray
    motion: np.ndarray

    def taken(self, seen_field: np.ndarray) -> np.ndarray:
        """What is observed (n_t, n_s, n_c) of a field that went through the instrument."""
        taken = seen_field[self.index]
        return taken if taken.ndim == 3 else taken[:, :, None]


@dataclass(frozen=True)
class Instruments:
    """Cameras on the faces of a body and the load cell: samplers and observations by field "u", "theta", "force", and the run."""

    run: AnyRun
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
            return View(u, scene, np.arange(len(index)), u)
        return View(here.operator.temperature(history.theta)[:, :, 0], scene, here.index, u)

    def predicted(self, name: str, history: History, parameters: Parameters) -> np.ndarray:
        """What the instruments show of a history (n_t, n_s, n_c), as means over patches where the observation is one of those; a load cell
        shows the force as its effects have it (`shown_force`)."""
        if name == "force":
            force, recorded = self.samplers[name].observed(name, history), self.observations[name].value
            return shown_force(force.ravel(), recorded.ravel(), parameters).reshape(force.shape)
        if not self.changes(name, parameters):
            return self.observations[name].averaged(self.samplers[name].observed(name, history))
        view = self.view(name, history)
        shown = seen(view.field, view.scene, chain(SLOTS[name], parameters), parameters)
        shown = _at_its_points(name, shown, view, parameters)
        return self.observations[name].averaged(view.taken(shown))

    def changes(self, name: str, parameters: Parameters) -> bool:
        """True where an effect makes what is observed of a field other than what is there."""
        return bool(chain((*SLOTS.get(name, ()), *(CAMERA if name == "theta" else ())), parameters))

    def shown_along(self, name: str, view: View, slope: np.ndarray, parameters: Parameters) -> np.ndarray:
        """What is observed (n_t, n_s, n_c), point by point, of a field that changes at the rate `slope`, of the shape of the view's."""
        shown = seen_along(view.field, slope, view.scene, chain(SLOTS[name], parameters), parameters)
        return view.taken(_at_its_points(name, shown, view, parameters))

    def shown_by(self, name: str, view: View, param: str, parameters: Parameters) -> np.ndarray:
        """What is observed (n_t, n_s, n_c), point by point, of a Param of the measuring chain that changes at the rate one; zero where it
        does not act on what is observed of the field."""
        links = chain(SLOTS[name], parameters)
        own = tuple(e for e in effects(SLOTS[name]) if param in e.names or e in links)
        shown = np.zeros_like(view.field)
        if any(param in e.names for e in own):
            shown = _at_its_points(name, seen_along(view.field, shown, view.scene, own, parameters, param), view, parameters)
        elif name == "theta" and any(param in e.names for e in effects(CAMERA)):
            shown = carried(seen(view.field, view.scene, links, parameters), view.scene, _misplaced(view, parameters, param))
        return view.taken(shown)


def carried(theta: np.ndarray, scene: Scene, error: np.ndarray) -> np.ndarray:
    """What an error d (n_t, n_s, 2) mm of measured displacements adds to the temperatures (n_t, n_s) K of material points.

    A pixel is given to the point that the displacement cameras say is there: F^-1 d . grad theta to first order, F that of a bar that keeps
    its volume.
    """
    by_x, by_y = scene.gradient(theta)
    along = np.exp(-scene.strain)
    return np.asarray(error[..., 0] / np.sqrt(along) * by_x + error[..., 1] * along * by_y)


def _at_its_points(name: str, shown: np.ndarray, view: View, parameters: Parameters) -> np.ndarray:
    """What an instrument shows at the points to which it is given; temperatures where effects of the displacement cameras place them."""
    links = chain(CAMERA, parameters) if name == "theta" else ()
    if not links:
        return shown
    return shown + carried(shown, view.scene, seen(view.motion, view.scene, links, parameters) - view.motion)


def _misplaced(view: View, parameters: Parameters, param: str) -> np.ndarray:
    """Derivative (n_t, n_s, 2) mm of measured displacements by a Param, at the points where temperatures are compared."""
    links = tuple(e for e in effects(CAMERA) if param in e.names or e in chain(CAMERA, parameters))
    return seen_along(view.motion, np.zeros_like(view.motion), view.scene, links, parameters, param)


@dataclass(frozen=True)
class JointPrediction:
    """Error fields of all channels by one run, and their derivatives by parameters of body and instruments."""

    instruments: Instruments

    def errors(self, parameters: Parameters) -> Errors:
        """Error fields of the parameters. NumericsError where the run fails."""
        return self.of(self.instruments.run(parameters), parameters)

    def of(self, history: History, parameters: Parameters) -> Errors:
        """Error fields of a history of the parameters."""
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
            self._fill(name, history, parameters, names, of_body, slopes.of(name), out)
            found[name] = observation.averaged(out)
        return self.of(history, parameters), found

    def _fill(
        self,
        name: str,
        history: History,
        parameters: Parameters,
        names: tuple[str, ...],
        of_body: tuple[str, ...],
        slopes: np.ndarray,
        out: np.ndarray,
    ) -> None:
        """Derivatives of one field at the observed points into out (n_t, n_s, n_c, n_p): those of the specimen as shown, those of the
        instruments."""
        on = self.instruments.changes(name, parameters)
        stations = [n for n in names if n not in of_body]
        view = self.instruments.view(name, history) if name in SLOTS and (on or stations) else None
        index = self.instruments.samplers[name].index
        for k, n in enumerate(names):
            if n in of_body:
                slope = slopes[..., of_body.index(n)]
                if name == "force":
                    recorded = self.instruments.observations[name].value.ravel()
                    force = self.instruments.samplers[name].observed(name, history).ravel()
                    rate = shown_force_rate(force, slope.ravel(), recorded, parameters, n)
                    out[..., k] = rate.reshape(slope.shape)
                elif view is not None and on:
                    flat = slope if name == "u" else slope[:, :, 0]
                    out[..., k] = self.instruments.shown_along(name, view, flat, parameters)
                else:
                    out[..., k] = slope[index] if name == "theta" else slope
            elif view is not None:
                out[..., k] = self.instruments.shown_by(name, view, n, parameters)


class _Slopes:
    """Collects the derivatives of a run: displacements at the times of the stages, temperatures at every step."""

    def __init__(self, instruments: Instruments, n_p: int) -> None:
        self._samplers = instruments.samplers
        n_steps = len(instruments.run.time)
        self._values: dict[str, np.ndarray] = {}
        self._resting: np.ndarray | float = 0.0
        for name, observation in instruments.observations.items():
            n_t, n_s, n_c = observation.value.shape
            self._values[name] = np.zeros((n_steps if name == "theta" else n_t, n_s, n_c, n_p))

    def collect(self, n: int, at: StepRates) -> None:
        for name, here in self._samplers.items():
            place = np.array([n]) if name == "theta" else np.flatnonzero(here.index == n)
            if name == "u" and n == here.reference:
                self._resting = here.observed_rates("u", at)
            if place.size:
                value = here.observed_rates(name, at)
                self._values[name][place] = value - self._resting if name == "u" else value

    def of(self, name: str) -> np.ndarray:
        return self._values[name]
