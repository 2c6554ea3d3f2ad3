"""Cholesky factorisation of a narrow band, K = L L^T, in panels of eight columns that stay in registers while they are formed.

LAPACK hands blocks to BLAS-3, which for half bandwidths below some hundred are too small to be fast. Here a tile, eight rows of a
panel, gathers what all columns to its left give,

    L_tile L_panel^T = K_tile - sum over k left of the panel of L_tile,k L_panel,k^T,

eight rows as lanes, one lanes value for each column, and is then divided by the panel's diagonal block (left-looking, tile by tile).
K_ij and L_ij lie at i + j stride of the flat band: a tile's rows of one column lie side by side, and so do the eight factors L_panel,k.
"""

from __future__ import annotations

import math

import numpy as np

from thermofit.core.jit import kernel
from thermofit.core.lanes import WIDTH, Lanes, multiply_add
from thermofit.point.lanes_memory import at, set_at

MARGIN = 2 * WIDTH
"""Zeros that a column needs beyond its half bandwidth: the last tile of a panel reaches so far."""
Tile = tuple[Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes]
"""Eight rows of the eight columns of a panel, column by column."""


@kernel(forceinline=True)
def _tile(flat: np.ndarray, start: int, stride: int) -> Tile:
    """Tile whose first row and column lie at `start`."""
    return (
        at(flat, start), at(flat, start + stride), at(flat, start + 2 * stride), at(flat, start + 3 * stride),
        at(flat, start + 4 * stride), at(flat, start + 5 * stride), at(flat, start + 6 * stride), at(flat, start + 7 * stride),
    )  # fmt: skip


@kernel(forceinline=True)
def _set_tile(flat: np.ndarray, start: int, stride: int, tile: Tile) -> None:
    set_at(flat, start, tile[0])
    set_at(flat, start + stride, tile[1])
    set_at(flat, start + 2 * stride, tile[2])
    set_at(flat, start + 3 * stride, tile[3])
    set_at(flat, start + 4 * stride, tile[4])
    set_at(flat, start + 5 * stride, tile[5])
    set_at(flat, start + 6 * stride, tile[6])
    set_at(flat, start + 7 * stride, tile[7])


@kernel(forceinline=True)
def _less(a: Tile, rows: Lanes, flat: np.ndarray, m: int) -> Tile:
    """a - L_tile,k L_panel,k^T: `rows` is L_tile,k, the eight numbers from m on are L_panel,k."""
    v = -rows
    return (
        multiply_add(v, flat[m], a[0]), multiply_add(v, flat[m + 1], a[1]), multiply_add(v, flat[m + 2], a[2]),
        multiply_add(v, flat[m + 3], a[3]), multiply_add(v, flat[m + 4], a[4]), multiply_add(v, flat[m + 5], a[5]),
        multiply_add(v, flat[m + 6], a[6]), multiply_add(v, flat[m + 7], a[7]),
    )  # fmt: skip


@kernel(forceinline=True)
def _divided(a: Tile, d: np.ndarray, pivot: np.ndarray) -> Tile:
    """x with x D^T = a for the lower triangle D of the diagonal block, D_ij = d[8 j + i], and pivot_i = 1 / D_ii."""
    x0 = a[0] * pivot[0]
    x1 = multiply_add(-x0, d[1], a[1]) * pivot[1]
    x2 = multiply_add(-x1, d[10], multiply_add(-x0, d[2], a[2])) * pivot[2]
    x3 = multiply_add(-x2, d[19], multiply_add(-x1, d[11], multiply_add(-x0, d[3], a[3]))) * pivot[3]
    x4 = multiply_add(-x1, d[12], multiply_add(-x0, d[4], a[4]))
    x4 = multiply_add(-x3, d[28], multiply_add(-x2, d[20], x4)) * pivot[4]
    x5 = multiply_add(-x2, d[21], multiply_add(-x1, d[13], multiply_add(-x0, d[5], a[5])))
    x5 = multiply_add(-x4, d[37], multiply_add(-x3, d[29], x5)) * pivot[5]
    x6 = multiply_add(-x2, d[22], multiply_add(-x1, d[14], multiply_add(-x0, d[6], a[6])))
    x6 = multiply_add(-x5, d[46], multiply_add(-x4, d[38], multiply_add(-x3, d[30], x6))) * pivot[6]
    x7 = multiply_add(-x2, d[23], multiply_add(-x1, d[15], multiply_add(-x0, d[7], a[7])))
    x7 = multiply_add(-x5, d[47], multiply_add(-x4, d[39], multiply_add(-x3, d[31], x7)))
    x7 = multiply_add(-x6, d[55], x7) * pivot[7]
    return (x0, x1, x2, x3, x4, x5, x6, x7)


@kernel
def _diagonal_block(d: np.ndarray, pivot: np.ndarray) -> bool:
    """Cholesky of the lower triangle of the 8 x 8 block d in place; False where a pivot is not positive."""
    for c in range(WIDTH):
        for k in range(c):
            for i in range(c, WIDTH):
                d[WIDTH * c + i] -= d[WIDTH * k + c] * d[WIDTH * k + i]
        if not d[WIDTH * c + c] > 0.0:
            return False
        pivot[c] = 1.0 / math.sqrt(d[WIDTH * c + c])
        for i in range(c, WIDTH):
            d[WIDTH * c + i] *= pivot[c]
    return True


@kernel
def factor_in_panels(band: np.ndarray, bandwidth: int) -> bool:
    """Cholesky in place of band[j, i - j] = K_ij (n, at least bandwidth + 1 + MARGIN), zero beyond; False where a pivot is not positive.

    n must be a multiple of WIDTH: fill up with rows of the identity.
    """
    n, stride = band.shape[0], band.shape[1] - 1
    flat = band.reshape(-1)
    d, pivot = np.zeros(WIDTH * WIDTH), np.zeros(WIDTH)
    for j in range(0, n, WIDTH):
        for i in range(j, min(j + bandwidth + WIDTH, n), WIDTH):
            tile = _tile(flat, i + j * stride, stride)
            for k in range(max(0, i - bandwidth), j):
                tile = _less(tile, at(flat, i + k * stride), flat, j + k * stride)
            if i > j:
                _set_tile(flat, i + j * stride, stride, _divided(tile, d, pivot))
                continue
            _set_tile(d, 0, WIDTH, tile)
            if not _diagonal_block(d, pivot):
                return False
            for c in range(WIDTH):
                for r in range(c, WIDTH):
                    flat[j + r + (j + c) * stride] = d[WIDTH * c + r]
    return True
