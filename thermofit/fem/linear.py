"""Linear algebra behind one small interface: symmetric band pattern, factor, solve, residual check, fall back.

Numbering the nodes of a long thin body along its long axis gives a narrow band, on which LAPACK's band Cholesky beats
general sparse solvers; where the band is not narrow, SuperLU takes over. A matrix that is not positive definite (past the
load maximum) is factored by SuperLU as well. Every solve is checked by its residual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from thermofit.core.errors import NumericsError
from thermofit.core.jit import kernel

_RESIDUAL_LIMIT = 1e-8
_BAND_SHARE = 0.15
"""Band storage is used where the half bandwidth is below this share of the equations."""


@dataclass(frozen=True)
class BandPattern:
    """Sparsity of a symmetric matrix, kept by the non-zeros of its lower triangle: entry s is (row[s], column[s])."""

    n: int
    bandwidth: int
    row: np.ndarray
    column: np.ndarray

    @property
    def n_slots(self) -> int:
        """Number of stored non-zeros of the lower triangle."""
        return len(self.row)


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
def multiply_symmetric(row: np.ndarray, column: np.ndarray, data: np.ndarray, x: np.ndarray) -> np.ndarray:
    """y = K x of a symmetric matrix kept by its lower triangle."""
    y = np.zeros(x.shape[0])
    for s in range(row.shape[0]):
        i, j = row[s], column[s]
        y[i] += data[s] * x[j]
        if i != j:
            y[j] += data[s] * x[i]
    return y


class Factor:
    """A factored symmetric matrix: `solve(b)` for (n,) or (n, m) right-hand sides.

    `positive` is False where Cholesky met a negative pivot or the band was too wide and LU was taken.
    """

    def __init__(self, pattern: BandPattern, data: np.ndarray) -> None:
        self._pattern, self._data = pattern, data
        self._lu: SuperLU | None = None
        self.positive = False
        if pattern.bandwidth < _BAND_SHARE * pattern.n + 50:
            band = np.zeros((pattern.n, pattern.bandwidth + 1))
            band[pattern.column, pattern.row - pattern.column] = data
            self._band, info = lapack.dpbtrf(band.T, lower=1, overwrite_ab=1)
            self.positive = info == 0
        if not self.positive:
            self._lu = _sparse_lu(pattern, data)

    def solve(self, b: np.ndarray) -> np.ndarray:
        """x with K x = b; one refinement where the residual asks for it. NumericsError where the residual stays large."""
        x = self._raw_solve(b)
        for refinement in range(3):
            residual = b - self._apply(x)
            size = float(np.max(np.abs(residual), initial=0.0)) / max(float(np.max(np.abs(b), initial=0.0)), 1e-300)
            if size <= _RESIDUAL_LIMIT or not np.any(b):
                return x
            if refinement < 2:
                x = x + self._raw_solve(residual)
        raise NumericsError(
            f"linear solve: relative residual {size:.1e} after refinement, expected below {_RESIDUAL_LIMIT:.0e}; "
            "check the boundary conditions"
        )

    def _apply(self, x: np.ndarray) -> np.ndarray:
        p = self._pattern
        if x.ndim == 1:
            return multiply_symmetric(p.row, p.column, self._data, x)
        return np.stack([multiply_symmetric(p.row, p.column, self._data, np.ascontiguousarray(c)) for c in x.T], axis=1)

    def _raw_solve(self, b: np.ndarray) -> np.ndarray:
        if self._lu is not None:
            return self._lu.solve(b)
        x, info = lapack.dpbtrs(self._band, b, lower=1)
        if info != 0:
            raise NumericsError(f"band solve: LAPACK dpbtrs returned {info}; expected 0")
        return x


def _sparse_lu(pattern: BandPattern, data: np.ndarray) -> SuperLU:
    off = pattern.row != pattern.column
    rows = np.concatenate([pattern.row, pattern.column[off]])
    columns = np.concatenate([pattern.column, pattern.row[off]])
    matrix = csc_matrix((np.concatenate([data, data[off]]), (rows, columns)), shape=(pattern.n, pattern.n))
    try:
        return splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    except RuntimeError as err:
        raise NumericsError(f"linear solve: the matrix is singular ({err}); check that the body is held and heat can leave it") from err
