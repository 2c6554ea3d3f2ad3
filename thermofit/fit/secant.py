"""Bounded Gauss-Newton that saves forward runs: without exact derivatives the Jacobian is updated by Broyden and recomputed only where
that fails; with them they also tell the second derivatives that matter where the model lacks something (`Curvature`).

Secant version of the damped Gauss-Newton method (K. Madsen, H. B. Nielsen, O. Tingleff, Methods for Non-Linear Least Squares
Problems, 2nd ed., IMM, DTU, 2004, section 3.5) with a box as trust region: box and bounds are then one set of bounds of a
small linear least-squares problem that is solved exactly. Convergence is declared only on a Jacobian computed at the final
point; the covariance needs that one anyway.

That part of the Hessian of r.r is learnt from derivatives that the trials of a search give anyway. Half the Hessian of f = r.r is J^T J +
S with S = sum_i r_i d2r_i/dz2. Where the model fits the data, S is small against J^T J. Where it lacks something, the residual is large, S
may outweigh J^T J along a parameter that the data hardly tell, and the full Gauss-Newton step is too long by (J^T J + S)/(J^T J): the
search crawls with shorter and shorter steps. S is kept by secant updates as in NL2SOL (J. E. Dennis, D. M. Gay, R. E. Welsch, ACM Trans.
Math. Softw. 7, 1981, 348-368), and used only where it has predicted f better.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermofit.fit.evaluate import EvaluationLimit, Evaluations, Purpose
from thermofit.fit.gauss_newton import AT_EDGE, AT_NOISE, pinned, reached, unresolved
from thermofit.fit.jacobian import jacobian_at
from thermofit.fit.least_squares import Crawls, Ending, Pace
from thermofit.fit.linear_model import LinearModel, Step
from thermofit.fit.problem import Problem, from_scaled, scaled_bounds, to_scaled
from thermofit.fit.settings import Settings

_GOOD = 0.5
"""Gauss-Newton is left as it is while a trial achieves between this share and its inverse of the drop that it predicts."""
_SMALLEST = 1e-12
"""Share of the largest curvature below which a direction has none that a step could be based on."""


@dataclass(frozen=True)
class Curvature:
    """S (n_p, n_p) with respect to the scaled variables z, whether the steps are based on J^T J + S (`used`) or on J^T J, and which of them
    has predicted the last trial better."""

    S: np.ndarray
    used: bool = False
    better: bool = False


def augmented(here: LinearModel, S: np.ndarray) -> LinearModel:
    """The quadratic model of f with J^T J + S in the form of a linear least-squares problem: R^T R = J^T J + S, R^T c = J^T r.

    A direction of negative curvature counts by its magnitude: a step goes down along it, as far as for a valley of that curvature.
    """
    norms = here.size
    values, vectors = np.linalg.eigh((here.columns.T @ here.columns + S) / np.outer(norms, norms))
    values = np.abs(values)
    root = np.sqrt(np.maximum(values, _SMALLEST * values.max()))
    R = root[:, None] * vectors.T * norms
    return LinearModel(vectors.T @ (here.columns.T @ here.residual / norms) / root, R)


def learnt(known: Curvature, here: LinearModel, there: LinearModel, d: np.ndarray, moved: bool) -> Curvature:
    """S after a trial from `here` to `there` = here + d (n_p,), for the point that the search goes on from: `there` if `moved`.

    Of the two predictions of f the better one is used next; that of Gauss-Newton is kept while it is good by itself.
    """
    achieved = here.f - there.f
    plain = _promised(here, d)
    errors = abs(achieved - plain), abs(achieved - (plain - float(d @ known.S @ d)))
    wrong = not _GOOD * plain <= achieved <= plain / _GOOD
    better = errors[1] < errors[0]
    weights = there.residual if moved else here.residual
    curving = there.columns.T @ weights - here.columns.T @ weights
    turning = there.columns.T @ there.residual - here.columns.T @ here.residual
    return Curvature(updated(known.S, d, curving, turning), better and (known.used or wrong), better)


def updated(S: np.ndarray, d: np.ndarray, curving: np.ndarray, turning: np.ndarray) -> np.ndarray:
    """Secant update of Dennis, Gay and Welsch: the result, symmetric (n_p, n_p), maps the step d to `curving`.

    `curving`: (J(z + d) - J(z))^T r, `turning`: change of the gradient J^T r; all (n_p,). S is first sized, so that what was learnt
    where the residual was larger does not outlive it. Unlike there, S is kept where the gradient does not rise along the step.
    """
    slope = float(turning @ d)
    if slope <= _SMALLEST * float(np.linalg.norm(turning) * np.linalg.norm(d)):
        return S
    known = float(d @ S @ d)
    S = S * (min(1.0, abs(float(d @ curving)) / abs(known)) if known != 0.0 else 1.0)
    miss = curving - S @ d
    mixed = np.outer(miss, turning)
    return np.asarray(S + (mixed + mixed.T) / slope - float(d @ miss) * np.outer(turning, turning) / slope**2)


def _promised(here: LinearModel, d: np.ndarray) -> float:
    """Drop of f along d by the linear model of the residual."""
    change = here.columns @ d
    return -float(2.0 * here.residual @ change + change @ change)


FIRST_RADIUS = 0.3
"""Half width of the first trust box in units of the scale."""
FIRST_RADIUS_EXACT = 0.5
"""The same with exact derivatives, which a longer step does not spoil."""
BELIEVED = 0.5
"""Achieved over predicted drop below which an updated Jacobian is recomputed."""


@dataclass(frozen=True)
class SearchState:
    """Point z (n_p,), its residual (n,) and Jacobian (n, n_p) with respect to z, half width `radius` of the trust box.

    `fresh`: the Jacobian was computed at z, neither updated nor given; `rejected`: trials in a row that did not lower f; `failed`: the last
    one because the forward model failed; `curvature`: what is known of the second derivatives, None where derivatives are not exact or
    the data say nothing along some direction or are fewer than twice the parameters.
    """

    z: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    radius: float
    fresh: bool = True
    rejected: int = 0
    failed: bool = False
    curvature: Curvature | None = None

    @property
    def local(self) -> LinearModel:
        """Residual and Jacobian of the point."""
        return LinearModel(self.residual, self.jacobian)


def secant_gauss_newton(evaluations: Evaluations, settings: Settings) -> Ending:
    """Minimise r.r within bounds; where the problem has exact derivatives, every trial is a linearised run and nothing is updated, and
    along directions in which the data say nothing the search stays where it is. A Jacobian that is known near the start leads to the
    first trial; no search ends on it.

    A failed evaluation is rejected like one that raises f: the box shrinks to a quarter of the step. The limit of evaluations
    ends the search in any case. NumericsError if the start fails or a derivative cannot be had.
    """
    try:
        state, pace = _first(evaluations, settings), Pace(evaluations, settings)
        while True:
            full = _full(evaluations, state)
            f = state.local.f
            end = reached(full, f, state.residual.size, settings)
            if end and state.fresh:
                return Ending(True, end, _told(evaluations.problem, state))
            if state.fresh and state.rejected and not state.failed and unresolved(full, f, state.residual.size, settings):
                return Ending(True, AT_NOISE, _told(evaluations.problem, state))
            exhausted = state.radius < 0.01 * settings.x_tolerance
            if exhausted and state.fresh:
                return _stuck(evaluations, state, settings)
            if end or exhausted:
                state = _refresh(evaluations, state, settings)
                continue
            pace.after(f)
            state = _advance(evaluations, state, settings)
    except Crawls as end:
        return Ending(False, str(end))
    except EvaluationLimit as limit:
        return Ending(False, f"not converged: {limit}; raise max_evaluations or start closer")


def _told(problem: Problem, state: SearchState) -> np.ndarray | None:
    """S (n_p, n_p) with respect to x of a search that ends, where it has predicted the last trial better than J^T J alone."""
    known = state.curvature
    return None if known is None or not known.better else known.S / np.outer(problem.scale, problem.scale)


def _first(evaluations: Evaluations, settings: Settings) -> SearchState:
    """The start of a search. Where dr/dx is known near by, its residual alone is computed: a derivative costs a few runs, and tells more
    at the first trial."""
    problem, given = evaluations.problem, evaluations.problem.first_jacobian
    exact, z = problem.linearise is not None, to_scaled(problem, problem.start)
    if given is not None:
        residual = evaluations.residual(problem.start)
        if given.shape == (residual.size, len(problem.names)):
            scaled = given * problem.scale
            if exact:
                near = problem.first_curvature
                known = None if near is None else Curvature(near * np.outer(problem.scale, problem.scale), used=True)
                return SearchState(z, residual, pinned(scaled, residual), FIRST_RADIUS_EXACT, fresh=False, curvature=known)
            return SearchState(z, residual, scaled, FIRST_RADIUS, fresh=False)
    if exact:
        return _exact(problem, problem.start, *evaluations.linearised(problem.start))
    residual = evaluations.residual(problem.start)
    return SearchState(z, residual, jacobian_at(evaluations, problem.start, settings) * problem.scale, FIRST_RADIUS)


def _exact(problem: Problem, x: np.ndarray, residual: np.ndarray, jacobian: np.ndarray) -> SearchState:
    """The state at a point with an exact dr/dx (n, n_p)."""
    scaled = jacobian * problem.scale
    matrix = pinned(scaled, residual)
    told = matrix is scaled and residual.size >= 2 * (x.size + 1)
    curvature = Curvature(np.zeros((x.size, x.size))) if told else None
    return SearchState(to_scaled(problem, x), residual, matrix, FIRST_RADIUS_EXACT, curvature=curvature)


def _refresh(evaluations: Evaluations, state: SearchState, settings: Settings) -> SearchState:
    """The Jacobian computed at z. A box that shrank on account of an outdated one gets room again."""
    problem, x = evaluations.problem, from_scaled(evaluations.problem, state.z)
    radius = max(state.radius, 10.0 * settings.x_tolerance)
    if problem.linearise is not None:
        return replace(_knowing(_exact(problem, x, *evaluations.linearised(x)), state), radius=radius)
    jacobian = jacobian_at(evaluations, x, settings) * problem.scale
    return replace(state, jacobian=jacobian, fresh=True, rejected=0, radius=radius)


def _knowing(there: SearchState, before: SearchState) -> SearchState:
    """A state with the second derivatives that the search knew before; nothing where the data do not tell them."""
    return there if there.curvature is None or before.curvature is None else replace(there, curvature=before.curvature)


def _step(evaluations: Evaluations, state: SearchState, radius: float) -> Step:
    """Minimum within bounds and box of the linear model, or of the quadratic one where that has proved better."""
    lower, upper = scaled_bounds(evaluations.problem)
    room = np.maximum(lower - state.z, -radius), np.minimum(upper - state.z, radius)
    curvature = state.curvature
    if curvature is not None and curvature.used:
        return replace(augmented(state.local, curvature.S), bounds=room).step
    return replace(state.local, bounds=room).step


def _full(evaluations: Evaluations, state: SearchState) -> Step:
    """The step without a box, by which a search ends. Where steps are based on second derivatives, which are learnt from few trials, the
    linear model must agree that nothing is left: the longer step and the larger drop of both."""
    plain = _step(evaluations, replace(state, curvature=None), np.inf)
    if state.curvature is None or not state.curvature.used:
        return plain
    curved = _step(evaluations, state, np.inf)
    return Step(max(plain.d, curved.d, key=lambda d: float(np.max(np.abs(d)))), max(plain.drop, curved.drop))


def _advance(evaluations: Evaluations, state: SearchState, settings: Settings) -> SearchState:
    """One trial step and the state after it."""
    problem = evaluations.problem
    step = _step(evaluations, state, state.radius)
    length = float(np.max(np.abs(step.d)))
    x = from_scaled(problem, state.z + step.d)
    purpose: Purpose = "step" if problem.linearise is None else "linearise"
    outcome = evaluations.outcome(x, purpose)
    if outcome.residual is None:
        return replace(state, radius=0.25 * length, rejected=state.rejected + 1, failed=True)
    ratio = (float(state.residual @ state.residual) - outcome.f) / step.drop if step.drop > 0.0 else -1.0
    accepted = ratio > 1e-4
    if outcome.jacobian is not None:
        there = _knowing(_exact(problem, x, outcome.residual, outcome.jacobian), state)
        if state.curvature is not None and there.curvature is not None and state.fresh:  # two models differ by more than they curve
            there = replace(there, curvature=learnt(state.curvature, state.local, there.local, there.z - state.z, accepted))
        if accepted:
            return replace(there, radius=_radius(state.radius, length, ratio))
        if not state.fresh:
            return _refresh(evaluations, state, settings)  # a wrong derivative tells nothing of the box
        rejected = replace(state, radius=0.25 * length, rejected=state.rejected + 1, failed=False)
        if state.curvature is None or there.curvature is None:
            return rejected
        # What one model promised in vain says nothing of the other, on which the next trial is based.
        count = rejected.rejected if there.curvature.used == state.curvature.used else 0
        return replace(rejected, curvature=there.curvature, rejected=count)
    z = to_scaled(problem, x)
    jacobian = _update(state, z - state.z, outcome.residual)
    if accepted:
        moved = SearchState(z, outcome.residual, jacobian, _radius(state.radius, length, ratio), fresh=False)
        return moved if ratio >= BELIEVED else _refresh(evaluations, moved, settings)
    if state.fresh:
        return replace(state, radius=0.25 * length, rejected=state.rejected + 1, failed=False)
    if state.rejected == 0:
        # A rejected trial teaches the updated Jacobian too: one more try costs one run, a new Jacobian one per parameter.
        return replace(state, jacobian=jacobian, radius=0.25 * length, rejected=1, failed=False)
    return _refresh(evaluations, replace(state, radius=0.5 * length), settings)


def _radius(radius: float, length: float, ratio: float) -> float:
    """The next box after an accepted step of that length and ratio of achieved to predicted drop."""
    if ratio > 0.75:
        return max(radius, 2.0 * length)
    if ratio > 0.25:
        return radius
    return (0.5 if ratio > 0.1 else 0.25) * length


def _update(state: SearchState, d: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Broyden's rank-one update: the smallest change of J that explains the residual after the step d."""
    square = float(d @ d)
    if square == 0.0:
        return state.jacobian
    miss = residual - state.residual - state.jacobian @ d
    return np.asarray(state.jacobian + np.outer(miss, d / square))


def _stuck(evaluations: Evaluations, state: SearchState, settings: Settings) -> Ending:
    """No step lowers f, down to the shortest. Where second derivatives outweigh J^T J, the linear model takes the noise of the residual
    for many times the drop that the quadratic one does: that one decides."""
    curvature = None if state.curvature is None else replace(state.curvature, used=True)
    curved = _step(evaluations, replace(state, curvature=curvature), np.inf)
    if not state.failed and unresolved(curved, state.local.f, state.residual.size, settings):
        return Ending(True, AT_NOISE)
    if state.failed:
        return Ending(False, AT_EDGE)
    return Ending(
        False,
        "stopped: no step lowers the objective although its derivative says so; the residual is not smooth enough for its "
        "derivatives, raise difference_step where they are differences or use nelder-mead",
    )
