"""Linear algebra behind one small interface: symmetric pattern, factor, solve many, residual check, refine, fall back.

The solver is chosen by predicted cost (`sparse_plan`): band Cholesky for long thin bodies, general sparse otherwise; the numbering
for the band lives inside. A matrix that is not positive definite (past the load maximum) is factored by LU. Solves are checked by their
residual: every one, or of a band Cholesky factor, whose solves are backward stable, the first and then one in `_SAMPLED`. The
environment variable THERMOFIT_SOLVER (auto, band, sparse, pardiso) overrides the choice.
"""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np

from thermofit.body.solve.band import BandCholesky, BandLU, NotPositiveError
from thermofit.body.solve.sparse import PardisoAnalysis, PardisoCholesky, PardisoError, PardisoMissingError, SparseLU, pardiso_installed
from thermofit.body.solve.sparse_plan import BAND_CHOLESKY, BAND_LU, PARDISO, SPARSE_LU, Plan, plan_of
from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.jit import kernel

SOLVER_VARIABLE = "THERMOFIT_SOLVER"
"""Environment variable that asks for a solver; without it the cheapest one is taken."""

_RESIDUAL_LIMIT = 1e-8
_ROUNDING, _AT_ROUNDING = 16.0 * np.finfo(float).eps, 1e-6
"""A residual below _ROUNDING |K| |x| is rounding of the product itself: a better x leaves no less (W. Oettli and W. Prager, Numer. Math. 6,
1964). Where a specimen as a whole is far softer than its elements, this is above _RESIDUAL_LIMIT of the load well before the matrix is
singular. Such an x is taken up to a residual of _AT_ROUNDING of the load."""
_SEVERAL = 4
"""Right-hand sides from which they are checked together."""
_REFINEMENTS = 2
_SAMPLED = 8
"""Solves by one band Cholesky factor of which one is checked."""
_ASKED = {"band": (BAND_CHOLESKY, BAND_LU), "sparse": (SPARSE_LU, SPARSE_LU), "pardiso": (PARDISO, SPARSE_LU)}
"""Solver that is asked for, and the one for a matrix that is not positive definite."""


@dataclass(frozen=True, eq=False)
class BandPattern:
    """Sparsity of a symmetric matrix, kept by the non-zeros of its lower triangle row by row: entry s is (row[s], column[s]).

    `bandwidth` is the half bandwidth of the equations as they are numbered. `fallbacks` counts, by a sentence each, how often a
    factorisation of this pattern did not go the planned way.
    """

    n: int
    bandwidth: int
    row: np.ndarray
    column: np.ndarray
    fallbacks: Counter[str] = field(default_factory=Counter)

    @property
    def n_slots(self) -> int:
        """Number of stored non-zeros of the lower triangle."""
        return len(self.row)

    @cached_property
    def plan(self) -> Plan:
        """Numbering and predicted cost of all solvers, found when first needed."""
        return plan_of(self.n, self.row, self.column, self.bandwidth)

    @cached_property
    def pardiso(self) -> PardisoAnalysis:
        """PARDISO's symbolic factorisation, made when first needed."""
        return PardisoAnalysis(self.n, self.row, self.column)

    def __reduce__(self) -> tuple[object, ...]:
        """What is found when needed stays in its process: PARDISO's part of it is an address."""
        return BandPattern, (self.n, self.bandwidth, self.row, self.column)


def _lower_keys(equation: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    rows = np.broadcast_to(equation[:, :, None], (*equation.shape, equation.shape[1]))
    columns = np.swapaxes(rows, 1, 2)
    used = (rows >= columns) & (columns >= 0)
    return used, rows[used].astype(np.int64) * n + columns[used]


def band_pattern(equation: np.ndarray, n: int) -> BandPattern:
    """Pattern of element matrices whose local dofs have the given equations, (n_el, n_dof), -1 for prescribed dofs."""
    unique = np.unique(_lower_keys(equation, n)[1])
    row, column = unique // n, unique % n
    return BandPattern(n, int((row - column).max(initial=0)), row, column)


def slots(pattern: BandPattern, equation: np.ndarray) -> np.ndarray:
    """Storage slot (n_el, n_dof, n_dof) of every local pair of dofs with the given equations; -1 where it is skipped.

    Two local dofs of one equation (a tie) count with both their pairs, because only the lower triangle is kept.
    """
    used, key = _lower_keys(equation, pattern.n)
    out = np.full(used.shape, -1, dtype=np.int32)
    out[used] = np.searchsorted(pattern.row * pattern.n + pattern.column, key)
    return out


@kernel
def scatter(values: np.ndarray, slot: np.ndarray, data: np.ndarray) -> None:
    """data (n_slots,) += element matrices `values` (n_el, m, m) by `slot` (n_el, m, m)."""
    for e in range(values.shape[0]):
        for i in range(values.shape[1]):
            for j in range(values.shape[2]):
                s = slot[e, i, j]
                if s >= 0:
                    data[s] += values[e, i, j]


@kernel
def gathered(equation: np.ndarray, force: np.ndarray, out: np.ndarray) -> None:
    """out (n_eq,) += element forces (n_el, 24) by equation numbers (n_el, 24); negative numbers are prescribed dofs."""
    for e in range(equation.shape[0]):
        for i in range(equation.shape[1]):
            k = equation[e, i]
            if k >= 0:
                out[k] += force[e, i]


@kernel
def multiply_symmetric(row: np.ndarray, column: np.ndarray, data: np.ndarray, x: np.ndarray) -> np.ndarray:
    """y = K x (n,) of a symmetric matrix kept by its lower triangle; fastest where the non-zeros of a row follow each other."""
    y = np.zeros(x.shape[0])
    s, n_slots = 0, row.shape[0]
    while s < n_slots:
        i, total = row[s], 0.0
        x_i = x[i]
        while s < n_slots and row[s] == i:
            j = column[s]
            total += data[s] * x[j]
            if i != j:
                y[j] += data[s] * x_i
            s += 1
        y[i] += total
    return y


@kernel
def _residual(row: np.ndarray, column: np.ndarray, data: np.ndarray, x: np.ndarray, b: np.ndarray) -> np.ndarray:
    """b - K x for x and b (n, m) in C order: the m values of an equation lie side by side."""
    m = x.shape[1]
    r = b.copy()
    for s in range(row.shape[0]):
        i, j, k_ij = row[s], column[s], data[s]
        for c in range(m):
            r[i, c] -= k_ij * x[j, c]
        if i != j:
            for c in range(m):
                r[j, c] -= k_ij * x[i, c]
    return r


@kernel
def _largest(a: np.ndarray) -> np.ndarray:
    """Largest absolute value (m,) of every column of a (n, m); nan where a column holds one."""
    top = np.zeros(a.shape[1])
    for i in range(a.shape[0]):
        for c in range(a.shape[1]):
            value = abs(a[i, c])
            if value > top[c] or value != value:
                top[c] = value
    return top


class _Solver(Protocol):
    def solve(self, b: np.ndarray) -> np.ndarray:
        """x (n, m) in C order for b (n, m)."""


@dataclass(frozen=True)
class _Renumbered:
    """A solver of the matrix whose equation k is equation order[k] here."""

    solver: _Solver
    order: np.ndarray

    def solve(self, b: np.ndarray) -> np.ndarray:
        x = np.empty_like(b)
        x[self.order] = self.solver.solve(b[self.order])
        return x


class Factor:
    """A factored symmetric matrix: `solve(b)` for (n,) or (n, m) right-hand sides, fastest in C order. `data` must stay as it is.

    `method` names the solver in use. NumericsError where the matrix is singular, StudyError where THERMOFIT_SOLVER asks for something
    that is not there.
    """

    def __init__(self, pattern: BandPattern, data: np.ndarray) -> None:
        self._pattern, self._data, self._solves = pattern, data, 0
        asked = _asked()
        self.method = _ASKED[asked][0] if asked in _ASKED else _cheapest(pattern.plan)
        try:
            self._solver = self._made()
        except NotPositiveError:
            method = _ASKED[asked][1] if asked in _ASKED else pattern.plan.cheapest((BAND_LU, SPARSE_LU))
            self._take(method, "the matrix is not positive definite")
        except PardisoError as err:
            if asked == "pardiso" and isinstance(err, PardisoMissingError):
                raise StudyError(
                    f"{SOLVER_VARIABLE} is pardiso, but {err}; install it with pip install 'thermofit[mkl]' or use another solver"
                ) from err
            self._take(SPARSE_LU, str(err))

    @property
    def positive(self) -> bool:
        """True for a Cholesky factorisation, False for LU."""
        return self.method in (BAND_CHOLESKY, PARDISO)

    def solve(self, b: np.ndarray) -> np.ndarray:
        """x with K x = b, refined where a residual asks for it; every column is judged by its own size.

        NumericsError where a residual stays large; then, and where one had to be refined, the next solve is checked too.
        """
        right = np.ascontiguousarray(b, dtype=float).reshape(self._pattern.n, -1 if b.ndim == 1 else b.shape[1])
        if self.method == BAND_CHOLESKY and self._solves % _SAMPLED:
            self._solves += 1
            return self._solver.solve(right).reshape(b.shape)
        x, size = self._refined(right)
        if self.method == PARDISO and not size <= _RESIDUAL_LIMIT:
            self._take(SPARSE_LU, "a residual stayed large")
            x, size = self._refined(right)
        if not (size <= _RESIDUAL_LIMIT or (size <= _AT_ROUNDING and self._at_rounding(x, right))):
            raise NumericsError(
                f"linear solve: relative residual {size:.1e} after refinement ({self.method}), expected below {_RESIDUAL_LIMIT:.0e}: the "
                "matrix is nearly singular, as at the load maximum of a specimen that its force drives; prescribe the displacement of its "
                "end or of sections instead"
            )
        return x.reshape(b.shape)

    def _refined(self, b: np.ndarray) -> tuple[np.ndarray, float]:
        """x (n, m) after at most _REFINEMENTS corrections, and its largest relative residual (nan where x is not finite)."""
        scale = _largest(b)
        x = self._solver.solve(b)
        if b.shape[1] >= _SEVERAL and self._sound(x, b, scale):
            self._solves += 1
            return x, 0.0
        for refinement in range(_REFINEMENTS + 1):
            with np.errstate(all="ignore"):
                residual = self._residual(x, b)
                error = _largest(residual)
                size = float(np.where(error > 0.0, error / scale, error).max(initial=0.0))
            if size <= _RESIDUAL_LIMIT and refinement == 0:
                self._solves += 1
            if size <= _RESIDUAL_LIMIT or refinement == _REFINEMENTS or not np.isfinite(size):
                break
            x = x + self._solver.solve(residual)
        return x, size

    def _at_rounding(self, x: np.ndarray, b: np.ndarray) -> bool:
        """Whether the residual of every column of x (n, m) is rounding alone."""
        p = self._pattern
        error, sizes = _largest(self._residual(x, b)), _residual(p.row, p.column, -np.abs(self._data), np.abs(x), np.zeros_like(b))
        return bool(np.all(error <= _ROUNDING * _largest(sizes)))

    def _sound(self, x: np.ndarray, b: np.ndarray, scale: np.ndarray) -> bool:
        """Whether all columns pass at once: the residual of one random combination of them, each taken in units of its own size.

        A column that fails would have to be cancelled by the others to pass (R. Freivalds, IFIP Congress 1977). False asks for the full
        check.
        """
        weights = np.random.default_rng(b.shape[1]).uniform(0.5, 1.5, b.shape[1]) / np.where(scale > 0.0, scale, 1.0)
        weights[::2] *= -1.0
        with np.errstate(all="ignore"):
            error = _largest(self._residual((x @ weights)[:, None], (b @ weights)[:, None]))
        return bool(error[0] <= 0.5 * _RESIDUAL_LIMIT)

    def _residual(self, x: np.ndarray, b: np.ndarray) -> np.ndarray:
        p = self._pattern
        if x.shape[1] == 1:
            return b - multiply_symmetric(p.row, p.column, self._data, x[:, 0])[:, None]
        return _residual(p.row, p.column, self._data, x, b)

    def _take(self, method: str, reason: str) -> None:
        """Factor by another method, and count why."""
        self._pattern.fallbacks[f"linear solve: {self.method} was replaced by {method}, because {reason}"] += 1
        self.method = method
        self._solver = self._made()

    def _made(self) -> _Solver:
        pattern, data = self._pattern, self._data
        if self.method != BAND_CHOLESKY and not np.all(np.isfinite(data)):
            raise NumericsError("linear solve: the matrix holds numbers that are not finite; check the deformation and the parameters")
        if self.method == PARDISO:
            return PardisoCholesky(pattern.pardiso, data)
        if self.method == SPARSE_LU:
            return SparseLU(pattern.n, pattern.row, pattern.column, data)
        plan = pattern.plan
        band = BandCholesky if self.method == BAND_CHOLESKY else BandLU
        solver = band(pattern.n, plan.bandwidth, plan.row, plan.column, data)
        return solver if plan.order is None else _Renumbered(solver, plan.order)


def _asked() -> str:
    """Value of THERMOFIT_SOLVER; StudyError for an unknown one."""
    asked = os.environ.get(SOLVER_VARIABLE) or "auto"
    if asked != "auto" and asked not in _ASKED:
        raise StudyError(f"{SOLVER_VARIABLE} is '{asked}'; expected auto, {', '.join(_ASKED)}")
    return asked


def _cheapest(plan: Plan) -> str:
    """Cheapest method that is there; whether PARDISO is takes a search on disk, so that it is asked only where it would be taken."""
    method = plan.cheapest((BAND_CHOLESKY, SPARSE_LU, PARDISO))
    return method if method != PARDISO or pardiso_installed() else plan.cheapest((BAND_CHOLESKY, SPARSE_LU))
