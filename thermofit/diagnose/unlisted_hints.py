"""What a reconstructed term goes with: few state variables, chosen again and again on other halves of its blocks (stability selection).

Meinshausen and Buehlmann, J. R. Stat. Soc. B 72 (2010) 417: on each of many random halves, a greedy selection (orthogonal matching
pursuit) takes at most MOST variables; the frequency with which one is taken says how much it may be trusted. These are hints, no law.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thermofit.experiment.residuals import Span, span_of
from thermofit.fit.linear_model import LinearModel

HALVES = 100
MOST = 3
WORTH = 0.02
"""Least fall of the square sum, relative to that of the term, for which a variable is taken."""
SEED = 7
_BLOCKS = 24


@dataclass(frozen=True)
class Hint:
    """A state variable, how often it was chosen, the sign with which the term goes with it, and its correlation with the term."""

    variable: str
    frequency: float
    sign: int
    correlation: float


def hints(term: np.ndarray, states: Mapping[str, np.ndarray], time: np.ndarray, spans: tuple[Span, ...]) -> tuple[Hint, ...]:
    """Hints of a term (n_k, n_places) from state variables of the same shape; phases of the test take part as variables."""
    names, columns = _features(states, time, spans, term.shape)
    y = term.ravel() - term.mean()
    if not names or not np.any(y):
        return ()
    k = np.repeat(np.arange(term.shape[0]), term.shape[1])
    block = (k * _BLOCKS) // term.shape[0] * 4 + np.tile((4 * np.arange(term.shape[1])) // term.shape[1], term.shape[0])
    block = np.unique(block, return_inverse=True)[1]
    rng, count = np.random.default_rng(SEED), np.zeros(len(names))
    for _ in range(HALVES):
        half = rng.permutation(block.max() + 1)[: (block.max() + 2) // 2]
        rows = np.isin(block, half)
        for chosen in _pursued(columns[rows], y[rows]):
            count[chosen] += 1
    size = np.linalg.norm(columns, axis=0) * np.linalg.norm(y)
    correlation = columns.T @ y / np.where(size > 0.0, size, 1.0)
    order = [n for n in np.argsort(-count, kind="stable") if count[n] > 0]
    return tuple(Hint(names[n], float(count[n] / HALVES), int(np.sign(correlation[n])), float(correlation[n])) for n in order)


def _features(
    states: Mapping[str, np.ndarray], time: np.ndarray, spans: tuple[Span, ...], shape: tuple[int, ...]
) -> tuple[list[str], np.ndarray]:
    """Names and centred columns of all variables that vary, of length one each."""
    names, columns = [], []
    phase = span_of(time, spans) if spans else np.zeros(len(time), dtype=int)
    windows = {f"phase {s.name}": np.repeat((phase == n).astype(float)[:, None], shape[1], axis=1) for n, s in enumerate(spans)}
    for name, value in {**states, **(windows if len(spans) > 1 else {})}.items():
        column = value.ravel() - value.mean()
        size = float(np.linalg.norm(column))
        if size > 1e-12 * max(1.0, float(np.abs(value).max())):
            names.append(name)
            columns.append(column / size)
    return names, np.stack(columns, axis=1) if columns else np.zeros((int(np.prod(shape)), 0))


def _pursued(columns: np.ndarray, y: np.ndarray) -> list[int]:
    """Variables taken one after the other, each the one that leaves least."""
    y = y - y.mean()
    columns = columns - columns.mean(axis=0)
    whole, left = float(y @ y), y
    taken: list[int] = []
    for _ in range(MOST):
        size = np.linalg.norm(columns, axis=0)
        score = np.abs(columns.T @ left) / np.where(size > 1e-9, size, np.inf)
        score[taken] = 0.0
        best = int(np.argmax(score))
        rest = LinearModel(y, columns[:, [*taken, best]]).left
        if float(left @ left - rest @ rest) < WORTH * whole:
            break
        taken.append(best)
        left = rest
    return taken
