"""Standard errors of correlated points: the correlation is found from the residual, and the errors are those of repeated tests."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from thermofit.fit.linear_model import LinearModel
from thermofit.identify.correlated import correlogram, with_correlated_noise
from thermofit.identify.solve import Solved

RNG = np.random.default_rng(6)
XY = RNG.uniform([0.0, 0.0], [20.0, 60.0], (1500, 2))
NEAR = cKDTree(XY).query_ball_point(XY, 1.5)


def noise(correlated: bool) -> np.ndarray:
    """Noise (n, 2) of unit variance: white, or averaged over discs of radius 1.5 mm, so that it has died away at 3 mm."""
    white = RNG.normal(size=XY.shape)
    if not correlated:
        return white
    mean = np.stack([white[ids].mean(axis=0) * np.sqrt(len(ids)) for ids in NEAR])
    return np.asarray(mean)


def solved_with(error: np.ndarray) -> tuple[Solved, np.ndarray]:
    """A fit of u_x = a + b y, u_y = a y to noise: residual and Jacobian are all that matters. Also the estimate."""
    n = len(XY)
    rows = np.stack([np.zeros(2 * n, int), np.repeat(np.arange(n), 2), np.tile([0, 1], n)], axis=1)
    slope = np.empty((2 * n, 2))
    slope[0::2] = np.stack([np.ones(n), XY[:, 1] / 60.0], axis=1)
    slope[1::2] = np.stack([XY[:, 1] / 60.0, np.zeros(n)], axis=1)
    data = error.reshape(-1)
    x = np.linalg.lstsq(slope, data, rcond=None)[0]
    bound = np.zeros(2, bool)
    fit = SimpleNamespace(jacobian=slope, residual=slope @ x - data, names=("a", "b"), at_bound=bound)
    model = SimpleNamespace(comparisons=(SimpleNamespace(rows=rows, noise=None),), observations={"u": SimpleNamespace(xy=XY)})
    spread = LinearModel(fit.residual, fit.jacobian).covariance(fit.names, bound)
    made: Any = Solved(None, model, fit, spread, (), ())  # type: ignore[arg-type]
    return made, x


def test_correlogram_finds_the_range() -> None:
    distance, rho = correlogram(XY, noise(True))
    assert rho[0] > 0.6 and 2.0 < distance[-1] <= 6.0
    assert np.all(np.diff(rho[:5]) < 0.0)
    assert len(correlogram(XY, noise(False))[0]) <= 2


@pytest.mark.parametrize("correlated", [True, False])
def test_errors_are_those_of_repeated_tests(correlated: bool) -> None:
    estimates, sigmas, white = [], [], []
    for _ in range(60):
        case, x = solved_with(noise(correlated))
        wide, remark = with_correlated_noise(case)
        assert wide.covariance is not None and case.covariance is not None and remark
        estimates.append(x)
        sigmas.append(wide.covariance.sigma)
        white.append(case.covariance.sigma)
    spread, claimed, naive = np.std(estimates, axis=0), np.mean(sigmas, axis=0), np.mean(white, axis=0)
    assert claimed == pytest.approx(spread, rel=0.35)
    if correlated:
        assert np.all(naive < 0.5 * spread)
