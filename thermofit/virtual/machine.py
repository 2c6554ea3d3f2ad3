"""Testing machine of a virtual experiment: a crosshead programme becomes a force history.

The test is driven by the crosshead, the finite-element kernel by the force. A slice model of the dogbone carries the
one over to the other: every slice along y is uniaxial, with elongation in closed form, and at each time the force
solves elongation(F) + compliance F + slip(F) = crosshead. The gauge is exact to 5e-5 of stretch; the shoulders, which are
not uniaxial, make the crosshead of the finite-element run differ by up to 4 % of the elongation from the commanded one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from thermofit.core.errors import StudyError
from thermofit.core.experiment import Specimen
from thermofit.core.parameters import Parameters
from thermofit.core.slots import Slots
from thermofit.point.driver import PointHistory, PointSettings, Programme, simulate
from thermofit.point.step import PLASTIC_Y
from thermofit.study.virtual import Action, Machine

_STRAIN_END = 6.0
"""Largest nominal strain of the tabulated law, far beyond any sheet metal."""
_TABLE = 20001
_ELASTIC_END = 0.05
_SLOW, _RESERVOIR = 1e9, 1e12
"""Duration of a step in s, so long that no effect feels a rate, and a heat capacity in mJ/(mm^3 K) that keeps the temperature."""
_BISECTIONS = 40
_SHOULDER_POINTS = 24
_TINY_FORCE = 1e-6


@dataclass(frozen=True)
class CrossheadStep:
    """One item of the programme: `kind` is hold (s), crosshead_to (mm), force_to (N) or hold_force_until (s).

    `rate` is the signed crosshead rate in mm/s (zero for the holds).
    """

    kind: str
    target: float
    rate: float = 0.0


@dataclass(frozen=True)
class LoadHistory:
    """Noise-free drive of the test: all arrays (n_t,), linear between the rows.

    `time` s at the rate of the load cell plus every kink, `force` N (total), `crosshead` mm as commanded, `slip` mm of
    both jaws together; `kinks` (n_k,) s are the interior times at which the programme changes.
    """

    time: np.ndarray
    force: np.ndarray
    crosshead: np.ndarray
    slip: np.ndarray
    kinks: np.ndarray

    def changes(self, begin: float, end: float) -> bool:
        """Whether the force is not the same from `begin` to `end`, in s."""
        inside = self.force[(self.time > begin) & (self.time < end)]
        return float(np.ptp(np.append(inside, np.interp([begin, end], self.time, self.force)))) > _TINY_FORCE


@dataclass(frozen=True)
class UniaxialLaw:
    """Monotonic uniaxial response along y as the point driver gives it.

    `nominal` (n,) MPa, P_22 at yield, increases from first yield to the largest that the material carries; `plastic` (n,) is the
    logarithmic plastic stretch there. `mandel` (m,) MPa over the logarithmic `elastic` stretch (m,): M_22 = P_22 F_22.
    """

    nominal: np.ndarray
    plastic: np.ndarray
    mandel: np.ndarray
    elastic: np.ndarray


@dataclass(frozen=True)
class Bar:
    """Slices of the dogbone along y: `length` (n,) mm and `area` (n,) mm^2, with the law they share."""

    length: np.ndarray
    area: np.ndarray
    law: UniaxialLaw

    @property
    def capacity(self) -> float:
        """Largest force in N that every slice can carry."""
        return float(self.area.min() * self.law.nominal[-1])


def uniaxial_law(parameters: Parameters, model: int | str | Slots = 2, points: int = _TABLE) -> UniaxialLaw:
    """Uniaxial law for the load along y: that of the point driver with all its effects, at rest and at the reference temperature.

    A slow, isothermal pull to a strain at which any sheet has necked, then again, finely, up to the largest nominal stress. Where the
    yield stress has a plateau or a drop the table leaps: a force that grows leads a slice through it at once. `points` of the table:
    2001 tell the largest stress to 1e-5. NumericsError where the driver does not get there.
    """
    still = parameters.replace(c0=_RESERVOIR, theta_air=parameters["theta_ref"])

    def pull(strain: np.ndarray, *, plastic: bool = True) -> PointHistory:
        programme = Programme.by_strain(np.arange(len(strain)) * _SLOW, strain)
        return simulate(still, programme, PointSettings(model, plastic=plastic, max_strain=_STRAIN_END))

    # Denser near first yield, where hardening bends most.
    shares = np.linspace(0.0, 1.0, points) ** 1.5
    whole = pull(_STRAIN_END * shares)
    table = pull(whole.strain[min(int(np.argmax(whole.stress)) + 1, points - 1)] * shares)
    flows = int(np.argmax(table.accumulated > 0.0))
    below, above = table.strain[flows - 1], table.strain[flows]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (below + above)
        below, above = (below, middle) if pull(np.array([0.0, middle])).accumulated[-1] > 0.0 else (middle, above)
    first = pull(np.array([0.0, above]))
    nominal = np.concatenate([first.stress[1:], table.stress[flows:]])
    plastic = np.concatenate([first.states[1:, PLASTIC_Y], table.states[flows:, PLASTIC_Y]])
    higher = np.concatenate([[True], nominal[1:] > np.maximum.accumulate(nominal)[:-1]])
    elastic = pull(_ELASTIC_END * shares, plastic=False)
    return UniaxialLaw(nominal[higher], plastic[higher], elastic.stress * (1.0 + elastic.strain), np.log1p(elastic.strain))


def bar_of(specimen: Specimen, law: UniaxialLaw) -> Bar:
    """Slices of the whole dogbone: parallel part, Gauss points of the shoulders, gripped ends.

    Width in the shoulder w = w_0 + 2 (R - sqrt(R^2 - s^2)), s = |y| - L_p / 2. StudyError where the lengths of the
    specimen do not fit together.
    """
    radius, step = specimen.shoulder_radius, 0.5 * (specimen.grip_width - specimen.gauge_width)
    if not 0.0 <= step <= max(radius, 0.0):
        raise StudyError(
            f"specimen: grip_width {specimen.grip_width:g} mm cannot be reached from gauge_width {specimen.gauge_width:g} mm "
            f"with a shoulder_radius of {radius:g} mm; correct one of the three"
        )
    shoulder = float(np.sqrt(radius**2 - (radius - step) ** 2))
    grip = 0.5 * (specimen.total_length - specimen.parallel_length) - shoulder
    if grip < -1e-6 * specimen.total_length:
        raise StudyError(
            f"specimen: total_length {specimen.total_length:g} mm is shorter than parallel length and shoulders "
            f"({specimen.parallel_length + 2 * shoulder:g} mm); correct the lengths"
        )
    point, weight = np.polynomial.legendre.leggauss(_SHOULDER_POINTS)
    s = 0.5 * shoulder * (point + 1.0)
    width = specimen.gauge_width + 2.0 * (radius - np.sqrt(radius**2 - s**2))
    length = np.concatenate([[specimen.parallel_length], shoulder * weight, [2.0 * max(grip, 0.0)]])
    widths = np.concatenate([[specimen.gauge_width], width, [specimen.grip_width]])
    return Bar(length, widths * specimen.thickness, law)


def elongation(bar: Bar, force: np.ndarray, largest: np.ndarray) -> np.ndarray:
    """Elongation in mm (n,) of the bar at `force` N (n,) after the force has been as high as `largest` N (n,).

    The plastic stretch follows from `largest` (unloading is elastic); the elastic Hencky strain e is that of the Mandel stress
    M_22 = P_22 F_22 = P_22 exp(plastic + e).
    """
    law = bar.law
    plastic = np.interp(np.asarray(largest)[:, None] / bar.area, law.nominal, law.plastic, left=0.0)
    nominal = np.asarray(force)[:, None] / bar.area
    elastic = np.zeros_like(nominal)
    for _ in range(8):  # contraction by the elastic strain itself (< 0.02): exact after a few rounds
        elastic = np.interp(nominal * np.exp(plastic + elastic), law.mandel, law.elastic)
    return np.asarray(np.expm1(plastic + elastic) @ bar.length)


def slip_of(machine: Machine, bar: Bar, largest: np.ndarray) -> np.ndarray:
    """Slip in mm (n,) of both jaws after the force has been as high as `largest` N (n,).

    The jaws bite early and do not let go: s = slip (1 - exp(-3 F/F_max)) / (1 - exp(-3)), F_max the capacity of the bar.
    """
    return np.asarray(machine.slip * np.expm1(-3.0 * np.asarray(largest) / bar.capacity) / np.expm1(-3.0))


def _crosshead(bar: Bar, machine: Machine, force: np.ndarray, largest: float) -> np.ndarray:
    """Crosshead in mm (n,) at `force` N (n,) if the force had been at `largest` before."""
    peak = np.maximum(force, largest)
    return np.asarray(elongation(bar, force, peak) + machine.compliance * np.asarray(force) + slip_of(machine, bar, peak))


def _force_at(crosshead: Callable[[np.ndarray], np.ndarray], target: np.ndarray, capacity: float) -> np.ndarray:
    """Force in N (n,) at the crosshead positions `target` (n,), by bisection of an increasing function."""
    low, high = np.zeros_like(target), np.full_like(target, capacity)
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = crosshead(middle) < target
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(0.5 * (low + high))


def programme_of(actions: Sequence[Action]) -> tuple[CrossheadStep, ...]:
    """Steps of a `simulate.programme`."""
    return tuple(CrossheadStep(action.kind, getattr(action, action.kind), getattr(action, "rate", 0.0)) for action in actions)


def describe_programme(steps: Sequence[CrossheadStep]) -> tuple[str, ...]:
    """The programme in words, one line per step, as in `experiment.yaml`."""
    words = {
        "hold": "crosshead at rest for {0:g} s",
        "crosshead_to": "crosshead at {1:g} mm/s to {0:g} mm",
        "force_to": "crosshead at {1:g} mm/s until the force is {0:g} N",
        "hold_force_until": "constant force until {0:g} s",
    }
    return tuple(words[step.kind].format(step.target, step.rate) for step in steps)


@dataclass(frozen=True)
class _Standing:
    """Where the programme stands: time s, force N, crosshead mm, largest force so far N."""

    time: float = 0.0
    force: float = 0.0
    crosshead: float = 0.0
    largest: float = 0.0


def _advance(state: _Standing, step: CrossheadStep, bar: Bar, machine: Machine) -> _Standing:
    """State at the end of a step; StudyError where the machine or the material cannot do it."""
    if step.kind == "hold":
        return replace(state, time=state.time + step.target)
    if step.kind == "hold_force_until":
        if step.target < state.time:
            raise StudyError(f"programme: hold_force_until {step.target:g} s lies before {state.time:.1f} s, when it begins; put it later")
        return replace(state, time=step.target)
    capacity = bar.capacity

    def crosshead(force: float) -> float:
        return float(_crosshead(bar, machine, np.array([force]), state.largest)[0])

    limit = crosshead(capacity)
    if step.kind == "crosshead_to":
        if step.target > limit:
            raise StudyError(
                f"programme: crosshead_to {step.target:g} mm goes past the largest force of the specimen ({capacity:.0f} N, reached at "
                f"{limit:.2f} mm), where it would neck; stay below"
            )
        rest = crosshead(0.0)
        if step.target < rest - 1e-9:
            raise StudyError(
                f"programme: crosshead_to {step.target:g} mm would compress the sheet (its force is zero at {rest:.3f} mm); use force_to: 0"
            )
        position = step.target
        # The position may miss the bracket by rounding: at rest or at the very limit.
        inside = min(max(position, rest), limit)
        force = brentq(lambda f: crosshead(f) - inside, 0.0, capacity, xtol=1e-9)
    else:
        force = step.target
        if force > capacity:
            raise StudyError(f"programme: force_to {force:g} N is more than the specimen can carry ({capacity:.0f} N); stay below")
        position = crosshead(force)
    duration = (position - state.crosshead) / step.rate
    if duration < 0.0:
        raise StudyError(
            f"programme: {step.kind} {step.target:g} is never reached from crosshead {state.crosshead:.3f} mm with a rate of "
            f"{step.rate:g} mm/s; change its sign"
        )
    return _Standing(state.time + duration, float(force), position, max(state.largest, float(force)))


def _segment(start: _Standing, end: _Standing, time: np.ndarray, bar: Bar, machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """Force N and crosshead mm (n,) at `time` (n,) inside one step."""
    share = (time - start.time) / max(end.time - start.time, 1e-300)
    position = start.crosshead + (end.crosshead - start.crosshead) * share
    if end.crosshead == start.crosshead:
        return np.full_like(time, start.force), position
    return _force_at(lambda f: _crosshead(bar, machine, f, start.largest), position, bar.capacity), position


def load_history(steps: Sequence[CrossheadStep], bar: Bar, machine: Machine, rate: float = 10.0) -> LoadHistory:
    """Force history of a crosshead programme.

    `rate` in Hz is that of the load cell. The history is isothermal: thermal strains (some um) appear only in the
    crosshead of the finite-element run. StudyError where the programme is empty or cannot be carried out.
    """
    states = [_Standing()]
    for step in steps:
        states.append(_advance(states[-1], step, bar, machine))
    end = states[-1].time
    if not end > 0.0:
        raise StudyError("programme: it takes no time; add at least one step that lasts")
    marks = np.array([state.time for state in states])
    ticks = np.arange(int(np.floor(end * rate * (1 + 1e-12))) + 1) / rate
    # Ticks that all but coincide with a kink would make steps of rounding length.
    ticks = ticks[np.abs(ticks[:, None] - marks).min(axis=1) > 1e-6]
    time, force, position = [np.zeros(1)], [np.zeros(1)], [np.zeros(1)]
    for start, stop in pairwise(states):
        if stop.time <= start.time:
            continue
        inside = ticks[(ticks > start.time) & (ticks < stop.time)]
        f, c = _segment(start, stop, inside, bar, machine)
        time += [inside, np.array([stop.time])]
        force += [f, np.array([stop.force])]
        position += [c, np.array([stop.crosshead])]
    times, forces = np.concatenate(time), np.concatenate(force)
    forces[np.abs(forces) < _TINY_FORCE] = 0.0
    slip = slip_of(machine, bar, np.maximum.accumulate(forces))
    kinks = np.unique(marks[(marks > 0.0) & (marks < end)])
    return LoadHistory(times, forces, np.concatenate(position), slip, kinks)
