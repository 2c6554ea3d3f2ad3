"""Structure in a residual: how much of its square sum hangs together in blocks of time and place, above both floors.

With S_b the sum of the n_b whitened rows of a block, noise alone gives E[S_b^2 / n_b] = v, one where sigma is right. v is taken from
differences of block means in time, with what samples that follow each other share (`remembered`), so that neither a wrong sigma nor noise
that neighbours share looks like structure. What all times of a point have in common (the
reference of dtheta) comes on top, and so does the error of the discretisation. The excess

    X = sum_b [S_b^2 / n_b - v_b - 4 N_b^2 / n_b]

is what is left to be explained; its standard deviation under noise is sqrt(2 sum_b v_b^2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thermofit.core.parameters import bare_name
from thermofit.diagnose.case import Case
from thermofit.diagnose.held_out import Rows
from thermofit.diagnose.remembered import remembered
from thermofit.diagnose.score import OVER_NUMERICAL
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.memory import differences

BLOCKS = (16, 6, 2)
"""Blocks in time, y and x."""
_LEAST_WEIGHT = 1e-6
"""Added to all weights: a block to which an instrument would add nothing then counts as one without weights."""
SURE = 4.0
"""Standard deviations of the noise by which the excess has to stand out."""


@dataclass(frozen=True)
class ChannelBlocks:
    """Blocks of one channel: its `rows` of the residual, block and weight of each (n_rows,), sum of squared weights, noise v and numerical
    part (n_b,)."""

    channel: str
    rows: np.ndarray
    block: np.ndarray
    count: np.ndarray
    noise: np.ndarray
    numerical: np.ndarray
    weight: np.ndarray

    def excess(self, residual: np.ndarray) -> float:
        """X of a whitened residual (n,)."""
        sums = np.bincount(self.block, self.weight * residual[self.rows], len(self.count))
        return float(np.sum(sums**2 / self.count - self.noise - self.numerical))

    @property
    def spread(self) -> float:
        """Standard deviation of X under noise."""
        return float(np.sqrt(2.0 * np.sum(self.noise**2)))


@dataclass(frozen=True)
class Structure:
    """Excess of one channel in the residual, its standard deviation under noise, and its part of the square sum."""

    blocks: ChannelBlocks
    excess: float
    share: float

    @property
    def stands_out(self) -> bool:
        """True where the excess is more than noise and discretisation make."""
        return self.excess > SURE * self.blocks.spread


Weights = Mapping[int, tuple[np.ndarray, ...]]
"""By the number of a channel, weights of its rows (n_own,) whose mean square is one."""


def structures(
    case: Case, rows: Rows, residual: np.ndarray, numerical: np.ndarray | None, weights: Weights | None = None
) -> tuple[Structure, ...]:
    """Structure of every channel; `numerical` (n,) is the error of the discretisation in the residual.

    What an instrument adds may go to and fro within a block, as an error of the clock does where a load reverses, and leaves no sum there.
    So the rows are also weighted by what something would add (`weights`). The structure of a channel is the one of all that stands
    out most. Such a misfit looks like noise with a memory, so that memory is told by the residual without it.
    """
    out, at, memory = [], 0, remembered(case, rows, residual)
    turning = weights or {}
    for k, comparison in enumerate(case.model.comparisons):
        own = np.arange(at, at + comparison.n)
        at += comparison.n
        in_place, in_time, series = _places(rows, own, comparison.rows, case.model.segments is not None)
        found = []
        for number, weight in enumerate((np.ones(comparison.n), *turning.get(k, ()))):
            # By its weight, what is added has one sign wherever it is.
            block, alike, without = (in_time if number > 0 else in_place), memory.of_channel[k], residual.copy()
            count = np.bincount(block, weight**2)
            if number > 0:
                without[own] -= weight * (np.bincount(block, weight * residual[own]) / count)[block]
                alike = remembered(case, rows, without).of_channel[k]
            level = alike.of_sums if case.model.segments is not None else alike.of_blocks(differences(without[own], *series)[0])
            shared = shared_part(case, own, block, count, weight)
            error = np.zeros(len(count)) if numerical is None else np.bincount(block, weight * numerical[own], len(count)) ** 2 / count
            blocks = ChannelBlocks(case.channels[k], own, block, count, np.full(len(count), level) + shared, OVER_NUMERICAL * error, weight)
            excess = blocks.excess(residual)
            found.append(Structure(blocks, excess, excess / max(float(residual[own] @ residual[own]), 1e-300)))
        out.append(max(found, key=lambda s: s.excess / s.blocks.spread))
    return tuple(out)


def alternating(case: Case, fitted: LinearModel) -> dict[int, tuple[np.ndarray, ...]]:
    """Weights of the channels of coupons: what each kind of error of their instrument adds beside the fitted parameters, where it lasts."""
    missing, model = case.model.missing, case.model
    out: dict[int, tuple[np.ndarray, ...]] = {}
    if missing is None or not missing.records:
        return {}
    for kinds in missing.of_instruments.values():
        for kind in kinds:
            grid = missing.grid(kind, (1, 1, 1))
            added = missing.answers(kind, case.parameters, grid, np.arange(grid.size))
            for k, columns in model.columns(added).items():
                own = slice(*np.cumsum([0, *(c.n for c in model.comparisons)])[k : k + 2])
                whole = np.zeros(len(fitted.residual))
                whole[own] = columns.sum(axis=1)
                if (weight := as_weight(fitted, whole, own)) is not None:
                    out[k] = (*out.get(k, ()), weight)
    return out


def as_weight(fitted: LinearModel, added: np.ndarray, own: slice | np.ndarray) -> np.ndarray | None:
    """Weight of the rows of a channel, `own`, by what is added (n,) to the residual beside the fitted parameters; None where that is
    nothing."""
    weight = fitted.projected(added)[own]
    size = float(np.sqrt(np.mean(weight**2)))
    return weight / size + _LEAST_WEIGHT if size > 0.0 else None


def _places(
    rows: Rows, own: np.ndarray, where: np.ndarray, by_sample: bool
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Block (n_own,) of every row, the same by time alone, and (place, time index) of each for the differences in time."""
    time = where[:, 0]
    stamp = np.unique(time, return_inverse=True)[1] if by_sample else rows.time[own]
    edges = np.unique(np.quantile(stamp, np.linspace(0.0, 1.0, BLOCKS[0] + 1)))
    i = np.clip(np.searchsorted(edges, stamp, side="right") - 1, 0, max(len(edges) - 2, 0))
    place = where[:, 2].astype(np.int64)
    for axis, n in ((1, BLOCKS[1]), (0, BLOCKS[2])):
        v = rows.xy[own, axis]
        extent = float(np.ptp(v))
        part = np.zeros(len(v), dtype=np.int64) if extent <= 0.0 else np.minimum((n * (v - v.min()) / extent).astype(np.int64), n - 1)
        place = place * n + part
    place = np.unique(place, return_inverse=True)[1]
    block = np.unique(i * (place.max(initial=0) + 1) + place, return_inverse=True)[1]
    return block, np.unique(i, return_inverse=True)[1], (place, np.unique(time, return_inverse=True)[1])


def shared_part(case: Case, own: np.ndarray, block: np.ndarray, count: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """What correlation of the noise over time adds to v (n_b,): w^T C w / w^T w - 1."""
    at = 0
    for comparison in case.model.comparisons:
        if at == own[0] and comparison.noise is not None and bare_name(comparison.channel) == "dtheta":
            found = np.empty(len(count))
            for b in range(len(count)):
                one = weight * (block == b)
                found[b] = float(one @ comparison.noise(one[:, None])[:, 0]) / count[b] - 1.0
            return np.maximum(found, 0.0)
        at += comparison.n
    return np.zeros(len(count))
