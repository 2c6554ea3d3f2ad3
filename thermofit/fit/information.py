"""What a Jacobian says of its parameters before any fit: spectrum of the information, flat directions, what must be fixed.

Everything is in relative changes d = dx/size (n_p,), size = |x| where x is a positive quantity: d is then the change of ln x, a flat
direction is a set of exponents, and what stays constant along it are ratios and products of powers. The information matrix is G = W^T W
with |W d|^2 the squared departure in standard errors; its eigenvectors are those of the Hessian (2.31) in these variables, 1/sqrt of its
eigenvalues the standard errors along them. Correlated noise is in W: G is the inverse of the honest covariance A^-1 J^T C J A^-1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy.linalg

from thermofit.fit.covariance import NoiseOperator
from thermofit.fit.linear_model import LinearModel

FREEDOM = 0.1
"""Relative standard error along a unit direction from which on it counts as flat: the data leave more than 10 % to it."""
MEMBER = 0.1
"""Share of the largest component from which on a parameter belongs to a flat direction."""
_EXACT = 1e-7
"""Smallest over largest singular value below which it is the model, not the noise, that leaves a direction open."""
_MOST_SETS = 20_000


@dataclass(frozen=True)
class Information:
    """`root` W (m, n_p), m <= n_p, of parameters `names` at `x` (n_p,) in relative changes of `size` (n_p,)."""

    names: tuple[str, ...]
    x: np.ndarray
    size: np.ndarray
    root: np.ndarray

    def of(self, kept: Sequence[int]) -> Information:
        """The same with only the parameters of these places free."""
        k = list(kept)
        triangle = np.asarray(np.linalg.qr(self.root[:, k], mode="r")) if k else np.zeros((0, 0))
        return Information(tuple(self.names[i] for i in k), self.x[k], self.size[k], triangle)


@dataclass(frozen=True)
class Invariant:
    """x_i / x_reference^exponent, which stays constant along a flat direction: `drift` is the relative change of the plain ratio or
    product (exponent rounded) per relative change of the reference, `sigma` the relative standard error with which the data give it."""

    name: str
    exponent: float
    plain: int | None
    drift: float
    sigma: float


@dataclass(frozen=True)
class Flat:
    """A direction that the data leave open: `direction` (n_p,) of unit length in relative changes, `sigma` the relative standard error
    along it (inf where exactly zero), `exact` where the model itself leaves it open; members, reference and what stays constant."""

    direction: np.ndarray
    sigma: float
    exact: bool
    members: tuple[str, ...]
    reference: str
    invariants: tuple[Invariant, ...]


@dataclass(frozen=True)
class Spectrum:
    """Eigenvalues (n_p,) of the information, largest first, eigenvectors (n_p, n_p) as columns, `sigma` (n_p,) along them, `condition`
    (largest over smallest singular value), and the flat directions in their plainest form."""

    values: np.ndarray
    vectors: np.ndarray
    sigma: np.ndarray
    condition: float
    flat: tuple[Flat, ...]


def information(
    jacobian: np.ndarray, names: tuple[str, ...], x: np.ndarray, size: np.ndarray, noise: NoiseOperator | None = None, s2: float = 1.0
) -> Information:
    """Information of a whitened Jacobian dr/dx (n, n_p); `noise` applies the correlation C of r to columns, s2 is its variance."""
    relative = jacobian * size
    if noise is None:
        return Information(names, x, size, np.asarray(np.linalg.qr(relative, mode="r")) / np.sqrt(s2))
    model = LinearModel(np.zeros(len(relative)), relative, noise)
    lower = np.linalg.cholesky(model.meat(model.basis) * s2)
    return Information(names, x, size, scipy.linalg.solve_triangular(lower, model.basis.T @ relative, lower=True))


def spectrum(info: Information, reference: str | None = None, freedom: float = FREEDOM) -> Spectrum:
    """Spectrum of an information; `reference` is the parameter that ratios refer to where it takes part."""
    p = len(info.names)
    _, values, vectors_t = np.linalg.svd(info.root, full_matrices=True)
    values = np.pad(values, (0, p - len(values)))
    sigma = np.divide(1.0, values, out=np.full(p, np.inf), where=values > 0.0)
    largest = float(values.max(initial=0.0))
    smallest = float(values.min(initial=np.inf))
    open_ = sigma > freedom
    flat = tuple(
        _flat(info, vector, values, vectors_t.T, open_, reference)
        for vector in _plain_basis(vectors_t[open_])
    )  # fmt: skip
    condition = largest / smallest if smallest > 0.0 else float("inf")
    return Spectrum(values**2, vectors_t.T, sigma, condition, flat)


def _plain_basis(basis: np.ndarray) -> np.ndarray:
    """The basis of a space (k, n_p) with the fewest names, each of unit length."""
    if len(basis) < 2:
        return basis
    _, triangle, order = scipy.linalg.qr(basis, mode="economic", pivoting=True)
    plain = np.linalg.solve(triangle[:, : len(basis)], triangle)
    out = np.empty_like(plain)
    out[:, order] = plain / np.linalg.norm(plain, axis=1, keepdims=True)
    return out


def _flat(info: Information, v: np.ndarray, values: np.ndarray, vectors: np.ndarray, open_: np.ndarray, reference: str | None) -> Flat:
    """The open direction v (n_p,) in words; singular values (n_p,) and vectors (n_p, n_p) of the whole, `open_` (n_p,) where it is open."""
    members = [i for i in range(len(v)) if abs(v[i]) > MEMBER * np.abs(v).max()]
    names = [info.names[i] for i in members]
    lead = info.names.index(reference) if reference in names else int(np.argmax(np.abs(v)))
    v = v * np.sign(v[lead])
    left = float(np.linalg.norm(info.root @ v))
    resolved = vectors[:, ~open_] / values[~open_]
    invariants = tuple(_invariant(info, v, (i, lead), resolved) for i in members if i != lead)
    exact = left <= _EXACT * float(values.max(initial=0.0))
    return Flat(v, 1.0 / left if left > 0.0 else float("inf"), exact, tuple(names), info.names[lead], invariants)


def _invariant(info: Information, v: np.ndarray, pair: tuple[int, int], resolved: np.ndarray) -> Invariant:
    """The combination ln x_i - e ln x_r that does not change along v, and its standard error from the directions that the data give."""
    i, lead = pair
    exponent = float(v[i] / v[lead])
    plain = round(exponent) if 0 < abs(round(exponent)) <= 2 else None
    drift = abs(exponent - plain) if plain is not None else float("inf")
    plain = plain if drift <= 0.05 else None
    combination = np.zeros(len(v))
    combination[i], combination[lead] = 1.0, -exponent
    return Invariant(info.names[i], exponent, plain, drift, float(np.linalg.norm(combination @ resolved)))


def relative_sigma(info: Information) -> np.ndarray:
    """Relative standard error (n_p,) of every parameter with all others free; inf where the data do not give it at all."""
    _, values, vectors_t = np.linalg.svd(info.root, full_matrices=True)
    values = np.pad(values, (0, len(info.names) - len(values)))
    floor = 1e-14 * max(float(values.max(initial=0.0)), np.finfo(float).tiny)
    variance = np.zeros(len(info.names))
    for value, vector in zip(values, vectors_t, strict=True):
        if value > floor:
            variance += (vector / value) ** 2
        else:
            variance[np.abs(vector) > 1e-6] = np.inf
    return np.sqrt(variance)


def detectability(info: Information) -> np.ndarray:
    """Share (n_p,) of the effect of every parameter that no change of the others can imitate: 1 alone, 0 wholly imitated or unfelt."""
    out = np.zeros(len(info.names))
    for i in range(len(out)):
        column = info.root[:, i]
        if np.any(column):
            left = LinearModel(column, np.delete(info.root, i, axis=1)).left
            out[i] = float(np.linalg.norm(left) / np.linalg.norm(column))
    return out


def fixing_sets(info: Information, freedom: float = FREEDOM) -> tuple[tuple[str, ...], ...]:
    """The smallest sets of parameters that must be given so that the data leave no direction of the others open; () inside where none.

    Of equal size the one first after which the least determined parameter is determined best. Empty where too many sets would be tried.
    """
    p, tried = len(info.names), 0
    for count in range(p):
        found = []
        for fixed in combinations(range(p), count):
            tried += 1
            if tried > _MOST_SETS:
                return ()
            rest = info.of([i for i in range(p) if i not in fixed])
            worst = _worst(rest)
            if worst <= freedom:
                found.append((worst, tuple(info.names[i] for i in fixed)))
        if found:
            return tuple(names for _, names in sorted(found))
    return (info.names,)


def _worst(info: Information) -> float:
    """Standard error along the least determined direction."""
    if len(info.root) < len(info.names):
        return float("inf")
    smallest = float(np.linalg.svd(info.root, compute_uv=False).min(initial=np.inf))
    return 1.0 / smallest if smallest > 0.0 else float("inf")


@dataclass(frozen=True)
class DesignCriteria:
    """How good a test is for its parameters together, in relative standard errors: `d` the geometric mean of the axes of the confidence
    ellipsoid, det(G)^(-1/(2 p)); `a` the root mean square of the standard errors, sqrt(tr(G^-1)/p); `e` the longest axis. inf: open."""

    d: float
    a: float
    e: float


def criteria(info: Information) -> DesignCriteria:
    """D-, A- and E-criterion of an information; smaller is better."""
    p = len(info.names)
    values = np.linalg.svd(info.root, compute_uv=False)
    floor = 1e-14 * max(float(values.max(initial=0.0)), np.finfo(float).tiny)
    if len(values) < p or values.min() <= floor:
        return DesignCriteria(float("inf"), float("inf"), float("inf"))
    return DesignCriteria(float(np.exp(-np.mean(np.log(values)))), float(np.sqrt(np.mean(values**-2.0))), float(1.0 / values.min()))
