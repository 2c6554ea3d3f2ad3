"""Is the optimum unique? What several starts of one identification say about it (thesis 2.8.4, remarks to Tables 5.6, 5.10, 5.19)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

AGREE = 0.01
"""Relative spread of a parameter up to which starts have reached the same optimum."""
NEAR = 0.01
"""f up to this share above the best one: the starts over which the spread is stated."""
EQUAL = 1e-3
"""f up to this share above the best one counts as numerically identical."""
FIXED_RATIO = 0.1
"""A ratio is constant where its spread is below this share of the spread of either parameter."""

Kind = Literal["one optimum", "several optima", "valley", "nothing to compare"]


@dataclass(frozen=True)
class Uniqueness:
    """Verdict on the starts: `spread` is (largest - smallest)/best per parameter over the starts with f near the best, `largest`
    that of the worst parameter over all converged starts; `ratios` are pairs with constant ratio, with the spread of it."""

    kind: Kind
    spread: dict[str, float]
    largest: float
    ratios: dict[str, float]
    text: str


def relative_spread(x: np.ndarray, best: np.ndarray) -> np.ndarray:
    """(max - min)/|best| (n_p,) over the rows of x (n, n_p); the largest magnitude stands in where the best is zero."""
    width = x.max(axis=0) - x.min(axis=0)
    size = np.where(best != 0.0, np.abs(best), np.abs(x).max(axis=0))
    return np.divide(width, size, out=np.zeros_like(width), where=size > 0.0)


def constant_ratios(names: Sequence[str], x: np.ndarray, spread: np.ndarray) -> dict[str, float]:
    """The largest family of ratios to one parameter that stay constant over the rows of x (n, n_p) while the parameters move."""
    moving = [i for i in range(len(names)) if spread[i] > AGREE and np.all(x[:, i] > 0.0)]
    families = []
    for reference in moving:
        family = {}
        for other in moving:
            ratio = x[:, other] / x[:, reference]
            width = float((ratio.max() - ratio.min()) / ratio.mean())
            if other != reference and width <= FIXED_RATIO * min(spread[other], spread[reference]):
                family[f"{names[other]}/{names[reference]}"] = width
        families.append(family)
    return max(families, key=lambda family: (len(family), -max(family.values(), default=0.0)), default={})


def uniqueness(names: Sequence[str], x: np.ndarray, f: np.ndarray, converged: np.ndarray) -> Uniqueness:
    """Verdict from the optima x (n, n_p), their objectives f (n,) and which of the n starts converged."""
    total, count = len(f), int(converged.sum())
    if count < 2:
        text = f"{count} of {total} starts converged: nothing to compare"
        return Uniqueness("nothing to compare", {}, float("nan"), {}, text)
    x, f = x[converged], f[converged]
    best = x[int(np.argmin(f))]
    near, equal = f <= (1.0 + NEAR) * f.min(), f <= (1.0 + EQUAL) * f.min()
    spread = dict(zip(names, relative_spread(x[near], best).tolist(), strict=True))
    everywhere = relative_spread(x, best)
    largest = float(everywhere.max())
    who = f"{count} of {total} starts converge"
    if largest <= AGREE:
        text = f"one optimum: {who} and agree within {_percent(largest)} ({names[int(np.argmax(everywhere))]})"
        return Uniqueness("one optimum", spread, largest, {}, text)
    of_equal = relative_spread(x[equal], best)
    if of_equal.max() > AGREE:
        ratios = constant_ratios(names, x[equal], of_equal)
        apart = ", ".join(f"{name} by {_percent(s)}" for name, s in zip(names, of_equal, strict=True) if s > AGREE)
        fixed = f"; constant within {_percent(max(ratios.values()))}: {', '.join(ratios)}" if ratios else "; no ratio of them is constant"
        text = f"valley: {int(equal.sum())} of {total} starts reach the same f within {_percent(EQUAL)} but differ in {apart}{fixed}"
        return Uniqueness("valley", spread, largest, ratios, text)
    levels = _levels(x, f, best)
    text = f"several optima: {who}, to {len(levels)} optima with f = {', '.join(f'{level:.5g}' for level in levels)}; the lowest is taken"
    return Uniqueness("several optima", spread, largest, {}, text)


def _levels(x: np.ndarray, f: np.ndarray, best: np.ndarray) -> list[float]:
    """f of every distinct optimum, lowest first: a start opens a new one where none before it agrees with it."""
    found: list[int] = []
    for i in np.argsort(f):
        if all(relative_spread(x[[i, j]], best).max() > AGREE for j in found):
            found.append(int(i))
    return [float(f[i]) for i in found]


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"
