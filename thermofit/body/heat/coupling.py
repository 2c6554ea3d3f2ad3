"""The heat equation of one time step, solved on iterates of its mechanics until both fields agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermofit.body.body import Body, thermal_geometry
from thermofit.body.heat.conduction import HeatConditions, HeatStep, expansion_capacity, heat_step, same_step, stored_heat
from thermofit.body.heat.equation import heat_of_increment, smallest_dissipation
from thermofit.body.heat.fixed_stress import STRONG, left_of
from thermofit.body.heat.sources import source_heat
from thermofit.body.heat.structure import structure_heat
from thermofit.body.sensitivity.march import StepEnds
from thermofit.body.solve.history import Balance, State, point_history, top_displacement
from thermofit.body.solve.newton import Equilibrium
from thermofit.core.errors import NumericsError
from thermofit.law.page import Law, law_in_step

_MOVED = 1e-6
"""Displacement, as a share of the specimen's length, after which conduction and films are formed anew within a step."""


class HeatOfStep:
    """Heat equation of the step from `start` to time t s, on whatever deformation and sources the mechanics has so far.

    Its geometry is formed on the first iterate and again where the body moved on. The temperature that goes back to the mechanics is
    relaxed by c0 / (c0 + 9 K alpha^2 theta_0): free expansion at constant stress takes the rest of the heat (fixed-stress split). Where
    that rest is large, conduction counts as well (`fixed_stress`).
    """

    def __init__(self, body: Body, law: Law, conditions: HeatConditions, start: State, when: tuple[float, str]) -> None:
        self._t, self._scheme = when
        self._body, self._law, self._conditions, self._start = body, law_in_step(law, self._t - start.time), conditions, start
        self._more = expansion_capacity(law)
        self._share, self._strong = conditions.c0 / (conditions.c0 + self._more), self._more > STRONG * conditions.c0
        self._before = point_history(start.points, start.dilatation)
        self._length = float(np.ptp(body.mesh.nodes[:, 1]))
        self._u: np.ndarray | None = None
        self._geometry = self._mean = start.geometry
        self._step: HeatStep | None = None
        self._source = 0.0
        self._added = np.zeros_like(self._before.alpha)

    def __call__(self, u: np.ndarray, points: np.ndarray, dilatation: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, float]:
        """Temperature (n_np,) K for the mechanics after an iterate, and how far it still is from the heat equation's answer, K."""
        change = self.solve(u, points, dilatation, theta) - theta
        return theta + self._eased(change), float(np.max(np.abs(change)))

    def _eased(self, change: np.ndarray) -> np.ndarray:
        """The part of a change of temperature (n_np,) K that the mechanics is given."""
        if not self._strong:
            return np.asarray(self._share * change)
        return left_of(self._body, self._solved, self._more, change)

    def solve(self, u: np.ndarray, points: np.ndarray, dilatation: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Temperature (n_np,) at the end of the step; theta (n_np,) K is the latest estimate of it."""
        body, start = self._body, self._start
        moved = self._u is None or float(np.max(np.abs(u - self._u))) > _MOVED * self._length
        if moved:
            self._u, self._geometry = u, thermal_geometry(body, u)
            self._mean = start.geometry.mean_with(self._geometry)
        heat = np.zeros(body.mesh.n_nodes)
        after = point_history(points, dilatation)
        self._middle = 0.5 * (start.theta + theta)
        self._released = heat_of_increment(body.data, self._before, after, self._middle, self._law, heat)
        if after.structure.size:
            self._added, *more = structure_heat(body.data, self._before, after, self._middle, start.theta, self._law, heat)
            self._released = (self._released[0] + more[0], self._released[1] + more[1])
        dt, first = self._t - start.time, start.time if self._conditions.moment is None else self._conditions.moment.first
        conditions = self._conditions.at(first, start.time, self._middle)
        flow = (self._before.accumulated, after.accumulated - self._before.accumulated)
        source = source_heat(body, conditions.effects, flow, conditions.moment, dt)
        if source is not None:
            heat += source
            self._source = float(source.sum())
        loads = None if self._step is None else self._step.loads
        if moved or self._step is None or (loads is not None and loads.linearised):
            self._step = heat_step(body, self._mean, conditions, start.theta, heat, (dt, self._scheme))
        else:
            self._step = same_step(body, replace(self._step, conditions=conditions), heat)
        return self._step.theta

    @property
    def _solved(self) -> HeatStep:
        if self._step is None:
            raise NumericsError("heat: the step ended before its heat equation was solved; use smaller steps")
        return self._step

    def finish(self, found: Equilibrium, load: float) -> tuple[State, Balance]:
        """State and energies at the end of the step."""
        body, start, step, s = self._body, self._start, self._solved, self._body.symmetry
        theta, geometry = step.theta, self._geometry
        state = State(self._t, load, found.u, theta, found.state, found.dilatation, geometry, found.top_force, found.direction)
        work = 0.5 * (start.top_force + found.top_force) * (top_displacement(body, found.u) - top_displacement(body, start.u))
        dissipated, elastic = self._released
        stored, plain = (stored_heat(body, self._conditions, start.theta, theta, c) for c in (step.capacity, None))
        balance = Balance(
            work=s * work,
            dissipated=s * dissipated,
            thermoelastic=s * elastic,
            outflow={name: s * value for name, value in step.outflow.items()},
            stored=s * stored,
            source=s * self._source,
            stored_by_effects=s * (stored - plain),
            smallest_dissipation=smallest_dissipation(
                self._before, point_history(found.state, found.dilatation), float(self._middle.mean()), self._law, self._added
            ),
        )
        return state, balance

    def ends(self, found: Equilibrium) -> StepEnds:
        """What the differentiation of the step needs of its heat equation."""
        start = self._start
        after = point_history(found.state, found.dilatation)
        return StepEnds(self._before, after, (start.u, found.u), (self._middle, start.theta), self._solved)
