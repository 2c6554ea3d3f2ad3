"""Stages after fracture: the software repeats its last result (frozen), or most points are gone and halves fly apart (torn)."""

from __future__ import annotations

import numpy as np

_LEAST_SHARE = 0.5
"""A stage with fewer than this share of the largest number of points is torn, at the end of a series."""
_SUDDEN_SHARE = 0.75
"""... if it lost them at once: it has fewer than this share of the points of the stage before it."""
_JUMP = 10.0
"""A step is the fracture itself where it is this many times the median of the steps before, and frozen stages follow."""
_STEPS_BEFORE = 10


def after_fracture(displacement: np.ndarray) -> tuple[int, str]:
    """Number of stages to keep of `displacement` (n_t, n_s, 3), and why the others go ("" where none does)."""
    n = len(displacement)
    present = np.isfinite(displacement[:, :, :2]).all(axis=2).sum(axis=1)
    end = n
    while end > 1 and present[end - 1] < _LEAST_SHARE * present.max():
        end -= 1
    # Stages whose points went one by one are measured: only a sudden loss is fracture.
    end = next((k for k in range(end, n) if present[k] < _SUDDEN_SHARE * present[k - 1]), n)
    torn = n - end
    last = end
    while last > 1 and _repeats(displacement[last - 1], displacement[last - 2]):
        last -= 1
    frozen = end - last
    if frozen and last > 2 and _is_jump(displacement[:last]):
        last -= 1
    if last == n:
        return n, ""
    words = [f"{torn} hold fewer than half of the points"] if torn else []
    if frozen:
        words.append(f"{frozen} repeat the extreme values of the one before")
    if end - last > frozen:
        words.append(f"the one before these jumps by more than {_JUMP:g} times the usual step")
    return last, "after fracture, " + ", ".join(words)


def _repeats(stage: np.ndarray, before: np.ndarray) -> bool:
    """Whether all extreme values of two stages (n_s, 3) are the same; noise never leaves them so. A stage at rest (zeros) is none."""
    extremes = [_extremes(field) for field in (stage, before)]
    return bool(np.array_equal(extremes[0], extremes[1], equal_nan=True) and np.nanmax(np.abs(extremes[0])) > 0.0)


def _extremes(field: np.ndarray) -> np.ndarray:
    """Smallest and largest value of every component (2, 3), NaN for one that is not measured."""
    found = np.full((2, 3), np.nan)
    for k, column in enumerate(field.T):
        known = column[np.isfinite(column)]
        if len(known):
            found[:, k] = known.min(), known.max()
    return found


def _is_jump(displacement: np.ndarray) -> bool:
    """Whether the last step of the stages is far larger than those before it."""
    steps = []
    for before, after in zip(displacement[-_STEPS_BEFORE - 2 : -1], displacement[-_STEPS_BEFORE - 1 :], strict=True):
        apart = np.abs(after - before)[:, :2]
        known = apart[np.isfinite(apart).all(axis=1)]
        steps.append(float(known.max()) if len(known) else np.inf)
    return len(steps) > 1 and steps[-1] > _JUMP * float(np.median(steps[:-1]))
