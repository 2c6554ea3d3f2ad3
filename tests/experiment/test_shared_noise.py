"""Noise that comparisons have in common: all innovations together are as white as the whole, and one comparison tells the next."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.experiment.shared_noise import Modes, shared
from thermofit.observe.comparison import Comparison

K, SIZES, STRENGTH = 6, (40, 30, 25), (8.0, 3.0, 0.5)


def comparison(n: int) -> Comparison:
    return Comparison("du", lambda e: e.copy(), None, np.zeros((n, 3), dtype=int), np.ones(n), np.ones(n), "mm")


def problem(seed: int = 0) -> tuple[tuple[Comparison, ...], dict[int, Modes], np.ndarray]:
    """Comparisons, what they show of the common errors (the second one of three of them, the third of one), and A (n, k)."""
    random = np.random.default_rng(seed)
    modes = {}
    for place, (n, r) in enumerate(zip(SIZES, (K, 3, 1), strict=True)):
        turned = np.linalg.qr(random.normal(size=(K, r)))[0]
        modes[place] = Modes(STRENGTH[place] * random.normal(size=(n, r)), turned)
    whole = np.concatenate([m.columns @ m.turned.T for m in modes.values()])
    return tuple(comparison(n) for n in SIZES), modes, whole


def whitened(seed: int, r: np.ndarray) -> np.ndarray:
    """Innovations (n, ...) of residuals (n, ...)."""
    comparisons, modes, _ = problem(seed)
    blurred, common = shared(comparisons, modes)
    assert common is not None
    own = [_each(c, part) for c, part in zip(blurred, np.split(r, np.cumsum(SIZES)[:-1]), strict=True)]
    return np.concatenate(common.innovations(own))


def _each(c: Comparison, part: np.ndarray) -> np.ndarray:
    return c.residual(part) if part.ndim == 1 else np.stack([c.residual(x) for x in part.T], axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_innovations_are_the_whole_whitened(seed: int) -> None:
    """W (1 + A A^T) W^T = 1 for the map W of residuals to innovations, so that r''.r'' = r.(1 + A A^T)^-1 r."""
    _, _, a = problem(seed)
    n = len(a)
    noise = np.eye(n) + a @ a.T
    w = whitened(seed, np.eye(n))
    np.testing.assert_allclose(w @ noise @ w.T, np.eye(n), atol=1e-9)
    r = np.random.default_rng(9).normal(size=n)
    np.testing.assert_allclose(w @ r, whitened(seed, r), atol=1e-12)


def test_what_one_tells_is_taken_from_the_next() -> None:
    """A common error of many sigma that the first shows clearly leaves the second with its own noise; alone, the second is blind to it."""
    comparisons, modes, a = problem()
    random = np.random.default_rng(3)
    r = random.normal(size=len(a)) + a @ (30.0 * random.normal(size=K))
    second = slice(SIZES[0], SIZES[0] + SIZES[1])
    own = whitened(0, r)[second]
    assert float(np.mean(own**2)) < 2.0
    alone, _ = shared(comparisons[1:2], {0: modes[1]})
    assert float(np.mean(alone[0].residual(r[second]) ** 2)) > 10.0


@pytest.mark.parametrize("blurs", [False, True])
def test_columns_hold_nothing_of_what_others_told(blurs: bool) -> None:
    """What a change of the error field makes of a residual is the same wherever that is counted from."""
    comparisons, modes, _ = problem()
    blurred, common = shared(comparisons, modes)
    assert common is not None
    own = (blurred if blurs else comparisons)[1]
    told = common.given(np.ones(K), {1: 0}).without(0, own)
    fields = np.random.default_rng(2).normal(size=(SIZES[1], 4))
    zero = np.zeros(SIZES[1])
    assert np.abs(told.residual(zero)).max() > 0.1, "others must have told something"
    np.testing.assert_allclose(told.columns(fields), own.columns(fields), atol=1e-12)
    np.testing.assert_allclose(told.slopes(zero, fields), own.columns(fields), atol=1e-12)


def test_places_move_with_what_stands_before() -> None:
    comparisons, modes, a = problem()
    blurred, common = shared(comparisons, modes)
    assert common is not None
    r = np.random.default_rng(5).normal(size=len(a))
    parts = [c.residual(x) for c, x in zip(blurred, np.split(r, np.cumsum(SIZES)[:-1]), strict=True)]
    before = np.ones(7)
    found = common.moved(1).innovations([before, *parts])
    assert found[0] is before
    np.testing.assert_array_equal(np.concatenate(found[1:]), np.concatenate(common.innovations(parts)))


def test_without_common_errors_nothing_changes() -> None:
    comparisons, _, _ = problem()
    assert shared(comparisons, {}) == (comparisons, None)


def test_nothing_tells_nothing_of_the_common_errors() -> None:
    """Where no motion is compared, temperatures have all of the error of the force as noise of their own."""
    comparisons, modes, _ = problem()
    _, common = shared(comparisons, modes)
    assert common is not None and np.array_equal(common.told({}), np.zeros(K))
