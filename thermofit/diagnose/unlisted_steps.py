"""A missing term over time that is the same everywhere, as a few steps: what is switched on, off, or jumps.

Hats follow any history, but a smooth one is the likeliest for them, and parameters take up what is smooth. A lamp that burns for a minute,
or a camera that jumps, is one or two steps:

    minimise |r + J x + B S_K c|^2,   S_K the columns K of the unit steps between the hats,

K is chosen forward, each of it again at the others (orthogonal matching pursuit with exchange; Pati, Rezaiifar & Krishnaprasad 1993, 27th
Asilomar Conference), and is as small as held-out data allow: more steps, or hats, have to predict them better as any effect has to, and
to take what a cause does not leave behind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermofit.diagnose.held_out import Rows, Split
from thermofit.diagnose.unlisted_field import ALONE, Basis, MissingField, believed, best_beside, field_of, proved
from thermofit.fit.linear_model import LinearModel

MOST = 8
"""Most steps."""
_SWEEPS = 5
"""Times that every step is sought again beside the others, at most."""
Step = tuple[int, ...]
"""Columns of one step: that of a knot, and of the neighbour with which it is shared."""
_NOTHING = 1e-7
"""Part of the square of a column that parameters and other steps leave, below which it is none of its own."""


def in_steps(known: LinearModel, basis: Basis, rows: Rows, split: Split) -> MissingField | None:
    """The term of hats over time (one place, one record) as steps; None where no step takes anything away.

    Coefficients, covariance and posterior are those of the hats, which the steps are sums of; `MissingField.steps` are the steps."""
    shape = _unit_steps(basis.columns.shape[1])
    columns = basis.columns @ shape
    found: list[MissingField] = []
    for steps in _chosen(known, basis, columns):
        places = list(dict.fromkeys(k for step in steps for k in step))
        own = replace(basis, columns=columns[:, places], rough=np.eye(len(places)), chosen=basis.chosen[places])
        least = _NOTHING * float(np.mean(own.columns**2)) * len(own.columns)  # what a fold does not see of a step stays at nothing
        found.append(_of_hats(field_of(known, own, rows, split, least), basis, shape[:, places], steps, places))
    if not found:
        return None
    best = min(found, key=lambda f: float(np.nanmean(f.after[basis.rows] ** 2)))
    return next(f for f in found if f is best or not better(f, best, rows, split))


def of_steps(term: MissingField) -> np.ndarray | None:
    """Coefficients (m, k) of the hats of the steps that a term was fitted as; None where it was fitted as hats."""
    if term.solved is None:
        return None
    return _unit_steps(len(term.basis.chosen))[:, np.searchsorted(term.basis.chosen, term.solved.chosen)]


def best_of_its_form(term: MissingField, residual: np.ndarray, hat: Basis) -> tuple[np.ndarray, float]:
    """`best_beside` of hats (m,) elsewhere, as the steps that a term is where it is of steps, held as the term is."""
    shape = of_steps(term)
    if shape is None or term.solved is None:
        return best_beside(residual, hat, term.weight)
    q, square = best_beside(residual, replace(hat, columns=hat.columns @ shape, rough=term.solved.rough), term.weight)
    return shape @ q, square


def _unit_steps(m: int) -> np.ndarray:
    """Coefficients (m, m) of the hats of a unit step at every knot."""
    return np.tril(np.ones((m, m)))


def better(one: MissingField, other: MissingField, rows: Rows, split: Split) -> bool:
    """Whether the other field predicts the held-out rows that feel it better, by so much that it is believed, and the one leaves more than
    ALONE of what the other takes. Errors of mesh and steps ask for more steps than there are, and these for other parameters."""
    own = one.basis.rows
    nothing, first, second = (float(np.nanmean(r[own] ** 2)) for r in (one.before, one.after, other.after))
    leaves = first - second > ALONE * (nothing - second)
    return leaves and believed(replace(other, proof=proved(other.basis, rows, (one.after, other.after), len(split.held_out))))


def _of_hats(field: MissingField, basis: Basis, shape: np.ndarray, steps: Sequence[Step], places: Sequence[int]) -> MissingField:
    """A field of steps (m, k) in the coefficients of the hats. A step between two knots is shared out to both by its time."""
    amount = dict(zip(places, field.q.tolist(), strict=True))
    told = []
    for step in steps:
        at = [0.5 * (basis.grid.time[max(k - 1, 0)] + basis.grid.time[k]) for k in step]
        whole = sum(amount[k] for k in step)
        mean = sum(amount[k] * t for k, t in zip(step, at, strict=True)) / whole if whole else at[0]
        told.append((float(np.clip(mean, min(at), max(at))), whole))
    return replace(
        field,
        basis=basis,
        q=shape @ field.q,
        covariance=shape @ field.covariance @ shape.T,
        posterior=shape @ field.posterior @ shape.T,
        solved=field.basis,
        steps=tuple(sorted(told)),
    )


def _chosen(known: LinearModel, basis: Basis, columns: np.ndarray) -> list[tuple[Step, ...]]:
    """Steps of every number from 1 to MOST that take most of r.r away beside the parameters, each with the neighbour that takes more with
    it: where between knots it is. Columns (n_rows, m) are those of the unit steps."""
    inside = known.basis[basis.rows]
    cross = inside.T @ columns
    gram = columns.T @ columns - cross.T @ cross
    right = columns.T @ known.residual[basis.rows] - cross.T @ (known.basis.T @ known.residual)
    own = np.einsum("nk,nk->k", columns, columns)
    usable = np.diag(gram) > _NOTHING * own
    chosen: list[int] = []
    out: list[tuple[Step, ...]] = []
    while len(chosen) < MOST:
        best = _next(gram, right, own, chosen, usable)
        if best is None:
            break
        chosen.append(best)
        for _ in range(_SWEEPS):
            before = list(chosen)
            for k in range(len(chosen)):
                others = chosen[:k] + chosen[k + 1 :]
                again = _next(gram, right, own, others, usable)
                chosen[k] = chosen[k] if again is None else again
            if chosen == before:
                break
        every = list(chosen)
        steps: list[Step] = []
        for k in sorted(chosen):
            beside = [n for n in (k - 1, k + 1) if 0 <= n < len(own)]
            near = _next(gram, right, own, every, usable & np.isin(np.arange(len(own)), beside))
            steps.append((k,) if near is None else (k, near))
            every += steps[-1][1:]
        out.append(tuple(steps))
    return out


def _next(gram: np.ndarray, right: np.ndarray, own: np.ndarray, chosen: Sequence[int], usable: np.ndarray) -> int | None:
    """The column that takes most away beside the chosen ones; None where none has a part of its own."""
    left, square = right, np.diag(gram)
    if chosen:
        k = list(chosen)
        along = np.linalg.solve(gram[np.ix_(k, k)], np.column_stack([right[k], gram[k]]))
        left = right - gram[:, k] @ along[:, 0]
        square = square - np.einsum("nk,kn->n", gram[:, k], along[:, 1:])
    free = usable & (square > _NOTHING * own)
    free[list(chosen)] = False
    if not free.any():
        return None
    drop = np.where(free, left**2 / np.where(free, square, 1.0), -np.inf)
    return int(np.argmax(drop))
