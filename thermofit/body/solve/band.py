"""Symmetric band matrices: Cholesky, back-substitution in blocks on BLAS-3, and LU where the matrix is not positive.

scipy's own BLAS and LAPACK are called from compiled code. Their addresses, which differ from process to process, are bound to
symbols when this module is imported; the cached kernels hold only the names.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm  # type: ignore[import-untyped]
import numpy as np
from numba import types
from numba.extending import get_cython_function_address
from scipy.linalg import lapack

from thermofit.body.solve.band_panels import MARGIN, factor_in_panels, solve_in_panels, solve_lanes_in_panels
from thermofit.core.errors import NumericsError
from thermofit.core.jit import kernel
from thermofit.core.lanes import WIDTH
from thermofit.point.lanes_memory import lane_workspace

_BLOCK = 16
"""Columns eliminated at once in a solve; 16 to 32 are equally fast for half bandwidths of 70 to 700, more are slower."""
NARROW = 400
"""Half bandwidth up to which factorisation and solves in panels are used: the former takes a third of LAPACK's time at 71, 0.6 at 196."""


class NotPositiveError(Exception):
    """Cholesky met a pivot that is not positive."""


def _routine(module: str, name: str, n_arguments: int) -> Any:
    """A BLAS or LAPACK routine for kernels: all arguments by address, as in Fortran.

    Integers are passed as 64 bit numbers: on little-endian machines a routine that reads only 32 of them finds the same value.
    """
    symbol = f"thermofit_{name}"
    llvm.add_symbol(symbol, get_cython_function_address(f"scipy.linalg.{module}", name))
    return types.ExternalFunction(symbol, types.void(*[types.voidptr] * n_arguments))


_dpbtrf = _routine("cython_lapack", "dpbtrf", 6)
_dpbtrs = _routine("cython_lapack", "dpbtrs", 9)
_dtrsm = _routine("cython_blas", "dtrsm", 11)
_dgemm = _routine("cython_blas", "dgemm", 13)
_R, _L, _N, _T = (ord(letter) for letter in "RLNT")


@kernel
def _fill(row: np.ndarray, column: np.ndarray, data: np.ndarray, band: np.ndarray) -> None:
    """band[j, i - j] = K_ij, zero elsewhere."""
    band[:] = 0.0
    for s in range(row.shape[0]):
        band[column[s], row[s] - column[s]] = data[s]


@kernel
def _factor(band: np.ndarray, bandwidth: int) -> int:
    """LAPACK's Cholesky in place; 0, or the number of the first equation whose pivot is not positive."""
    letter = np.array([_L], dtype=np.uint8)
    n, ld = band.shape
    number = np.array([n, bandwidth, ld, 0], dtype=np.int64)
    _dpbtrf(letter.ctypes, number.ctypes, number[1:].ctypes, band.ctypes, number[2:].ctypes, number[3:].ctypes)
    return number[3]


@kernel
def _solve_one(band: np.ndarray, bandwidth: int, x: np.ndarray) -> None:
    """K^-1 x in place for one right-hand side x (n, 1): here LAPACK is as fast as memory."""
    letter = np.array([_L], dtype=np.uint8)
    n, ld = band.shape
    number = np.array([n, bandwidth, 1, ld, n, 0], dtype=np.int64)
    _dpbtrs(
        letter.ctypes, number.ctypes, number[1:].ctypes, number[2:].ctypes, band.ctypes, number[3:].ctypes, x.ctypes,
        number[4:].ctypes, number[5:].ctypes,
    )  # fmt: skip


@kernel
def _solve_many(band: np.ndarray, bandwidth: int, x: np.ndarray) -> None:
    """K^-1 x in place for x (n, m) in C order, which Fortran sees as x^T (m, n): x_1^T := x_1^T L_11^-T, x_2^T -= x_1^T L_21^T, and back.

    K_ij = band[j, i - j] lies at address i + j (ld - 1): any block of the band is a matrix with that leading dimension. The _BLOCK
    zeros beyond the band complete the block L_21 below a diagonal block, (bandwidth, _BLOCK), to a rectangle.
    """
    letter = np.array([_R, _L, _N, _T], dtype=np.uint8)
    right, lower, no, transposed = letter, letter[1:], letter[2:], letter[3:]
    one = np.array([1.0, -1.0])
    minus = one[1:]
    n, ld = band.shape
    m = x.shape[1]
    number = np.array([m, 0, 0, ld - 1], dtype=np.int64)
    k, r, stride = number[1:], number[2:], number[3:]
    factor, flat = band.reshape(-1), x.reshape(-1)
    for j in range(0, n, _BLOCK):
        k[0] = min(_BLOCK, n - j)
        r[0] = min(bandwidth, n - j - k[0])
        _dtrsm(
            right.ctypes, lower.ctypes, transposed.ctypes, no.ctypes, number.ctypes, k.ctypes, one.ctypes, factor[j * ld :].ctypes,
            stride.ctypes, flat[j * m :].ctypes, number.ctypes,
        )  # fmt: skip
        if r[0] > 0:
            _dgemm(
                no.ctypes, transposed.ctypes, number.ctypes, r.ctypes, k.ctypes, minus.ctypes, flat[j * m :].ctypes, number.ctypes,
                factor[j * ld + k[0] :].ctypes, stride.ctypes, one.ctypes, flat[(j + k[0]) * m :].ctypes, number.ctypes,
            )  # fmt: skip
    for j in range((n - 1) // _BLOCK * _BLOCK, -1, -_BLOCK):
        k[0] = min(_BLOCK, n - j)
        r[0] = min(bandwidth, n - j - k[0])
        if r[0] > 0:
            _dgemm(
                no.ctypes, no.ctypes, number.ctypes, k.ctypes, r.ctypes, minus.ctypes, flat[(j + k[0]) * m :].ctypes, number.ctypes,
                factor[j * ld + k[0] :].ctypes, stride.ctypes, one.ctypes, flat[j * m :].ctypes, number.ctypes,
            )  # fmt: skip
        _dtrsm(
            right.ctypes, lower.ctypes, no.ctypes, no.ctypes, number.ctypes, k.ctypes, one.ctypes, factor[j * ld :].ctypes,
            stride.ctypes, flat[j * m :].ctypes, number.ctypes,
        )  # fmt: skip


class BandCholesky:
    """K = L L^T of a band given by its lower non-zeros; NotPositiveError where a pivot is not positive."""

    def __init__(self, n: int, bandwidth: int, row: np.ndarray, column: np.ndarray, data: np.ndarray) -> None:
        self.bandwidth = bandwidth
        rows, columns = -(-n // WIDTH) * WIDTH, 1 + -(-(bandwidth + max(_BLOCK, MARGIN)) // WIDTH) * WIDTH
        self._whole = lane_workspace(-(-rows * columns // WIDTH))[: rows * columns].reshape(rows, columns)
        _fill(row, column, data, self._whole)
        self._whole[n:, 0] = 1.0
        self.band = self._whole[:n]
        if not (factor_in_panels(self._whole, bandwidth) if bandwidth <= NARROW else _factor(self.band, bandwidth) == 0):
            raise NotPositiveError

    def solve(self, b: np.ndarray) -> np.ndarray:
        """x (n, m) in C order for b (n, m)."""
        n, m = b.shape
        if self.bandwidth <= NARROW and (m == 1 or (m > 0 and m % WIDTH == 0)):
            x = np.zeros((len(self._whole), m))
            x[:n] = b
            if m == 1:
                solve_in_panels(self._whole, self.bandwidth, x[:, 0])
            else:
                solve_lanes_in_panels(self._whole, self.bandwidth, x)
            return x[:n]
        x = np.array(b, dtype=float, order="C")
        if x.shape[1] == 1:
            _solve_one(self.band, self.bandwidth, x)
        elif x.shape[1] > 1:
            _solve_many(self.band, self.bandwidth, x)
        return x


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
