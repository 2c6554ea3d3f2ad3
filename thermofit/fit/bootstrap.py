"""Block bootstrap of a least-squares fit: residuals change sign block by block, and the fit answers, linearised or in full.

The residual of a fit at optimum is cut into blocks of time and space that are longer than its memory. One repeat multiplies every block by
a random sign (the wild bootstrap for clusters; Webb's six weights where blocks are few) and fits again: correlation within a block, unequal
noise and misfit of the model are kept as they are, and missing values need no filling. Linearised, the repeat moves the optimum by
-(J^T J)^-1 J^T r*, within the bounds, and only the block sums J_b^T r_b are needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import UntrustworthyError
from thermofit.fit.gauss_newton import Reduced, bounded_step

FEW = 24
"""Fewer blocks than this take six weights instead of two signs: 2^n patterns would be too few."""
LEAST = 5
_WEBB = np.sqrt(np.array([0.5, 1.0, 1.5]))


@dataclass(frozen=True)
class Blocks:
    """`label` (n,) of every entry of the residual, 0 .. count-1; `remark` says in words what a block is."""

    label: np.ndarray
    count: int
    remark: str


def block_weights(blocks: Blocks, seed: int, number: int) -> np.ndarray:
    """Weights (count,) of one repeat, mean 0 and variance n/(n - 1): the residual of a fit holds one mean less than its blocks."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    size = blocks.count
    signs = rng.choice((-1.0, 1.0), size)
    if size < FEW:
        signs = signs * rng.choice(_WEBB, size)
    return np.asarray(signs * np.sqrt(size / (size - 1.0)))


def drawn_residual(residual: np.ndarray, blocks: Blocks, seed: int, number: int, n_parameters: int) -> np.ndarray:
    """Residual r* (n,) of one repeat: blocks with random signs, widened for the degrees of freedom that the fit took."""
    widen = np.sqrt(residual.size / max(residual.size - n_parameters, 1))
    return np.asarray(widen * residual * block_weights(blocks, seed, number)[blocks.label])


def require_blocks(blocks: Blocks) -> None:
    """UntrustworthyError where the residual is worth too few blocks."""
    if blocks.count < LEAST:
        raise UntrustworthyError(
            f"bootstrap: the residual is worth {blocks.count} blocks ({blocks.remark}), at least {LEAST} are needed: its misfit is "
            "correlated over the whole record; improve the model first, or use the profile"
        )


def linearised_repeats(
    jacobian: np.ndarray, residual: np.ndarray, blocks: Blocks, room: tuple[np.ndarray, np.ndarray], draws: tuple[int, int]
) -> np.ndarray:
    """Moves dx (count, n_p) of the optimum in `draws` = (seed, count) repeats; `room` = (lowest, highest) dx within the bounds.

    UntrustworthyError where there are too few blocks.
    """
    require_blocks(blocks)
    seed, count = draws
    n, p = jacobian.shape
    widen = np.sqrt(n / max(n - p, 1))
    product = jacobian * residual[:, None]
    sums = np.stack([np.bincount(blocks.label, product[:, i], blocks.count) for i in range(p)], axis=1)
    weights = np.stack([block_weights(blocks, seed, k) for k in range(count)])
    right = widen * weights @ sums
    norms = np.linalg.norm(jacobian, axis=0)
    unit = np.where(norms > 0.0, norms, 1.0)
    triangle = np.asarray(np.linalg.qr(jacobian / unit, mode="r"))
    inverse = np.linalg.pinv(triangle, rcond=1e-10)
    # R^T R d = -g with g in the span of R^T, so that c = R^-T g is the right-hand side of the bounded problem |R d + c|.
    c = (right / unit) @ inverse
    moves = -(c @ inverse.T) / unit
    outside = np.any((moves < room[0]) | (moves > room[1]), axis=1)
    reduced = triangle * unit
    for k in np.flatnonzero(outside):
        moves[k] = bounded_step(Reduced(reduced, c[k], norms), room).d
    return np.asarray(moves)


def percentile_interval(values: np.ndarray, level: float = 0.95) -> tuple[float, float]:
    """The central `level` of values (n,)."""
    low, high = np.quantile(values, [0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    return float(low), float(high)
