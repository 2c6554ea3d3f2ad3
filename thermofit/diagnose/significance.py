"""Significance of a local balance: what is missing in every cell beyond what a change of the fitted parameters could make, over its error.

r (m,) is the balance at the fitted parameters, C its noise, N what errors of unit variance of force, mesh and steps make of it, J its
derivatives by the fitted parameters, each of which may be off by as much as it is large, if the other channels have nothing against it
(T, whitened derivatives of these). With L L^T = C + N N^T and G = L^-1 J,

    q = L (1 - H) L^-1 r,   cov q = L (1 - H) L^T,   H = G (G^T G + T^T T + R^-2)^-1 G^T,   z = q / sd(q),   chi2 = |(1 - H)^(1/2) L^-1 r|^2,

R the diagonal of their sizes. z of a balance that misses nothing is N(0, 1), chi2 has tr(1 - H) degrees of freedom. Cells overlap: the
chance of the largest |z| is that of as many independent ones as give the same median, from draws.

The whole model may have driven the parameters far off, so that a first-order change does not bring them back. Where the balance stands
out it is therefore evaluated again at the parameters that it asks for itself: at the likeliest of those that are scanned, else step by
step until they stay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi_square
from scipy.stats import norm

from thermofit.core.errors import NumericsError
from thermofit.experiment.local_balance import LocalBalance
from thermofit.fit.linear_model import LinearModel

LEVEL = 0.01
"""Chance that the map of a balance which misses nothing is said to miss something."""
_LEAST = 1e-3
"""Part of the width of its bounds that a parameter may be off at least."""
_BOUNDED = 0.01
"""Part of the variance of a cell that parameters must leave: a cell whose amount they determine says nothing."""
_STEPS, _SETTLED = 8, 0.1
"""Steps of the parameters at most, and the fall of chi2 that ends them."""
_DRAWS, _SEED = 2000, 5
_JITTER = 1e-9


@dataclass(frozen=True)
class SignificanceMap:
    """A local balance with its significance: `amount`, its standard error `sigma` and `z` (m,), nan in the cells `taken` by parameters;
    `chi2` with `degrees` of freedom; `chance` of the largest |z| and of chi2; `threshold` of |z| at LEVEL for all cells together;
    `beyond`: share of |z| above 3. `off` (p,): how far the balance alone wants the fitted parameters, with standard errors `off_sigma`,
    which are their reach where it does not tell them."""

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
    off_sigma: np.ndarray
    log_volume: float
    """ln det of the noise: chi2 + ln det is least at the likeliest parameters where these change the noise."""

    @property
    def peak(self) -> int:
        """Cell of the largest |z|."""
        return int(np.nanargmax(np.abs(self.z)))

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
    if not found.stands_out or balance.follow is None:
        return found
    if balance.scan:
        each = [(_map(balance.follow(x), x)) for x in balance.scan]
        return min([*each, found], key=lambda m: m.chi2 + m.log_volume)
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
    return best


def _map(balance: LocalBalance, at: np.ndarray) -> SignificanceMap:
    """SignificanceMap of a balance at parameters that are off by `at` (p,) from the fitted ones."""
    noise = balance.covariance + balance.beside @ balance.beside.T
    noise = noise + _JITTER * np.diag(np.diag(noise))
    root = np.linalg.cholesky(noise)
    # A balance has no scale of its own: all of its coefficients at zero balance as well. So a change costs what it is large.
    reach = np.maximum(np.abs(balance.value + at), _LEAST * (balance.bounds[1] - balance.bounds[0]))
    white = np.linalg.solve(root, np.column_stack([balance.amount, balance.columns * reach]))
    told = balance.told * reach
    residual = np.concatenate([white[:, 0], balance.told @ at, np.zeros(len(at))])
    room = (balance.bounds[0] - balance.value - at) / reach, (balance.bounds[1] - balance.value - at) / reach
    model = LinearModel(residual, np.concatenate([white[:, 1:], told, np.eye(len(at))]), bounds=room)
    left = model.left
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
        off_sigma=reach * np.sqrt(np.sum(model.root() ** 2, axis=1)),
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
