"""Equilibrium of one load level: quasi-Newton on a kept factor, line search, and a clear failure.

The factor of an earlier iteration or step is used again while the residual falls fast enough with it; otherwise the tangent is
formed at the current iterate. Every full step teaches how the residual answers to it: BFGS puts that on the kept factor (H. Matthies
and G. Strang 1979, Int. J. Numer. Methods Eng. 14). In a coupled step the temperature follows the iterates: the heat equation is
solved on the deformation and the sources of an iterate, and the forces of the change of temperature are added to the residual, so that
both fields converge together. Nothing here commits state: old state in, new state out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from thermofit.body.body import FIXED, LOADED, Body
from thermofit.body.element.hex8 import element_pass
from thermofit.body.element.thermal_load import thermal_forces
from thermofit.body.solve.linear import Factor, gathered, scatter
from thermofit.core.errors import NumericsError, StudyError
from thermofit.law.page import Law
from thermofit.point.state import N_FULL, N_STATE, TRACE

PATIENCE = 4.0
"""Iterations with a kept factor that cost as much as a fresh tangent, its factor and the iterations that still follow."""
_KEPT_DECREASE = 0.9
_GOOD_RATE = 5e-3
"""Remaining share of the residual after a step with a kept factor that is as good as a fresh one."""
_UPHILL = 100.0
"""Factor by which the residual may rise in a full step that leads from the elastic tangent to the plastic one."""
_MAX_UPHILL = 3
_MEMORY = 20
"""Steps that the kept factor is corrected by."""
_CURVATURE = 1e-6
"""Cosine between a step and the answer of the residual from which the tangent along it counts as positive."""
_THERMAL_START = 1e-3
"""Relative residual below which an iterate is good enough to solve the heat equation on it."""
_THERMAL_AGAIN = 0.05
"""Drop of the residual after which the heat equation is solved again."""
_FLOOR_STRESS = 0.1
"""MPa; stress whose nodal forces bound the residual from below where the body is (nearly) unloaded."""
_ROUND_OFF_STRAIN = 64.0 * float(np.finfo(float).eps)
"""Strain below which a deformation gradient is round-off: displacements are some ten times larger than the edges of an element."""


TemperatureOf = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, float]]
"""Temperature (n_np,) K for the mechanics that follows an iterate, and its open change in K, from u, point states, J and the
temperature so far."""


TOLERANCE = 1e-5
"""Relative residual: displacements of a dogbone to some 1e-5 mm, a hundredth of the noise of image correlation (docs/performance.md)."""


@dataclass(frozen=True)
class NewtonSettings:
    """Relative residual at which equilibrium is accepted, iteration and backtracking limits.

    A residual of round-off is accepted whatever the tolerance.
    """

    tolerance: float = TOLERANCE
    max_iterations: int = 40
    max_backtracks: int = 6


@dataclass(frozen=True)
class Direction:
    """Of a step along the path of equilibria (`body.solve.arc`): change of u (n_np, 3) mm and of the force on the end (model) N per mm."""

    u: np.ndarray
    force: float


@dataclass(frozen=True)
class Equilibrium:
    """Solution of one load level: u (n_np, 3) mm, point states (n_el, 8, 11), J (n_el, 8), force on the top end (model) N."""

    u: np.ndarray
    state: np.ndarray
    dilatation: np.ndarray
    top_force: float
    iterations: int
    residuals: tuple[float, ...]
    direction: Direction | None = None


@dataclass(frozen=True)
class LoadLevel:
    """What is given for one load level: temperature, old state, load; and the buffers of the new state and of J."""

    theta: np.ndarray
    state_n: np.ndarray
    load: float
    state: np.ndarray
    dilatation: np.ndarray


@dataclass(frozen=True)
class _Iterate:
    """u (n_np, 3), its residual (n_eq,) N, the norm of it (infinite where an element failed), the scale of the forces, and the share of
    the step that led here."""

    u: np.ndarray
    residual: np.ndarray
    norm: float
    scale: float
    length: float = 1.0


@dataclass(frozen=True)
class _Update:
    """What a step taught of the tangent: change s (n_eq,) mm of the unknowns, y (n_eq,) N of the residual, and 1 / s.y in 1/mJ."""

    change: np.ndarray
    answer: np.ndarray
    inverse: float


class Equilibrator:
    """Buffers and the last factor for one body and law; `solve` itself is free of side effects on physical state."""

    def __init__(self, body: Body, law: Law, settings: NewtonSettings) -> None:
        self.body, self.law, self.settings = body, law, settings
        n_el = body.mesh.n_elements
        self._force = np.empty((n_el, 24))
        self._warming = np.empty((n_el, 24))
        self._stiffness = np.empty((n_el, 24, 24))
        self._factor: Factor | None = None
        self._updates: list[_Update] = []
        self._top = np.flatnonzero(np.isin(body.mesh.hexes, body.loaded).ravel())
        size = float(body.data.volume.sum()) ** (2.0 / 3.0) / n_el ** (1.0 / 6.0)
        self._floor = _FLOOR_STRESS * size
        self._round_off = _ROUND_OFF_STRAIN * (law.lame + 2.0 * law.mu) * size
        self._foreseen = False
        self._uphill_steps = 0
        self._rate = 1.0
        self.factorisations = 0
        self.passes = 0

    def forget(self) -> None:
        """Drop the kept factor, for example after a load reversal."""
        self._factor = None

    def solve(
        self,
        u_start: np.ndarray,
        theta: np.ndarray,
        state_n: np.ndarray,
        load: float,
        *,
        fresh: bool = False,
        thermal: tuple[TemperatureOf, float] | None = None,
    ) -> Equilibrium:
        """Equilibrium under `load`: N on the top end of the model (force control) or mm (displacement control).

        theta (n_np,) K is given, or an estimate where `thermal` = (temperature of an iterate, its tolerance in K) couples the heat
        equation. NumericsError where equilibrium is not found; the caller may cut the step.
        """
        level = LoadLevel(theta, state_n, load, np.empty_like(state_n), np.empty(state_n.shape[:2]))
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
        change, wanted = (0.0, 0.0) if thermal is None else (float("inf"), 0.0 if self._foreseen else _THERMAL_START)
        for iteration in range(self.settings.max_iterations):
            if thermal is not None and (here.norm <= wanted * here.scale or self._balanced(here)):
                first, last = not np.isfinite(change), self._balanced(here)
                warmer, change = thermal[0](here.u, level.state, level.dilatation, level.theta)
                if first:
                    self._foreseen = change <= thermal[1]
                if not last or change > thermal[1]:
                    here, level = self._warmed(here, level, warmer), replace(level, theta=warmer)
                    wanted = _THERMAL_AGAIN * here.norm / here.scale if change > thermal[1] else 0.0
                    if self._balanced(here):
                        continue
            if self._balanced(here):
                return Equilibrium(here.u, level.state, level.dilatation, self._top_force(), iteration, tuple(norms))
            if self._factor is None:
                here = self._evaluate(here.u, level, tangent=True)
                exact = True
            step = self._step(here)
            there = self._search(here, self._nodal(step), level, backtrack=exact)
            if there is None and exact:
                raise NumericsError(
                    f"equilibrium: the line search failed at relative residual {here.norm / here.scale:.1e} in iteration {iteration + 1}"
                )
            if there is None:
                self._factor = None
                continue
            self._rate = 1.0 if self._updates else there.norm / here.norm
            if self._too_slow(here, there):
                self._factor = None
            else:
                self._learn(here, there, step)
            exact, here = False, there
            norms.append(here.norm)
        left = f"relative residual {here.norm / here.scale:.1e}, expected {self.settings.tolerance:.0e}"
        if thermal is not None and self._balanced(here):
            left = f"the temperature still changes by {change:.1e} K from sweep to sweep, expected {thermal[1]:.0e} K"
        raise NumericsError(f"equilibrium: no convergence in {self.settings.max_iterations} iterations, {left}")

    def good_factor(self) -> Factor | None:
        """The kept factor, if its last step left next to nothing of the residual: then it is nearly that of the equilibrium found."""
        return self._factor if self._rate < _GOOD_RATE else None

    def linearise(self, u: np.ndarray, theta: np.ndarray, state_n: np.ndarray) -> tuple[Factor, np.ndarray]:
        """Factor and element stiffness (n_el, 24, 24) of the consistent tangent at an equilibrium; the factor is kept for the next step.

        NumericsError where the state is not admissible.
        """
        level = LoadLevel(theta, state_n, 0.0, np.empty_like(state_n), np.empty(state_n.shape[:2]))
        here = self._evaluate(u, level, tangent=True)
        if self._factor is None or not np.isfinite(here.norm):
            raise NumericsError("equilibrium: the converged state has no tangent")
        return self._factor, self._stiffness

    def answer(self, u: np.ndarray, theta: np.ndarray, state_n: np.ndarray, change: float) -> np.ndarray:
        """u (n_np, 3) after a displacement of the end by `change` mm, as the tangent K at an equilibrium answers to it,

            du_f = -K_ff^-1 (r_f + K_fp change).

        The factor is not kept. NumericsError where the state is not admissible."""
        factor, stiffness = self.linearise(u, theta, state_n)
        moved = np.where(self.body.equation == LOADED, change, 0.0)
        forces = np.einsum("eij,ej->ei", stiffness, moved[self.body.mesh.hexes].reshape(len(stiffness), -1))
        residual = np.zeros(self.body.n_equations)
        gathered(self.body.element_equation, self._force + forces, residual)
        self.forget()
        return u + moved + self._nodal(factor.solve(-residual))

    def _allowed(self, scale: float) -> float:
        """Norm of the residual in N at which equilibrium is accepted."""
        return max(self.settings.tolerance * scale, self._round_off)

    def _balanced(self, here: _Iterate) -> bool:
        return here.norm <= self._allowed(here.scale)

    def _too_slow(self, here: _Iterate, there: _Iterate) -> bool:
        """Whether the kept factor, at the rate of its last step, needs more iterations than a fresh one is worth."""
        target = self._allowed(there.scale)
        if there.norm <= target:
            return False
        rate = there.norm / here.norm
        return rate >= 1.0 or bool(np.log(target / there.norm) < PATIENCE * np.log(rate))

    def _warmed(self, here: _Iterate, level: LoadLevel, theta: np.ndarray) -> _Iterate:
        """The iterate at another temperature: the forces of the change enter its residual."""
        thermal_forces(self.body.data, here.u, level.state, level.theta, theta, self.law, self._warming)
        residual = here.residual.copy()
        gathered(self.body.element_equation, self._warming, residual)
        return replace(here, residual=residual, norm=float(np.linalg.norm(residual)))

    def _learn(self, here: _Iterate, there: _Iterate, step: np.ndarray) -> None:
        """Keep what the step (n_eq,), taken as far as it was, taught, if the tangent along it is positive.

        The temperature of both iterates is the same.
        """
        answer = there.residual - here.residual
        work = there.length * float(step @ answer)
        if work > _CURVATURE * there.length * float(np.linalg.norm(step) * np.linalg.norm(answer)):
            self._updates = [*self._updates[1 - _MEMORY :], _Update(there.length * step, answer, 1.0 / work)]

    def _step(self, here: _Iterate) -> np.ndarray:
        """Change (n_eq,) by the kept factor and what was learnt since (two loops: J. Nocedal 1980, Math. Comp. 35)."""
        if self._factor is None:
            raise NumericsError("equilibrium: no tangent was formed")
        right, shares = -here.residual, []
        for update in reversed(self._updates):
            shares.append(update.inverse * float(update.change @ right))
            right -= shares[-1] * update.answer
        x = self._factor.solve(right)
        for update, share in zip(self._updates, reversed(shares), strict=True):
            x += (share - update.inverse * float(update.answer @ x)) * update.change
        return x

    def _nodal(self, x: np.ndarray) -> np.ndarray:
        """Nodal field (n_np, 3) of x (n_eq,): zero where u is prescribed, one value where it is tied."""
        equation = self.body.equation
        return np.where(equation >= 0, x[np.maximum(equation, 0)], 0.0)

    def _admissible(self, u: np.ndarray, load: float) -> np.ndarray:
        """u with prescribed values: zero where fixed, the load where the top is displaced."""
        u = u.copy()
        u[self.body.equation == FIXED] = 0.0
        if self.body.top < 0:
            u[self.body.equation == LOADED] = load
        return u

    def _evaluate(self, u: np.ndarray, level: LoadLevel, *, tangent: bool = False) -> _Iterate:
        """Residual at u, and the new point states in the buffers of the level; forms and factors the tangent if asked."""
        body = self.body
        self.passes += 1
        failed = element_pass(
            body.data, u, level.theta, level.state_n, self.law, tangent, self._force, self._stiffness, level.state, level.dilatation
        )
        if failed:
            return _Iterate(u, np.empty(0), float("inf"), 1.0)
        residual = np.zeros(body.n_equations)
        gathered(body.element_equation, self._force, residual)
        if body.top >= 0:
            residual[body.top] -= level.load
        if tangent:
            data = np.zeros(body.mechanical.n_slots)
            scatter(self._stiffness, body.mechanical_slot, data)
            self._factor, self._rate, self._updates = Factor(body.mechanical, data), 1.0, []
            self.factorisations += 1
        return _Iterate(u, residual, float(np.linalg.norm(residual)), max(float(np.linalg.norm(self._force)), self._floor))

    def _search(self, here: _Iterate, step: np.ndarray, level: LoadLevel, *, backtrack: bool) -> _Iterate | None:
        """Backtracking on the residual norm: the accepted iterate, or None where no step length lowers the norm.

        With a kept factor only the full step is tried. Any decrease is enough with a fresh tangent. Where all points stand on the
        yield surface, the tangent is elastic and their answer plastic: no length lowers the residual, but the full step leads
        to where the tangent is plastic. It is taken, at most `_MAX_UPHILL` times.
        """
        length, uphill = 1.0, False
        enough = 1.0 if backtrack else _KEPT_DECREASE
        for _ in range(self.settings.max_backtracks if backtrack else 1):
            there = self._evaluate(here.u + length * step, level)
            if there.norm < enough * here.norm or self._balanced(there):
                return replace(there, length=length)
            uphill |= length == 1.0 and there.norm < _UPHILL * here.norm
            length *= 0.5
        if not (backtrack and uphill and self._uphill_steps < _MAX_UPHILL):
            return None
        self._uphill_steps += 1
        return self._evaluate(here.u + step, level)

    def _top_force(self) -> float:
        """Internal force along y on the loaded end of the model, N."""
        return float(self._force.reshape(-1, 3)[self._top, 1].sum())


def virgin_state(n_elements: int, axes: np.ndarray | None = None, *, structure: bool = False) -> np.ndarray:
    """State (n_el, 8, 11) of a material that was never loaded: F_p^-1 = Q, alpha = Lambda = 0; with `structure` (n_el, 8, N_FULL), C_el = 1
    and no backstress.

    The columns of the rotation Q `axes` (3, 3) are the material axes 1, 2, 3 (default: those of the model). Elasticity is isotropic
    and C_p^-1 = Q Q^T = 1: nothing is deformed, but C_el = Q^T C Q, which the yield surface (4.19) sees, is in the material axes.
    StudyError where Q is no rotation.
    """
    q = np.eye(3) if axes is None else np.asarray(axes, dtype=float)
    if q.shape != (3, 3) or not np.allclose(q @ q.T, np.eye(3), atol=1e-12) or np.linalg.det(q) < 0.0:
        raise StudyError("material axes: no rotation found; expected three orthonormal right-handed columns")
    state = np.zeros((n_elements, 8, N_FULL if structure else N_STATE))
    state[:, :, :9] = q.ravel()
    state[:, :, TRACE : TRACE + 1] = 3.0
    return state


def axes_about_z(angle: float) -> np.ndarray:
    """Material axes (3, 3) of a sheet turned by `angle` degrees about its thickness axis z; exact at multiples of 90."""
    quarter = angle / 90.0
    if quarter == round(quarter):
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarter) % 4]
    else:
        c, s = float(np.cos(np.radians(angle))), float(np.sin(np.radians(angle)))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
