"""What drives the loaded end of a body over time, and the solution steps between the times that are recorded.

Between what the machine recorded and what acts on the specimen stand the effects of slot `load`: functions of the recorded force N and
crosshead mm, both (n_t,), that return what they make of both. Derivatives are made by complex step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.body.body import Body
from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import Parameters, load_mode
from thermofit.effects.catalogue import LOAD, Effect, effects

_CONTROLS = ("force", "displacement", "arc")
_STEP = 1e-30
_APART = 1e-3
"""Part of the largest force over which the slope of what acts is taken."""


@dataclass(frozen=True)
class Loading:
    """What drives the loaded end over time s, piecewise linear: total force in N, its displacement in mm, or arc length in mm.

    A displacement counts from the stress-free reference state, or `from_rest` from the resting specimen, which its temperature has
    already lengthened. Control "arc" (of a body under force control) goes on along the path of equilibria (`body.solve.arc`) where neither
    force nor end displacement grows, and back along it, unloading, where the value falls; it starts without force.

    Where a displacement is that of a machine's crosshead, `force` N (n_t,) is the force that the machine recorded with it; None: it is
    that of the specimen's end itself, and no effect of the machine can stand in between (nor for an arc length).

    `modes` (n_t, k): changes of the value, in its unit, along which a run can be differentiated (`core.parameters.load_modes`).
    """

    time: np.ndarray
    value: np.ndarray
    control: str = "force"
    from_rest: bool = False
    force: np.ndarray | None = None
    modes: np.ndarray | None = None

    def at(self, t: float) -> float:
        """Value at time t."""
        return float(np.interp(t, self.time, self.value))

    def between(self, values: np.ndarray, t: float) -> np.ndarray:
        """Columns (m,) at time t of values (n_t, m) at the times of the loading."""
        return np.array([np.interp(t, self.time, column) for column in values.T])

    @property
    def of_machine(self) -> bool:
        """Whether effects of the machine stand between this loading and the specimen."""
        return self.control == "force" or (self.control == "displacement" and self.force is not None)

    def acting(self, parameters: Parameters) -> Loading:
        """The loading of the specimen itself: this one after the effects of the machine that are not neutral."""
        links = [e for e in effects(LOAD) if e.is_on(parameters)]
        return replace(self, value=self._acting(links, parameters)) if links and self.of_machine else self

    def rates(self, parameters: Parameters, names: Sequence[str]) -> np.ndarray:
        """Derivatives (n_t, n_p) of the acting value by the named parameters and along its modes, zero for those of no such effect."""
        out = np.zeros((len(self.time), len(names)))
        for k, mode in enumerate(map(load_mode, names)):
            if mode >= 0:
                out[:, k] = self._along(mode, parameters)
        if self.of_machine:
            for k, (name, links) in enumerate((name, _links(parameters, name)) for name in names):
                if links:
                    out[:, k] = np.imag(self._acting(links, parameters, name)) / _STEP
        return out

    def _along(self, mode: int, parameters: Parameters) -> np.ndarray:
        """Derivative (n_t,) of the acting value along a mode of what is prescribed."""
        if self.modes is None or (self.control != "force" and self.of_machine):
            raise StudyError(f"march: a derivative along mode {mode} of the loading was asked for; expected a prescribed load with modes")
        if not self.of_machine:
            return np.asarray(self.modes[:, mode])
        links = [e for e in effects(LOAD) if e.is_on(parameters)]
        moved = self.value + 1j * _STEP * self.modes[:, mode]
        return np.asarray(np.imag(_through(links, moved, np.zeros_like(moved), (parameters, ""))[0]) / _STEP)

    def _acting(self, links: Sequence[Effect], parameters: Parameters, name: str = "") -> np.ndarray:
        """Value (n_t,) after the effects, the Param `name` moved by i h; an end displacement counts from the first time, as its own."""
        if self.control == "force":
            return _through(links, self.value, np.zeros_like(self.value), (parameters, name))[0]
        force = np.zeros_like(self.value) if self.force is None else self.force
        change = _through(links, force, self.value, (parameters, name))[1] - self.value
        return np.asarray(self.value + change - change[0])

    def check(self, body: Body, times: np.ndarray) -> None:
        """StudyError where the body or the solution times (n_t,) s do not suit the control."""
        if self.control not in _CONTROLS:
            raise StudyError(f"march: control '{self.control}' found; expected one of {', '.join(_CONTROLS)}")
        if (self.control == "displacement") != (body.top < 0):
            raise StudyError(
                f"march: the loading prescribes a {self.control}, but the body was made for the other control; use one control for both"
            )
        if self.control == "arc" and np.any(np.diff([self.at(float(t)) for t in times]) == 0.0):
            raise StudyError("march: the arc length stands still between two times; under arc control it must change in every step")


def moving(names: Sequence[str], rates: np.ndarray) -> list[int]:
    """Places of the names that move anything in a run: Params of effects of the machine do so through the loading alone, whose derivatives
    (n_t, n_p) by the names are `rates`."""
    machine = {name for e in effects(LOAD) for name in e.names}
    return [k for k, name in enumerate(names) if name not in machine or bool(np.any(rates[:, k]))]


def _links(parameters: Parameters, name: str) -> list[Effect]:
    """Effects of the machine that are not neutral, and that of `name`; none if `name` is not of such an effect."""
    if not any(name in e.names for e in effects(LOAD)):
        return []
    return [e for e in effects(LOAD) if name in e.names or e.is_on(parameters)]


def _through(links: Sequence[Effect], force: np.ndarray, end: np.ndarray, at: tuple[Parameters, str]) -> tuple[np.ndarray, np.ndarray]:
    """Force and end displacement (n_t,) after the effects; at = (parameters, name of the one that is moved by i h)."""
    parameters, name = at
    for link in links:
        force, end = link.act(force, end, *(parameters[n] + 1j * _STEP if n == name else parameters[n] for n in link.names))
    return force, end


def acting_force(force: np.ndarray, parameters: Parameters) -> np.ndarray:
    """Force (n_t,) N on the specimen where the load cell recorded `force`; exactly that where all effects are neutral."""
    links = [e for e in effects(LOAD) if e.is_on(parameters)]
    return np.asarray(_through(links, force, np.zeros_like(force), (parameters, ""))[0])


def acting_force_rate(force: np.ndarray, parameters: Parameters, name: str) -> np.ndarray:
    """Derivative (n_t,) of `acting_force` by one parameter."""
    links = _links(parameters, name)
    return np.asarray(np.imag(_through(links, force, np.zeros_like(force), (parameters, name))[0]) / _STEP)


def shown_force(force: np.ndarray, recorded: np.ndarray, parameters: Parameters) -> np.ndarray:
    """What a load cell shows (n_t,) N of a force F on the specimen (n_t,), near what it recorded, R:

        R - (a(R) - F) / a'(R),   a: `acting_force`.

    Without a' an effect that makes all forces smaller would make what is left smaller, too. NumericsError where the force that acts does
    not grow with the recorded one: then many recorded forces would make the same."""
    return np.asarray(recorded - (acting_force(recorded, parameters) - force) / _growth(recorded, parameters))


def shown_force_rate(force: np.ndarray, rate: np.ndarray, recorded: np.ndarray, parameters: Parameters, name: str) -> np.ndarray:
    """Derivative (n_t,) of `shown_force` by one parameter, by which F changes at `rate` (n_t,)."""
    slope = _growth(recorded, parameters)
    off = (acting_force(recorded, parameters) - force) / slope
    moved = acting_force_rate(recorded, parameters, name) - rate
    return np.asarray((off * _slope(recorded, parameters, name) - moved) / slope)


def _growth(recorded: np.ndarray, parameters: Parameters) -> np.ndarray:
    """a'(R) (n_t,), above zero. NumericsError where it is not."""
    slope = _slope(recorded, parameters)
    if np.any(slope <= 0.0):
        on = ", ".join(e.name for e in effects(LOAD) if e.is_on(parameters))
        raise NumericsError(f"load cell: with {on} the force on the specimen does not grow with the recorded one; use a law that grows")
    return slope


def _slope(recorded: np.ndarray, parameters: Parameters, name: str | None = None) -> np.ndarray:
    """a'(R) (n_t,), or its derivative by one parameter: central differences over _APART of the largest force."""
    apart = _APART * max(float(np.abs(recorded).max(initial=0.0)), 1.0)

    def at(force: np.ndarray) -> np.ndarray:
        return acting_force(force, parameters) if name is None else acting_force_rate(force, parameters, name)

    return np.asarray((at(recorded + apart) - at(recorded - apart)) / (2.0 * apart))


def solution_times(start: float, end: float, longest: float) -> np.ndarray:
    """Times after `start` up to `end` in equal steps of at most `longest`, all in s."""
    n = max(1, int(np.ceil((end - start) / longest * (1.0 - 1e-9))))
    return np.append(start + (end - start) * np.arange(1, n) / n, end)
