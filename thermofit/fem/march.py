"""March in time: mechanics and heat, step by step; the only place where state is committed.

`coupling` "full" iterates both fields of a step until the temperature stands still (staggered); "one-way" solves the mechanics
at the initial temperature and the heat equation, with the heat capacity of constant stress, on the deformation and dissipation
that follow from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import Parameters
from thermofit.fem.body import Body, ThermalGeometry, thermal_geometry
from thermofit.fem.conduction import HeatConditions, at_constant_stress, heat_conditions, heat_step, steady_temperature, stored_heat
from thermofit.fem.heat import PointHistory, heat_of_increment, smallest_dissipation
from thermofit.fem.linear import multiply_symmetric
from thermofit.fem.newton import Equilibrator, Equilibrium, NewtonSettings, virgin_state
from thermofit.material.law import Law, law_of
from thermofit.material.point import ALPHA, LAMBDA

_FIRST_SWEEP = 1e3
"""Looser equilibrium of the first sweep of a coupled step, whose temperature is an extrapolation."""


@dataclass(frozen=True)
class MarchSettings:
    """Numerics of a run; tolerances in K where they are temperatures."""

    newton: NewtonSettings = NewtonSettings()
    coupling: str = "full"
    coupling_tolerance: float = 1e-3
    max_coupling: int = 20
    heat_scheme: str = "sdirk2"
    max_cuts: int = 8
    model: int = 2
    closed_form: bool = True
    plastic: bool = True
    keep_points: bool = False


@dataclass(frozen=True)
class Loading:
    """What drives the loaded end: total force in N, or its displacement in mm, piecewise linear over time s.

    A displacement counts from the stress-free reference state, or `from_rest` from the resting specimen, which its temperature has
    already lengthened.
    """

    time: np.ndarray
    value: np.ndarray
    control: str = "force"
    from_rest: bool = False

    def at(self, t: float) -> float:
        """Value at time t."""
        return float(np.interp(t, self.time, self.value))


@dataclass(frozen=True)
class State:
    """Everything that a step starts from; model units (quarter model where the body is one)."""

    time: float
    load: float
    u: np.ndarray
    theta: np.ndarray
    points: np.ndarray
    dilatation: np.ndarray
    geometry: ThermalGeometry
    top_force: float


@dataclass(frozen=True)
class Balance:
    """Energies of one step for the whole specimen, mJ: work of the load, dissipated, thermoelastic, left through films, stored."""

    work: float
    dissipated: float
    thermoelastic: float
    outflow: dict[str, float]
    stored: float
    smallest_dissipation: float

    @property
    def heat_defect(self) -> float:
        """Stored heat minus what was released and did not leave; zero up to the linear solver."""
        return self.stored - (self.dissipated + self.thermoelastic - sum(self.outflow.values()))


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
    points: tuple[PointHistory, ...] = ()
    counts: dict[str, int] = field(default_factory=dict)

    def total(self, name: str) -> float:
        """Sum of one scalar energy over all steps, mJ."""
        return float(sum(getattr(step, name) for step in self.balance))


def march(
    body: Body,
    parameters: Parameters,
    loading: Loading,
    times: np.ndarray,
    settings: MarchSettings = MarchSettings(),
    on_step: Callable[[int], None] | None = None,
) -> History:
    """Solve the coupled boundary value problem at the increasing `times` s (n_t,); the first is the state at rest.

    NumericsError where a step fails even after `max_cuts` bisections; the message names the time.
    """
    if len(times) < 2 or np.any(np.diff(times) <= 0.0):
        raise StudyError("march: at least two increasing times are needed; check the evaluation times of the study")
    if (loading.control == "force") != (body.top >= 0):
        raise StudyError(
            f"march: the loading prescribes a {loading.control}, but the body was made for the other control; use one control for both"
        )
    law = law_of(parameters, settings.model, closed_form=settings.closed_form, plastic=settings.plastic)
    conditions = heat_conditions(parameters)
    if settings.coupling == "one-way":
        conditions = at_constant_stress(conditions, law)
    run = _Run(body, law, conditions, loading, settings)
    start = run.initial(float(times[0]))
    past: tuple[_Passed, ...] = ()
    records, balances = [_record(body, start, settings)], []
    for n, t in enumerate(times[1:], start=1):
        state, balance = run.advance(start, past, float(t), 0)
        past, start = (_passed(start), *past[:1]), state
        records.append(_record(body, state, settings))
        balances.append(balance)
        if on_step is not None:
            on_step(n)
    return _history(body, records, tuple(balances), run)


@dataclass(frozen=True)
class _Passed:
    """What extrapolation needs of a state before the current one: time s, load, u mm, theta K."""

    time: float
    load: float
    u: np.ndarray
    theta: np.ndarray


def _passed(state: State) -> _Passed:
    return _Passed(state.time, state.load, state.u, state.theta)


@dataclass(frozen=True)
class _Record:
    """What is kept of a state that is passed."""

    time: float
    u: np.ndarray
    theta: np.ndarray
    top_force: float
    largest_multiplier: float
    plastic_points: int
    points: PointHistory | None


def _point_history(points: np.ndarray, dilatation: np.ndarray) -> PointHistory:
    return PointHistory(dilatation, np.ascontiguousarray(points[:, :, ALPHA]), np.ascontiguousarray(points[:, :, LAMBDA]))


def _record(body: Body, state: State, settings: MarchSettings) -> _Record:
    accumulated = state.points[:, :, LAMBDA]
    points = _point_history(state.points, state.dilatation) if settings.keep_points else None
    return _Record(
        state.time, state.u, state.theta, state.top_force * body.symmetry, float(accumulated.max()), int((accumulated > 0.0).sum()), points
    )


class _Run:
    """One march: body, law, conditions and the solver with its buffers."""

    def __init__(self, body: Body, law: Law, conditions: HeatConditions, loading: Loading, settings: MarchSettings) -> None:
        self.body, self.law, self.conditions, self.loading, self.settings = body, law, conditions, loading, settings
        self.solver = Equilibrator(body, law, settings.newton)
        self.factor = body.symmetry if loading.control == "force" else 1.0
        self.iterations = 0
        self.cuts = 0
        self.resting_temperature = np.empty(0)
        self.rest_displacement = 0.0

    def load(self, t: float) -> float:
        """Load of the model at time t: its share of the force, or the displacement."""
        return self.loading.at(t) / self.factor + self.rest_displacement

    def initial(self, t: float) -> State:
        """Equilibrium at the steady temperature of the resting specimen (5.2.2)."""
        body = self.body
        u = np.zeros((body.mesh.n_nodes, 3))
        theta = steady_temperature(body, thermal_geometry(body, u), self.conditions)
        self.resting_temperature = theta
        if self.loading.control == "displacement" and self.loading.from_rest:
            self.rest_displacement = self.law.alpha_exp * _mean(body, theta - self.law.theta_ref) * float(np.ptp(body.mesh.nodes[:, 1]))
        load = self.load(t)
        found = self.solver.solve(u, theta, virgin_state(body.mesh.n_elements), load)
        geometry = thermal_geometry(body, found.u)
        return State(t, load, found.u, theta, found.state, found.dilatation, geometry, found.top_force)

    def advance(self, start: State, past: tuple[_Passed, ...], t: float, depth: int) -> tuple[State, Balance]:
        """One step to time t; bisected where it fails."""
        try:
            return self._step(start, past, t)
        except NumericsError as err:
            self.solver.forget()
            if depth >= self.settings.max_cuts:
                raise NumericsError(
                    f"time step to t = {t:.4g} s failed after {depth} bisections ({err}); check loads and starts, or allow smaller steps"
                ) from err
        self.cuts += 1
        middle, first = self.advance(start, (), 0.5 * (start.time + t), depth + 1)
        end, second = self.advance(middle, (), t, depth + 1)
        return end, _added(first, second)

    def _guess(self, start: State, past: tuple[_Passed, ...], t: float, load: float) -> tuple[np.ndarray, np.ndarray, bool]:
        """Extrapolated u and theta, and whether a fresh tangent is needed.

        Quadratic in time through the last three states where the load went on in the same sense over all of them, linear through
        two, the state itself (and a fresh tangent) after a change of the programme.
        """
        points = [_passed(start)]
        rate = (load - start.load) / (t - start.time)
        for before in past:
            last = points[-1]
            if not _goes_on((last.load - before.load) / (last.time - before.time), rate):
                break
            points.append(before)
        if len(points) == 1:
            return start.u, start.theta, True
        weights = _lagrange([p.time for p in points], t)
        u = sum((w * p.u for w, p in zip(weights, points, strict=True)), np.zeros_like(start.u))
        theta = sum((w * p.theta for w, p in zip(weights, points, strict=True)), np.zeros_like(start.theta))
        return u, theta, False

    def _step(self, start: State, past: tuple[_Passed, ...], t: float) -> tuple[State, Balance]:
        settings, load = self.settings, self.load(t)
        u, theta, fresh = self._guess(start, past, t, load)
        if settings.coupling == "one-way":
            found = self._mechanics(u, self.resting_temperature, start, load, (fresh, 1.0))
            return self._heat(start, found, start.theta, t, load)
        loose = _FIRST_SWEEP
        for _ in range(settings.max_coupling):
            found = self._mechanics(u, theta, start, load, (fresh, loose))
            state, balance = self._heat(start, found, theta, t, load)
            change = float(np.max(np.abs(state.theta - theta)))
            if change <= settings.coupling_tolerance and loose == 1.0:
                return state, balance
            u, theta, fresh, loose = found.u, state.theta, False, 1.0
        raise NumericsError(f"coupling: temperature still changes by {change:.1e} K after {settings.max_coupling} sweeps")

    def _mechanics(self, u: np.ndarray, theta: np.ndarray, start: State, load: float, how: tuple[bool, float]) -> Equilibrium:
        """Equilibrium from the guess u, or from the start of the step where the guess leads nowhere; how = (fresh tangent, looseness)."""
        fresh, loose = how
        try:
            found = self.solver.solve(u, theta, start.points, load, fresh=fresh, loose=loose)
        except NumericsError:
            if fresh and u is start.u:
                raise
            found = self.solver.solve(start.u, theta, start.points, load, fresh=True, loose=loose)
        self.iterations += found.iterations
        return found

    def _heat(self, start: State, found: Equilibrium, theta: np.ndarray, t: float, load: float) -> tuple[State, Balance]:
        """Heat equation of the step on the deformation found; theta is the latest estimate of the temperature at its end."""
        body, law, conditions = self.body, self.law, self.conditions
        geometry = thermal_geometry(body, found.u)
        before = _point_history(start.points, start.dilatation)
        after = _point_history(found.state, found.dilatation)
        heat = np.zeros(body.mesh.n_nodes)
        dissipated, elastic = heat_of_increment(body.data, before, after, 0.5 * (start.theta + theta), law, heat)
        step = heat_step(
            body, start.geometry.mean_with(geometry), conditions, start.theta, heat, (t - start.time, self.settings.heat_scheme)
        )
        state = State(t, load, found.u, step.theta, found.state, found.dilatation, geometry, found.top_force)
        s = body.symmetry
        work = 0.5 * (start.top_force + found.top_force) * (_top(body, found.u) - _top(body, start.u))
        balance = Balance(
            work=s * work,
            dissipated=s * dissipated,
            thermoelastic=s * elastic,
            outflow={name: s * value for name, value in step.outflow.items()},
            stored=s * stored_heat(body, conditions, start.theta, step.theta),
            smallest_dissipation=smallest_dissipation(before, after, law),
        )
        return state, balance


def _goes_on(before: float, now: float) -> bool:
    """True where a load rate is that of the same phase of the programme: same sign, less than three times apart (or both zero)."""
    if before == 0.0 or now == 0.0:
        return before == now
    return 1.0 / 3.0 < now / before < 3.0


def _lagrange(times: list[float], t: float) -> list[float]:
    """Weights of the polynomial through `times` at t."""
    return [float(np.prod([(t - b) / (a - b) for b in times if b != a])) for a in times]


def _mean(body: Body, theta: np.ndarray) -> float:
    """Volume mean of a nodal field (n_np,)."""
    p = body.thermal
    return float(multiply_symmetric(p.row, p.column, body.capacity, theta).sum() / body.data.volume.sum())


def _top(body: Body, u: np.ndarray) -> float:
    return float(u[body.loaded[0], 1])


def _added(first: Balance, second: Balance) -> Balance:
    return Balance(
        first.work + second.work,
        first.dissipated + second.dissipated,
        first.thermoelastic + second.thermoelastic,
        {name: first.outflow[name] + second.outflow[name] for name in first.outflow},
        first.stored + second.stored,
        min(first.smallest_dissipation, second.smallest_dissipation),
    )


def _history(body: Body, records: list[_Record], balances: tuple[Balance, ...], run: _Run) -> History:
    counts = {
        "steps": len(records) - 1,
        "newton_iterations": run.iterations,
        "factorisations": run.solver.factorisations,
        "element_passes": run.solver.passes,
        "bisections": run.cuts,
    }
    return History(
        time=np.array([r.time for r in records]),
        u=np.array([r.u for r in records]),
        theta=np.array([r.theta for r in records]),
        force=np.array([r.top_force for r in records]),
        u_top=np.array([_top(body, r.u) for r in records]),
        largest_multiplier=np.array([r.largest_multiplier for r in records]),
        plastic_points=np.array([r.plastic_points for r in records]),
        balance=balances,
        points=tuple(r.points for r in records if r.points is not None),
        counts=counts,
    )
