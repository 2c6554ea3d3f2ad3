"""General sparse factorisations: SuperLU of scipy, and PARDISO of the Intel MKL where the optional package pypardiso is installed."""

from __future__ import annotations

import importlib.util
import weakref
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.linalg import splu

from thermofit.body.solve.band import NotPositiveError
from thermofit.core.errors import NumericsError

_KEEP_DIAGONAL = 0.01
"""Pivots of SuperLU stay on the diagonal down to this share of their column: partial pivoting (1) destroys the symmetric ordering,
which took 13 s instead of 0.3 s on an indefinite matrix of 14 000 equations. Refinement makes up for what it costs in digits."""
_SYMMETRIC_POSITIVE = 2
_ANALYSE, _FACTOR, _SOLVE, _RELEASE = 11, 22, 33, -1
_NOT_POSITIVE = -4
_CONTROL = {1: 1, 2: 2, 8: 0}
"""iparm of PARDISO, counted from 1: (1) no defaults, which gave residuals of 1e30 without a word; (2) numbering by METIS nested
dissection; (8) no refinement inside, because every solve is checked and refined outside, at a quarter of the time."""


class PardisoError(Exception):
    """PARDISO failed; the text says how."""


class PardisoMissingError(PardisoError):
    """pypardiso or the MKL could not be loaded; the text says why."""


class SparseLU:
    """LU by SuperLU, minimum degree ordering; NumericsError where the matrix is singular."""

    def __init__(self, n: int, row: np.ndarray, column: np.ndarray, data: np.ndarray) -> None:
        off = row != column
        rows, columns = np.concatenate([row, column[off]]), np.concatenate([column, row[off]])
        matrix = csc_matrix((np.concatenate([data, data[off]]), (rows, columns)), shape=(n, n))
        try:
            self._lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=_KEEP_DIAGONAL, options={"SymmetricMode": True})
        except RuntimeError as err:
            raise NumericsError(f"linear solve: the matrix is singular ({err}); check that the body is held and heat can leave it") from err

    def solve(self, b: np.ndarray) -> np.ndarray:
        """x (n, m) for b (n, m)."""
        return np.ascontiguousarray(self._lu.solve(b))


def pardiso_installed() -> bool:
    """True where the optional package pypardiso can be imported."""
    return importlib.util.find_spec("pypardiso") is not None


class PardisoAnalysis:
    """Symbolic factorisation of one pattern, made once, and the only numeric one that PARDISO keeps for it."""

    def __init__(self, n: int, row: np.ndarray, column: np.ndarray) -> None:
        try:
            import pypardiso

            self._solver = pypardiso.PyPardisoSolver(mtype=_SYMMETRIC_POSITIVE)
        except (ImportError, OSError) as err:
            raise PardisoMissingError(f"PARDISO could not be loaded ({err})") from err
        for number, value in _CONTROL.items():
            self._solver.set_iparm(number, value)
        # PARDISO wants the upper triangle by rows; it is the lower one by columns.
        self._by_column = np.lexsort((row, column))
        start = np.searchsorted(column[self._by_column], np.arange(n + 1))
        self._upper = csr_matrix((np.ones(len(row)), row[self._by_column], start), shape=(n, n))
        self._owner: object = None
        self._call(_ANALYSE, self._upper, np.zeros((n, 1)))
        weakref.finalize(self, _release, self._solver, self._upper)

    def solve(self, owner: object, data: np.ndarray, b: np.ndarray) -> np.ndarray:
        """K^-1 b for the matrix with the non-zeros `data`, factored again only if another one was factored since."""
        self.factor(owner, data)
        return self._call(_SOLVE, self._upper, np.asfortranarray(b))

    def factor(self, owner: object, data: np.ndarray) -> None:
        """Numeric factorisation on behalf of `owner`."""
        if self._owner is owner:
            return
        self._owner = None
        self._upper.data[:] = data[self._by_column]
        self._call(_FACTOR, self._upper, np.zeros((self._upper.shape[0], 1)))
        self._owner = owner

    def _call(self, phase: int, matrix: csr_matrix, b: np.ndarray) -> np.ndarray:
        from pypardiso.pardiso_wrapper import PyPardisoError

        self._solver.set_phase(phase)
        try:
            return self._solver._call_pardiso(matrix, b)
        except PyPardisoError as err:
            if err.value == _NOT_POSITIVE:
                raise NotPositiveError from err
            raise PardisoError(f"PARDISO stopped with error {err.value}") from err


def _release(solver: Any, matrix: csr_matrix) -> None:
    solver.set_phase(_RELEASE)
    solver._call_pardiso(matrix, np.zeros((matrix.shape[0], 1)))


class PardisoCholesky:
    """K = L L^T by PARDISO; NotPositiveError where a pivot is not positive, PardisoError where PARDISO fails."""

    def __init__(self, analysis: PardisoAnalysis, data: np.ndarray) -> None:
        self._analysis, self._data, self._token = analysis, data, object()
        analysis.factor(self._token, data)

    def solve(self, b: np.ndarray) -> np.ndarray:
        """x (n, m) for b (n, m)."""
        return np.ascontiguousarray(self._analysis.solve(self._token, self._data, b))
