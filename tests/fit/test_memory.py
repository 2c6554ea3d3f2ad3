"""Correlated residuals: what they are worth, and the standard errors that follow."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.fit.linear_model import LinearModel
from thermofit.fit.memory import (
    NeighbourNoise,
    autoregressive,
    differences,
    memories,
    neighbours,
    noise_operator,
    rough_in_place,
    tapered_correlation,
)


def remembering(n: int, rho: float, rng: np.random.Generator) -> np.ndarray:
    """A stationary first-order autoregression of unit variance."""
    out = np.empty(n)
    out[0] = rng.normal()
    for k in range(1, n):
        out[k] = rho * out[k - 1] + np.sqrt(1.0 - rho**2) * rng.normal()
    return out


def test_white_noise_is_worth_its_number() -> None:
    (found,) = memories(np.random.default_rng(1).normal(size=4000), [4000])
    assert found.independent == pytest.approx(4000.0, rel=0.1)
    assert found.independent <= found.n


@pytest.mark.parametrize("rho", [0.6, 0.95])
def test_autoregression_is_worth_its_correlation_time(rho: float) -> None:
    """n (1 - rho)/(1 + rho), the textbook value."""
    (found,) = memories(remembering(40000, rho, np.random.default_rng(2)), [40000])
    assert found.independent == pytest.approx(40000.0 * (1.0 - rho) / (1.0 + rho), rel=0.25)


def test_operator_is_the_banded_matrix_of_every_segment() -> None:
    """Two segments of different size: block diagonal, symmetric, positive, with the mean square of each segment on its diagonal."""
    rng = np.random.default_rng(3)
    residual = np.concatenate([remembering(60, 0.8, rng), 5.0 * remembering(41, 0.5, rng)])
    apply = noise_operator(memories(residual, [60, 41]))
    matrix = apply(np.eye(101))
    assert matrix == pytest.approx(matrix.T, abs=1e-12)
    assert np.abs(matrix[:60, 60:]).max() == 0.0
    assert np.linalg.eigvalsh(matrix).min() > -1e-9
    squares = [np.mean(part**2) / np.mean(residual**2) for part in (residual[:60], residual[60:])]
    assert np.diag(matrix) == pytest.approx(np.repeat(squares, [60, 41]), rel=1e-9)
    rho = tapered_correlation(residual[:60])
    assert matrix[10, 10 + np.arange(len(rho))][:5] == pytest.approx(squares[0] * rho[:5], rel=1e-9)


def test_standard_errors_of_a_mean_under_memory() -> None:
    """The scatter of the mean of 200 records is what the sandwich says, five times the naive value."""
    rng, n, rho = np.random.default_rng(4), 3000, 0.92
    means, said = [], []
    for _ in range(200):
        residual = remembering(n, rho, rng)
        means.append(residual.mean())
        left = residual - residual.mean()
        found = LinearModel(left, np.ones((n, 1)), noise_operator(memories(left, [n]))).covariance(("mean",))
        said.append(found.sigma[0])
    assert np.median(said) == pytest.approx(np.std(means), rel=0.2)
    assert np.std(means) > 4.0 / np.sqrt(n)


def test_segments_must_add_up() -> None:
    with pytest.raises(ValueError, match="segments of 3 values for a residual of 4"):
        memories(np.ones(4), [1, 2])


def test_taper_keeps_the_covariance_positive() -> None:
    """A misfit that swings: its correlation cut off without a taper would have negative eigenvalues."""
    residual = np.cos(np.linspace(0.0, 9.0, 60))
    matrix = noise_operator(memories(residual, [60]))(np.eye(60))
    assert np.linalg.eigvalsh(matrix).min() > -1e-9
    assert len(tapered_correlation(residual)) > 10


@pytest.mark.parametrize("rho", [0.0, 0.3, 0.6, 0.75])
def test_neighbours_tell_noise_from_a_misfit(rho: float) -> None:
    """Variance 4 and correlation of the noise, beside a smooth misfit three times as large; its square sums are those of noise alone."""
    n = 20000
    noise = 2.0 * remembering(n, rho, np.random.default_rng(5))
    misfit = 6.0 * np.sin(np.linspace(0.0, 40.0, n))
    found = neighbours(noise + misfit, np.zeros(n, dtype=int), np.arange(n))
    assert found.rho == pytest.approx(rho, abs=0.03)
    assert found.of_sums == pytest.approx(4.0 * (1.0 + rho) / (1.0 - rho), rel=0.15)


def test_noise_is_no_more_than_the_whole_residual() -> None:
    """Of 300 samples differences tell little of what changes slowly; the mean square bounds it. Without: 39 times the variance."""
    rng = np.random.default_rng(6)
    found = [neighbours(remembering(300, 0.75, rng), np.zeros(300, dtype=int), np.arange(300)) for _ in range(200)]
    assert np.quantile([f.rho for f in found], 0.95) < 0.85 and np.median([f.of_sums for f in found]) > 4.0


def test_white_noise_stays_white() -> None:
    rng = np.random.default_rng(7)
    found = [neighbours(rng.normal(size=300), np.zeros(300, dtype=int), np.arange(300)) for _ in range(200)]
    assert np.mean([f.rho == 0.0 for f in found]) > 0.85 and np.mean([f.of_sums for f in found]) == pytest.approx(1.0, abs=0.15)
    assert neighbours(np.ones(3), np.zeros(3, dtype=int), np.arange(3)).of_sums == 1.0


def test_curvature_of_a_misfit_is_no_memory() -> None:
    """Ten records of 20 samples off by levels of their own and a bend, with noise of a thousandth: without the rule rho is 0.95, and a
    variance of the noise of hundreds of times the true one."""
    rng = np.random.default_rng(10)
    record, sample = np.repeat(np.arange(10), 20), np.tile(np.arange(20), 10)
    misfit = rng.normal(size=10)[record] + 0.3 * rng.normal(size=10)[record] * np.sin(0.4 * sample)
    found = neighbours(misfit + 1e-3 * rng.normal(size=200), record, sample)
    assert found.rho == 0.0 and found.of_sums < 1e-3


def test_records_of_a_channel_are_not_joined() -> None:
    """Two records with levels far apart: the step between them is no noise."""
    rng = np.random.default_rng(8)
    r = np.concatenate([rng.normal(size=200), 100.0 + rng.normal(size=200)])
    record, sample = np.repeat([0, 1], 200), np.tile(np.arange(200), 2)
    assert neighbours(r, record, sample).of_sums == pytest.approx(1.0, rel=0.3)


def test_lag_is_where_the_correlation_has_fallen() -> None:
    found = neighbours(remembering(40000, 0.6, np.random.default_rng(9)), np.zeros(40000, dtype=int), np.arange(40000))
    assert found.rho ** found.lag(0.1) == pytest.approx(0.1)


def test_autoregressive_operator_is_its_matrix() -> None:
    """rho^|i - j| within each series, whose rows need not follow one another, nothing between them; samples may be missing."""
    series = np.array([*[0] * 29, 1, *[2] * 20, *[3] * 30])
    sample = np.array([*range(10), *range(11, 30), 0, *range(20), *range(30)])
    mixed = np.random.default_rng(11).permutation(len(series))
    series, sample = series[mixed], sample[mixed]
    rho = np.array([0.7, 0.9, 0.0, 0.4])
    together = series[:, None] == series[None, :]
    apart = np.abs(np.subtract.outer(sample, sample))
    expected = np.where(together, np.where(apart == 0, 1.0, rho[series][:, None] ** apart), 0.0)
    assert autoregressive(series, sample, rho)(np.eye(len(series))) == pytest.approx(expected, abs=1e-12)


def test_smooth_functions_of_the_place_are_no_noise() -> None:
    """Of a misfit that is cubic in the place, and changes with time, nothing is left; white noise keeps its variance."""
    rng = np.random.default_rng(12)
    n_t, n_s = 20, 80
    xy = rng.uniform(-1.0, 1.0, size=(n_s, 2)) * [8.0, 30.0]
    time, point, component = (v.ravel() for v in np.meshgrid(np.arange(n_t), np.arange(n_s), [0, 1], indexing="ij"))
    x, y = xy[point].T
    smooth = (1.0 + component) * (np.sin(time) * y**3 / 1e4 + np.cos(3.0 * time) * x * y + 5.0 * x**2 + time)
    assert np.abs(rough_in_place(smooth, component, time, xy[point])).max() < 1e-9 * np.abs(smooth).max()
    noise = rng.normal(size=len(time))
    left = rough_in_place(noise + smooth, component, time, xy[point])
    assert left @ left / len(left) == pytest.approx(1.0, abs=0.05)
    few = point < 25
    assert len(rough_in_place(noise[few], component[few], time[few], xy[point[few]])) == 0


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
def test_sums_over_places_that_have_a_variance_of_their_own(rho: float) -> None:
    """Sums of noise whose places go together by threes, from the second differences of single times."""
    rng = np.random.default_rng(13)
    noise = np.sqrt(3.0) * remembering(60000, rho, rng)
    v = differences(noise, np.zeros(60000, dtype=int), np.arange(60000))[0]
    assert NeighbourNoise(1.0, rho).of_blocks(v) == pytest.approx(3.0 * (1.0 + rho) / (1.0 - rho), rel=0.1)
