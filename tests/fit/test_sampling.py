"""Markov chains: the normal distribution of a linear model, its cut at a bound, a full model that can fail."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.core.errors import NumericsError, StudyError
from thermofit.fit.sampling import full_density, linear_density, sampled

pytest.importorskip("emcee")
COVARIANCE = np.array([[4.0, 1.8], [1.8, 1.0]])
WIDE = (np.full(2, -100.0), np.full(2, 100.0))


def test_chain_of_a_normal_distribution() -> None:
    chain = sampled(linear_density(np.array([3.0, -1.0]), COVARIANCE, *WIDE), np.array([3.0, -1.0]), np.ones(2), WIDE, 1)
    assert np.cov(chain.x.T) == pytest.approx(COVARIANCE, rel=0.15)
    assert chain.x.mean(axis=0) == pytest.approx([3.0, -1.0], abs=0.3)
    assert 0.2 < chain.acceptance < 0.9 and not chain.remark


def test_bound_cuts_the_distribution() -> None:
    bounds = (np.array([0.0, -100.0]), WIDE[1])
    chain = sampled(linear_density(np.zeros(2), COVARIANCE, *bounds), np.array([0.5, 0.0]), np.ones(2), bounds, 1)
    assert chain.x[:, 0].min() >= 0.0
    # Half a normal distribution: its mean is sigma sqrt(2/pi).
    assert chain.x[:, 0].mean() == pytest.approx(2.0 * np.sqrt(2.0 / np.pi), rel=0.1)


def test_full_model_that_fails_has_no_probability() -> None:
    def objective(x: np.ndarray) -> float:
        if x[0] > 1.0:
            raise NumericsError("fails")
        return float(x @ x) / 0.25

    log_density = full_density(objective, 0.0, 1.0, WIDE)
    assert log_density(np.array([2.0, 0.0])) == -np.inf and log_density(np.array([0.5, 0.0])) == pytest.approx(-0.5)
    assert log_density(np.array([-101.0, 0.0])) == -np.inf


def test_same_seed_same_chain_and_too_many_parameters() -> None:
    density = linear_density(np.zeros(2), COVARIANCE, *WIDE)
    a, b = (sampled(density, np.zeros(2), np.ones(2), WIDE, 5, 100) for _ in range(2))
    assert np.array_equal(a.x, b.x)
    with pytest.raises(StudyError, match="13 parameters are free, 12 at most"):
        sampled(lambda x: 0.0, np.zeros(13), np.ones(13), (np.full(13, -9.0), np.full(13, 9.0)), 1)
