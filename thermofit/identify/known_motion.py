"""Temperatures on a motion that is known: what the heat equation and the infrared camera alone can change.

Temperatures hardly act on the motion (thermal strains of 1e-5 beside plastic ones of 1e-2), so that everything that lives in the heat
equation is answered by a heat run, at a tenth of the cost of a coupled one. Two uses: fits of the thermal parameters on their own, and
the influence of effects of the heat problem that are off, for many values of their times and exponents at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.parameters import Parameters, is_known
from thermofit.effects.catalogue import HEAT, Effect, effects
from thermofit.fem.history import History
from thermofit.fem.one_way import HeatProblem, heat_problem, heat_run, heat_run_rates
from thermofit.identify.instruments import SLOTS, Instruments, station_names
from thermofit.identify.model import THERMAL
from thermofit.identify.prediction import Errors
from thermofit.measure.stations import INFRARED, chain, seen_along

IN_HEAT = (*HEAT, "dissipation")
"""Slots of effects that act in the heat equation only."""
Direction = tuple[str, Mapping[str, float]]
"""A Param along which a derivative is taken, and values of the other Params of its effect, which is off."""


def acts_in_heat(effect: Effect) -> bool:
    """True for an effect that the heat equation alone feels."""
    return effect.slot in IN_HEAT


def thermal_names(names: Sequence[str]) -> tuple[str, ...]:
    """Those of the named parameters that change temperatures, or what the infrared camera shows of them, on a motion that is known."""
    felt = {*THERMAL, *(n for e in effects((*IN_HEAT, *INFRARED)) for n in e.names)}
    return tuple(name for name in names if is_known(name) and name in felt)


@dataclass(frozen=True)
class KnownMotion:
    """Instruments that look at a history, and the heat problem on its motion."""

    instruments: Instruments
    history: History
    problem: HeatProblem

    def errors(self, parameters: Parameters) -> Errors:
        """Error field of the temperatures."""
        return self._errors(heat_run(self.problem, parameters), parameters)

    def _errors(self, theta: np.ndarray, parameters: Parameters) -> Errors:
        seen = self.instruments.predicted("theta", replace(self.history, theta=theta), parameters)
        return {"theta": seen - self.instruments.observations["theta"].value}

    def linearise(self, parameters: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
        """Error field of the temperatures and its derivatives (n_t, n_s, 1, n_p)."""
        stations = station_names()
        heated = tuple(name for name in names if name not in stations)
        theta, slopes = self._run(parameters, [(name, {}) for name in heated])
        out = np.zeros((*self.instruments.observations["theta"].value.shape, len(names)))
        history = replace(self.history, theta=theta)
        self.instruments.fill("theta", history, parameters, (names, heated, slopes[:, :, None, :]), out)
        return self._errors(theta, parameters), {"theta": out}

    def along(self, parameters: Parameters, directions: Sequence[Direction]) -> np.ndarray:
        """Derivatives (n_t, n_s, 1, n) of the temperatures that the camera shows, the specimen expanding freely as it warms.

        The history must be of the same parameters. Its motion holds the thermal strain of its own temperatures only; the heat that the
        strain of a change takes enters the heat capacity.
        """
        settings = replace(self.problem.settings, coupling="one-way")
        _, slopes = replace(self, problem=replace(self.problem, settings=settings))._run(parameters, directions)
        links, index = chain(SLOTS["theta"], parameters), self.instruments.samplers["theta"].index
        if not links:
            return slopes[index][:, :, None, :]
        view = self.instruments.view("theta", self.history)
        shown = [view.taken(seen_along(view.field, slope, view.scene, links, parameters)) for slope in np.moveaxis(slopes, -1, 0)]
        return np.stack(shown, axis=-1)

    def _run(self, parameters: Parameters, directions: Sequence[Direction]) -> tuple[np.ndarray, np.ndarray]:
        """Temperatures (n_steps, n_np) and their slopes (n_steps, n_s, n) at the pixels."""
        if not directions:
            return heat_run(self.problem, parameters), np.zeros((len(self.history.time), self._pixels, 0))
        operator, names = self.instruments.samplers["theta"].operator, [name for name, _ in directions]
        theta = np.empty((len(self.problem.time), self.problem.body.mesh.n_nodes))
        slopes = np.zeros((len(theta), self._pixels, len(names)))

        def collect(n: int, temperature: np.ndarray, rates: np.ndarray) -> None:
            theta[n] = temperature
            slopes[n] = operator.temperature(rates[:, : len(names)].T)[:, :, 0].T

        heat_run_rates(self.problem, parameters, names, collect, [others for _, others in directions])
        return theta, slopes

    @property
    def _pixels(self) -> int:
        return int(self.instruments.observations["theta"].value.shape[1])


def known_motion(instruments: Instruments, parameters: Parameters) -> KnownMotion:
    """The motion of a coupled run with given parameters. NumericsError where it fails."""
    keeping = replace(instruments.run, settings=replace(instruments.run.settings, keep_points=True))
    return on_motion(instruments, keeping(parameters))


def on_motion(instruments: Instruments, history: History) -> KnownMotion:
    """The same of a history that kept its points."""
    run = instruments.run
    return KnownMotion(instruments, history, heat_problem(run.body, history, run.settings))
