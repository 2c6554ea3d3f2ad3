"""Combined standard uncertainty of fitted parameters, part by part (JCGM 100:2008, 5.2; JCGM 102 for several outputs).

The optimum of |r|^2 moves by -(J^T J)^+ J^T dr where something that the fit takes for exact is off by so much that the residual changes by
dr. An independent cause k, with m_k errors of unit variance that make columns C_k (n, m_k) of the residual, moves the parameters by

    L_k = -(J^T J)^+ J^T C_k,   and their covariance is sum_k L_k L_k^T.

The moves are kept, not only their squares: what a later fit takes from this one passes them on cause by cause, with its correlation.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from thermofit.fit.covariance import Covariance
from thermofit.fit.linear_model import LinearModel

NOISE = "noise"
"""What of the noise of the residual no other cause names: that of the cameras or sensors."""
MISFIT = "misfit"
"""What the residual shows beyond its noise."""
EXPONENTS, HELD_LAW, SLOWER_RATES = "held exponents", "held hardening law", "rates below the slowest"
"""Exponents of added effects that a fit holds, a hardening law that it holds beside a curve of any form, and what a law of the rate says
where the test has no data."""
FORM_OF_HEAT = "form of the heat of flow"
"""What an added heat of plastic flow may be of another form over plastic strain."""
OTHER_FORM = "another effect in its stead"
"""What an effect that the data do not tell from an added one would make of the parameters."""
EXCHANGED = "exchange of equal forms"
"""The same model with the values of an added effect and of a part of the base model that is of its form exchanged."""
QUIET = "quiet histories"
"""What histories that nothing tells, for they lower no error that counts, may make of the parameters."""
QUIET_EFFECT = "quiet effects"
"""What effects that nothing tells may make of them."""
PULLED = "pull of temperatures"
"""How far temperatures pull parameters of the motion from where displacements have them, beside an added heat."""


@dataclass(frozen=True, eq=False)
class Budget:
    """Moves (n_p, m_k) of parameters `names` by every cause, for errors of unit variance; `open` (n_p,): the data do not determine them.
    `noise_of`: the share (n_p,) that each channel has in the variance of the noise; empty where it was not asked."""

    names: tuple[str, ...]
    parts: Mapping[str, np.ndarray]
    open: np.ndarray
    noise_of: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def covariance(self) -> np.ndarray:
        """Combined covariance (n_p, n_p); zero rows for parameters that the data do not determine."""
        p = len(self.names)
        total = sum((moves @ moves.T for moves in self.parts.values()), np.zeros((p, p)))
        return np.where(self.open[:, None] | self.open[None, :], 0.0, total)

    @property
    def sigma(self) -> np.ndarray:
        """Combined standard uncertainties (n_p,), infinite where the data determine nothing."""
        return np.where(self.open, np.inf, np.sqrt(np.diag(self.covariance)))

    def of(self, cause: str) -> np.ndarray:
        """Standard uncertainty (n_p,) by one cause."""
        return np.asarray(np.linalg.norm(self.parts[cause], axis=1))

    def largest_first(self, name: str) -> list[tuple[str, float]]:
        """Causes of the uncertainty of one parameter with their size, those that make nothing left out."""
        i = self.names.index(name)
        found = [(cause, float(self.of(cause)[i])) for cause in self.parts]
        return sorted((one for one in found if one[1] > 0.0), key=lambda one: -one[1])

    def largest_noise(self) -> tuple[str, float]:
        """The channel whose noise makes most of the variances that the noise makes, the mean over all parameters, and its share of these;
        no name where it was not asked."""
        total = np.diag(self.covariance)
        seen = total > 0.0
        if not self.noise_of or not seen.any():
            return "", 0.0
        noise = self.of(NOISE)[seen] ** 2 / total[seen]
        found = {name: float(np.mean(noise * share[seen])) for name, share in self.noise_of.items()}
        most = max(found, key=lambda name: found[name])
        return most, found[most] / max(float(np.mean(noise)), np.finfo(float).tiny)

    def shares(self, names: Collection[str] | None = None) -> dict[str, float]:
        """Share of every cause in the variance, the mean over all parameters, or over `names`, that are determined; largest first."""
        total = np.diag(self.covariance)
        seen = (total > 0.0) & [names is None or name in names for name in self.names]
        found = {cause: float(np.mean(self.of(cause)[seen] ** 2 / total[seen])) if seen.any() else 0.0 for cause in self.parts}
        return dict(sorted(found.items(), key=lambda one: -one[1]))


def moves(fit: LinearModel, columns: np.ndarray, at_bound: np.ndarray) -> np.ndarray:
    """What columns C (n, m) of the residual make of the parameters, -(J^T J)^+ J^T C (n_p, m); those at a bound stay there."""
    free = np.flatnonzero(~at_bound)
    inside = fit.only(free)
    root = inside.root()
    out = np.zeros((fit.columns.shape[1], columns.shape[1]))
    out[free] = -root @ ((inside.columns @ root).T @ columns)
    return out


def combined(
    fit: LinearModel,
    spread: Covariance,
    causes: Mapping[str, np.ndarray],
    *,
    within: Mapping[str, np.ndarray] | None = None,
    noise_scale: float | None = 1.0,
    groups: np.ndarray | None = None,
    channels: Mapping[str, slice] | None = None,
) -> Budget:
    """Budget of a fit of covariance `spread`; `channels`: rows of the residual by channel, whose noise is told apart.

    `causes`: columns (n, m) of the residual of what the fit takes for exact. `within`: the same of what its noise already holds, which is
    told apart. `noise_scale`: mean square of the residual that the noise makes where it is known (1: weights are 1/sigma^2); None where the
    residual itself tells it. `groups` (n,) numbers rows that a misfit has in common, None where there is none: then the covariance is in
    every direction at least what the sums over these groups show (sandwich; Liang and Zeger, Biometrika 73, 1986).
    """
    matrix = spread.matrix if noise_scale is None else noise_scale * spread.matrix_unit
    known = {cause: moves(fit, columns, spread.at_bound) for cause, columns in (within or {}).items()}
    rest = matrix - sum((own @ own.T for own in known.values()), np.zeros_like(matrix))
    parts = {NOISE: root_of(rest), **known}
    if groups is not None and noise_scale is not None:
        parts[MISFIT] = _misfit(fit, spread, noise_scale, groups)
    parts |= {cause: moves(fit, columns, spread.at_bound) for cause, columns in causes.items()}
    # A parameter at a bound is held there; its standard error is the one that it would have if it were released.
    held = np.flatnonzero(spread.at_bound & np.isfinite(spread.sigma_unit))
    if len(held):
        own = np.zeros((len(matrix), len(held)))
        own[held, np.arange(len(held))] = (spread.sigma if noise_scale is None else np.sqrt(noise_scale) * spread.sigma_unit)[held]
        parts[NOISE] = np.column_stack([parts[NOISE], own])
    return Budget(spread.names, parts, np.isinf(spread.sigma_unit), _by_channel(fit, spread.at_bound, channels or {}))


def _by_channel(fit: LinearModel, at_bound: np.ndarray, channels: Mapping[str, slice]) -> dict[str, np.ndarray]:
    """Share (n_p,) of every channel in the variance that the noise of all of them makes, (J^T J)^+ J_k^T C J_k (J^T J)^+ over their sum."""
    free = np.flatnonzero(~at_bound)
    inside = fit.only(free)
    root = inside.root()
    moved = inside.columns @ root @ root.T
    found = {}
    for name, rows in channels.items():
        own = np.zeros_like(moved)
        own[rows] = moved[rows]
        found[name] = np.zeros(len(at_bound))
        found[name][free] = np.diag(inside.meat(own))
    total = np.sum(list(found.values()), axis=0)
    return {name: variance / np.where(total > 0.0, total, 1.0) for name, variance in found.items()}


def root_of(matrix: np.ndarray) -> np.ndarray:
    """R (n, m) with R R^T = M of a symmetric matrix, without its directions of no or (by rounding) negative variance."""
    size = np.sqrt(np.abs(np.diag(matrix)))
    size = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    kept = values > 1e-14 * max(float(values.max(initial=0.0)), 1e-300)
    return np.asarray(size[:, None] * vectors[:, kept] * np.sqrt(values[kept]))


def _misfit(fit: LinearModel, spread: Covariance, noise_scale: float, groups: np.ndarray) -> np.ndarray:
    """Moves (n_p, m) by what the residual shows beyond its noise: by its size, and by sums of groups of rows that have it in common.

    Sums over few groups scatter: what k groups show of p parameters by chance alone reaches (1 + sqrt(p/k))^2 times their variance
    (Marchenko and Pastur, 1967), and counts for nothing.
    """
    free = np.flatnonzero(~spread.at_bound)
    inside = fit.only(free)
    root = inside.root()
    if not root.size:  # every parameter is at a bound, or the data feel none
        return np.zeros((fit.columns.shape[1], 0))
    basis = inside.columns @ root
    noise = noise_scale * inside.meat(basis)
    larger = max(spread.s2 / noise_scale, 1.0) * noise
    count = int(groups.max(initial=0)) + 1
    sums = np.stack([np.bincount(groups, column, count) for column in (basis * fit.residual[:, None]).T], axis=1)
    lower = np.linalg.cholesky(larger)
    inner = np.linalg.solve(lower, np.linalg.solve(lower, sums.T @ sums * count / max(count - 1, 1)).T)
    values, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    values = np.where(values > (1.0 + np.sqrt(root.shape[1] / count)) ** 2, values, 1.0)
    shown = lower @ (vectors * values) @ vectors.T @ lower.T
    excess = root @ root_of(shown - noise)
    out = np.zeros((fit.columns.shape[1], excess.shape[1]))
    out[free] = excess
    return out
