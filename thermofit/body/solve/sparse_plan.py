"""Which solver for which sparsity pattern: predicted seconds of each, and the numbering that the band solvers use."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from thermofit.body.solve.sparse_graph import dissection_size, narrow_order, node_graph

BAND_CHOLESKY, BAND_LU, SPARSE_LU, PARDISO = "band Cholesky", "band LU", "SuperLU", "PARDISO Cholesky"

_NARROWER = 0.9
"""Another numbering is taken where it makes the band narrower by this factor; it costs a permutation in every solve."""

_PRICE = {BAND_CHOLESKY: (2.0e-9, 16e-12), BAND_LU: (23e-9, 61e-12), SPARSE_LU: (34e-9, 130e-12), PARDISO: (18e-9, 10e-12)}
"""Seconds per non-zero and per multiplication of the Cholesky factor, for one factorisation and one solve with 16 right-hand sides.

Fitted on one thread to bars, plates (with and without a hole), slabs and cubes of 860 to 61 000 equations with 1 and 3 unknowns per
node: non-zeros n b and multiplications n b^2 / 1 of a band of half width b, those of nested dissection for the sparse solvers. The
predictions meet the measured times within 40 %; other machines change them all, their ratios much less. Those of band Cholesky were
fitted anew when its panels became faster, to dogbones and a cube of 14 000 to 26 000 equations and half widths of 196 to 1348.
"""


@dataclass(frozen=True)
class Plan:
    """Band numbering and predicted seconds of every solver for one pattern.

    `order` (n,) lists the equations in the band's numbering (None: as they are), (`row`, `column`) are the stored non-zeros in it.
    """

    bandwidth: int
    row: np.ndarray
    column: np.ndarray
    order: np.ndarray | None
    seconds: Mapping[str, float]

    def cheapest(self, methods: Iterable[str]) -> str:
        """The method with the least predicted seconds."""
        return min(methods, key=self.seconds.__getitem__)


def plan_of(n: int, row: np.ndarray, column: np.ndarray, bandwidth: int) -> Plan:
    """Plan for the pattern with the lower non-zeros (row, column) and that half bandwidth."""
    graph = node_graph(n, row, column)
    multiplications, non_zeros = dissection_size(graph)
    order, narrow = narrow_order(graph, row, column)
    if narrow >= _NARROWER * bandwidth:
        return Plan(bandwidth, row, column, None, _seconds(n, bandwidth, non_zeros, multiplications))
    position = np.empty(n, dtype=np.int64)
    position[order] = np.arange(n)
    i, j = position[row], position[column]
    return Plan(narrow, np.maximum(i, j), np.minimum(i, j), order, _seconds(n, narrow, non_zeros, multiplications))


def _seconds(n: int, bandwidth: int, non_zeros: float, multiplications: float) -> dict[str, float]:
    band, sparse = (float(n * bandwidth), float(n) * bandwidth**2), (non_zeros, multiplications)
    out = {}
    for method, (per_entry, per_multiplication) in _PRICE.items():
        entries, products = band if method in (BAND_CHOLESKY, BAND_LU) else sparse
        out[method] = per_entry * entries + per_multiplication * products
    return out
