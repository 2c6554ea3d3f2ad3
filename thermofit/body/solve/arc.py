"""Equilibrium along its path: the load is an unknown too, and the step has a given arc length instead of a given load.

Beyond the load maximum no force is an equilibrium, beyond a snap-back no end displacement; the path itself goes on. The arc
length of a step that changes u by du and the force by dF is

    s^2 = (1/V) int |du|^2 dV + (dF / k)^2        in mm^2,

k the elastic stiffness of the loaded end in N/mm: Crisfield's sphere, consistently linearised (Schweizerhof and Wriggers 1986), so
that Newton's quadratic convergence stays. With x_r = -K^-1 r and x_q = K^-1 q (q: unit force on the end) from one factor, the change
of the force follows from the linearised constraint, that of u is x_r + dF x_q.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermofit.body.body import Body
from thermofit.body.solve.linear import multiply_symmetric
from thermofit.body.solve.newton import Direction, Equilibrator, Equilibrium, LoadLevel, NewtonSettings
from thermofit.core.errors import NumericsError, StudyError
from thermofit.law.page import Law

_LENGTH_TOLERANCE = 1e-9
"""Relative error of the arc length at which the constraint counts as met."""


@dataclass(frozen=True)
class PathPoint:
    """A state on the path: u (n_np, 3) mm, force on the end (model) N, and the direction in which it was reached (None: at rest)."""

    u: np.ndarray
    force: float
    direction: Direction | None


class PathFollower(Equilibrator):
    """An Equilibrator that also steps along the path; the body is one under force control. StudyError for another."""

    def __init__(self, body: Body, law: Law, settings: NewtonSettings) -> None:
        super().__init__(body, law, settings)
        if body.top < 0:
            raise StudyError("arc control: the body was made for displacement control; make it for force control")
        p = body.thermal
        self._weight = multiply_symmetric(p.row, p.column, body.capacity, np.ones(body.mesh.n_nodes)) / body.data.volume.sum()
        self._pull = np.zeros(body.n_equations)
        self._pull[body.top] = 1.0
        self._end_stiffness = 0.0

    def follow(self, start: PathPoint, theta: np.ndarray, state_n: np.ndarray, length: float) -> Equilibrium:
        """Equilibrium at the arc length `length` mm from `start`: on along the path, back where it is negative.

        theta (n_np,) K is given, state_n (n_el, 8, 11) is the state at `start`. NumericsError where it is not found; the caller
        may cut the step.
        """
        level = LoadLevel(theta, state_n, start.force, np.empty_like(state_n), np.empty(state_n.shape[:2]))
        direction = start.direction or self._elastic_direction(start, level)
        du, force_change = length * direction.u, length * direction.force
        norms: list[float] = []
        for iteration in range(self.settings.max_iterations):
            level = replace(level, load=start.force + force_change)
            here = self._evaluate(start.u + du, level, tangent=True)
            if not np.isfinite(here.norm) or self._factor is None:
                raise NumericsError("arc control: an element is inverted or its plastic step too large; use shorter arc lengths")
            norms.append(here.norm)
            excess = self._product(du, du) + (force_change / self._end_stiffness) ** 2 - length**2
            if here.norm <= self.settings.tolerance * here.scale and abs(excess) <= _LENGTH_TOLERANCE * length**2:
                if length * self._along(direction, du, force_change) < 0.0:
                    raise NumericsError("arc control: the path was found in the wrong sense; use shorter arc lengths")
                onward = Direction(du / length, force_change / length)
                return Equilibrium(here.u, level.state, level.dilatation, self._top_force(), iteration, tuple(norms), onward)
            x = self._factor.solve(np.stack([-here.residual, self._pull], axis=1))
            rest, pull = self._nodal(x[:, 0]), self._nodal(x[:, 1])
            slope = self._product(du, pull) + force_change / self._end_stiffness**2
            d_force = -(0.5 * excess + self._product(du, rest)) / slope
            du = du + rest + d_force * pull
            force_change += d_force
        raise NumericsError(
            f"arc control: no convergence in {self.settings.max_iterations} iterations, relative residual {here.norm / here.scale:.1e}"
        )

    def _elastic_direction(self, start: PathPoint, level: LoadLevel) -> Direction:
        """Direction of a growing force at the state of rest; the stiffness of the end is taken there."""
        self._evaluate(start.u, level, tangent=True)
        if self._factor is None:
            raise NumericsError("arc control: the state of rest is not admissible")
        pull = self._factor.solve(self._pull)
        self._end_stiffness = 1.0 / float(pull[self.body.top])
        u = self._nodal(pull)
        length = float(np.sqrt(self._product(u, u) + self._end_stiffness**-2))
        return Direction(u / length, 1.0 / length)

    def _along(self, direction: Direction, du: np.ndarray, force_change: float) -> float:
        return self._product(direction.u, du) + direction.force * force_change / self._end_stiffness**2

    def _product(self, a: np.ndarray, b: np.ndarray) -> float:
        """(1/V) int a . b dV of nodal fields (n_np, 3), by lumped volumes."""
        return float(self._weight @ np.einsum("ni,ni->n", a, b))
