"""Missing terms of coupons: heat through the lumped balance and the sensor, stress as the load cell would show it, and an error of the
clock of temperatures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.core.slots import Slots
from thermofit.experiment.coupon_records import CouponTest
from thermofit.experiment.coupon_sensor import SENSOR, sensor_scene
from thermofit.experiment.missing import Grid, time_hats
from thermofit.law.page import along_tension
from thermofit.observe.stations import chain, seen_along
from thermofit.point.driver import PointHistory

FIELDS = {"theta": "heat", "stress": "stress"}
"""Kind of the missing term by observed field."""
OF_INSTRUMENTS = {"theta": ("clock",)}
"""Kinds by observed field of what its instrument may add. Any other history of a temperature is one of a power, by the lumped balance."""
SHOWN_BY = {**{kind: field for field, kind in FIELDS.items()}, **{kind: field for field, kinds in OF_INSTRUMENTS.items() for kind in kinds}}
"""The observed field that shows a kind."""


@dataclass(frozen=True)
class CouponMissing:
    """What the runs of records lack: these, what is added to the time of each (n_tests,), their own parameters and histories, the observed
    fields, and the slots of the law."""

    records: tuple[CouponTest, ...]
    offsets: np.ndarray
    of_test: Callable[[Parameters, CouponTest], Parameters]
    run: Callable[[Parameters, CouponTest], PointHistory]
    fields: tuple[str, ...]
    slots: Slots = Slots()

    @property
    def folded(self) -> bool:
        """A record has one place."""
        return False

    @property
    def of_yield(self) -> CouponMissing:
        """Itself."""
        return self

    @property
    def kinds(self) -> Mapping[str, str]:
        """Kind of the missing term by observed field."""
        return {field: kind for field, kind in FIELDS.items() if field in self.fields}

    @property
    def time(self) -> np.ndarray:
        """All times (n_t,) s on the common axis."""
        return np.concatenate([t.time + offset for t, offset in zip(self.records, self.offsets, strict=True)])

    @property
    def part(self) -> np.ndarray:
        """Record (n_t,) of every time."""
        return np.repeat(np.arange(len(self.records)), [len(t.time) for t in self.records])

    def everywhere(self, counts: tuple[int, int]) -> None:
        """Nothing: a coupon has no place."""

    def spot(self, count: int) -> None:
        """Nothing: a coupon has no place."""

    def grid(self, kind: str, counts: tuple[int, int, int]) -> Grid:
        """Hats in time alone; every record has its share of samples, four at least, one after as many samples as another."""
        whole = sum(len(t.time) for t in self.records)
        knots, part = [], []
        for n, test in enumerate(self.records):
            own = int(np.clip(round(counts[0] * len(test.time) / whole), 4, len(test.time)))
            index = np.linspace(0, len(test.time) - 1, own)
            knots.append(np.interp(index, np.arange(len(test.time)), test.time) + self.offsets[n])
            part.append(np.full(own, n))
        return Grid(np.concatenate(knots), np.concatenate(part), np.zeros(1), np.zeros(1))

    def answers(
        self, kind: str, parameters: Parameters, grid: Grid, chosen: np.ndarray, amount: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        """Change (n_t, 1, 1, m) of the observed field by unit coefficients of the chosen hats; mW/mm^3, MPa and s; m = 1 by an `amount`
        (m,) of each. What a load cell or a sensor lacks shows in its own records alone.

        A clock that is late by tau(t) shows theta(t + tau), to first order tau dtheta/dt more. One that lags by tau shows so much less.
        """
        field = SHOWN_BY[kind]
        in_time = time_hats(grid, self.time, self.part)[:, chosen]
        if amount is not None:
            in_time = (in_time @ amount)[:, None]
        if kind == "stress":
            return {field: in_time[:, None, None, :]}
        out = np.zeros_like(in_time)
        for n, test in enumerate(self.records):
            own = self.part == n
            if kind == "clock":
                out[own] = np.gradient(self.run(parameters, test).theta_sensor, test.time)[:, None] * in_time[own]
            else:
                out[own] = self._warmed(self.of_test(parameters, test), test, in_time[own])
        return {field: out[:, None, None, :]}

    def slopes(
        self, kind: str, parameters: Parameters, grid: Grid, chosen: np.ndarray, amount: np.ndarray, names: Sequence[str]
    ) -> dict[str, np.ndarray]:
        """None: beside a term of a coupon parameters take three steps at most, by their sensitivities without it."""
        return {}

    def _warmed(self, parameters: Parameters, test: CouponTest, power: np.ndarray) -> np.ndarray:
        """What the sensor shows (n, m) of powers (n, m) in mW/mm^3."""
        scene, links = sensor_scene(test), chain(SENSOR, parameters)
        theta = lumped(test.time, power, parameters["c0"], parameters["tau"])
        if parameters["lag"] > 0.0:
            theta = scene.lagged(theta, parameters["lag"])
        if not links:
            return theta
        shown = self.run(parameters, test).theta_sensor[:, None]
        return np.stack([seen_along(shown, column[:, None], scene, links, parameters)[:, 0] for column in theta.T], axis=1)

    def yielding(self, parameters: Parameters, variable: str, edges: np.ndarray, width: float) -> np.ndarray:
        """Change (n_t, 1, 1, m) of the stress by steps of one MPa of the yield stress at edges (m,) of a state variable, all of one width.

        While the coupon flows the stress follows the yield stress; while it does not, the change stays, because the plastic strain does.
        """
        parts = []
        for test in self.records:
            own, history = self.of_test(parameters, test), self.run(parameters, test)
            z = (yield_variable(history, variable)[:, None] - edges) / width
            stretch = (1.0 + history.strain) * along_tension(own, self.slots)[0]
            value = np.sign(history.stress)[:, None] * smooth_step(z) / stretch[:, None]
            flows = np.append(False, np.diff(history.accumulated) > 0.0)
            last = np.maximum.accumulate(np.where(flows, np.arange(len(flows)), -1))
            parts.append(np.where(last[:, None] >= 0, value[np.maximum(last, 0)], 0.0))
        return np.concatenate(parts)[:, None, None, :]

    @property
    def of_surface(self) -> Mapping[str, tuple[str, ...]]:
        """None: a coupon is one point."""
        return {}

    @property
    def of_instruments(self) -> Mapping[str, tuple[str, ...]]:
        """An error of the clock of temperatures."""
        return {field: kinds for field, kinds in OF_INSTRUMENTS.items() if field in self.fields}

    def yield_variables(self, parameters: Parameters, variable: str) -> np.ndarray:
        """Values of a state variable wherever a coupon flows."""
        found = []
        for test in self.records:
            history = self.run(parameters, test)
            flows = np.append(False, np.diff(history.accumulated) > 0.0)
            found.append(yield_variable(history, variable)[flows])
        return np.concatenate(found)

    def volumes(self, grid: Grid) -> np.ndarray | None:
        """Not known of a coupon."""
        return None

    def states(self, parameters: Parameters, grid: Grid) -> Mapping[str, np.ndarray]:
        """State variables (n_k, 1) at the knots."""
        parts: dict[str, list[np.ndarray]] = {}
        for test in self.records:
            history = self.run(parameters, test)
            for name, value in point_states(history).items():
                parts.setdefault(name, []).append(value)
        time = self.time
        return {name: np.interp(grid.time, time, np.concatenate(value))[:, None] for name, value in parts.items()}


def point_states(history: PointHistory) -> dict[str, np.ndarray]:
    """State variables (n_t,) of a run by name."""
    t = history.time
    rate, flow = np.gradient(history.strain, t), np.maximum(np.gradient(history.accumulated, t), 0.0)
    return {
        "strain": history.strain,
        "strain rate": rate,
        "stress": history.stress,
        "stress rate": np.gradient(history.stress, t),
        "accumulated plastic strain": history.accumulated,
        "plastic strain rate": flow,
        "temperature rise": history.theta - history.theta[0],
        "sense of strain": np.sign(rate) * (np.abs(rate) > 0.05 * np.abs(rate).max()),
    }


def lumped(time: np.ndarray, power: np.ndarray, c0: float, tau: float) -> np.ndarray:
    """Temperature (n, m) K above the air of a coupon that gets the power (n, m) mW/mm^3, straight between samples: c0 (T' + T/tau) = q."""
    out = np.zeros_like(power)
    for n, dt in enumerate(np.diff(time)):
        decay, lost = np.exp(-dt / tau), -np.expm1(-dt / tau)
        held = lost * tau / dt
        out[n + 1] = out[n] * decay + 0.5 * (power[n] + power[n + 1]) * dt * held / c0
    return out


def smooth_step(z: np.ndarray) -> np.ndarray:
    """From 0 to 1 around z = 0, algebraic, so that no argument overflows."""
    return np.asarray(0.5 + 0.5 * z / np.sqrt(1.0 + z * z))


def yield_variable(history: PointHistory, variable: str) -> np.ndarray:
    """A state variable (n_t,) of a run that a yield stress may depend on."""
    if variable == "accumulated plastic strain":
        return history.accumulated
    if variable == "temperature":
        return history.theta
    rate = np.append(0.0, np.diff(history.accumulated) / np.diff(history.time))
    return np.asarray(np.log(1e-12 + np.maximum(rate, 0.0)))
