"""What a march is asked for and what it leaves: settings, states, energies of the steps, and the history of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from thermofit.body.body import Body, ThermalGeometry
from thermofit.body.heat.equation import PointStates
from thermofit.body.sensitivity.march import Rates, Sensitivities
from thermofit.body.solve.newton import Direction, NewtonSettings
from thermofit.core.slots import Slots
from thermofit.point.state import ALPHA, LAMBDA, N_STATE

COUPLING_TOLERANCE = 1e-3
"""K; a tenth of the noise of an infrared camera. Both fields then agree some thirty times better: expansion takes 3 % of the heat."""


@dataclass(frozen=True)
class MarchSettings:
    """Numerics of a run; tolerances in K where they are temperatures.

    `model` is the hardening law, by number or name, or says with it which yield surface it is. `material_angle` turns the axes of the
    yield surface about the thickness axis z, in degrees: that between the rolling direction (axis 2 of the law) and the load. `max_step` s
    puts solution steps between the recorded times. A step is bisected `max_cuts` times at most, all of a run together once for every
    solution step and `all_cuts` times besides: a run that needs more takes many times as long, and hardly has a solution. `films` gives
    facet sets of the mesh their own (coefficient W/(m^2 K), medium temperature K), see `films.conditions_of`. `keep_energy` has the
    internal energy summed at every recorded time, for the first law.
    """

    newton: NewtonSettings = NewtonSettings()
    coupling: str = "full"
    coupling_tolerance: float = COUPLING_TOLERANCE
    max_coupling: int = 20
    heat_scheme: str = "sdirk2"
    max_cuts: int = 8
    all_cuts: int = 100
    model: int | str | Slots = 2
    closed_form: bool = True
    plastic: bool = True
    keep_points: bool = False
    keep_energy: bool = False
    material_angle: float = 0.0
    max_step: float = float("inf")
    films: Mapping[str, tuple[float, float]] = field(default_factory=dict)


DEFAULTS = MarchSettings()


@dataclass(frozen=True)
class Watch:
    """Who follows a march: `step(n)` is called at every recorded time after the first, `state(n, state)` at every one with all that the
    model knows there, `sensitivities` has every step differentiated."""

    step: Callable[[int], None] | None = None
    sensitivities: Sensitivities | None = None
    state: Callable[[int, State], None] | None = None


NOBODY = Watch()


@dataclass(frozen=True)
class State:
    """Everything that a step starts from; model units (quarter model where the body is one). `rates`: its derivatives, if asked for."""

    time: float
    load: float
    u: np.ndarray
    theta: np.ndarray
    points: np.ndarray
    dilatation: np.ndarray
    geometry: ThermalGeometry
    top_force: float
    direction: Direction | None = None
    rates: Rates | None = None


@dataclass(frozen=True)
class Balance:
    """Energies of one step for the whole specimen, mJ: work of the load, dissipated, thermoelastic, left through films, stored.

    `stored` is heat (heat capacity times temperature), `internal` the change of the law's internal energy, taken between recorded
    times (nan where the run did not keep it); with coupling "one-way" it has the heat capacity of constant stress, which stands for the
    expansion that is not solved for.
    `source` is set free by effects of slot heat_source, `stored_by_effects` the part of `stored` that a changed heat capacity takes.
    """

    work: float
    dissipated: float
    thermoelastic: float
    outflow: dict[str, float]
    stored: float
    smallest_dissipation: float
    internal: float = float("nan")
    source: float = 0.0
    stored_by_effects: float = 0.0

    @property
    def heat_defect(self) -> float:
        """Stored heat minus what was released and did not leave; zero up to the linear solver."""
        return self.stored - (self.dissipated + self.thermoelastic + self.source - sum(self.outflow.values()))

    @property
    def first_law_defect(self) -> float:
        """Change of internal energy minus work and heat that came in; falls with the square of the step in smooth phases, more slowly
        while points begin to flow (docs/theory.md)."""
        return self.internal + self.stored_by_effects - self.source - (self.work - sum(self.outflow.values()))


@dataclass(frozen=True)
class History:
    """Result of a run at its step times: time s (n_t,), u mm (n_t, n_np, 3), theta K (n_t, n_np), force N (n_t,), u_top mm (n_t,).

    `points` holds the point histories if they were kept; `balance` one entry per step after the first.
    """

    time: np.ndarray
    u: np.ndarray
    theta: np.ndarray
    force: np.ndarray
    u_top: np.ndarray
    largest_multiplier: np.ndarray
    plastic_points: np.ndarray
    balance: tuple[Balance, ...]
    points: tuple[PointStates, ...] = ()
    counts: dict[str, int] = field(default_factory=dict)

    def total(self, name: str) -> float:
        """Sum of one scalar energy over all steps, mJ."""
        return float(sum(getattr(step, name) for step in self.balance))


@dataclass(frozen=True)
class KeptState:
    """What is kept of a state that is passed."""

    time: float
    u: np.ndarray
    theta: np.ndarray
    top_force: float
    largest_multiplier: float
    plastic_points: int
    points: PointStates | None


def point_history(points: np.ndarray, dilatation: np.ndarray) -> PointStates:
    """What the heat sources need of point states (n_el, 8, 11) and J (n_el, 8)."""
    plain = PointStates(dilatation, np.ascontiguousarray(points[:, :, ALPHA]), np.ascontiguousarray(points[:, :, LAMBDA]))
    return plain if points.shape[2] == N_STATE else plain._replace(structure=np.ascontiguousarray(points[:, :, N_STATE:]))


def recorded(body: Body, state: State, settings: MarchSettings) -> KeptState:
    """Record of a state."""
    accumulated = state.points[:, :, LAMBDA]
    points = point_history(state.points, state.dilatation) if settings.keep_points else None
    return KeptState(
        state.time, state.u, state.theta, state.top_force * body.symmetry, float(accumulated.max()), int((accumulated > 0.0).sum()), points
    )


def top_displacement(body: Body, u: np.ndarray) -> float:
    """u_y of the loaded end, mm."""
    return float(u[body.loaded[0], 1])


def added(first: Balance, second: Balance) -> Balance:
    """Energies of two steps together."""
    return Balance(
        first.work + second.work,
        first.dissipated + second.dissipated,
        first.thermoelastic + second.thermoelastic,
        {name: first.outflow[name] + second.outflow[name] for name in first.outflow},
        first.stored + second.stored,
        min(first.smallest_dissipation, second.smallest_dissipation),
        source=first.source + second.source,
        stored_by_effects=first.stored_by_effects + second.stored_by_effects,
    )


def history(body: Body, records: list[KeptState], balances: tuple[Balance, ...], counts: dict[str, int]) -> History:
    """History of recorded states."""
    return History(
        time=np.array([r.time for r in records]),
        u=np.array([r.u for r in records]),
        theta=np.array([r.theta for r in records]),
        force=np.array([r.top_force for r in records]),
        u_top=np.array([top_displacement(body, r.u) for r in records]),
        largest_multiplier=np.array([r.largest_multiplier for r in records]),
        plastic_points=np.array([r.plastic_points for r in records]),
        balance=balances,
        points=tuple(r.points for r in records if r.points is not None),
        counts=counts,
    )
