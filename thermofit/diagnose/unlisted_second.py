"""Histories of another kind that may be there beside one that is told: what they would make of the fitted parameters.

A lamp may burn while a camera jumps. One history over time then takes most of both, and the parameters the rest. Beside a history (or one
spot) B q every other kind k that the channel may have, B_k q_k, is therefore weighed, and none of them too:

    p_k = L_k / (1 + sum_j L_j),   L_k the largest restricted likelihood with k over that without.

One is told as likely where none is, too (docs/other-causes.md counts it). So values stay what they are. With d_k how far they would move
beside k, and C_k and C their covariance with it and without, they are off by

    E = sum_k p_k (C_k - C + d_k d_k^T),

mean square: that of a mixture of models about one of them (Hoeting et al., Statistical Science 14, 1999). Where any of K kinds together
is less likely than none before the data speak, by b to 1 - b, L_k / K times that ratio stands for L_k (`quiet`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import softmax

from thermofit.diagnose.unlisted_field import Basis, MissingField, System
from thermofit.fit.linear_model import LinearModel


@dataclass(frozen=True)
class Second:
    """How likely a second history of every kind is (none of them: the rest of one), and E (p, p)."""

    likelihood: Mapping[str, float]
    covariance: np.ndarray


def second_histories(known: LinearModel, term: MissingField, others: Mapping[str, Basis]) -> Second:
    """What other kinds of histories may make of the fitted parameters beside a term with its lambda; `known`: the linear model of the
    parameters where they are, `others`: the hats of each kind; of a channel that can have no other kind there are none."""
    p = known.columns.shape[1]
    if not others:
        return Second({}, np.zeros((p, p)))
    found = mixed(with_term(known, term), others)
    return replace(found, covariance=found.covariance[:p, :p])


def mixed(whole: LinearModel, others: Mapping[str, Basis], before: float | None = None, parts: Sequence[float] | None = None) -> Second:
    """How likely one history of any kind is beside all that a linear model fits, and what they may make of that; `others`: the hats of each
    kind, one at least. `before`: how likely any of them is before the data speak, each kind as any other, or to its share in `parts`; None:
    each as none of them."""
    own = next(iter(others.values()))
    none = replace(own, columns=own.columns[:, :0], rough=own.rough[:0, :0])
    alone, least = System(whole, none).solved(1.0)
    gains, moved = [0.0], [np.zeros_like(least)]
    for basis in others.values():
        system = System(whole, basis)
        gained = system.gains * basis.counts
        step, covariance = system.solved(system.weights[int(np.argmax(gained))])
        away = step - alone
        gains.append(float(gained.max()))
        moved.append(covariance - least + np.outer(away, away))
    if before is not None:
        even = [1.0 / len(others)] * len(others)
        gains = [np.log(1.0 - before), *(gain + np.log(before * part) for gain, part in zip(gains[1:], parts or even, strict=True))]
    share = softmax(gains)
    return Second(dict(zip(others, share[1:].tolist(), strict=True)), np.tensordot(share, np.array(moved), axes=1))


def with_term(known: LinearModel, term: MissingField) -> LinearModel:
    """The linear model with the coefficients of a term behind its parameters, and rows that hold them, lambda q^T R q."""
    fitted = term.basis if term.solved is None else term.solved
    block = np.zeros((len(known.residual), fitted.columns.shape[1]))
    block[fitted.rows] = fitted.columns
    values, vectors = np.linalg.eigh(fitted.rough)
    return held_beside(known, block, np.sqrt(term.weight * np.maximum(values, 0.0))[:, None] * vectors.T)


def held_beside(known: LinearModel, columns: np.ndarray, held: np.ndarray) -> LinearModel:
    """The linear model with columns (n, m) behind its own, and rows (k, m) of unit variance that hold their coefficients at nothing."""
    below = np.concatenate([np.zeros((len(held), known.columns.shape[1])), held], axis=1)
    columns = np.concatenate([np.concatenate([known.columns, columns], axis=1), below])
    return replace(known, residual=np.append(known.residual, np.zeros(len(held))), columns=columns, bounds=None)
