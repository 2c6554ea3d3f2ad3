"""How well the data determine the parameters: covariance, correlations, and which combination they do not determine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from thermofit.core.errors import UntrustworthyError

NoiseOperator = Callable[[np.ndarray], np.ndarray]

PARTICIPATION = 0.1
"""A parameter belongs to an undetermined direction if its share of the unit vector exceeds this."""


@dataclass(frozen=True)
class NullDirection:
    """A combination of parameters that the residual does not feel: `names` and `weights`, per unit of column norm.

    A single name is a parameter without any effect on the residual.
    """

    names: tuple[str, ...]
    weights: tuple[float, ...]


@dataclass(frozen=True)
class Covariance:
    """Covariance of the parameters at an optimum.

    `matrix` = s2 * `matrix_unit` (n_p, n_p): scaled with the reduced chi-square `s2` (2.38), resp. taking the whitening at its
    word (s2 = 1); zero rows for parameters at a bound, which are held there, and for undetermined ones. `sigma`, `sigma_unit` (n_p,):
    standard errors; that of a parameter at a bound is the one it would have if it alone were released; infinite exactly for
    the parameters in `null`. `correlation_sensitivity` C^S (2.34), `correlation_parameters` C^P (2.37), 0 where not defined.
    """

    names: tuple[str, ...]
    matrix: np.ndarray
    matrix_unit: np.ndarray
    sigma: np.ndarray
    sigma_unit: np.ndarray
    s2: float
    n: int
    degrees_of_freedom: float
    correlation_sensitivity: np.ndarray
    correlation_parameters: np.ndarray
    at_bound: np.ndarray
    null: tuple[NullDirection, ...]
    condition: float

    @property
    def identifiable(self) -> bool:
        """True if the data determine every parameter."""
        return not self.null


def covariance(
    jacobian: np.ndarray,
    residual: np.ndarray,
    names: tuple[str, ...],
    at_bound: np.ndarray | None = None,
    noise: NoiseOperator | None = None,
    null_tolerance: float = 1e-6,
) -> Covariance:
    """P = s2 (J^T J)^-1 = 2 s2 H_lin^-1 (2.36 with the missing factor 2, because H_lin = 2 J^T J, 2.31), s2 = r.r/n_dof (2.38).

    `jacobian` dr/dx (n, n_p) and `residual` (n,) whitened. With `noise`, a function that applies the correlation matrix C of
    the residual (unit diagonal) to columns (n, k), the sandwich A^-1 J^T C J A^-1 with A = J^T J, and n_dof = n - tr(A^-1 J^T C J);
    without it C = I and n_dof = n - rank J. Columns are normalised first; directions whose singular value is below
    `null_tolerance` of the largest are undetermined. UntrustworthyError if there are not more data than parameters.
    """
    n, size = jacobian.shape
    at_bound = np.zeros(size, dtype=bool) if at_bound is None else np.asarray(at_bound, dtype=bool)
    free = np.flatnonzero(~at_bound)
    bread = _Bread.of(jacobian, free, null_tolerance)
    unit, trace = bread.sandwich(jacobian, noise)
    dof = n - trace
    if dof < 1e-6:  # an exact zero does not survive rounding
        raise UntrustworthyError(
            f"{n} residuals cannot determine {free.size} parameters and their errors (degrees of freedom {dof:.3g}): "
            "fix parameters or use more data"
        )
    s2 = float(residual @ residual) / dof
    variance = np.diag(unit).copy()
    for i in np.flatnonzero(at_bound):
        released = _Bread.of(jacobian, np.append(free, i), null_tolerance)
        variance[i] = np.inf if names[i] in released.undetermined(names) else released.sandwich(jacobian, noise)[0][i, i]
    null = bread.null(names)
    lost = [i for i in free if any(names[i] in direction.names for direction in null)]
    variance[lost] = np.inf
    unit[lost, :] = 0.0
    unit[:, lost] = 0.0
    return Covariance(
        names=names,
        matrix=s2 * unit,
        matrix_unit=unit,
        sigma=np.sqrt(s2) * np.sqrt(variance) if s2 > 0.0 else np.where(np.isinf(variance), np.inf, 0.0),
        sigma_unit=np.sqrt(variance),
        s2=s2,
        n=n,
        degrees_of_freedom=float(dof),
        correlation_sensitivity=correlation(jacobian.T @ jacobian),
        correlation_parameters=correlation(unit),
        at_bound=at_bound,
        null=null,
        condition=bread.condition,
    )


def correlation(matrix: np.ndarray) -> np.ndarray:
    """C_ij = M_ij / sqrt(M_ii M_jj) (2.35, 2.37) of a symmetric matrix (n_p, n_p); rows with M_ii = 0 become unit rows."""
    root = np.sqrt(np.diag(matrix))
    root = np.where(root > 0.0, root, 1.0)
    result = matrix / np.outer(root, root)
    np.fill_diagonal(result, 1.0)
    return np.asarray(np.clip(result, -1.0, 1.0))


def require_identifiable(result: Covariance) -> None:
    """UntrustworthyError that names the parameters which the data do not determine."""
    if result.identifiable:
        return
    parts = []
    for direction in result.null:
        if len(direction.names) == 1:
            parts.append(f"'{direction.names[0]}' has no effect on the residual")
        else:
            parts.append(f"{' and '.join(repr(name) for name in direction.names)} can only be told apart up to one combination")
    raise UntrustworthyError(f"the data do not determine all parameters: {'; '.join(parts)}; fix one of each or add data")


@dataclass(frozen=True)
class _Bread:
    """Pseudo-inverse of J^T J over the parameters `free` by the SVD of their normalised columns; `dead` have a zero column."""

    size: int
    dead: np.ndarray
    free: np.ndarray
    norms: np.ndarray
    values: np.ndarray
    vectors: np.ndarray
    kept: np.ndarray

    @staticmethod
    def of(jacobian: np.ndarray, free: np.ndarray, tolerance: float) -> _Bread:
        norms = np.linalg.norm(jacobian[:, free], axis=0)
        dead, free, norms = free[norms == 0.0], free[norms > 0.0], norms[norms > 0.0]
        # The triangle has the singular values of the tall matrix at a fraction of the cost.
        triangle = np.linalg.qr(jacobian[:, free] / norms, mode="r") if free.size else np.zeros((0, 0))
        _, values, vectors_t = np.linalg.svd(triangle, full_matrices=True)
        values = np.pad(values, (0, free.size - values.size))
        kept = values > tolerance * max(float(values.max(initial=0.0)), np.finfo(float).tiny)
        return _Bread(jacobian.shape[1], dead, free, norms, values, vectors_t.T, kept)

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of the normalised columns, infinite where the smallest is zero."""
        if self.values.size == 0:
            return 1.0
        smallest = float(self.values.min())
        return float(self.values.max()) / smallest if smallest > 0.0 else float("inf")

    def basis(self) -> np.ndarray:
        """B (n_p, rank) with B B^T = (J^T J)^+, so that J B is orthonormal; zero rows for parameters that are not free."""
        full = np.zeros((self.size, int(np.count_nonzero(self.kept))))
        full[self.free] = self.vectors[:, self.kept] / self.values[self.kept] / self.norms[:, None]
        return full

    def sandwich(self, jacobian: np.ndarray, noise: NoiseOperator | None) -> tuple[np.ndarray, float]:
        """(J^T J)^+ J^T C J (J^T J)^+ (n_p, n_p) and tr((J^T J)^+ J^T C J), in the orthonormal basis, which squares no condition."""
        basis = self.basis()
        if noise is None:
            return basis @ basis.T, float(basis.shape[1])
        columns = jacobian @ basis
        spread = np.asarray(noise(columns))
        if spread.shape != columns.shape:
            raise ValueError(f"noise operator returned shape {spread.shape}, expected {columns.shape}")
        meat = columns.T @ spread
        return basis @ (0.5 * (meat + meat.T)) @ basis.T, float(np.trace(meat))

    def null(self, names: tuple[str, ...]) -> tuple[NullDirection, ...]:
        """Undetermined directions in their plainest form: a null space has many bases, this one has the fewest names."""
        found = [NullDirection((names[i],), (1.0,)) for i in self.dead]
        basis = self.vectors[:, ~self.kept].T
        if basis.size:
            _, triangle, order = scipy.linalg.qr(basis, mode="economic", pivoting=True)
            plain = np.linalg.solve(triangle[:, : basis.shape[0]], triangle)
            basis = np.empty_like(plain)
            basis[:, order] = plain / np.linalg.norm(plain, axis=1, keepdims=True)
        for vector in basis:
            members = np.flatnonzero(np.abs(vector) > PARTICIPATION)
            found.append(NullDirection(tuple(names[self.free[m]] for m in members), tuple(float(vector[m]) for m in members)))
        return tuple(found)

    def undetermined(self, names: tuple[str, ...]) -> set[str]:
        return {name for direction in self.null(names) for name in direction.names}
