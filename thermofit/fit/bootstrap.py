"""Block bootstrap of a least-squares fit: residuals change sign block by block, and the fit answers, linearised or in full.

The residual of a fit at optimum is cut into blocks of time and space that are longer than its memory. One repeat multiplies every block by
a random sign (the wild bootstrap for clusters; Webb's six weights where blocks are few) and fits again: correlation within a block, unequal
noise and misfit of the model are kept as they are, and missing values need no filling. A fit has bent towards the errors of each block, so
that its residual is too small; taken instead is the residual of the block against a fit to all others (the jackknife), linearised

    r~_b = r_b + J_b (A - J_b^T J_b)^-1 J_b^T r_b,   A = J^T J.

A linearised repeat moves the optimum by -A^-1 sum_b w_b J_b^T r~_b, within the bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import UntrustworthyError
from thermofit.fit.linear_model import LinearModel, projection

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
    """Weights (count,) of one repeat, mean 0 and variance 1."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    size = blocks.count
    signs = rng.choice((-1.0, 1.0), size)
    if size < FEW:
        signs = signs * rng.choice(_WEBB, size)
    return np.asarray(signs)


def drawn_residual(outside: np.ndarray, blocks: Blocks, seed: int, number: int) -> np.ndarray:
    """Residual r* (n,) of one repeat: the blocks of `LinearModel.outside` with random signs."""
    return np.asarray(outside * block_weights(blocks, seed, number)[blocks.label])


def require_blocks(blocks: Blocks) -> None:
    """UntrustworthyError where the residual is worth too few blocks."""
    if blocks.count < LEAST:
        raise UntrustworthyError(
            f"bootstrap: the residual is worth {blocks.count} blocks ({blocks.remark}), at least {LEAST} are needed: its misfit is "
            "correlated over the whole record; improve the model first, or use the profile"
        )


def linearised_repeats(fit: LinearModel, blocks: Blocks, *, seed: int, count: int) -> np.ndarray:
    """Moves dx (count, n_p) of the optimum within the bounds of a fit in `count` repeats.

    UntrustworthyError where there are too few blocks.
    """
    require_blocks(blocks)
    product = fit.columns * fit.outside(blocks.label)[:, None]
    sums = np.stack([np.bincount(blocks.label, column, blocks.count) for column in product.T], axis=1)
    weights = np.stack([block_weights(blocks, seed, k) for k in range(count)])
    # With g = J^T r* and B B^T = (J^T J)^+ a repeat moves the optimum by -B B^T g, and B^T g = U^T r* is its residual in the basis U.
    root = fit.root()
    right = (weights @ sums) @ root
    moves = -right @ root.T
    if fit.bounds is not None:
        columns = fit.basis.T @ fit.columns
        for k in np.flatnonzero(np.any((moves < fit.bounds[0]) | (moves > fit.bounds[1]), axis=1)):
            moves[k] = LinearModel(right[k], columns, bounds=fit.bounds).step.d
    return np.asarray(moves)


def effective_blocks(jacobian: np.ndarray, blocks: Blocks) -> np.ndarray:
    """Number of blocks (n_p,) that each parameter rests on: (sum v)^2 / sum v^2 of the shares v of the blocks in its variance (Carter,
    Schnepel and Steigerwald, Review of Economics and Statistics 99, 2017). A parameter that a few blocks alone feel has few."""
    fit = projection(jacobian)
    weights = fit.root() @ fit.basis.T
    shares = np.stack([np.bincount(blocks.label, row**2, blocks.count) for row in weights])
    squares = (shares**2).sum(axis=1)
    return np.divide(shares.sum(axis=1) ** 2, squares, out=np.ones(len(squares)), where=squares > 0.0)


def percentile_interval(values: np.ndarray, level: float = 0.95) -> tuple[float, float]:
    """The central `level` of values (n,)."""
    low, high = np.quantile(values, [0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    return float(low), float(high)
