"""Equilibrium of one load level: Newton with a kept factor, line search, and a clear failure.

The factor of an earlier iteration or step is used again while the residual falls by a factor of four; otherwise the tangent
is formed at the current iterate. Nothing here commits state: old state in, new state out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.fem.body import FIXED, LOADED, Body
from thermofit.fem.element import element_pass
from thermofit.fem.linear import Factor, scatter
from thermofit.material.law import Law
from thermofit.material.point import N_STATE

_KEEP = 0.25
_KEPT_DECREASE = 0.9
_UPHILL = 100.0
"""Factor by which the residual may rise in a full step that leads from the elastic tangent to the plastic one."""
_MAX_UPHILL = 3
_FLOOR_STRESS = 0.1
"""MPa; stress whose nodal forces bound the residual from below where the body is (nearly) unloaded."""


@dataclass(frozen=True)
class NewtonSettings:
    """Relative residual at which equilibrium is accepted, iteration and backtracking limits."""

    tolerance: float = 1e-7
    max_iterations: int = 40
    max_backtracks: int = 6


@dataclass(frozen=True)
class Equilibrium:
    """Solution of one load level: u (n_np, 3) mm, point states (n_el, 8, 11), J (n_el, 8), force on the top end (model) N."""

    u: np.ndarray
    state: np.ndarray
    dilatation: np.ndarray
    top_force: float
    iterations: int
    residuals: tuple[float, ...]


@dataclass(frozen=True)
class _Level:
    """What is given for one load level: temperature, old state, load; and the buffers of the new state and of J."""

    theta: np.ndarray
    state_n: np.ndarray
    load: float
    state: np.ndarray
    dilatation: np.ndarray


@dataclass(frozen=True)
class _Iterate:
    """u (n_np, 3), its residual (n_eq,) N, the norm of it (infinite where an element failed) and the scale of the forces."""

    u: np.ndarray
    residual: np.ndarray
    norm: float
    scale: float


class Equilibrator:
    """Buffers and the last factor for one body and law; `solve` itself is free of side effects on physical state."""

    def __init__(self, body: Body, law: Law, settings: NewtonSettings) -> None:
        self.body, self.law, self.settings = body, law, settings
        n_el = body.mesh.n_elements
        self._force = np.empty((n_el, 24))
        self._stiffness = np.empty((n_el, 24, 24))
        self._factor: Factor | None = None
        flat = body.element_equation.ravel()
        self._used = np.flatnonzero(flat >= 0)
        self._equation = flat[self._used]
        self._top = np.flatnonzero(np.isin(body.mesh.hexes, body.loaded).ravel())
        size = float(body.data.volume.sum()) ** (2.0 / 3.0) / n_el ** (1.0 / 6.0)
        self._floor = _FLOOR_STRESS * size
        self._uphill_steps = 0
        self.factorisations = 0
        self.passes = 0

    def forget(self) -> None:
        """Drop the kept factor, for example after a load reversal."""
        self._factor = None

    def solve(
        self, u_start: np.ndarray, theta: np.ndarray, state_n: np.ndarray, load: float, *, fresh: bool = False, loose: float = 1.0
    ) -> Equilibrium:
        """Equilibrium under `load`: N on the top end of the model (force control) or mm (displacement control).

        theta (n_np,) K is given; `loose` multiplies the tolerance (for sweeps whose temperature is still an estimate).
        NumericsError where it is not found; the caller may cut the step.
        """
        tolerance = loose * self.settings.tolerance
        level = _Level(theta, state_n, load, np.empty_like(state_n), np.empty(state_n.shape[:2]))
        if fresh:
            self._factor = None
        exact = self._factor is None
        here = self._evaluate(self._admissible(u_start, load), level, tangent=exact)
        if not np.isfinite(here.norm):
            raise NumericsError(
                "equilibrium: the start of the Newton iteration is not admissible (inverted element or too large a plastic step)"
            )
        norms: list[float] = [here.norm]
        self._uphill_steps = 0
        for iteration in range(self.settings.max_iterations):
            if here.norm <= tolerance * here.scale:
                return Equilibrium(here.u, level.state, level.dilatation, self._top_force(), iteration, tuple(norms))
            if self._factor is None:
                here = self._evaluate(here.u, level, tangent=True)
                exact = True
            there = self._search(here, self._step(here), level, backtrack=exact)
            if there is None and exact:
                raise NumericsError(
                    f"equilibrium: the line search failed at relative residual {here.norm / here.scale:.1e} in iteration {iteration + 1}"
                )
            if there is None:
                self._factor = None
                continue
            if there.norm > _KEEP * here.norm:
                self._factor = None
            exact, here = False, there
            norms.append(here.norm)
        raise NumericsError(
            f"equilibrium: no convergence in {self.settings.max_iterations} iterations, relative residual {here.norm / here.scale:.1e}, "
            f"expected {tolerance:.0e}"
        )

    def _step(self, here: _Iterate) -> np.ndarray:
        """Change of u (n_np, 3) by the kept factor: zero where u is prescribed, one value where it is tied."""
        if self._factor is None:
            raise NumericsError("equilibrium: no tangent was formed")
        equation = self.body.equation
        x = self._factor.solve(-here.residual)
        return np.where(equation >= 0, x[np.maximum(equation, 0)], 0.0)

    def _admissible(self, u: np.ndarray, load: float) -> np.ndarray:
        """u with prescribed values: zero where fixed, the load where the top is displaced."""
        u = u.copy()
        u[self.body.equation == FIXED] = 0.0
        if self.body.top < 0:
            u[self.body.equation == LOADED] = load
        return u

    def _evaluate(self, u: np.ndarray, level: _Level, *, tangent: bool = False) -> _Iterate:
        """Residual at u, and the new point states in the buffers of the level; forms and factors the tangent if asked."""
        body = self.body
        self.passes += 1
        failed = element_pass(
            body.data, u, level.theta, level.state_n, self.law, tangent, self._force, self._stiffness, level.state, level.dilatation
        )
        if failed:
            return _Iterate(u, np.empty(0), float("inf"), 1.0)
        residual = np.bincount(self._equation, self._force.ravel()[self._used], minlength=body.n_equations)
        if body.top >= 0:
            residual[body.top] -= level.load
        if tangent:
            data = np.zeros(body.mechanical.n_slots)
            scatter(self._stiffness, body.mechanical_slot, data)
            self._factor = Factor(body.mechanical, data)
            self.factorisations += 1
        return _Iterate(u, residual, float(np.linalg.norm(residual)), max(float(np.linalg.norm(self._force)), self._floor))

    def _search(self, here: _Iterate, step: np.ndarray, level: _Level, *, backtrack: bool) -> _Iterate | None:
        """Backtracking on the residual norm: the accepted iterate, or None where no step length lowers the norm.

        With a kept factor only the full step is tried. Any decrease is enough with a fresh tangent. Where all points stand on the
        yield surface, the tangent is elastic and their answer plastic: no length lowers the residual, but the full step leads
        to where the tangent is plastic. It is taken, at most `_MAX_UPHILL` times.
        """
        length, uphill = 1.0, False
        enough = 1.0 if backtrack else _KEPT_DECREASE
        for _ in range(self.settings.max_backtracks if backtrack else 1):
            there = self._evaluate(here.u + length * step, level)
            if there.norm < enough * here.norm or there.norm <= self.settings.tolerance * there.scale:
                return there
            uphill |= length == 1.0 and there.norm < _UPHILL * here.norm
            length *= 0.5
        if not (backtrack and uphill and self._uphill_steps < _MAX_UPHILL):
            return None
        self._uphill_steps += 1
        return self._evaluate(here.u + step, level)

    def _top_force(self) -> float:
        """Internal force along y on the loaded end of the model, N."""
        return float(self._force.reshape(-1, 3)[self._top, 1].sum())


def virgin_state(n_elements: int) -> np.ndarray:
    """State (n_el, 8, 11) of a material that was never loaded: F_p = 1, alpha = Lambda = 0."""
    state = np.zeros((n_elements, 8, N_STATE))
    state[:, :, [0, 4, 8]] = 1.0
    return state
