"""The part of the Hessian of r.r that Gauss-Newton leaves out, learnt from derivatives that the trials of a search give anyway.

Half the Hessian of f = r.r is J^T J + S with S = sum_i r_i d2r_i/dz2. Where the model fits the data, S is small against J^T J. Where it
lacks something, the residual is large, S may outweigh J^T J along a parameter that the data hardly tell, and the full Gauss-Newton step
is too long by (J^T J + S)/(J^T J): the search crawls with shorter and shorter steps. S is kept by secant updates as in NL2SOL (J. E.
Dennis, D. M. Gay, R. E. Welsch, ACM Trans. Math. Softw. 7, 1981, 348-368), and used only where it has predicted f better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.fit.linear_model import LinearModel

_GOOD = 0.5
"""Gauss-Newton is left as it is while a trial achieves between this share and its inverse of the drop that it predicts."""
_SMALLEST = 1e-12
"""Share of the largest curvature below which a direction has none that a step could be based on."""


@dataclass(frozen=True)
class Curvature:
    """S (n_p, n_p) with respect to the scaled variables z, and whether the steps are based on J^T J + S (`used`) or on J^T J."""

    S: np.ndarray
    used: bool = False


def augmented(here: LinearModel, S: np.ndarray) -> LinearModel:
    """The quadratic model of f with J^T J + S in the form of a linear least-squares problem: R^T R = J^T J + S, R^T c = J^T r.

    A direction of negative curvature counts by its magnitude: a step goes down along it, as far as for a valley of that curvature.
    """
    norms = here.size
    values, vectors = np.linalg.eigh((here.columns.T @ here.columns + S) / np.outer(norms, norms))
    values = np.abs(values)
    root = np.sqrt(np.maximum(values, _SMALLEST * values.max()))
    R = root[:, None] * vectors.T * norms
    return LinearModel(vectors.T @ (here.columns.T @ here.residual / norms) / root, R)


def learnt(known: Curvature, here: LinearModel, there: LinearModel, d: np.ndarray, moved: bool) -> Curvature:
    """S after a trial from `here` to `there` = here + d (n_p,), for the point that the search goes on from: `there` if `moved`.

    Of the two predictions of f the better one is used next; that of Gauss-Newton is kept while it is good by itself.
    """
    achieved = here.f - there.f
    plain = _promised(here, d)
    errors = abs(achieved - plain), abs(achieved - (plain - float(d @ known.S @ d)))
    wrong = not _GOOD * plain <= achieved <= plain / _GOOD
    used = errors[1] < errors[0] and (known.used or wrong)
    weights = there.residual if moved else here.residual
    curving = there.columns.T @ weights - here.columns.T @ weights
    turning = there.columns.T @ there.residual - here.columns.T @ here.residual
    return Curvature(updated(known.S, d, curving, turning), used)


def updated(S: np.ndarray, d: np.ndarray, curving: np.ndarray, turning: np.ndarray) -> np.ndarray:
    """Secant update of Dennis, Gay and Welsch: the result, symmetric (n_p, n_p), maps the step d to `curving`.

    `curving`: (J(z + d) - J(z))^T r, `turning`: change of the gradient J^T r; all (n_p,). S is first sized, so that what was learnt
    where the residual was larger does not outlive it. Unlike there, S is kept where the gradient does not rise along the step.
    """
    slope = float(turning @ d)
    if slope <= _SMALLEST * float(np.linalg.norm(turning) * np.linalg.norm(d)):
        return S
    known = float(d @ S @ d)
    S = S * (min(1.0, abs(float(d @ curving)) / abs(known)) if known != 0.0 else 1.0)
    miss = curving - S @ d
    mixed = np.outer(miss, turning)
    return np.asarray(S + (mixed + mixed.T) / slope - float(d @ miss) * np.outer(turning, turning) / slope**2)


def _promised(here: LinearModel, d: np.ndarray) -> float:
    """Drop of f along d by the linear model of the residual."""
    change = here.columns @ d
    return -float(2.0 * here.residual @ change + change @ change)
