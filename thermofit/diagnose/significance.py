"""Significance of a local balance: what is missing in every cell beyond what a change of the fitted parameters could make, over its error.

r (m,) is the balance at the fitted parameters, C its noise, N what errors of unit variance of force, mesh and steps make of it, J its
derivatives by the fitted parameters. Each of these may be off by as much as it is large, or usually is, if the other channels have nothing
against it (T, whitened derivatives of these). With L L^T = C + N N^T and G = L^-1 J,

    H = G (G^T G + T^T T + R^-2)^-1 G^T,   q = L (1 - H) L^-1 r,   cov q = L (1 - H) L^T,   z = q / sd(q),
    chi2 = |(1 - H)^(1/2) L^-1 r|^2,

R the diagonal of their sizes. z of a balance that misses nothing is N(0, 1), chi2 has tr(1 - H) degrees of freedom. Cells overlap: the
chance of the largest |z| is that of as many independent ones as give the same median, from draws.

A block is a constant amount in neighbouring cells, b in these and zero elsewhere. With P = L^-T (1 - H) L^-1 its amount is
b^T P r / b^T P b, with variance 1 / b^T P b, and chi2 falls by (b^T P r)^2 / b^T P b. The block with the largest fall says where and when.
The parameters of a map that misses something are fitted beside up to four blocks: what is missing in one place would else draw them off,
and spread over all cells.

The whole model may have driven the parameters far off, so that a first-order change does not bring them back. Where the balance stands
out it is therefore evaluated again at the parameters that it asks for itself. Those that are scanned (the noise changes with them) are
compared by likelihood, a block being free beside them; one counts only if the balance closes with it. Others go step by step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import chi2 as chi_square
from scipy.stats import norm

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import param
from thermofit.experiment.local_balance import LocalBalance
from thermofit.fit.linear_model import LinearModel

LEVEL = 0.01
"""Chance that the map of a balance which misses nothing is said to miss something."""
_BOUNDED = 0.01
"""Part of the variance of a cell that parameters must leave: a cell whose amount they determine says nothing."""
_STEPS, _SETTLED = 8, 0.1
"""Steps of the parameters at most, and the fall of chi2 that ends them."""
_WORTH = 9.0
"""Fall of chi2 + ln det for which another parameter is believed: three standard errors."""
MOST_BLOCKS = 4
"""Blocks of what is missing beside which the parameters are fitted, at most."""
_DRAWS, _SEED = 2000, 5
_JITTER = 1e-9


@dataclass(frozen=True)
class Block:
    """Neighbouring cells with one amount: y and time from, to; amount and standard error, and the fall of chi2 that it makes."""

    y: tuple[float, float]
    time: tuple[float, float]
    amount: float
    sigma: float
    drop: float
    cells: np.ndarray
    """1 in its cells (m,), 0 elsewhere."""


Follow = Callable[[np.ndarray], LocalBalance]


@dataclass(frozen=True)
class Asked:
    """A parameter as a balance alone wants it, with its standard error (nan: it is at an end of what was scanned), and as it was fitted."""

    name: str
    value: float
    sigma: float
    fitted: float


@dataclass(frozen=True)
class SignificanceMap:
    """A local balance with its significance: `amount`, its standard error `sigma` and `z` (m,), nan in the cells `taken` by parameters;
    `chi2` with `degrees` of freedom; `chance` of the largest |z| and of chi2; `threshold` of |z| at LEVEL for all cells together;
    `beyond`: share of |z| above 3. `off` (p,): how far the balance wants the fitted parameters by the next step."""

    balance: LocalBalance
    amount: np.ndarray
    sigma: np.ndarray
    z: np.ndarray
    chi2: float
    degrees: float
    chance_peak: float
    chance_chi2: float
    threshold: float
    beyond: float
    taken: int
    off: np.ndarray
    precision: np.ndarray
    """P (m, m)."""
    noise: np.ndarray
    """C + N N^T (m, m)."""
    reach: np.ndarray
    """R (p,)."""
    log_volume: float
    """ln det of the noise: chi2 + ln det is least at the likeliest parameters where these change the noise."""
    asks: Asked | None = None
    """The parameter with which the balance was evaluated in the end; None: the fitted ones, or others by steps."""

    @property
    def peak(self) -> int:
        """Cell of the largest |z|."""
        return int(np.nanargmax(np.abs(self.z)))

    @cached_property
    def block(self) -> Block:
        """The block of cells whose amount takes most of chi2."""
        b = self.balance
        rows, columns = _runs(int(b.row.max()) + 1), _runs(int(b.column.max()) + 1)
        in_time = (b.row[:, None] >= rows[:, 0]) & (b.row[:, None] <= rows[:, 1])
        in_place = (b.column[:, None] >= columns[:, 0]) & (b.column[:, None] <= columns[:, 1])
        pull, best = self.precision @ b.amount, (-1.0, 0, 0, 0.0, 1.0)
        for c in range(len(columns)):
            cells = (in_time & in_place[:, [c]]).astype(float)
            size, force = np.einsum("mk,mk->k", cells, self.precision @ cells), cells.T @ pull
            drop = np.where(size > 0.0, force**2 / np.maximum(size, 1e-300), 0.0)
            k = int(np.argmax(drop))
            if drop[k] > best[0]:
                best = (float(drop[k]), k, c, float(force[k] / size[k]), float(size[k]))
        own = in_time[:, best[1]] & in_place[:, best[2]]
        # A bump counts within half of its size about the middle of its cell.
        y, t, d = b.y[own], b.time[own], b.duration[own]
        return Block(
            (float(y.min()) - 0.25 * b.extent, float(y.max()) + 0.25 * b.extent),
            (float((t - 0.25 * d).min()), float((t + 0.25 * d).max())),
            best[3],
            best[4] ** -0.5,
            best[0],
            own.astype(float),
        )

    @property
    def blocks(self) -> int:
        """Number of blocks that were compared."""
        n_t, n_y = int(self.balance.row.max()) + 1, int(self.balance.column.max()) + 1
        return n_t * (n_t + 1) * n_y * (n_y + 1) // 4

    @property
    def stands_out(self) -> bool:
        """True where the balance misses more than chance: LEVEL is shared by its largest cell and its chi2."""
        return min(self.chance_peak, self.chance_chi2) < 0.5 * LEVEL

    def gridded(self, value: np.ndarray) -> np.ndarray:
        """Values (m,) of the cells as a map (time, place), nan where there is no cell."""
        out = np.full((int(self.balance.row.max()) + 1, int(self.balance.column.max()) + 1), np.nan)
        out[self.balance.row, self.balance.column] = value
        return out


def significance(balance: LocalBalance) -> SignificanceMap:
    """SignificanceMap of a local balance, with the parameters where it wants them."""
    found = _map(balance, np.zeros(len(balance.names)))
    if not found.stands_out:
        return found
    if balance.follow is None:
        return _beside_blocks(found)
    if balance.scan:
        return _beside_blocks(_scanned(balance, balance.follow, found))
    best, at, before = found, np.zeros(len(balance.names)), np.inf
    for _ in range(_STEPS):
        try:
            there = _map(balance.follow(at), at)
        except NumericsError:
            break
        if there.chi2 < best.chi2:
            best = there
        if abs(before - there.chi2) < _SETTLED:
            break
        at, before = there.off, there.chi2
    return _beside_blocks(best)


def _scanned(balance: LocalBalance, follow: Follow, found: SignificanceMap) -> SignificanceMap:
    """The likeliest of the scanned maps, and the parameter that it asks for with its standard error from the curvature of the likelihood
    over its logarithm."""
    maps = [_map(follow(x), x) for x in balance.scan]
    level = np.array([_level(m) for m in maps])
    k = int(np.argmin(level))
    if _level(found) - level[k] < _WORTH:
        return found
    moved = int(np.argmax(np.abs(balance.scan[k])))
    value = np.array([balance.value[moved] + x[moved] for x in balance.scan])
    best, sigma = float(value[k]), float("nan")
    if 0 < k < len(maps) - 1 and value[k - 1] < value[k] < value[k + 1]:
        bent, slope, _ = np.polyfit(np.log(value[k - 1 : k + 2] / value[k]), level[k - 1 : k + 2] - level[k], 2)
        if bent > 0.0:
            best = float(value[k] * np.exp(-0.5 * slope / bent))
            sigma = float(best / np.sqrt(bent))
    if maps[k].stands_out or not np.isfinite(sigma):
        # No parameter closes the balance: something is missing, and what it lacks is told at the fitted ones.
        return found
    return replace(maps[k], asks=Asked(balance.names[moved], best, sigma, float(balance.value[moved])))


def _beside_blocks(found: SignificanceMap) -> SignificanceMap:
    """A map that misses something, with the parameters fitted beside blocks of what is missing: what is missing in one place then does not
    draw them off, which would spread it over all cells. Its chances stay those of the map without blocks."""
    if not found.stands_out:
        return found
    b, blocks, left = found.balance, [found.block.cells], found
    for _ in range(MOST_BLOCKS - 1):
        beside = np.stack(blocks, axis=1)
        size = beside.T @ found.precision @ beside
        rest = b.amount - beside @ np.linalg.solve(size, beside.T @ (found.precision @ b.amount))
        taken = found.precision - found.precision @ beside @ np.linalg.solve(size, beside.T @ found.precision)
        left = replace(found, balance=replace(b, amount=rest), precision=taken)
        left.__dict__.pop("block", None)
        if left.block.drop < _WORTH + 2.0 * float(np.log(left.blocks)):
            break
        blocks.append(left.block.cells)
    columns, noise = b.columns * found.reach, found.noise
    design = np.concatenate([columns, np.stack(blocks, axis=1)], axis=1)
    weighted = np.linalg.solve(noise, design)
    told = b.told * found.reach
    normal = design.T @ weighted
    p = columns.shape[1]
    normal[:p, :p] += told.T @ told + np.eye(p)
    step = np.linalg.solve(normal, weighted.T)[:p]
    change = np.eye(len(noise)) - columns @ step
    amount, variance = change @ b.amount, np.einsum("ij,jk,ik->i", change, noise, change)
    open_ = np.isfinite(found.z)
    sigma = np.sqrt(np.where(open_, variance, np.nan))
    return replace(found, amount=np.where(open_, amount, np.nan), sigma=sigma, z=amount / sigma)


def _level(found: SignificanceMap) -> float:
    """-2 ln likelihood of a map beside the best of its blocks, where that is worth being picked from so many."""
    return found.chi2 + found.log_volume - max(found.block.drop - 2.0 * float(np.log(found.blocks)), 0.0)


def _runs(n: int) -> np.ndarray:
    """First and last (k, 2) of all runs of neighbours among n."""
    return np.array([(i, j) for i in range(n) for j in range(i, n)])


def _map(balance: LocalBalance, at: np.ndarray) -> SignificanceMap:
    """SignificanceMap of a balance at parameters that are off by `at` (p,) from the fitted ones."""
    noise = balance.covariance + balance.beside @ balance.beside.T
    noise = noise + _JITTER * np.diag(np.diag(noise))
    root = np.linalg.cholesky(noise)
    # A balance has no scale of its own: all of its coefficients at zero balance as well. So a change costs what it is large.
    reach = np.maximum(np.abs(balance.value + at), [param(name).scale for name in balance.names])
    white = np.linalg.solve(root, np.column_stack([balance.amount, balance.columns * reach]))
    told = balance.told * reach
    residual = np.concatenate([white[:, 0], balance.told @ at, np.zeros(len(at))])
    room = (balance.bounds[0] - balance.value - at) / reach, (balance.bounds[1] - balance.value - at) / reach
    model = LinearModel(residual, np.concatenate([white[:, 1:], told, np.eye(len(at))]), bounds=room)
    left, inverse = model.left, np.linalg.inv(root)
    hat = model.basis[: len(root)]
    covariance = root @ (np.eye(len(root)) - hat @ hat.T) @ root.T
    amount, variance = root @ left[: len(root)], np.diag(covariance)
    open_ = variance > _BOUNDED * np.diag(noise)
    sigma = np.sqrt(np.where(open_, variance, np.nan))
    z = amount / sigma
    chi2 = float(left @ left)
    degrees = float(len(root) - np.sum(hat**2))
    count, peak = _independent(covariance[np.ix_(open_, open_)]), float(np.max(np.abs(z[open_]), initial=0.0))
    one = (1.0 - LEVEL) ** (1.0 / count)
    return SignificanceMap(
        balance=balance,
        amount=np.where(open_, amount, np.nan),
        sigma=sigma,
        z=z,
        chi2=chi2,
        degrees=degrees,
        chance_peak=float(-np.expm1(count * np.log1p(-min(2.0 * norm.sf(peak), 1.0 - 1e-16)))),
        chance_chi2=float(chi_square.sf(chi2, max(degrees, 1e-9))),
        threshold=float(norm.isf(0.5 * (1.0 - one))),
        beyond=float(np.mean(np.abs(z[open_]) > 3.0)) if open_.any() else 0.0,
        taken=int((~open_).sum()),
        off=at + reach * model.step.d,
        noise=noise,
        reach=reach,
        precision=inverse.T @ (np.eye(len(root)) - hat @ hat.T) @ inverse,
        log_volume=2.0 * float(np.log(np.diag(root)).sum()),
    )


def _independent(covariance: np.ndarray) -> float:
    """Number of independent cells whose largest |z| has the median that correlated ones (m, m) have."""
    if not len(covariance):
        return 1.0
    sd = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / sd[:, None] / sd[None, :])
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    largest = np.abs(np.random.default_rng(_SEED).normal(size=(_DRAWS, len(root))) @ root.T).max(axis=1)
    return float(max(np.log(0.5) / np.log1p(-2.0 * norm.sf(np.median(largest))), 1.0))
