"""Noise that neighbouring samples of a coupon share is neither an effect nor structure, and does not leak into held-out blocks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from thermofit.diagnose.held_out import Rows, split_by_blocks
from thermofit.diagnose.trace import neighbours_of, noise_of
from thermofit.diagnose.unlisted_structure import structures

N, RHO = 1600, 0.7


def alike(seed: int, rho: float = RHO) -> np.ndarray:
    """Noise (N,) of unit variance whose neighbours have this correlation."""
    drawn = np.random.default_rng(seed).normal(size=N)
    drawn[1:] *= np.sqrt(1.0 - rho**2)
    return np.asarray(lfilter([1.0], [1.0, -rho], drawn))


def comparison(channel: str) -> Any:
    """Two records of half of the samples each."""
    place = np.repeat([0, 1], N // 2)
    return SimpleNamespace(channel=channel, n=N, noise=None, rows=np.stack([np.arange(N), np.zeros(N, dtype=int), place], axis=1))


def case(coupon: bool = True) -> Any:
    """Stress and temperature of two records, and one prior."""
    model = SimpleNamespace(comparisons=(comparison("stress"), comparison("dtheta")), segments=(N // 2,) * 4 + (1,) if coupon else None)
    return SimpleNamespace(model=model, channels=("stress", "dtheta"))


def test_correlation_is_told_of_each_channel_from_all_its_records() -> None:
    here = case()
    residual = np.concatenate([alike(1), np.random.default_rng(2).normal(size=N), [0.3]])
    found = neighbours_of(here, residual)
    assert len(found) == 5 and found[0] == found[1] and found[2] == found[3]
    assert found[0].rho == pytest.approx(RHO, abs=0.12) and found[2].rho == 0.0 and found[4].rho == 0.0
    apply = noise_of(here, found)
    assert apply is not None
    matrix = apply(np.eye(2 * N + 1))
    assert matrix[0, 1] == pytest.approx(found[0].rho) and matrix[N // 2 - 1, N // 2] == 0.0
    assert np.array_equal(matrix[N:, N:], np.eye(N + 1))


def test_white_noise_and_bodies_need_none() -> None:
    white = np.random.default_rng(3).normal(size=2 * N + 1)
    assert noise_of(case(), neighbours_of(case(), white)) is None
    assert neighbours_of(case(coupon=False), white) == () and noise_of(case(coupon=False), ()) is None


def test_no_sample_is_seen_whose_noise_is_that_of_a_held_out_one() -> None:
    """Up to half of a block of 16 samples."""
    n = 401
    rows = Rows(np.zeros(n, dtype=int), np.arange(float(n)), np.zeros((n, 2)), np.zeros(n, dtype=int))
    for memory, reach in ((0.0, 4.0), (6.0, 6.0), (60.0, 8.0)):
        split = split_by_blocks(rows, (25, 1), (4.0, 0.0), clock="samples", memory=memory)
        assert f"buffers {reach:.3g} samples" in split.by


def test_noise_alike_is_no_structure() -> None:
    """With the differences of neighbours alone it would stand out in every draw."""
    here = case()
    rows = Rows(np.repeat([0, 1], N), np.tile(np.arange(float(N)), 2), np.zeros((2 * N, 2)), np.zeros(2 * N, dtype=int))
    out = [structures(here, rows, np.concatenate([alike(seed), alike(seed + 100)]), None) for seed in range(20)]
    assert sum(s.stands_out for found in out for s in found) <= 2
    misfit = 2.0 * np.sin(np.linspace(0.0, 6.0, N))
    found = structures(here, rows, np.concatenate([alike(1) + misfit, alike(2)]), None)
    assert found[0].stands_out and not found[1].stands_out
