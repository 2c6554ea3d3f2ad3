"""Equilibrium of one load level: Newton with a kept factor, line search, and a clear failure.

The factor of an earlier iteration or step is used again while the residual falls by a factor of four; otherwise the tangent
is formed at the current iterate. Nothing here commits state: old state in, new state out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.fem.body import LOADED, Body
from thermofit.fem.element import element_pass
from thermofit.fem.linear import Factor, scatter
from thermofit.material.law import Law
from thermofit.material.point import N_STATE

_KEEP = 0.25
_KEPT_DECREASE = 0.9
_UPHILL = 100.0
"""Factor by which the residual may rise in a full step that leads from the elastic tangent to the plastic one."""
_MAX_UPHILL = 2
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


class Equilibrator:
    """Buffers and the last factor for one body and law; `solve` itself is free of side effects on physical state."""

    def __init__(self, body: Body, law: Law, settings: NewtonSettings) -> None:
        self.body, self.law, self.settings = body, law, settings
        n_el = body.mesh.n_elements
        self._force = np.empty((n_el, 24))
        self._stiffness = np.empty((n_el, 24, 24))
        self._factor: Factor | None = None
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
        if fresh:
            self._factor = None
        u = self._admissible(u_start, load)
        states = (state_n, np.empty_like(state_n), np.empty(state_n.shape[:2]))
        exact = self._factor is None
        norm, residual, scale = self._residual(u, theta, states, load, tangent=exact)
        if not np.isfinite(norm):
            raise NumericsError("equilibrium: the start of the Newton iteration is not admissible (inverted element or too large a plastic step)")
        norms = [norm]
        self._uphill_steps = 0
        for iteration in range(self.settings.max_iterations):
            if norm <= tolerance * scale:
                return Equilibrium(u, states[1], states[2], self._top_force(), iteration, tuple(norms))
            if self._factor is None:
                norm, residual, scale = self._residual(u, theta, states, load, tangent=True)
                exact = True
            step = self._expand(self._tangent().solve(-residual))
            accepted = self._search(u, step, theta, states, load, norm, backtrack=exact)
            if accepted is None and exact:
                raise NumericsError(f"equilibrium: the line search failed at relative residual {norm / scale:.1e} in iteration {iteration + 1}")
            if accepted is None:
                self._factor = None
                continue
            u, new_norm, residual, scale = accepted
            if new_norm > _KEEP * norm:
                self._factor = None
            exact = False
            norm = new_norm
            norms.append(norm)
        raise NumericsError(
            f"equilibrium: no convergence in {self.settings.max_iterations} iterations, relative residual {norm / scale:.1e}, "
            f"expected {self.settings.tolerance:.0e}"
        )

    def _tangent(self) -> Factor:
        if self._factor is None:
            raise NumericsError("equilibrium: no tangent was formed")
        return self._factor

    def _admissible(self, u: np.ndarray, load: float) -> np.ndarray:
        """u with prescribed values: zero where fixed, the load where the top is displaced, one common value where tied."""
        u = u.copy()
        u[self.body.equation == -1] = 0.0
        if self.body.top < 0:
            u[self.body.equation == LOADED] = load
        return u

    def _expand(self, x: np.ndarray) -> np.ndarray:
        equation = self.body.equation
        return np.where(equation >= 0, x[np.maximum(equation, 0)], 0.0)

    def _residual(
        self, u: np.ndarray, theta: np.ndarray, states: tuple[np.ndarray, np.ndarray, np.ndarray], load: float, *, tangent: bool
    ) -> tuple[float, np.ndarray, float]:
        """Norm of the residual, the residual (n_eq,) and the force scale; forms and factors the tangent if asked."""
        body = self.body
        state_n, state, dilatation = states
        self.passes += 1
        failed = element_pass(body.data, u, theta, state_n, self.law, tangent, self._force, self._stiffness, state, dilatation)
        if failed:
            return float("inf"), np.empty(0), 1.0
        flat = body.element_equation.ravel()
        used = flat >= 0
        residual = np.bincount(flat[used], self._force.ravel()[used], minlength=body.n_equations)
        if body.top >= 0:
            residual[body.top] -= load
        if tangent:
            data = np.zeros(body.mechanical.n_slots)
            scatter(self._stiffness, body.mechanical_slot, data)
            self._factor = Factor(body.mechanical, data)
            self.factorisations += 1
        scale = max(float(np.linalg.norm(self._force)), self._floor)
        return float(np.linalg.norm(residual)), residual, scale

    def _search(
        self,
        u: np.ndarray,
        step: np.ndarray,
        theta: np.ndarray,
        states: tuple[np.ndarray, np.ndarray, np.ndarray],
        load: float,
        norm: float,
        *,
        backtrack: bool,
    ) -> tuple[np.ndarray, float, np.ndarray, float] | None:
        """Backtracking on the residual norm; None where no step length lowers it. With a kept factor only the full step is tried.

        Any decrease is enough with a fresh tangent. Where all points stand on the yield surface the tangent is elastic and their
        answer plastic: no length lowers the residual, but the full step leads to where the tangent is plastic. It is taken.
        """
        length, uphill = 1.0, False
        enough = 1.0 if backtrack else _KEPT_DECREASE
        for _ in range(self.settings.max_backtracks if backtrack else 1):
            trial = u + length * step
            new_norm, residual, scale = self._residual(trial, theta, states, load, tangent=False)
            if new_norm < enough * norm or new_norm <= self.settings.tolerance * scale:
                return trial, new_norm, residual, scale
            uphill |= length == 1.0 and new_norm < _UPHILL * norm
            length *= 0.5
        if not (backtrack and uphill and self._uphill_steps < _MAX_UPHILL):
            return None
        self._uphill_steps += 1
        return (u + step, *self._residual(u + step, theta, states, load, tangent=False))

    def _top_force(self) -> float:
        """Internal force along y on the loaded end of the model, N."""
        top = np.isin(self.body.mesh.hexes, self.body.loaded)
        return float(self._force.reshape(-1, 8, 3)[:, :, 1][top].sum())


def virgin_state(n_elements: int) -> np.ndarray:
    """State (n_el, 8, 11) of a material that was never loaded: F_p = 1, alpha = Lambda = 0."""
    state = np.zeros((n_elements, 8, N_STATE))
    state[:, :, [0, 4, 8]] = 1.0
    return state
