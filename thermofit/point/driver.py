"""Drive a material point through a measured history of strain or stress: its history, and derivatives by any parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import Parameters, param
from thermofit.core.slots import Slots
from thermofit.effects.catalogue import Effect, effects
from thermofit.law.bounds import check_beta
from thermofit.law.composition import CAPACITIES
from thermofit.law.page import law_of
from thermofit.law.page_rates import N_NUMBERS, NUMBERS, STEP, number_rates
from thermofit.point.solve import AIR, FLAGS_OF, LAG, N_ALL, START, TAU, Flags, Limits, run
from thermofit.point.step import N_STATE, STATE

CHANNELS: tuple[str, ...] = (
    "strain", "stress", "lateral_x", "lateral_z", "theta", "theta_sensor", "alpha", "accumulated", "dissipated", "thermoelastic",
)  # fmt: skip
"""What a PointHistory holds of the state."""


@dataclass(frozen=True)
class Programme:
    """What a coupon is driven by: increasing `time` s (n_t,) and nominal `value` (n_t,), strain or, where `by_stress` (n_t,), MPa.

    An entry of `by_stress` says what its value is and how the interval that ends there is driven. A first value that is not zero is
    reached in a step as long as the first interval. `theta_start` K: temperature at the start, None for that of the air. `theta` K (n_t,):
    the temperature was measured, and the heat balance takes no part; None: it is computed.
    """

    time: np.ndarray
    value: np.ndarray
    by_stress: np.ndarray
    theta_start: float | None = None
    theta: np.ndarray | None = None

    @staticmethod
    def by_strain(time: np.ndarray, strain: np.ndarray, theta_start: float | None = None) -> Programme:
        """Strain control throughout."""
        return Programme(time, strain, np.zeros(len(time), dtype=bool), theta_start)

    @staticmethod
    def under_stress(time: np.ndarray, stress: np.ndarray, theta_start: float | None = None) -> Programme:
        """Stress control throughout; stress in MPa."""
        return Programme(time, stress, np.ones(len(time), dtype=bool), theta_start)

    def check(self) -> None:
        """StudyError where the history is too short, not finite, not increasing in time, or compresses to nothing."""
        n = len(self.time)
        if n < 2 or len(self.value) != n or len(self.by_stress) != n or (self.theta is not None and len(self.theta) != n):
            raise StudyError(f"coupon: {n} times and {len(self.value)} values found; expected as many, and at least two")
        late = np.flatnonzero(~(np.diff(self.time) > 0.0))
        if len(late):
            k = int(late[0])
            raise StudyError(f"coupon: time {self.time[k + 1]:g} s follows {self.time[k]:g} s; expected increasing times")
        bad = np.flatnonzero(~np.isfinite(self.value) | (~self.by_stress & (self.value <= -1.0)))
        if len(bad):
            k = int(bad[0])
            raise StudyError(
                f"coupon: the prescribed value at {self.time[k]:g} s is {self.value[k]:g}; expected a strain above -1 or a stress"
            )


@dataclass(frozen=True)
class PointSettings:
    """Numerics of a run: `model`, the hardening law by number or name, or with the yield surface (`core.slots.Slots`); closed form or
    backward Euler of alpha (model 2), plasticity at all; the largest change of the nominal strain in one step, and how often the steps of
    an interval may be halved."""

    model: int | str | Slots = 2
    closed_form: bool = True
    plastic: bool = True
    max_strain: float = 0.01
    max_cuts: int = 12


DEFAULTS = PointSettings()
_AT_ONCE = 1e-6
"""Time constant of the exchange of heat, over the shortest step, where the temperature is prescribed."""


@dataclass(frozen=True)
class PointHistory:
    """A run at the times of its programme, each (n_t,): time s, nominal strain and stress MPa, lateral strain in x and z, temperature of
    specimen and sensor K, alpha, Lambda, heat released so far in mJ/mm^3 by plastic flow and by elastic deformation; `counts`: steps,
    halvings, Newton iterations."""

    time: np.ndarray
    strain: np.ndarray
    stress: np.ndarray
    lateral_x: np.ndarray
    lateral_z: np.ndarray
    theta: np.ndarray
    theta_sensor: np.ndarray
    alpha: np.ndarray
    accumulated: np.ndarray
    dissipated: np.ndarray
    thermoelastic: np.ndarray
    states: np.ndarray
    counts: dict[str, int]

    def every(self, n: int) -> PointHistory:
        """The history at every n-th of its times."""
        arrays = {f.name: getattr(self, f.name)[::n] for f in fields(self) if f.name != "counts"}
        return PointHistory(counts=self.counts, **arrays)


@dataclass(frozen=True)
class PointRates:
    """Derivatives of a history by named parameters: `rates` (n_t, N_STATE, n_p)."""

    names: tuple[str, ...]
    rates: np.ndarray

    def __getitem__(self, channel: str) -> np.ndarray:
        """Derivatives (n_t, n_p) of a channel of the history."""
        return np.asarray(self.rates[:, STATE.index(channel), :])


def simulate(parameters: Parameters, programme: Programme, settings: PointSettings = DEFAULTS) -> PointHistory:
    """The history of a point. NumericsError names the time that is not reached; StudyError where the programme cannot be meant."""
    return _run(parameters, (), programme, settings)[0]


def simulate_rates(
    parameters: Parameters, names: Sequence[str], programme: Programme, settings: PointSettings = DEFAULTS
) -> tuple[PointHistory, PointRates]:
    """The history and its exact derivatives by the named parameters; errors as `simulate`."""
    history, rates = _run(parameters, tuple(names), programme, settings)
    return history, PointRates(tuple(names), rates)


def run_numbers(
    parameters: Parameters, names: tuple[str, ...], programme: Programme, settings: PointSettings
) -> tuple[np.ndarray, np.ndarray, Flags]:
    """Numbers (N_ALL,) of a run, their derivatives (N_ALL, n_p) by the named parameters, and the flags of the law."""
    law = law_of(parameters, settings.model, closed_form=settings.closed_form, plastic=settings.plastic)
    numbers, along = np.zeros(N_ALL), np.zeros((N_ALL, len(names)))
    numbers[:N_NUMBERS] = [getattr(law, name, 0.0) for name in NUMBERS]
    along[:N_NUMBERS] = number_rates(parameters, names, law)
    places = {TAU: "tau", LAG: "lag", AIR: "theta_air"} | ({START: "theta_air"} if programme.theta_start is None else {})
    for place, name in places.items():
        numbers[place] = parameters[name]
        along[place] = [float(other == name) for other in names]
    if programme.theta_start is not None:
        numbers[START] = programme.theta_start
    effective = law.effective or int(any(parameters[name] != param(name).neutral for name in CAPACITIES))
    return numbers, along, FLAGS_OF[type(law)](law.model, law.closed_form, law.plastic, effective)


def air_effects() -> tuple[Effect, ...]:
    """Effects that change the temperature of the air: slot boundary_temperature on the facet set "air"."""
    return tuple(e for e in effects(("boundary_temperature",)) if "air" in e.on)


def warmer_air(parameters: Parameters, names: Sequence[str], time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """By how much the air is warmer (n_t,) K at times s (n_t,) of a record, by all effects of the air, and its derivatives (n_t, n_p) by
    the named parameters, by complex step. On a coupon there is one place: y = 0."""
    warmer, along = np.zeros(len(time)), np.zeros((len(time), len(names)))
    for e in air_effects():
        values = [parameters[name] for name in e.names]
        if e.is_on(parameters):
            warmer += np.real(_of_air(e, time, values))
        for k, name in enumerate(names):
            if name in e.names:
                moved = [complex(v, STEP * (n == name)) for n, v in zip(e.names, values, strict=True)]
                along[:, k] = np.imag(_of_air(e, time, moved)) / STEP
    return warmer, along


def _of_air(e: Effect, time: np.ndarray, values: Sequence[complex]) -> np.ndarray:
    """What an effect of the air does at all times (n_t,), K; a user's is called as the body calls it, at one time after another."""
    elapsed = time - time[0]
    if not e.of_user:
        return np.asarray(e.act(0.0 * time, time, elapsed, *values))
    return np.array([e.act(np.zeros(1), float(t), float(d), *values)[0] for t, d in zip(time, elapsed, strict=True)])


def _run(parameters: Parameters, names: tuple[str, ...], programme: Programme, settings: PointSettings) -> tuple[PointHistory, np.ndarray]:
    programme.check()
    check_beta(parameters)
    numbers, along, flags = run_numbers(parameters, names, programme, settings)
    n = len(programme.time)
    states, counts = np.zeros((n, N_STATE)), np.zeros(3, dtype=np.int64)
    rates = np.zeros((n if names else 0, N_STATE, len(names)))
    time, value = np.ascontiguousarray(programme.time, dtype=float), np.ascontiguousarray(programme.value, dtype=float)
    limits = Limits(float(settings.max_strain), int(settings.max_cuts))
    by_stress = np.ascontiguousarray(programme.by_stress, dtype=np.bool_)
    warmer, warmer_along = warmer_air(parameters, names, time)
    if programme.theta is not None:
        # A specimen that follows its surroundings at once has the temperature that these are given.
        numbers[TAU], along[TAU] = _AT_ONCE * float(np.diff(time).min()), 0.0
        warmer, warmer_along = np.ascontiguousarray(programme.theta - numbers[AIR], dtype=float), np.zeros((n, len(names)))
        numbers[START], along[[AIR, START]] = float(programme.theta[0]), 0.0
    failed = run(time, value, by_stress, numbers, along, warmer, warmer_along, flags, limits, states, rates, counts)
    if failed >= 0:
        what = f"stress {value[failed]:g} MPa" if by_stress[failed] else f"strain {value[failed]:g}"
        raise NumericsError(
            f"material point: {what} at {time[failed]:g} s is not reached after {settings.max_cuts} halvings of the step; "
            "check the record there, and whether these parameters can reach it"
        )
    channels = {name: np.ascontiguousarray(states[:, STATE.index(name)]) for name in CHANNELS}
    cost = dict(zip(("steps", "halvings", "newton_iterations"), counts.tolist(), strict=True))
    return PointHistory(time=time, states=states, counts=cost, **channels), rates
