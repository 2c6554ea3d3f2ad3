"""Correlated residuals: what they are worth, and the standard errors that follow."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.fit.linear_model import LinearModel
from thermofit.fit.memory import memories, noise_operator, tapered_correlation


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
