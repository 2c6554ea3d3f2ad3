"""Cholesky factorisation and solves of a narrow band, K = L L^T, in panels of eight columns that stay in registers while they are formed.

LAPACK hands blocks to BLAS-3, which for half bandwidths below some hundred are too small to be fast. Here a tile, eight rows of a
panel, gathers what all columns to its left give,

    L_tile L_panel^T = K_tile - sum over k left of the panel of L_tile,k L_panel,k^T,

eight rows as lanes, one lanes value for each column, and is then divided by the panel's diagonal block (left-looking, tile by tile).
K_ij and L_ij lie at i + j stride of the flat band: a tile's rows of one column lie side by side, and so do the eight factors L_panel,k.
A solve goes through the panels once forward and once back. One right-hand side takes the rows of a tile as lanes, several take eight
right-hand sides as lanes.
"""

from __future__ import annotations

import math

import numpy as np

from thermofit.core.jit import kernel
from thermofit.core.lanes import WIDTH, Lanes, multiply_add, spread
from thermofit.point.lanes_memory import at, lane_sum, number_at, row, set_at, set_row

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
        multiply_add(v, number_at(flat, m), a[0]), multiply_add(v, number_at(flat, m + 1), a[1]),
        multiply_add(v, number_at(flat, m + 2), a[2]), multiply_add(v, number_at(flat, m + 3), a[3]),
        multiply_add(v, number_at(flat, m + 4), a[4]), multiply_add(v, number_at(flat, m + 5), a[5]),
        multiply_add(v, number_at(flat, m + 6), a[6]), multiply_add(v, number_at(flat, m + 7), a[7]),
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


@kernel(forceinline=True)
def _less_product(v: Lanes, flat: np.ndarray, start: int, stride: int, x: Tile) -> Lanes:
    """v - L_tile,panel x of one right-hand side; x_c is eight times the same number."""
    even = multiply_add(-x[2], at(flat, start + 2 * stride), multiply_add(-x[0], at(flat, start), v))
    odd = multiply_add(-x[3], at(flat, start + 3 * stride), -x[1] * at(flat, start + stride))
    even = multiply_add(-x[6], at(flat, start + 6 * stride), multiply_add(-x[4], at(flat, start + 4 * stride), even))
    odd = multiply_add(-x[7], at(flat, start + 7 * stride), multiply_add(-x[5], at(flat, start + 5 * stride), odd))
    return even + odd


@kernel(forceinline=True)
def _plus_products(a: Tile, v: Lanes, flat: np.ndarray, start: int, stride: int) -> Tile:
    """a_c + L_tile,c times the tile v of x, row by row."""
    return (
        multiply_add(v, at(flat, start), a[0]), multiply_add(v, at(flat, start + stride), a[1]),
        multiply_add(v, at(flat, start + 2 * stride), a[2]), multiply_add(v, at(flat, start + 3 * stride), a[3]),
        multiply_add(v, at(flat, start + 4 * stride), a[4]), multiply_add(v, at(flat, start + 5 * stride), a[5]),
        multiply_add(v, at(flat, start + 6 * stride), a[6]), multiply_add(v, at(flat, start + 7 * stride), a[7]),
    )  # fmt: skip


@kernel
def solve_in_panels(band: np.ndarray, bandwidth: int, x: np.ndarray) -> None:
    """K^-1 x in place, by the factor of `factor_in_panels`, for x of as many numbers as the band has rows."""
    n, stride = band.shape[0], band.shape[1] - 1
    flat, o = band.reshape(-1), spread(0.0)
    for j in range(0, n, WIDTH):
        for c in range(j, j + WIDTH):
            x[c] /= flat[c + c * stride]
            for r in range(c + 1, j + WIDTH):
                x[r] -= flat[r + c * stride] * x[c]
        t = (
            spread(x[j]), spread(x[j + 1]), spread(x[j + 2]), spread(x[j + 3]),
            spread(x[j + 4]), spread(x[j + 5]), spread(x[j + 6]), spread(x[j + 7]),
        )  # fmt: skip
        for i in range(j + WIDTH, min(j + bandwidth + WIDTH, n), WIDTH):
            set_at(x, i, _less_product(at(x, i), flat, i + j * stride, stride, t))
    for j in range(n - WIDTH, -1, -WIDTH):
        a = (o, o, o, o, o, o, o, o)
        for i in range(j + WIDTH, min(j + bandwidth + WIDTH, n), WIDTH):
            a = _plus_products(a, at(x, i), flat, i + j * stride, stride)
        x[j] -= lane_sum(a[0])
        x[j + 1] -= lane_sum(a[1])
        x[j + 2] -= lane_sum(a[2])
        x[j + 3] -= lane_sum(a[3])
        x[j + 4] -= lane_sum(a[4])
        x[j + 5] -= lane_sum(a[5])
        x[j + 6] -= lane_sum(a[6])
        x[j + 7] -= lane_sum(a[7])
        for c in range(j + WIDTH - 1, j - 1, -1):
            for r in range(c + 1, j + WIDTH):
                x[c] -= flat[r + c * stride] * x[r]
            x[c] /= flat[c + c * stride]


@kernel(forceinline=True)
def _rows(x: np.ndarray, n: int, step: int) -> Tile:
    """Rows n, n + step, ... of x: eight equations of eight right-hand sides."""
    return (
        row(x, n), row(x, n + step), row(x, n + 2 * step), row(x, n + 3 * step),
        row(x, n + 4 * step), row(x, n + 5 * step), row(x, n + 6 * step), row(x, n + 7 * step),
    )  # fmt: skip


@kernel(forceinline=True)
def _set_rows(x: np.ndarray, n: int, step: int, t: Tile) -> None:
    set_row(x, n, t[0])
    set_row(x, n + step, t[1])
    set_row(x, n + 2 * step, t[2])
    set_row(x, n + 3 * step, t[3])
    set_row(x, n + 4 * step, t[4])
    set_row(x, n + 5 * step, t[5])
    set_row(x, n + 6 * step, t[6])
    set_row(x, n + 7 * step, t[7])


@kernel(forceinline=True)
def _less_row(v: Lanes, flat: np.ndarray, m: int, stride: int, x: Tile) -> Lanes:
    """v - L_i,panel x of eight right-hand sides, m the place of L_i,j."""
    even = multiply_add(-x[2], number_at(flat, m + 2 * stride), multiply_add(-x[0], number_at(flat, m), v))
    odd = multiply_add(-x[3], number_at(flat, m + 3 * stride), -x[1] * number_at(flat, m + stride))
    even = multiply_add(-x[6], number_at(flat, m + 6 * stride), multiply_add(-x[4], number_at(flat, m + 4 * stride), even))
    odd = multiply_add(-x[7], number_at(flat, m + 7 * stride), multiply_add(-x[5], number_at(flat, m + 5 * stride), odd))
    return even + odd


@kernel(forceinline=True)
def _less_rows(a: Tile, v: Lanes, flat: np.ndarray, m: int, stride: int) -> Tile:
    """a_c - L_ic x_i of eight right-hand sides, m the place of L_ij."""
    v = -v
    return (
        multiply_add(v, number_at(flat, m), a[0]), multiply_add(v, number_at(flat, m + stride), a[1]),
        multiply_add(v, number_at(flat, m + 2 * stride), a[2]), multiply_add(v, number_at(flat, m + 3 * stride), a[3]),
        multiply_add(v, number_at(flat, m + 4 * stride), a[4]), multiply_add(v, number_at(flat, m + 5 * stride), a[5]),
        multiply_add(v, number_at(flat, m + 6 * stride), a[6]), multiply_add(v, number_at(flat, m + 7 * stride), a[7]),
    )  # fmt: skip


@kernel(forceinline=True)
def _block_forward(d: np.ndarray, pivot: np.ndarray, b: Tile) -> Tile:
    """D^-1 b of the lower triangle D of a diagonal block, D_ij = d[8 j + i]."""
    x0 = b[0] * pivot[0]
    x1 = multiply_add(-x0, d[1], b[1]) * pivot[1]
    x2 = multiply_add(-x1, d[10], multiply_add(-x0, d[2], b[2])) * pivot[2]
    x3 = multiply_add(-x2, d[19], multiply_add(-x1, d[11], multiply_add(-x0, d[3], b[3]))) * pivot[3]
    x4 = multiply_add(-x1, d[12], multiply_add(-x0, d[4], b[4]))
    x4 = multiply_add(-x3, d[28], multiply_add(-x2, d[20], x4)) * pivot[4]
    x5 = multiply_add(-x2, d[21], multiply_add(-x1, d[13], multiply_add(-x0, d[5], b[5])))
    x5 = multiply_add(-x4, d[37], multiply_add(-x3, d[29], x5)) * pivot[5]
    x6 = multiply_add(-x2, d[22], multiply_add(-x1, d[14], multiply_add(-x0, d[6], b[6])))
    x6 = multiply_add(-x5, d[46], multiply_add(-x4, d[38], multiply_add(-x3, d[30], x6))) * pivot[6]
    x7 = multiply_add(-x2, d[23], multiply_add(-x1, d[15], multiply_add(-x0, d[7], b[7])))
    x7 = multiply_add(-x5, d[47], multiply_add(-x4, d[39], multiply_add(-x3, d[31], x7)))
    x7 = multiply_add(-x6, d[55], x7) * pivot[7]
    return (x0, x1, x2, x3, x4, x5, x6, x7)


@kernel(forceinline=True)
def _block_back(d: np.ndarray, pivot: np.ndarray, b: Tile) -> Tile:
    """D^-T b."""
    x7 = b[7] * pivot[7]
    x6 = multiply_add(-x7, d[55], b[6]) * pivot[6]
    x5 = multiply_add(-x6, d[46], multiply_add(-x7, d[47], b[5])) * pivot[5]
    x4 = multiply_add(-x5, d[37], multiply_add(-x6, d[38], multiply_add(-x7, d[39], b[4]))) * pivot[4]
    x3 = multiply_add(-x6, d[30], multiply_add(-x7, d[31], b[3]))
    x3 = multiply_add(-x4, d[28], multiply_add(-x5, d[29], x3)) * pivot[3]
    x2 = multiply_add(-x5, d[21], multiply_add(-x6, d[22], multiply_add(-x7, d[23], b[2])))
    x2 = multiply_add(-x3, d[19], multiply_add(-x4, d[20], x2)) * pivot[2]
    x1 = multiply_add(-x5, d[13], multiply_add(-x6, d[14], multiply_add(-x7, d[15], b[1])))
    x1 = multiply_add(-x2, d[10], multiply_add(-x3, d[11], multiply_add(-x4, d[12], x1))) * pivot[1]
    x0 = multiply_add(-x5, d[5], multiply_add(-x6, d[6], multiply_add(-x7, d[7], b[0])))
    x0 = multiply_add(-x2, d[2], multiply_add(-x3, d[3], multiply_add(-x4, d[4], x0)))
    x0 = multiply_add(-x1, d[1], x0) * pivot[0]
    return (x0, x1, x2, x3, x4, x5, x6, x7)


@kernel(forceinline=True)
def _take_diagonal(flat: np.ndarray, start: int, stride: int, d: np.ndarray, pivot: np.ndarray) -> None:
    """The diagonal block whose first entry lies at `start`, as `_block_forward` wants it, and 1 / D_ii."""
    for c in range(WIDTH):
        set_at(d, WIDTH * c, at(flat, start + c * stride))
        pivot[c] = 1.0 / d[WIDTH * c + c]


@kernel
def solve_lanes_in_panels(band: np.ndarray, bandwidth: int, x: np.ndarray) -> None:
    """K^-1 x in place for x (rows of the band, m), m a multiple of WIDTH."""
    n, stride, groups = band.shape[0], band.shape[1] - 1, x.shape[1] // WIDTH
    flat, d, pivot = band.reshape(-1), np.zeros(WIDTH * WIDTH), np.zeros(WIDTH)
    for j in range(0, n, WIDTH):
        panel, end = j * stride, min(j + bandwidth + WIDTH, n)
        _take_diagonal(flat, j + panel, stride, d, pivot)
        for group in range(groups):
            t = _block_forward(d, pivot, _rows(x, j * groups + group, groups))
            _set_rows(x, j * groups + group, groups, t)
            for i in range(j + WIDTH, end):
                k = i * groups + group
                set_row(x, k, _less_row(row(x, k), flat, i + panel, stride, t))
    for j in range(n - WIDTH, -1, -WIDTH):
        panel, end = j * stride, min(j + bandwidth + WIDTH, n)
        _take_diagonal(flat, j + panel, stride, d, pivot)
        for group in range(groups):
            t = _rows(x, j * groups + group, groups)
            for i in range(j + WIDTH, end):
                t = _less_rows(t, row(x, i * groups + group), flat, i + panel, stride)
            _set_rows(x, j * groups + group, groups, _block_back(d, pivot, t))
