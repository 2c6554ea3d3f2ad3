"""Block bootstrap: the scatter of a linear model, of blocks with memory, within bounds, and too few blocks."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.core.errors import UntrustworthyError
from thermofit.fit.bootstrap import (
    Blocks,
    block_weights,
    drawn_residual,
    effective_blocks,
    linearised_repeats,
    percentile_interval,
)
from thermofit.fit.linear_model import LinearModel

N, REPEATS = 400, 2000
X = np.linspace(-1.0, 1.0, N)
JACOBIAN = np.stack([np.ones(N), X, 2e3 * X**2], axis=1)


def residual(memory: int) -> np.ndarray:
    """Noise whose values are alike over `memory` entries, orthogonal to the columns as that of a fit is."""
    rng = np.random.default_rng(1)
    r = np.repeat(rng.normal(size=N // memory), memory)
    return np.asarray(r - JACOBIAN @ np.linalg.lstsq(JACOBIAN, r, rcond=None)[0])


def blocks(length: int) -> Blocks:
    return Blocks(np.arange(N) // length, N // length, f"{N // length} blocks")


def test_white_noise_gives_the_standard_errors() -> None:
    r = residual(1)
    moves = linearised_repeats(LinearModel(r, JACOBIAN), blocks(1), seed=1, count=REPEATS)
    sigma = np.sqrt(np.diag(np.linalg.inv(JACOBIAN.T @ JACOBIAN)) * (r @ r) / (N - 3))
    assert moves.std(axis=0) == pytest.approx(sigma, rel=0.12)
    assert np.all(np.abs(moves.mean(axis=0)) < 4.0 * sigma / np.sqrt(REPEATS))


def test_blocks_keep_the_memory_of_the_noise() -> None:
    """Values alike over ten entries count once: errors are sqrt(10) times those of single entries."""
    r = residual(10)
    single = linearised_repeats(LinearModel(r, JACOBIAN), blocks(1), seed=1, count=REPEATS).std(axis=0)
    whole = linearised_repeats(LinearModel(r, JACOBIAN), blocks(10), seed=1, count=REPEATS).std(axis=0)
    assert whole[0] / single[0] == pytest.approx(np.sqrt(10.0), rel=0.25)


def test_linearised_repeat_is_the_fit_to_the_drawn_residual() -> None:
    r, b = residual(10), blocks(20)
    moves = linearised_repeats(LinearModel(r, JACOBIAN), b, seed=7, count=5)
    for k in range(5):
        drawn = drawn_residual(LinearModel(r, JACOBIAN).outside(b.label), b, 7, k)
        assert moves[k] == pytest.approx(-np.linalg.lstsq(JACOBIAN, drawn, rcond=None)[0], rel=1e-8, abs=1e-14)


def test_residual_of_a_block_against_the_others() -> None:
    """It is that of a fit from which the block was left out."""
    r, b = residual(10), blocks(100)
    found = LinearModel(r, JACOBIAN).outside(b.label)
    for k in range(b.count):
        out = b.label == k
        x = np.linalg.lstsq(JACOBIAN[~out], r[~out], rcond=None)[0]
        assert found[out] == pytest.approx(r[out] - JACOBIAN[out] @ x, abs=1e-9)


def test_repeats_stay_within_bounds() -> None:
    r = residual(1)
    room = (np.array([0.0, -np.inf, -np.inf]), np.full(3, np.inf))
    free = linearised_repeats(LinearModel(r, JACOBIAN), blocks(1), seed=1, count=200)
    held = linearised_repeats(LinearModel(r, JACOBIAN, bounds=room), blocks(1), seed=1, count=200)
    assert held[:, 0].min() == 0.0 and (held[:, 0] == 0.0).mean() > 0.3
    inside = free[:, 0] > 0.0
    assert held[inside] == pytest.approx(free[inside])


def test_weights_and_too_few_blocks() -> None:
    few = Blocks(np.arange(N) // 50, 8, "8 blocks")
    w = np.concatenate([block_weights(few, 1, k) for k in range(2000)])
    assert w.mean() == pytest.approx(0.0, abs=0.03) and w.var() == pytest.approx(1.0, rel=0.03)
    assert len(np.unique(np.round(np.abs(w), 6))) == 3
    with pytest.raises(UntrustworthyError, match=r"4 blocks .*at least 5"):
        linearised_repeats(LinearModel(residual(1), JACOBIAN), Blocks(np.arange(N) // 100, 4, "4 blocks"), seed=1, count=10)


def test_percentiles() -> None:
    assert percentile_interval(np.linspace(0.0, 1.0, 1001)) == pytest.approx((0.025, 0.975))


def test_number_of_blocks_that_a_parameter_rests_on() -> None:
    """A mean rests on all blocks alike, a column that lives in one block on that alone."""
    jacobian = np.stack([np.ones(N), (np.arange(N) < 20) * 1e-6], axis=1)
    found = effective_blocks(jacobian, blocks(20))
    assert found[0] == pytest.approx(19.0, rel=0.01) and found[1] < 1.2
