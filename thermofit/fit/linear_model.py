"""The linearised least-squares problem, minimise |r + J d|^2 over steps d of the parameters: the one place of its linear algebra.

r (n,) is the whitened residual, J (n, p) its derivatives by the parameters; with columns of length one J = U S V^T (thin singular value
decomposition), and U spans what the parameters can do to r. From it follow the projection r - U U^T r, steps within bounds, the
prediction of rows that were held out, the score of columns that the model does not have yet, and the covariance of the parameters. Where
something else than the residual of a fit is asked (what is left of a column, of an error, of a change), that stands for r.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from scipy.optimize import lsq_linear

from thermofit.core.errors import UntrustworthyError
from thermofit.fit.covariance import PARTICIPATION, Covariance, NoiseOperator, NullDirection, correlation

TINY_DAMPING = 1e-12
"""Relative damping of an undamped step: keeps exactly dependent columns from giving a wild one."""
RANK = 1e-10
"""Singular value of columns of length one, over the largest, below which a direction is none: rounding alone makes as much."""
UNSEEN = 1e-9
"""The same for the eigenvalues of the normal matrix of the rows that a fold sees."""
INSENSITIVE = 1e-6
"""Part of a column, relative to its length, below which the fitted parameters take it up entirely."""

Room = tuple[np.ndarray, np.ndarray]
"""How far every parameter may go down (<= 0) and up (>= 0), each (p,): to its bounds."""
Fold = tuple[np.ndarray, np.ndarray]
"""Rows that are held out and rows that are not seen, these among them: masks (n,) each."""


@dataclass(frozen=True)
class Step:
    """Step d (p,) and the drop of r.r that the linear model predicts for it."""

    d: np.ndarray
    drop: float


@dataclass(frozen=True, eq=False)
class Further:
    """One Gauss-Newton step of further columns beside all others: s (n, k) is what of them is sensitive beyond these.

    `step` a = -(s^T s)^-1 s^T r (k,), `covariance` (s^T s)^-1 s^T C s (s^T s)^-1 (k, k), `inverse` (s^T s)^-1 (k, k), `drop` -r.s a of r.r.
    """

    columns: np.ndarray
    step: np.ndarray
    covariance: np.ndarray
    inverse: np.ndarray
    drop: float

    @property
    def sigma(self) -> np.ndarray:
        """Standard errors (k,) of the step."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def drop_of(self, error: np.ndarray) -> float:
        """Drop of e.e that the columns would make of an error e (n,) alone."""
        right = self.columns.T @ error
        return float(right @ self.inverse @ right)


@dataclass(frozen=True, eq=False)
class LinearModel:
    """r (n,), J (n, p) per unit of the parameters; `noise` applies the correlation C of r (unit diagonal) to columns (n, k), None where
    it is white; `bounds`: how far each parameter may go from here, None: anywhere. The last `n_priors` rows are priors, no data."""

    residual: np.ndarray
    columns: np.ndarray
    noise: NoiseOperator | None = None
    bounds: Room | None = None
    n_priors: int = 0

    @property
    def f(self) -> float:
        """f = r.r (2.24)."""
        return float(self.residual @ self.residual)

    @cached_property
    def norms(self) -> np.ndarray:
        """Lengths (p,) of the columns."""
        return np.asarray(np.linalg.norm(self.columns, axis=0))

    @property
    def size(self) -> np.ndarray:
        """The same (p,), one where a column is zero."""
        return np.where(self.norms > 0.0, self.norms, 1.0)

    @property
    def unit(self) -> np.ndarray:
        """Columns (n, p) of length one, or zero."""
        return np.asarray(self.columns / self.size)

    @cached_property
    def _svd(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """U (n, m), S (p,) with zeros behind the first m = min(n, p), V (p, p) of the columns of length one."""
        n, p = self.columns.shape
        u, values, vectors_t = scipy.linalg.svd(self.unit, full_matrices=n < p)
        return u, np.pad(values, (0, p - len(values))), vectors_t.T

    def _rank(self, tolerance: float) -> int:
        values = self._svd[1]
        return int(np.count_nonzero(values > tolerance * max(float(values.max(initial=0.0)), np.finfo(float).tiny)))

    @property
    def basis(self) -> np.ndarray:
        """Orthonormal basis U (n, rank) of the columns, without directions below RANK."""
        return self._svd[0][:, : self._rank(RANK)]

    def root(self, tolerance: float = RANK) -> np.ndarray:
        """B (p, rank) with B B^T = (J^T J)^+, so that J B is orthonormal; directions below the tolerance are left out."""
        _, values, vectors = self._svd
        rank = self._rank(tolerance)
        return np.asarray(vectors[:, :rank] / values[:rank] / self.size[:, None])

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of the columns of length one, infinite where the smallest is zero."""
        values = self._svd[1]
        if values.size == 0:
            return 1.0
        return float(values.max() / values.min()) if values.min() > 0.0 else float("inf")

    def only(self, kept: Sequence[int] | np.ndarray) -> LinearModel:
        """The model of the columns at these places alone."""
        k = np.asarray(kept, dtype=int)
        bounds = None if self.bounds is None else (self.bounds[0][k], self.bounds[1][k])
        return replace(self, columns=self.columns[:, k], bounds=bounds)

    def with_columns(self, block: np.ndarray, room: Room | None = None) -> LinearModel:
        """The model with further columns (n, k) behind its own, and how far their parameters may go."""
        ends = [_anywhere(m.shape[1]) if b is None else b for m, b in ((self.columns, self.bounds), (block, room))]
        bounds = None if self.bounds is None and room is None else (np.append(ends[0][0], ends[1][0]), np.append(ends[0][1], ends[1][1]))
        return replace(self, columns=np.concatenate([self.columns, block], axis=1), bounds=bounds)

    def projected(self, block: np.ndarray) -> np.ndarray:
        """Residual projection (1 - U U^T) of a vector (n,) or of columns (n, k): what no change of the parameters can imitate."""
        return np.asarray(block - self.basis @ (self.basis.T @ block))

    @cached_property
    def left(self) -> np.ndarray:
        """The residual (n,) without what the parameters, bounds aside, could still take up."""
        return self.projected(self.residual)

    def data(self, block: np.ndarray) -> np.ndarray:
        """The rows of a block that are data."""
        return block[: len(block) - self.n_priors]

    def sensitive(self, block: np.ndarray) -> np.ndarray:
        """Columns of a block beyond those of the model, without those that the parameters take up entirely, or that no data feel."""
        s = self.projected(block)
        size = np.linalg.norm(self.data(block), axis=0)
        return s[:, np.linalg.norm(self.data(s), axis=0) > INSENSITIVE * np.maximum(size, 1e-300)]

    @property
    def free_step(self) -> np.ndarray:
        """Step (p,) to the least |r + J d|, bounds aside; directions below RANK stay where they are."""
        return np.asarray(-self.root() @ (self.basis.T @ self.residual))

    @cached_property
    def triangular(self) -> LinearModel:
        """The problem with the same |r + J d|^2 for all d in p + 1 rows at most, from the QR decomposition of [J r]."""
        n, p = self.columns.shape
        if n <= p + 1:
            return self
        triangle = np.asarray(np.linalg.qr(np.column_stack([self.columns, self.residual]), mode="r"))
        return LinearModel(triangle[:, -1], triangle[:, :-1], bounds=self.bounds)

    @cached_property
    def step(self) -> Step:
        """The step to the least |r + J d| within the bounds, which must hold 0.

        Bounded-variable least squares is exact for the few parameters at hand, so that a step ends on a bound, not near it.
        """
        small, room = self.triangular, self.bounds or _anywhere(self.columns.shape[1])
        # A column of zeros says nothing about its parameter: any positive weight makes it stay where it is.
        weights = small.size
        matrix = np.vstack([small.columns, np.sqrt(TINY_DAMPING) * np.diag(weights)]) / weights
        right = -np.concatenate([small.residual, np.zeros(weights.size)])
        lower, upper = np.minimum(room[0], 0.0) * weights, np.maximum(room[1], 0.0) * weights
        solution = lsq_linear(matrix, right, bounds=(lower, upper), method="bvls", tol=1e-14, max_iter=20 * weights.size)
        d = np.clip(solution.x / weights, room[0], room[1])
        # Exactly on the bound, which the division by the weights may miss by one bit.
        d = np.where(solution.active_mask < 0, room[0], np.where(solution.active_mask > 0, room[1], d))
        after = small.residual + small.columns @ d
        return Step(d, max(0.0, small.f - float(after @ after)))

    @property
    def remaining(self) -> np.ndarray:
        """Residual (n,) after the step that all rows ask for within the bounds, as `predicted` takes it."""
        unit = self.unit
        return np.asarray(self.residual + unit @ self._one_end_after_the_other(unit.T @ unit, unit.T @ self.residual))

    def predicted(self, folds: Iterable[Fold]) -> np.ndarray:
        """Residual (n,) of every row when its fold is predicted from the rows that it sees; nan in rows that no fold holds out.

        The parameters take the step of the rows that are seen within the bounds, and rows that are held out change to r + J d.
        """
        out, unit = np.full(len(self.residual), np.nan), self.unit
        gram, right = unit.T @ unit, unit.T @ self.residual
        for held, hidden in folds:
            a = unit[hidden]
            step = self._one_end_after_the_other(gram - a.T @ a, right - a.T @ self.residual[hidden])
            out[held] = self.residual[held] + unit[held] @ step
        return out

    def _one_end_after_the_other(self, gram: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Step (p,) of columns of length one from their normal equations: a parameter that it would take beyond its room stays at the end
        of it, and the others step anew. Directions that the seen rows do not feel stay where they are.

        Not `step`: normal equations of a fold cost what its hidden rows cost, and a direction that the fold hardly sees must not be
        followed into the rows that are held out, where `step` goes to its end.
        """
        ends = _anywhere(len(right)) if self.bounds is None else (self.bounds[0] * self.size, self.bounds[1] * self.size)
        step, free = np.zeros(len(right)), np.ones(len(right), dtype=bool)
        for _ in range(len(right)):
            pull = right[free] + gram[np.ix_(free, ~free)] @ step[~free]
            step[free] = -np.linalg.pinv(gram[np.ix_(free, free)], rcond=UNSEEN, hermitian=True) @ pull
            outside = free & ((step < ends[0]) | (step > ends[1]))
            if not outside.any():
                break
            step[outside] = np.clip(step[outside], ends[0][outside], ends[1][outside])
            free &= ~outside
        return step

    def outside(self, label: np.ndarray) -> np.ndarray:
        """Residual (n,) of every block, `label` (n,) = 0, 1, ..., against the fit to all others, r_b + U_b (1 - U_b^T U_b)^-1 U_b^T r_b,
        for a residual at its optimum.

        As `predicted` of many blocks without bounds, but no smaller than the residual: a direction that a single block alone determines
        keeps that of the fit.
        """
        order = np.argsort(label, kind="stable")
        out = np.empty_like(self.residual)
        for rows in np.split(order, np.cumsum(np.bincount(label))[:-1]):
            own, r = self.basis[rows], self.residual[rows]
            values, vectors = np.linalg.eigh(own.T @ own)
            gain = np.divide(1.0, 1.0 - values, out=np.zeros_like(values), where=1.0 - values > 1e-3)
            out[rows] = r + own @ (vectors @ (gain * (vectors.T @ (own.T @ r))))
        return out

    def spread(self, block: np.ndarray) -> np.ndarray:
        """C S of columns S (n, k)."""
        if self.noise is None:
            return block
        spread = np.asarray(self.noise(block))
        if spread.shape != block.shape:
            raise ValueError(f"noise operator returned shape {spread.shape}, expected {block.shape}")
        return spread

    def meat(self, block: np.ndarray) -> np.ndarray:
        """S^T C S (k, k) of columns S (n, k)."""
        product = block.T @ self.spread(block)
        return np.asarray(0.5 * (product + product.T))

    def score(self, s: np.ndarray, groups: np.ndarray | None = None) -> Further:
        """Step, covariance and drop of further columns of which `felt` has left s (n, k).

        `groups` (n,) numbers rows that may be correlated with each other, whatever the reason: the covariance is in no direction smaller
        than the sums over these groups show it.
        """
        gram, right = s.T @ s, s.T @ self.left
        step = -np.linalg.solve(gram, right)
        inverse = np.linalg.inv(gram)
        meat = self.meat(s)
        if groups is not None:
            meat = _widened(meat, s * (self.left + s @ step)[:, None], groups)
        return Further(s, step, inverse @ meat @ inverse, inverse, float(-right @ step))

    def null(self, names: tuple[str, ...], tolerance: float) -> tuple[NullDirection, ...]:
        """Undetermined directions in their plainest form: a null space has many bases, this one has the fewest names."""
        found = [NullDirection((names[i],), (1.0,)) for i in np.flatnonzero(self.norms == 0.0)]
        alive = np.flatnonzero(self.norms > 0.0)
        felt = self if len(alive) == len(self.norms) else self.only(alive)
        basis = felt._svd[2][:, felt._rank(tolerance) :].T
        if basis.size:
            _, triangle, order = scipy.linalg.qr(basis, mode="economic", pivoting=True)
            plain = np.linalg.solve(triangle[:, : basis.shape[0]], triangle)
            basis = np.empty_like(plain)
            basis[:, order] = plain / np.linalg.norm(plain, axis=1, keepdims=True)
        for vector in basis:
            members = np.flatnonzero(np.abs(vector) > PARTICIPATION)
            found.append(NullDirection(tuple(names[alive[m]] for m in members), tuple(float(vector[m]) for m in members)))
        return tuple(found)

    def _sandwich(self, kept: np.ndarray, root: np.ndarray) -> tuple[np.ndarray, float]:
        """(J^T J)^+ J^T C J (J^T J)^+ and tr((J^T J)^+ J^T C J) of the columns at these places with that root: no condition squared."""
        if self.noise is None:
            return root @ root.T, float(root.shape[1])
        meat = self.meat(self.columns[:, kept] @ root)
        return root @ meat @ root.T, float(np.trace(meat))

    def covariance(self, names: tuple[str, ...], at_bound: np.ndarray | None = None, null_tolerance: float = 1e-6) -> Covariance:
        """P = s2 (J^T J)^-1 = 2 s2 H_lin^-1 (2.36 with the missing factor 2, because H_lin = 2 J^T J, 2.31), s2 = r.r/n_dof (2.38).

        With correlated noise the sandwich A^-1 J^T C J A^-1 with A = J^T J, and n_dof = n - tr(A^-1 J^T C J); without it C = I and
        n_dof = n - rank J. Parameters `at_bound` (p,) are held. Directions whose singular value is below `null_tolerance` of the largest
        are undetermined. UntrustworthyError if there are not more data than parameters.
        """
        n, size = self.columns.shape
        at_bound = np.zeros(size, dtype=bool) if at_bound is None else np.asarray(at_bound, dtype=bool)
        free = np.flatnonzero(~at_bound)
        small = self.triangular  # has the same singular values at a fraction of the cost
        fitted, own = small.only(free), tuple(names[i] for i in free)
        unit = np.zeros((size, size))
        unit[np.ix_(free, free)], trace = self._sandwich(free, fitted.root(null_tolerance))
        dof = n - trace
        if dof < 1e-6:  # an exact zero does not survive rounding
            raise UntrustworthyError(
                f"{n} residuals cannot determine {free.size} parameters and their errors (degrees of freedom {dof:.3g}): "
                "fix parameters or use more data"
            )
        s2 = self.f / dof
        variance = np.diag(unit).copy()
        for i in np.flatnonzero(at_bound):
            kept = np.append(free, i)
            released = small.only(kept)
            lost = any(names[i] in direction.names for direction in released.null((*own, names[i]), null_tolerance))
            variance[i] = np.inf if lost else self._sandwich(kept, released.root(null_tolerance))[0][-1, -1]
        null = fitted.null(own, null_tolerance)
        undetermined = [i for i in free if any(names[i] in direction.names for direction in null)]
        variance[undetermined] = np.inf
        unit[undetermined, :] = 0.0
        unit[:, undetermined] = 0.0
        return Covariance(
            names=names,
            matrix=s2 * unit,
            matrix_unit=unit,
            sigma=np.sqrt(s2) * np.sqrt(variance) if s2 > 0.0 else np.where(np.isinf(variance), np.inf, 0.0),
            sigma_unit=np.sqrt(variance),
            s2=s2,
            n=n,
            degrees_of_freedom=float(dof),
            correlation_sensitivity=correlation(self.columns.T @ self.columns),
            correlation_parameters=correlation(unit),
            at_bound=at_bound,
            null=null,
            condition=fitted.only(np.flatnonzero(fitted.norms > 0.0)).condition,
        )


def projection(columns: np.ndarray) -> LinearModel:
    """The model of columns (n, p) without a residual: for what lies in their span and beyond it."""
    return LinearModel(np.zeros(len(columns)), columns)


def _anywhere(count: int) -> Room:
    return np.full(count, -np.inf), np.full(count, np.inf)


def _widened(meat: np.ndarray, shown: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """S^T C S (k, k), or what groups of rows show of it by the sums of s_i r_i (n, k) over each, whichever is larger in every direction."""
    count = int(groups.max()) + 1
    sums = np.stack([np.bincount(groups, column, count) for column in shown.T], axis=1)
    root = np.linalg.cholesky(meat)
    inner = np.linalg.solve(root, np.linalg.solve(root, sums.T @ sums * count / max(count - 1, 1)).T)
    values, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    return np.asarray(root @ (vectors * np.maximum(values, 1.0)) @ vectors.T @ root.T)
