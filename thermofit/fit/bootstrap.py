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
    """Weights (count,) of one repeat, mean 0 and variance 1."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    size = blocks.count
    signs = rng.choice((-1.0, 1.0), size)
    if size < FEW:
        signs = signs * rng.choice(_WEBB, size)
    return np.asarray(signs)


def outside_residual(jacobian: np.ndarray, residual: np.ndarray, blocks: Blocks) -> np.ndarray:
    """Residual (n,) of every block against the fit to all other blocks, from the linear model; no smaller than that of the fit.

    A direction that a single block alone determines keeps the residual of the fit.
    """
    q = np.linalg.qr(_normalised(jacobian))[0]
    order = np.argsort(blocks.label, kind="stable")
    ends = np.cumsum(np.bincount(blocks.label, minlength=blocks.count))
    out = np.empty_like(residual)
    for first, last in zip(np.append(0, ends[:-1]), ends, strict=True):
        rows = order[first:last]
        own, r = q[rows], residual[rows]
        values, vectors = np.linalg.eigh(own.T @ own)
        left = 1.0 - values
        gain = np.divide(1.0, left, out=np.zeros_like(left), where=left > 1e-3)
        out[rows] = r + own @ (vectors @ (gain * (vectors.T @ (own.T @ r))))
    return out


def _normalised(jacobian: np.ndarray) -> np.ndarray:
    norms = np.linalg.norm(jacobian, axis=0)
    return np.asarray(jacobian / np.where(norms > 0.0, norms, 1.0))


def drawn_residual(outside: np.ndarray, blocks: Blocks, seed: int, number: int) -> np.ndarray:
    """Residual r* (n,) of one repeat: the blocks of `outside_residual` with random signs."""
    return np.asarray(outside * block_weights(blocks, seed, number)[blocks.label])


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
    product = jacobian * outside_residual(jacobian, residual, blocks)[:, None]
    sums = np.stack([np.bincount(blocks.label, column, blocks.count) for column in product.T], axis=1)
    weights = np.stack([block_weights(blocks, seed, k) for k in range(count)])
    right = weights @ sums
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


def effective_blocks(jacobian: np.ndarray, blocks: Blocks) -> np.ndarray:
    """Number of blocks (n_p,) that each parameter rests on: (sum v)^2 / sum v^2 of the shares v of the blocks in its variance (Carter,
    Schnepel and Steigerwald, Review of Economics and Statistics 99, 2017). A parameter that a few blocks alone feel has few."""
    unit = _normalised(jacobian)
    weights = np.linalg.pinv(unit, rcond=1e-10)
    shares = np.stack([np.bincount(blocks.label, row**2, blocks.count) for row in weights])
    squares = (shares**2).sum(axis=1)
    return np.divide(shares.sum(axis=1) ** 2, squares, out=np.ones(len(squares)), where=squares > 0.0)


def percentile_interval(values: np.ndarray, level: float = 0.95) -> tuple[float, float]:
    """The central `level` of values (n,)."""
    low, high = np.quantile(values, [0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    return float(low), float(high)
