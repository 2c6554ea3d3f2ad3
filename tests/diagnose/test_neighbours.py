"""Noise that samples which follow each other share is neither an effect nor structure, and does not leak into held-out blocks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from thermofit.diagnose.held_out import Rows, split_by_blocks
from thermofit.diagnose.remembered import noise_of, remembered
from thermofit.diagnose.trace import split_of
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


def case() -> Any:
    """Stress and temperature of two records, and one prior."""
    model = SimpleNamespace(comparisons=(comparison("stress"), comparison("dtheta")), segments=(N // 2,) * 4 + (1,))
    return SimpleNamespace(model=model, channels=("stress", "dtheta"), cheap=True)


ROWS = Rows(np.repeat([0, 1], N), np.tile(np.arange(float(N)), 2), np.zeros((2 * N, 2)), np.zeros(2 * N, dtype=int))
POINTS, FRAMES = 60, 80


def body(noise: Any = None) -> tuple[Any, Rows]:
    """Displacements and temperatures of points in frames 2 s apart, and a prior; `noise`: what the comparison of the second knows."""
    time, point, component = (v.ravel() for v in np.meshgrid(np.arange(FRAMES), np.arange(POINTS), [0, 1], indexing="ij"))
    first = np.stack([time, point, component], axis=1)
    second = first[component == 0]
    xy = np.random.default_rng(4).uniform(-1.0, 1.0, size=(POINTS, 2)) * [8.0, 30.0]
    made = [SimpleNamespace(channel=c, n=len(r), noise=n, rows=r) for c, r, n in (("du", first, None), ("dtheta", second, noise))]
    where = np.concatenate([first, second])
    n = len(where)
    rows = Rows(
        np.append(np.repeat([0, 1], [len(first), len(second)]), -1),
        np.append(2.0 * where[:, 0], 0.0),
        np.append(xy[where[:, 1]], [[0.0, 0.0]], axis=0),
        np.append(np.zeros(n, dtype=int), -1),
    )
    model = SimpleNamespace(comparisons=tuple(made), segments=None, noise=lambda v: 2.0 * v)
    spans = (SimpleNamespace(record="", experiment="", name="all"),)
    return SimpleNamespace(model=model, channels=("du", "dtheta"), cheap=False, correlation_length=0.0, spans=spans), rows


def seen(seed: int, rho: tuple[float, float]) -> np.ndarray:
    """Noise of the body, and a prior."""
    parts = []
    for k, (n, one) in enumerate(zip((2 * POINTS, POINTS), rho, strict=True)):
        drawn = np.random.default_rng([seed, k]).normal(size=(FRAMES, n))
        drawn[1:] *= np.sqrt(1.0 - one**2)
        parts.append(lfilter([1.0], [1.0, -one], drawn, axis=0).ravel())
    return np.concatenate([*parts, [0.3]])


def test_correlation_is_told_of_each_channel_from_all_its_records() -> None:
    here = case()
    residual = np.concatenate([alike(1), np.random.default_rng(2).normal(size=N), [0.3]])
    found = remembered(here, ROWS, residual)
    assert found.of_channel[0].rho == pytest.approx(RHO, abs=0.12) and found.of_channel[1].rho == 0.0
    assert found.rho.tolist() == [found.of_channel[0].rho] * 2 + [0.0] * 3
    assert found.lag(here, ROWS) == found.of_channel[0].lag(0.1)
    apply = noise_of(here, found)
    assert apply is not None
    matrix = apply(np.eye(2 * N + 1))
    assert matrix[0, 1] == pytest.approx(found.of_channel[0].rho) and matrix[N // 2 - 1, N // 2] == 0.0
    assert np.array_equal(matrix[N:, N:], np.eye(N + 1))


def test_white_noise_needs_none() -> None:
    white = np.random.default_rng(3).normal(size=2 * N + 1)
    assert noise_of(case(), remembered(case(), ROWS, white)) is None
    here, rows = body()
    found = remembered(here, rows, 0.9 * seen(0, (0.0, 0.0)))
    assert noise_of(here, found) is None and found.lag(here, rows) == 0.0


def test_frames_of_a_body_remember() -> None:
    """Beside a misfit that is smooth in place and fast in time; what the comparison of the reference knows comes on top."""
    here, rows = body()
    y, t = rows.xy[:, 1], rows.time
    misfit = 3.0 * np.sin(2.0 * t) * (y / 30.0) ** 2 + 4.0 * (t > 60.0) * y / 30.0
    found = remembered(here, rows, seen(1, (RHO, 0.0)) + misfit)
    assert found.of_channel[0].rho == pytest.approx(RHO, abs=0.05) and found.of_channel[1].rho == 0.0
    assert found.lag(here, rows) == pytest.approx(2.0 * found.of_channel[0].lag(0.1))
    apply = noise_of(here, found)
    assert apply is not None
    one = np.zeros((len(rows.time), 1))
    one[2 * POINTS * 10] = 1.0
    spread = apply(one)[:, 0]
    assert spread[2 * POINTS * 11] == pytest.approx(found.of_channel[0].rho) and spread[2 * POINTS * 10 + 1] == 0.0
    known, _ = body(noise=lambda v: v)
    apply = noise_of(known, found)
    assert apply is not None
    spread = apply(one)[:, 0]
    assert spread[2 * POINTS * 10] == pytest.approx(2.0) and spread[2 * POINTS * 11] == pytest.approx(found.of_channel[0].rho)


def test_noise_that_is_declared_too_small() -> None:
    """Temperatures scatter twice as much as declared: four times the covariance. Displacements scatter half as much, which is no gain."""
    here, rows = body()
    residual = seen(2, (0.0, 0.0)) * np.where(rows.channel == 1, 2.0, np.where(rows.channel == 0, 0.5, 1.0))
    found = remembered(here, rows, residual)
    apply = noise_of(here, found)
    assert apply is not None
    spread = apply(np.ones((len(residual), 1)))[:, 0]
    assert spread[rows.channel == 1] == pytest.approx(4.0, rel=0.1) and np.all(spread[rows.channel != 1] == 1.0)


def test_blocks_of_a_body_are_longer_than_its_memory() -> None:
    """A block of frames is held out with a buffer of half of it at most."""
    here, rows = body()
    fitted = np.stack([rows.time, np.ones(len(rows.time))], axis=1)
    for memory, count, reach in ((0.0, 25, 1.58), (10.0, 7, 10.0), (40.0, 5, 15.8)):
        assert f"{count} x 5 blocks" in (by := split_of(here, rows, fitted, "blocks", memory).by) and f"buffers {reach:.3g} s" in by


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
    out = [structures(here, ROWS, np.concatenate([alike(seed), alike(seed + 100)]), None) for seed in range(20)]
    assert sum(s.stands_out for found in out for s in found) <= 2
    misfit = 2.0 * np.sin(np.linspace(0.0, 6.0, N))
    found = structures(here, ROWS, np.concatenate([alike(1) + misfit, alike(2)]), None)
    assert found[0].stands_out and not found[1].stands_out


def test_noise_alike_of_frames_is_no_structure() -> None:
    here, rows = body()
    out = [structures(here, rows, seen(seed, (RHO, RHO)), None) for seed in range(20)]
    assert sum(s.stands_out for found in out for s in found) <= 2
    misfit = np.where(rows.channel == 1, np.sin(rows.time / 20.0) * np.cos(rows.xy[:, 1] / 10.0), 0.0)
    found = structures(here, rows, seen(1, (RHO, RHO)) + misfit, None)
    assert found[1].stands_out and not found[0].stands_out
