"""Is the optimum unique? What several starts of one identification say about it (thesis 2.8.4, remarks to Tables 5.6, 5.10, 5.19)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
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

Kind = Literal["unique", "several optima", "valley", "nothing to compare"]


@dataclass(frozen=True)
class Ratio:
    """A ratio of two parameters along a valley: its mean over the starts, and (largest - smallest)/mean."""

    value: float
    spread: float


@dataclass(frozen=True)
class Uniqueness:
    """Verdict on the starts: `spread` is (largest - smallest)/best per parameter over the starts with f near the best, `largest`
    that of the worst parameter over all converged starts; `ratios` are pairs with constant ratio; `relation` is the linearised relation
    along a valley, d ln p per d ln of the parameter that moves most; `groups` gives every start its optimum, from 1, the best, on
    (0: it did not converge)."""

    kind: Kind
    spread: dict[str, float]
    largest: float
    text: str
    groups: tuple[int, ...]
    ratios: dict[str, Ratio] = field(default_factory=dict)
    relation: dict[str, float] = field(default_factory=dict)


def relative_spread(x: np.ndarray, best: np.ndarray) -> np.ndarray:
    """(max - min)/|best| (n_p,) over the rows of x (n, n_p); the largest magnitude stands in where the best is zero."""
    width = x.max(axis=0) - x.min(axis=0)
    size = np.where(best != 0.0, np.abs(best), np.abs(x).max(axis=0))
    return np.divide(width, size, out=np.zeros_like(width), where=size > 0.0)


def constant_ratios(names: Sequence[str], x: np.ndarray, spread: np.ndarray) -> dict[str, Ratio]:
    """The largest family of ratios to one parameter that stay constant over the rows of x (n, n_p) while the parameters move.

    Of families of one size that to beta is taken where there is one, as the thesis has it (Table 5.10), else the most constant one.
    """
    moving = [i for i in range(len(names)) if spread[i] > AGREE and np.all(x[:, i] > 0.0)]
    families = []
    for reference in moving:
        family = {}
        for other in moving:
            ratio = x[:, other] / x[:, reference]
            width = float((ratio.max() - ratio.min()) / ratio.mean())
            if other != reference and width <= FIXED_RATIO * min(spread[other], spread[reference]):
                family[f"{names[other]}/{names[reference]}"] = Ratio(float(ratio.mean()), width)
        families.append((len(family), names[reference] == "beta", -max((r.spread for r in family.values()), default=0.0), family))
    return max(families, key=lambda known: known[:3])[3] if families else {}


def relation_along(names: Sequence[str], x: np.ndarray) -> dict[str, float]:
    """d ln p_i / d ln p_k along the line that fits the rows of x (n, n_p) best, p_k the parameter that moves most along it.

    Where a parameter is not positive everywhere, all relations are of p over its mean magnitude instead of its logarithm.
    """
    size = np.abs(x).mean(axis=0)
    y = np.log(x) if np.all(x > 0.0) else x / np.where(size > 0.0, size, 1.0)
    direction = np.linalg.svd(y - y.mean(axis=0))[2][0]
    return dict(zip(names, (direction / direction[np.argmax(np.abs(direction))]).tolist(), strict=True))


def uniqueness(
    names: Sequence[str], x: np.ndarray, f: np.ndarray, converged: np.ndarray, curvature: np.ndarray | None = None
) -> Uniqueness:
    """Verdict from the optima x (n, n_p), their objectives f (n,), which of the n starts converged, and J^T J (n, n_p, n_p) at them.

    Equal f at different optima is a valley where, by the curvature, f stays low on the way from each to the next one; without curvature
    it is taken for one.
    """
    total, count = len(f), int(converged.sum())
    if count < 2:
        text = f"{count} of {total} starts converged: nothing to compare"
        return Uniqueness("nothing to compare", {}, float("nan"), text, tuple(int(c) for c in converged))
    x, f = x[converged], f[converged]
    best = x[int(np.argmin(f))]
    near, equal = f <= (1.0 + NEAR) * f.min(), f <= (1.0 + EQUAL) * f.min()
    spread = dict(zip(names, relative_spread(x[near], best).tolist(), strict=True))
    everywhere = relative_spread(x, best)
    largest, who = float(everywhere.max()), f"{count} of {total} starts converge"
    levels = _levels(x, f, best)
    of_start = np.zeros(total, dtype=int)
    of_start[converged] = levels
    groups = tuple(of_start.tolist())
    if largest <= AGREE:
        text = f"unique: one optimum, {who} and agree within {_percent(largest)} ({names[int(np.argmax(everywhere))]})"
        return Uniqueness("unique", spread, largest, text, tuple(int(g > 0) for g in groups))
    of_equal = relative_spread(x[equal], best)
    if of_equal.max() > AGREE and _connected(x[equal], f[equal], None if curvature is None else curvature[converged][equal]):
        ratios, relation = constant_ratios(names, x[equal], of_equal), relation_along(names, x[equal])
        apart = ", ".join(f"{name} by {_percent(s)}" for name, s in zip(names, of_equal, strict=True) if s > AGREE)
        text = (
            f"valley: {int(equal.sum())} of {total} starts reach the same f within {_percent(EQUAL)} but differ in {apart}"
            f"{_ratio_text(ratios)}{_relation_text(relation)}"
        )
        return Uniqueness("valley", spread, largest, text, groups, ratios, relation)
    lows = [float(f[levels == level].min()) for level in range(1, levels.max() + 1)]
    taken = "the lowest is taken" if lows[-1] > (1.0 + EQUAL) * lows[0] or len(lows) < 2 else "several are as good as the lowest"
    text = f"several optima: {who}, to {len(lows)} optima with f = {', '.join(f'{low:.5g}' for low in lows)}; {taken}"
    return Uniqueness("several optima", spread, largest, text, groups)


def _levels(x: np.ndarray, f: np.ndarray, best: np.ndarray) -> np.ndarray:
    """Number (n,) of the optimum of every start, from 1, the lowest, on: a start opens a new one where none before it agrees with it."""
    found: list[int] = []
    number = np.zeros(len(f), dtype=int)
    for i in np.argsort(f, kind="stable"):
        same = [k for k, j in enumerate(found, start=1) if relative_spread(x[[i, j]], best).max() <= AGREE]
        if not same:
            found.append(int(i))
        number[i] = same[0] if same else len(found)
    return number


def _connected(x: np.ndarray, f: np.ndarray, curvature: np.ndarray | None) -> bool:
    """True where f stays near the lowest on a chain of straight ways (in logarithms) through all optima x (n, n_p).

    f at the middle of a way is f at its end and the quadratic form of the curvature there, by the better of both ends.
    """
    if curvature is None or not np.isfinite(curvature).all():
        return True
    logarithmic = bool(np.all(x > 0.0))
    y, slope = (np.log(x), x) if logarithmic else (x, np.ones_like(x))
    scaled = curvature * slope[:, :, None] * slope[:, None, :]
    reached, left = [0], set(range(1, len(x)))
    while left:
        rise, nearest = min((_rise(y, f, scaled, (i, j)), j) for i in reached for j in left)
        if rise > NEAR * f.min():
            return False
        reached.append(nearest)
        left.remove(nearest)
    return True


def _rise(y: np.ndarray, f: np.ndarray, curvature: np.ndarray, ends: tuple[int, int]) -> float:
    """How far f in the middle between two optima lies above the lowest f."""
    half = 0.5 * (y[ends[1]] - y[ends[0]])
    return float(min(f[k] + half @ curvature[k] @ half for k in ends) - f.min())


def _ratio_text(ratios: dict[str, Ratio]) -> str:
    if not ratios:
        return "; no ratio of them is constant"
    listed = ", ".join(f"{name} = {ratio.value:.4g}" for name, ratio in ratios.items())
    return f"; constant within {_percent(max(r.spread for r in ratios.values()))}: {listed}"


def _relation_text(relation: dict[str, float]) -> str:
    """The linearised relation in words: what goes with 1 % of the parameter that moves most."""
    leader = max(relation, key=lambda name: abs(relation[name]))
    others = ", ".join(f"{name} {share:+.3g} %" for name, share in relation.items() if name != leader)
    return f"; along it {leader} +1 % goes with {others}" if others else ""


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"
