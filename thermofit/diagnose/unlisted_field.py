"""A missing term as a regularised field: hats over place and time, together with a joint step of all fitted parameters.

    minimise |r + J x + B q|^2 + lambda q^T R q,

r the whitened residual, J the columns of the fitted parameters (so that q is what they cannot do), B those of the hats, R the sum of
squared differences between neighbouring hats and a little of q itself. lambda is the one that predicts held-out data best; below the one at
which the misfit falls to the noise (discrepancy principle) no data ask for it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cholesky, lstsq

from thermofit.diagnose.held_out import Proof, Rows, Split, compared
from thermofit.experiment.missing import Grid
from thermofit.fit.linear_model import LinearModel

WEIGHTS = tuple(10.0**k for k in np.arange(-6.0, 3.01, 0.75))
"""lambda tried, in units of tr(B^T B) / tr(R)."""
SURE, PRACTICAL = 3.0, 5e-3
"""Standard errors, and least relative fall of the held-out mean square of the channel, for which a field is believed."""
BEHIND = 0.1
"""Part of an excess that an effect which is the cause does not leave behind."""
ALONE = 0.02
"""Part of an excess below which nothing is told of what a term, or an effect of a coupon, leaves."""
SETTLED = 0.02
"""Largest of the steps of parameters beside a term, in units of their scale, with which they have settled. Of a film it is the largest
change of its history from one search to the next, in units of its largest value."""
SIZE = 0.002
"""Weight of q itself among the differences."""
VALLEY = 1e-8
"""Added to the diagonal of the scaled normal matrix."""
_RANK = 1e-10


@dataclass(frozen=True)
class Basis:
    """Hats of one kind: `chosen` (m,) of those of `grid`, the rows of the residual that feel them, their whitened columns (n_rows, m) and
    roughness R (m, m). Columns beyond m are of other terms that are sought with them. The first `n_own` rows are those of the channel that
    shows it, all where that is zero: held-out data of these prove a term. Where noise is correlated, `counts` is the share of what the
    logarithm of the likelihood gains that counts."""

    kind: str
    unit: str
    grid: Grid
    chosen: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    rough: np.ndarray
    n_own: int = 0
    counts: float = 1.0

    @property
    def own(self) -> np.ndarray:
        """Rows of the channel that shows it."""
        return self.rows[: self.n_own or len(self.rows)]

    @property
    def alone(self) -> Basis:
        """The hats without columns of other terms behind them."""
        m = len(self.chosen)
        return replace(self, columns=self.columns[:, :m], rough=self.rough[:m, :m])

    def full(self, q: np.ndarray) -> np.ndarray:
        """Coefficients (n_k, n_y, n_x, n_c) of all hats, zero where not chosen."""
        out = np.zeros(self.grid.size)
        out[self.chosen] = q[: len(self.chosen)]
        return out.reshape(self.grid.shape)


@dataclass(frozen=True)
class MissingField:
    """A reconstructed term: its basis, coefficients q (m,) and their covariance (m, m), lambda, the step (p,) of the fitted parameters,
    residual with it (n,), held-out residuals (n,) without and with it, the proof on the rows that feel it, and `effective`, the number of
    free coefficients that it is worth, tr[(G + lambda R)^-1 G] - p. `uncertainty` (p,) and `posterior` (m, m): standard errors of the
    fitted parameters beside it, and covariance of the coefficients beside these, (G + lambda R)^-1: the term is known no better than
    data and roughness tell it. `covariance` is what the noise alone makes of it."""

    basis: Basis
    q: np.ndarray
    covariance: np.ndarray
    weight: float
    step: np.ndarray
    residual: np.ndarray
    before: np.ndarray
    after: np.ndarray
    proof: Proof
    effective: float = 0.0
    uncertainty: np.ndarray = field(default_factory=lambda: np.zeros(0))
    posterior: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    solved: Basis | None = None
    """The steps over time that were fitted in the stead of the hats; None where the hats were."""
    steps: tuple[tuple[float, float], ...] = ()
    """Their times in s and amounts, each in the unit of the term."""
    bare: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Residual (n,) without it, where the parameters are."""
    together: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    """Covariance (p, p) of the fitted parameters beside it."""

    @property
    def values(self) -> np.ndarray:
        """Coefficients (n_k, n_y, n_x, n_c)."""
        return self.basis.full(self.q)

    @property
    def sigma(self) -> np.ndarray:
        """Their standard errors, (n_k, n_y, n_x, n_c)."""
        return self.basis.full(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))


def roughness(grid: Grid, chosen: np.ndarray, size: float = SIZE, from_nothing: bool = False) -> np.ndarray:
    """R (m, m): squared differences between hats that are neighbours in time (of one record), y or x, and `size` times q^2; `from_nothing`:
    in the stead of that, the square of q at the first time, from which it drifts as far as it likes."""
    index = np.arange(grid.size).reshape(grid.shape)
    pairs = []
    for axis in range(3):
        a, b = np.moveaxis(index, axis, 0)[:-1], np.moveaxis(index, axis, 0)[1:]
        if axis == 0:
            same = grid.part[:-1] == grid.part[1:]
            a, b = a[same], b[same]
        pairs.append(np.stack([a.ravel(), b.ravel()], axis=1))
    at = np.full(grid.size, -1)
    at[chosen] = np.arange(len(chosen))
    place = at[np.concatenate(pairs)]
    place = place[(place >= 0).all(axis=1)]
    out = np.diag((chosen < grid.size // len(grid.time)).astype(float)) if from_nothing else size * np.eye(len(chosen))
    for i, j in ((0, 0), (1, 1)):
        np.add.at(out, (place[:, i], place[:, j]), 1.0)
    np.add.at(out, (place[:, 0], place[:, 1]), -1.0)
    np.add.at(out, (place[:, 1], place[:, 0]), -1.0)
    return out


def likeliest(known: LinearModel, basis: Basis) -> float:
    """lambda of the largest restricted likelihood (Patterson & Thompson, Biometrika 58, 1971), the variance of the noise profiled out:

        (n - p) log S + log det [G + lambda R] - m log lambda,   S = min |r + J x + B q|^2 + lambda q^T R q,   G = [J B]^T [J B].

    It says how large the term is that the data hold, where held-out blocks say how well it is interpolated.
    """
    system = System(known, basis)
    return min(system.weights, key=lambda weight: system.unlikely(weight) - len(system.rough) * float(np.log(weight)))


def field_of(known: LinearModel, basis: Basis, rows: Rows, split: Split, weight: float | None = None) -> MissingField:
    """The field that predicts held-out data best, beside the fitted parameters without their bounds; `weight`: the one of that lambda."""
    system = System(known, basis)
    folds = [(held, *system.without(hidden)) for held, hidden in split.folds]
    before = replace(known, bounds=None).predicted(split.folds)
    best: tuple[float, float, np.ndarray] | None = None
    for tried in system.weights if weight is None else [weight]:
        after = _predicted(system, folds, tried)
        error = float(np.nanmean(after[basis.rows] ** 2))
        if best is None or error < best[0]:
            best = (error, tried, after)
    assert best is not None
    _, weight, after = best
    step = _step((system.gram, system.right), system.rough, weight, system.p)
    whole, scale = _scaled(system.gram, system.rough, weight, system.p)
    inverse = np.linalg.pinv(whole, rcond=_RANK, hermitian=True) * scale[:, None] * scale[None, :]
    residual = known.residual + system.fitted @ step[: system.p]
    residual[basis.rows] += basis.columns @ step[system.p :]
    spread = (inverse @ system.gram @ inverse)[system.p :, system.p :]
    moved = step[: system.p] / system.size
    proof = proved(basis, rows, (before, after), len(folds))
    effective = float(np.trace(inverse @ system.gram)) - system.p
    together = inverse[: system.p, : system.p] / np.outer(system.size, system.size)
    return MissingField(
        basis=basis,
        q=step[system.p :],
        covariance=spread,
        weight=weight,
        step=moved,
        residual=residual,
        before=before,
        after=after,
        proof=proof,
        effective=effective,
        uncertainty=np.sqrt(np.diag(together)),
        posterior=inverse[system.p :, system.p :],
        bare=known.residual,
        together=together,
    )


def best_beside(residual: np.ndarray, basis: Basis, weight: float) -> tuple[np.ndarray, float]:
    """Coefficients (m,) of a basis beside parameters that stay, and the sum of squares that they leave,

        min_q |r + B q|^2 + lambda q^T R q,

    `residual`: r (n,) where the parameters are, `weight`: lambda."""
    right = -basis.columns.T @ residual[basis.rows]
    q = lstsq(basis.columns.T @ basis.columns + weight * basis.rough, right)[0]
    return np.asarray(q), float(residual @ residual - right @ q)


def with_parameters(known: LinearModel, basis: Basis, weight: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Coefficients (m,) of a basis beside any step of the parameters, their covariance (m, m), and the sum of squares that both leave,
    min |r + J x + B q|^2 + lambda q^T R q. Held-out data are not asked: for a search."""
    cross = known.basis[basis.rows].T @ basis.columns
    gram = basis.columns.T @ basis.columns - cross.T @ cross + weight * basis.rough
    right = -basis.columns.T @ known.left[basis.rows]
    inverse = np.linalg.pinv(gram, rcond=_RANK, hermitian=True)
    q = inverse @ right
    return q, inverse, float(known.left @ known.left - right @ q)


def moves_beside(known: LinearModel, term: MissingField, errors: np.ndarray) -> np.ndarray:
    """What errors (n, k) of the residual make of the fitted parameters (p, k) beside a term with its lambda; `known`: the linear model of
    the parameters where they are."""
    fitted = term.basis if term.solved is None else term.solved
    system = System(known, fitted)
    whole, scale = _scaled(system.gram, system.rough, term.weight, system.p)
    right = np.concatenate([system.fitted.T @ errors, fitted.columns.T @ errors[fitted.rows]])
    step = -scale[:, None] * (np.linalg.pinv(whole, rcond=_RANK, hermitian=True) @ (scale[:, None] * right))
    return np.asarray(step[: system.p] / system.size[:, None])


def proved(basis: Basis, rows: Rows, held_out: tuple[np.ndarray, np.ndarray], folds: int) -> Proof:
    """Proof on the rows that feel a basis, from held-out residuals (n,) without and with the term."""
    own = basis.own
    part = Rows(rows.channel[own], rows.time[own], rows.xy[own], rows.phase[own])
    return compared(held_out[0][own], held_out[1][own], part, folds)


def believed(field: MissingField, sure: float = SURE, practical: float = PRACTICAL) -> bool:
    """True where held-out data ask for a field by that many standard errors and that relative fall of their mean square."""
    return field.proof.gain > max(sure * field.proof.sigma, practical)


class System:
    """Normal equations of fitted parameters (scaled to columns of length one) and hats, G = [J B]^T [J B]."""

    def __init__(self, known: LinearModel, basis: Basis) -> None:
        self.residual, self.fitted, self.size = known.residual, known.unit, known.size
        self.basis, self.p, self.rough = basis, known.columns.shape[1], basis.rough
        self.gram, self.right = self._normal(slice(None), slice(None))

    def _normal(self, mask: np.ndarray | slice, inside: np.ndarray | slice) -> tuple[np.ndarray, np.ndarray]:
        j, r = self.fitted[mask], self.residual[mask]
        b, own = self.basis.columns[inside], self.basis.rows[inside]
        cross = self.fitted[own].T @ b
        gram = np.block([[j.T @ j, cross], [cross.T, b.T @ b]])
        return gram, np.concatenate([j.T @ r, b.T @ self.residual[own]])

    def without(self, hidden: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normal equations of the rows that are seen."""
        gram, right = self._normal(hidden, hidden[self.basis.rows])
        return self.gram - gram, self.right - right

    @property
    def weights(self) -> tuple[float, ...]:
        """lambda that are tried."""
        unit = float(np.trace(self.gram[self.p :, self.p :]) / np.trace(self.rough))
        return tuple(weight * unit for weight in WEIGHTS)

    def unlikely(self, weight: float) -> float:
        """(n - p) log S + log det [G + lambda R] of all unknowns, of the parameters alone where lambda is infinite; infinite where rounding
        decides."""
        hats = len(self.rough) if np.isfinite(weight) else 0
        own = slice(self.p + hats)
        whole, scale = _scaled(self.gram[own, own], self.rough[:hats, :hats], weight, self.p)
        right = scale * self.right[own]
        try:
            factor = cho_factor(whole)
        except LinAlgError:  # so little held that rounding decides: another weight is likelier
            return np.inf
        left = float(self.residual @ self.residual) - float(right @ cho_solve(factor, right))
        det = 2.0 * float(np.sum(np.log(np.diag(factor[0]))) - np.sum(np.log(scale)))
        return (len(self.residual) - self.p) * float(np.log(max(left, 1e-300))) + det

    @property
    def gains(self) -> np.ndarray:
        """What the logarithm of the restricted likelihood gains by the term with each of the lambdas (k,) over none,

            ((n - p) ln S_0 + ln det J^T J - (n - p) ln S - ln det [G + lambda R] + ln det lambda R) / 2,   S_0 = min |r + J x|^2;

        -inf where rounding decides. R has to hold all coefficients."""
        of_rough = 2.0 * float(np.sum(np.log(np.diag(cholesky(self.rough)))))
        wanted = [self.unlikely(weight) - len(self.rough) * float(np.log(weight)) for weight in self.weights]
        return 0.5 * (self.unlikely(np.inf) - np.array(wanted) + of_rough)

    def solved(self, weight: float) -> tuple[np.ndarray, np.ndarray]:
        """Step (p,) of the parameters beside hats with lambda, and their covariance (p, p), the block of (G + lambda R)^-1."""
        step = _step((self.gram, self.right), self.rough, weight, self.p)[: self.p]
        whole, scale = _scaled(self.gram, self.rough, weight, self.p)
        inverse = np.linalg.pinv(whole, rcond=_RANK, hermitian=True) * scale[:, None] * scale[None, :]
        return step / self.size, inverse[: self.p, : self.p] / np.outer(self.size, self.size)


Normal = tuple[np.ndarray, np.ndarray]
"""Normal matrix and right-hand side."""
Fold = tuple[np.ndarray, np.ndarray, np.ndarray]


def _predicted(system: System, folds: list[Fold], weight: float) -> np.ndarray:
    """Held-out residual (n,) with the field at that lambda; nan in rows that no fold holds out."""
    out, p = np.full(len(system.residual), np.nan), system.p
    inside = np.full(len(system.residual), -1)
    inside[system.basis.rows] = np.arange(len(system.basis.rows))
    for held, gram, right in folds:
        step = _step((gram, right), system.rough, weight, p)
        value = system.residual + system.fitted @ step[:p]
        out[held] = value[held]
        own = held & (inside >= 0)
        out[own] += system.basis.columns[inside[own]] @ step[p:]
    return out


def _step(system: Normal, rough: np.ndarray, weight: float, p: int) -> np.ndarray:
    """Step (p + m,); directions that nothing feels stay where they are."""
    whole, scale = _scaled(system[0], rough, weight, p)
    right = -scale * system[1]
    try:
        return np.asarray(scale * cho_solve(cho_factor(whole), right))
    except LinAlgError:
        return np.asarray(scale * (np.linalg.pinv(whole, rcond=_RANK, hermitian=True) @ right))


def _scaled(gram: np.ndarray, rough: np.ndarray, weight: float, p: int) -> tuple[np.ndarray, np.ndarray]:
    """Regularised normal matrix with ones on its diagonal, and the scale of every unknown."""
    whole = gram.copy()
    whole[p:, p:] += weight * rough
    scale = 1.0 / np.sqrt(np.maximum(np.diag(whole), 1e-300))
    # What the data do not determine stays where it is: it must not run off along a valley.
    return whole * scale[:, None] * scale[None, :] + VALLEY * np.eye(len(whole)), scale
