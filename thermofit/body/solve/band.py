"""Symmetric band matrices: Cholesky in panels (`band_panels`), and LAPACK's LU where the matrix is not positive."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from thermofit.body.solve.band_panels import MARGIN, factor_in_panels, solve_in_panels, solve_lanes_in_panels
from thermofit.core.errors import NumericsError
from thermofit.core.jit import kernel
from thermofit.core.lanes import WIDTH
from thermofit.point.lanes_memory import lane_workspace


class NotPositiveError(Exception):
    """Cholesky met a pivot that is not positive."""


@kernel
def _fill(row: np.ndarray, column: np.ndarray, data: np.ndarray, band: np.ndarray) -> None:
    """band[j, i - j] = K_ij, zero elsewhere."""
    band[:] = 0.0
    for s in range(row.shape[0]):
        band[column[s], row[s] - column[s]] = data[s]


class BandCholesky:
    """K = L L^T of a band given by its lower non-zeros; NotPositiveError where a pivot is not positive."""

    def __init__(self, n: int, bandwidth: int, row: np.ndarray, column: np.ndarray, data: np.ndarray) -> None:
        self.bandwidth = bandwidth
        rows, columns = _filled_up(n), 1 + _filled_up(bandwidth + MARGIN)
        self._whole = lane_workspace(-(-rows * columns // WIDTH))[: rows * columns].reshape(rows, columns)
        _fill(row, column, data, self._whole)
        self._whole[n:, 0] = 1.0
        self.band = self._whole[:n]
        if not factor_in_panels(self._whole, bandwidth):
            raise NotPositiveError

    def solve(self, b: np.ndarray) -> np.ndarray:
        """x (n, m) in C order for b (n, m)."""
        n, m = b.shape
        x = np.zeros((len(self._whole), m if m <= 1 else _filled_up(m)))
        x[:n, :m] = b
        if m == 1:
            solve_in_panels(self._whole, self.bandwidth, x[:, 0])
        elif m > 1:
            solve_lanes_in_panels(self._whole, self.bandwidth, x)
        return np.ascontiguousarray(x[:n, :m])


def _filled_up(n: int) -> int:
    """n, or the next multiple of WIDTH."""
    return -(-n // WIDTH) * WIDTH


class BandLU:
    """K = P L U of a symmetric indefinite band given by its lower non-zeros; NumericsError where K is singular."""

    def __init__(self, n: int, bandwidth: int, row: np.ndarray, column: np.ndarray, data: np.ndarray) -> None:
        self.bandwidth = bandwidth
        band = np.zeros((n, 3 * bandwidth + 1))
        band[column, 2 * bandwidth + row - column] = data
        band[row, 2 * bandwidth + column - row] = data
        self.band, self.pivots, info = lapack.dgbtrf(band.T, bandwidth, bandwidth, overwrite_ab=1)
        if info != 0:
            raise NumericsError(
                f"linear solve: the matrix is singular (no pivot in equation {info}); check that the body is held and heat can leave it"
            )

    def solve(self, b: np.ndarray) -> np.ndarray:
        """x (n, m) for b (n, m)."""
        x, info = lapack.dgbtrs(self.band, self.bandwidth, self.bandwidth, b, self.pivots)
        if info != 0:
            raise NumericsError(f"band solve: LAPACK dgbtrs returned {info}; expected 0")
        return np.ascontiguousarray(x)
