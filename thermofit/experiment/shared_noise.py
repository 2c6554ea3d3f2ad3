"""Noise that several comparisons have in common, as the error of a force that moves points and warms them: what one tells of it, the next
ones know.

With k errors m of unit variance and comparisons r_i = A_i m + e_i, e_i white of unit variance, the residuals are whitened one after the
other, each given those before it (the innovations of R. E. Kalman, 1960, Journal of Basic Engineering 82, for a state that stands still):

    r_i'' = (1 + A_i P_i A_i^T)^(-1/2) (r_i - A_i m_i),

m_i the mean and P_i the covariance of m that r_1 to r_(i-1) leave. All of them together are as white as the noise of the whole, and every
comparison keeps its rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.observe.comparison import Comparison

_TELLS = 1e-3
"""Size of a mode in units of the noise below which it is left out."""


@dataclass(frozen=True)
class SharedErrors:
    """What one comparison shows of k common errors, and what it tells of them.

    `columns` (n, r) the residuals, whitened, that its r modes make, `modes` (k, r) those modes in the errors; `basis` (n, q) and `gain`
    (k, q): gain basis^T r'' is what its innovation adds to the mean of the errors; `left` (q,) the sizes of the modes that were not known
    before, in units of the noise.
    """

    columns: np.ndarray
    modes: np.ndarray
    basis: np.ndarray
    gain: np.ndarray
    left: np.ndarray


@dataclass(frozen=True)
class SharedNoise:
    """Common errors of comparisons, by their place among all of them, in the order in which they are whitened."""

    shown: Mapping[int, SharedErrors]

    def innovations(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Residuals (n_i, ...), each whitened on its own, without what those before tell of the common errors."""
        return list(self.innovations_of(dict(enumerate(parts))).values())

    def innovations_of(self, parts: Mapping[int, np.ndarray]) -> dict[int, np.ndarray]:
        """The same of the comparisons at some places, in their order; those left out tell nothing, as where their residual is zero."""
        found, _ = self._filtered(parts)
        return {place: found.get(place, part) for place, part in parts.items()}

    def told(self, parts: Mapping[int, np.ndarray]) -> np.ndarray:
        """Mean (k,) of the common errors after the first comparisons, of which the whitened residuals (n_i,) are given by place; zero after
        none."""
        if not parts:
            return np.zeros(len(next(iter(self.shown.values())).modes))
        _, mean = self._filtered(parts)
        return mean

    def _filtered(self, parts: Mapping[int, np.ndarray]) -> tuple[dict[int, np.ndarray], np.ndarray]:
        """Innovations (n_i, ...) of the comparisons that show common errors and of which the residuals are given by place, and the mean
        (k, ...) of these errors after them."""
        first = next(iter(self.shown.values()))
        mean = np.zeros((len(first.modes), *next(iter(parts.values())).shape[1:]))
        found = {}
        for place in (p for p in self.shown if p in parts):
            one = self.shown[place]
            found[place] = parts[place] - one.columns @ (one.modes.T @ mean)
            mean = mean + one.gain @ (one.basis.T @ found[place])
        return found, mean

    def given(self, mean: np.ndarray, places: Mapping[int, int]) -> Given:
        """What is left of the common errors in the comparisons at `places` (old: new), where the others told their mean (k,)."""
        own = {new: self.shown[old] for old, new in places.items() if old in self.shown}
        return Given({new: one.columns @ (one.modes.T @ mean) for new, one in own.items()}, SharedNoise(own))

    def moved(self, by: int) -> SharedNoise:
        """The same where other comparisons stand before these."""
        return SharedNoise({place + by: one for place, one in self.shown.items()})


@dataclass(frozen=True)
class Given:
    """Residuals (n_i,) that comparisons show of what others told of the common errors, by place, and what they tell each other."""

    shown: Mapping[int, np.ndarray]
    rest: SharedNoise

    def without(self, place: int, comparison: Comparison) -> Comparison:
        """A comparison, whitened on its own, whose residual is without what the others told."""
        if place not in self.shown:
            return comparison
        shift, of, along = self.shown[place], comparison.residual, comparison.along
        linear = along or (lambda _, direction: of(direction))
        return replace(comparison, residual=lambda e: of(e) - shift, along=linear, several=comparison.columns)


@dataclass(frozen=True)
class Modes:
    """What a comparison shows of k common errors: `columns` (n, r) are the residuals of unit modes, `turned` (k, r) these modes in the
    errors."""

    columns: np.ndarray
    turned: np.ndarray


def shared(comparisons: Sequence[Comparison], modes: Mapping[int, Modes]) -> tuple[tuple[Comparison, ...], SharedNoise | None]:
    """Comparisons with common errors in their noise, and what they tell of each other; `modes` by place, in the order of whitening."""
    if not modes:
        return tuple(comparisons), None
    out, shown = list(comparisons), {}
    k = len(next(iter(modes.values())).turned)
    spread = np.eye(k)
    for place, own in modes.items():
        q, r = np.linalg.qr(own.columns)
        u, s, vt = np.linalg.svd(r @ own.turned.T @ spread, full_matrices=False)
        u, s, vt = u[:, s > _TELLS], s[s > _TELLS], vt[s > _TELLS]
        basis, root = q @ u, np.sqrt(1.0 + s**2)
        white = own.columns - basis @ ((1.0 - 1.0 / root)[:, None] * (basis.T @ own.columns))
        shown[place] = SharedErrors(white, own.turned, basis, spread @ (vt.T * (s / root)), s)
        out[place] = comparisons[place].blurred(basis * s)
        spread = np.linalg.qr((spread - (spread @ vt.T * (1.0 - 1.0 / root)) @ vt).T)[1].T
    return tuple(out), SharedNoise(shown)
