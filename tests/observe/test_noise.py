"""Noise floor: planted noise comes back from strong smooth signals with kinks, lost points and outliers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField, InfraredSequence
from thermofit.observe import noise as module
from thermofit.observe.noise import (
    correlation_length,
    displacement_noise,
    robust_sigma,
    second_differences,
    spatial_noise,
    temperature_noise,
    temporal_noise,
)

PLANTED = np.array([0.002, 0.003, 0.005])


def times(n: int = 60) -> np.ndarray:
    """Unequal spacing: dense while loading, sparse while cooling."""
    return np.concatenate([np.linspace(0.0, 60.0, 2 * n // 3), np.linspace(63.0, 400.0, n - 2 * n // 3)])


def points(seed: int = 0) -> np.ndarray:
    x, y = np.meshgrid(np.arange(-11.0, 11.5), np.arange(-20.0, 20.5))
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    return xy + np.random.default_rng(seed).uniform(-0.25, 0.25, xy.shape)


def tension(xy: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Loading with a partial unloading and a kink at its end, strain varying along y, a moving rigid body: millimetres."""
    load = np.interp(t, [3.0, 25.0, 28.0, 31.0, 55.0, 60.0], [0.0, 0.06, 0.055, 0.06, 0.14, 0.138])[:, None]
    x, y = xy.T
    bulge = 1.0 - 1e-4 * y**2
    uy = load * (y + 8.0) * bulge + 0.3 * np.sin(0.05 * t)[:, None]
    ux = -0.45 * load * x * bulge + 0.004 * t[:, None] ** 0.5 * y
    return np.stack([ux, uy, -0.01 * load * bulge + 0.002 * t[:, None]], axis=2)


def dic_field(seed: int = 0, outliers: float = 0.01, lost: float = 0.02) -> DicField:
    rng = np.random.default_rng(seed)
    xy, t = points(seed), times()
    u = tension(xy, t)
    u += rng.normal(size=u.shape) * PLANTED
    u += np.where(rng.random((*u.shape[:2], 1)) < outliers, rng.normal(0.0, 0.5, u.shape), 0.0)
    u[rng.random(u.shape[:2]) < lost] = np.nan
    return DicField(t, np.arange(len(xy)), np.column_stack([xy, np.zeros(len(xy))]), u)


@given(st.integers(0, 2**31), st.floats(0.0, 0.1), st.floats(1e-6, 1e3))
def test_robust_sigma_of_contaminated_normal_values(seed: int, share: float, sigma: float) -> None:
    rng = np.random.default_rng(seed)
    r = rng.normal(5.0, 1.0, 20000)
    bad = rng.random(r.size) < share
    r[bad] += 30.0
    estimate, n = robust_sigma(np.append(sigma * r, np.nan))
    assert estimate == pytest.approx(sigma, rel=0.03)
    # Nine of 20000 normal values lie beyond CLIP on average; forty in none of the seeds that a search may find.
    assert n == pytest.approx((~bad).sum(), rel=0.002)


def test_robust_sigma_of_nothing() -> None:
    assert robust_sigma(np.array([np.nan, 1.0]))[1] == 0
    assert robust_sigma(np.ones(5))[0] == 0.0


@given(st.lists(st.floats(0.01, 50.0), min_size=3, max_size=30), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
def test_second_differences_vanish_on_lines_at_any_spacing(steps: list[float], slope: float, start: float) -> None:
    t = np.cumsum(steps)
    line = start + slope * t[:, None]
    np.testing.assert_allclose(second_differences(t, line), 0.0, atol=1e-11 * (1.0 + np.abs(line).max()))


def test_second_differences_keep_the_standard_deviation() -> None:
    r = second_differences(times(30), np.random.default_rng(1).normal(size=(30, 20000)))
    np.testing.assert_allclose(r.std(axis=1), 1.0, atol=0.02)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_planted_displacement_noise(seed: int) -> None:
    """All ways within 5 % under a signal a hundred times as large, 1 % outliers, 2 % lost points."""
    for noise, planted in zip(displacement_noise(dic_field(seed)), PLANTED, strict=True):
        assert noise is not None
        assert noise.sigma == noise.temporal.sigma == pytest.approx(planted, rel=0.05)
        assert noise.spatial.sigma == pytest.approx(planted, rel=0.05)
        assert 0.4 < noise.correlation_length < 0.9
        assert noise.pattern < 0.2 * planted


def test_rest_before_loading_is_used_when_there_is_enough() -> None:
    dic = dic_field()
    x, y, _ = displacement_noise(dic, load_start=8.0)
    assert x.temporal.method == "6 stages before loading without smooth part in space" and x.temporal.at_rest == 6
    quiet = dataclasses.replace(dic, displacement=dic.displacement - tension(dic.reference[:, :2], dic.time))
    _, y, _ = displacement_noise(quiet, load_start=8.0)
    assert y.sigma == pytest.approx(PLANTED[1], rel=0.05)
    _, y, _ = displacement_noise(quiet, load_start=2.0)
    assert "second differences" in y.temporal.method and y.temporal.at_rest == 2


def resting(k: int, seed: int, lost: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Positions and values (k, n_s) of unit noise at rest: a pattern of the reference image at each point, a drift of the body that turns
    and bends, and outliers."""
    rng = np.random.default_rng(seed)
    xy = points(seed)
    x, y = xy.T
    drift = np.arange(k)[:, None] ** 1.5 * (20.0 + 0.5 * y - 0.2 * x + 0.01 * y**2)
    value = 5.0 * rng.normal(size=len(xy)) + drift + rng.normal(size=(k, len(xy)))
    value += np.where(rng.random(value.shape) < 0.01, 200.0, 0.0)
    value[rng.random(value.shape) < lost] = np.nan
    return xy, value


@pytest.mark.parametrize(("k", "lost"), [(3, 0.0), (5, 0.02), (6, 0.3), (200, 0.01)])
def test_rest_that_drifts_and_bends_holds_the_planted_noise(k: int, lost: float) -> None:
    """Within four standard errors; scatter about the mean of each point alone would be ten times as large and more."""
    xy, value = resting(k, k, lost)
    after = np.linspace(0.0, 500.0, 4)[:, None] * np.ones(len(xy))
    value, t = np.concatenate([value, value[-1:] + after]), np.arange(k + 4.0)
    found = temporal_noise(t, value, np.isfinite(value), float(k - 1), xy)
    assert found.method.startswith(f"{found.at_rest} stages before loading") and found.at_rest == min(k, 60)
    # A median over fields is worth 2 / pi of their mean.
    assert found.sigma == pytest.approx(1.0, abs=4.0 * np.sqrt(np.pi / 2.0 / (2.0 * found.n * (1.0 - 1.0 / k))))


def test_reference_stage_is_no_stage_at_rest() -> None:
    """Zero everywhere: the noise of the reference is in all the others, and none of its own is in it."""
    xy, value = resting(6, 3)
    value[0], t = 0.0, np.arange(6.0)
    found = temporal_noise(t, value, np.isfinite(value), 3.0, xy)
    assert found.at_rest == 3 and found.sigma == pytest.approx(1.0, rel=0.06)
    found = temporal_noise(t, value, np.isfinite(value), 2.0, xy)
    assert found.at_rest == 2 and "second differences" in found.method


def test_few_signals_at_rest_are_left_to_differences() -> None:
    value = np.random.default_rng(9).normal(size=(400, 12)) + np.arange(400.0)[:, None]
    everywhere = np.ones(value.shape, dtype=bool)
    found = temporal_noise(np.arange(400.0), value, everywhere, 3.0)
    assert "second differences" in found.method and found.at_rest == 0 and found.sigma == pytest.approx(1.0, rel=0.05)
    many = np.random.default_rng(9).normal(size=(10, 400)) + np.arange(10.0)[:, None]
    found = temporal_noise(np.arange(10.0), many, np.ones(many.shape, dtype=bool), 3.0)
    assert found.at_rest == 4 and found.sigma == pytest.approx(1.0, rel=0.06)


def test_two_dimensional_correlation_has_no_z_noise() -> None:
    dic = dic_field()
    dic.displacement[:, :, 2] = np.nan
    x, _, z = displacement_noise(dic)
    assert z is None and x.sigma == pytest.approx(PLANTED[0], rel=0.05)


def test_temporal_noise_of_few_signals() -> None:
    """Four thermocouples: pooled, the smooth part of a cooling curve is no noise."""
    t = np.linspace(0.0, 400.0, 2000)
    value = 5.0 * np.exp(-t / 90.0)[:, None] * np.arange(1.0, 5.0) + np.random.default_rng(3).normal(0.0, 0.05, (2000, 4))
    mask = np.random.default_rng(4).random(value.shape) > 0.1
    assert temporal_noise(t, value, mask).sigma == pytest.approx(0.05, rel=0.08)


def test_spatial_noise_of_one_stage_and_its_number() -> None:
    xy = points()
    value = 3.0 + 0.4 * xy[:, :1].T - 2.0 * xy[:, 1:].T + np.random.default_rng(5).normal(0.0, 0.1, (1, len(xy)))
    everywhere = np.ones(value.shape, dtype=bool)
    estimate = spatial_noise(xy, value, everywhere)
    assert estimate.sigma == pytest.approx(0.1, rel=0.05)
    assert 0.97 * len(xy) < estimate.n <= len(xy)
    everywhere[0, 400] = False
    assert estimate.n - 20 < spatial_noise(xy, value, everywhere).n < estimate.n


def smooth_noise(shape: tuple[int, int, int], width: float, seed: int) -> np.ndarray:
    white = np.random.default_rng(seed).normal(size=shape)
    field = gaussian_filter(white, (0.0, width, width), mode="wrap")
    return np.asarray(field / field.std())


@pytest.mark.parametrize("width", [1.0, 1.5])
def test_correlation_length_of_filtered_noise(width: float) -> None:
    """White noise behind a Gaussian filter of standard deviation w has the autocorrelation exp(-r^2 / (4 w^2)): 1/e at r = 2 w."""
    noise = smooth_noise((20, 50, 50), width, 6)
    xy = np.argwhere(np.ones((50, 50))).astype(float)
    assert correlation_length(xy, noise.reshape(20, -1)) == pytest.approx(2.0 * width, rel=0.1)


def test_correlation_length_of_a_crowd_looks_at_some_of_its_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the points crowd in one place, all of them within six spacings of one another: without a limit 10^6 pairs, here 10^4."""
    xy = np.argwhere(np.ones((40, 40))).astype(float)
    crowd = 20.0 + 0.5 * np.random.default_rng(3).uniform(size=(1500, 2))
    fields = np.random.default_rng(4).normal(size=(4, len(xy) + len(crowd)))
    seen: list[int] = []
    monkeypatch.setattr(module, "MOST_PAIRS", 100_000)
    pairs_of = cKDTree.query_pairs

    class Counted(cKDTree):
        def query_pairs(self, *arguments: object, **options: object) -> np.ndarray:
            found = pairs_of(self, *arguments, **options)
            seen.append(len(found))
            return np.asarray(found)

    monkeypatch.setattr(module, "cKDTree", Counted)
    assert correlation_length(np.concatenate([xy, crowd]), fields) < 1.0, "white noise"
    assert 1_000 < seen[-1] <= 100_000


def heated_frames(pattern: float, n: int = 40) -> tuple[InfraredSequence, np.ndarray]:
    """Specimen on a cooler background, moving by 20 px, heated by 5 K and cooling; 24 mK noise and a fixed pattern."""
    rng = np.random.default_rng(8)
    t = times(n)
    row, col = np.meshgrid(np.arange(100.0), np.arange(70.0), indexing="ij")
    moved = np.interp(t, [3.0, 55.0], [0.0, 20.0])[:, None, None]
    heat = 5.0 * np.interp(t, [3.0, 25.0, 26.0, 55.0, 400.0], [0.0, 0.4, 0.38, 1.0, 0.1])[:, None, None]
    on = np.abs(col - 35.0) < 25.0
    specimen = 297.0 + heat * (1.0 - ((row - 50.0 + moved) / 90.0) ** 2)
    frames = np.where(on, specimen, 296.0) + pattern * rng.normal(size=(100, 70)) + 0.024 * rng.normal(size=(n, 100, 70))
    return InfraredSequence(t, frames.astype(np.float32)), np.abs(col - 35.0) < 22.0


@pytest.mark.parametrize("pattern", [0.0, 0.015])
def test_planted_temperature_noise_and_fixed_pattern(pattern: float) -> None:
    infrared, pixels = heated_frames(pattern)
    noise = temperature_noise(infrared, pixels)
    assert noise.temporal.sigma == pytest.approx(0.024, rel=0.05)
    assert noise.sigma == pytest.approx(np.hypot(0.024, pattern), rel=0.05)
    assert noise.spatial.sigma == pytest.approx(np.hypot(0.024, pattern), rel=0.05)
    assert noise.pattern == pytest.approx(pattern, abs=0.002)
    assert noise.correlation_length < 1.0


def test_rest_under_a_lamp_holds_the_planted_noise() -> None:
    """Half a kelvin between the frames of the rest, most of it in a broad spot."""
    infrared, pixels = heated_frames(0.015)
    row, col = np.meshgrid(np.arange(100.0), np.arange(70.0), indexing="ij")
    spot = np.exp(-0.5 * ((row - 40.0) ** 2 + (col - 30.0) ** 2) / 45.0**2)
    lit = dataclasses.replace(infrared, frames=infrared.frames + (0.4 * infrared.time[:, None, None] * spot).astype(np.float32))
    noise = temperature_noise(lit, pixels, load_start=5.0)
    assert noise.temporal.at_rest >= 3 and "before loading" in noise.temporal.method
    assert noise.temporal.sigma == pytest.approx(0.024, rel=0.05) and noise.sigma == pytest.approx(np.hypot(0.024, 0.015), rel=0.05)


def test_all_pixels_with_background_and_edges() -> None:
    infrared, _ = heated_frames(0.0)
    assert temperature_noise(infrared).temporal.sigma == pytest.approx(0.024, rel=0.05)


def test_noise_free_field_has_no_noise() -> None:
    dic = dic_field()
    rest = dataclasses.replace(dic, displacement=np.zeros_like(dic.displacement))
    for noise in displacement_noise(rest):
        assert noise is not None
        assert (noise.sigma, noise.spatial.sigma, noise.pattern, noise.correlation_length) == (0.0, 0.0, 0.0, 0.0)


def test_too_little_data_is_said() -> None:
    dic = dic_field()
    with pytest.raises(DataError, match="2 stages"):
        displacement_noise(dataclasses.replace(dic, time=dic.time[:2], displacement=dic.displacement[:2]))
    with pytest.raises(DataError, match="9 points"):
        spatial_noise(points()[:9], np.zeros((1, 9)), np.ones((1, 9), dtype=bool))
    with pytest.raises(DataError, match="no value is measured"):
        temporal_noise(np.arange(5.0), np.zeros((5, 40)), np.zeros((5, 40), dtype=bool))
    with pytest.raises(DataError, match="no pixel"):
        temperature_noise(heated_frames(0.0)[0], np.zeros((100, 70), dtype=bool))


def test_no_stage_at_rest_and_points_measured_once_each() -> None:
    xy, value = resting(6, 4)
    t = np.arange(6.0)
    assert temporal_noise(t, value, np.isfinite(value), -1.0, xy).at_rest == 0
    assert temporal_noise(t, value, np.isfinite(value), 0.0, xy).at_rest == 1
    value[:3][np.arange(3)[:, None] != np.arange(len(xy)) % 3] = np.nan
    found = temporal_noise(t, value, np.isfinite(value), 2.0, xy)
    assert found.at_rest == 0 and found.sigma == pytest.approx(1.0, rel=0.1)
