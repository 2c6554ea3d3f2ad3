"""Combined uncertainty: every part against draws, passed on from fit to fit, and what a residual beyond its noise adds."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.fit.budget import MISFIT, NOISE, combined, moves, root_of
from thermofit.fit.linear_model import LinearModel

RNG = np.random.default_rng(3)
N, DRAWS = 60, 4000
FIRST, SECOND = RNG.normal(size=(N, 2)), RNG.normal(size=(N, 2))
OF_FIRST = 0.8 * SECOND + 0.3 * RNG.normal(size=(N, 2))
COMMON = np.concatenate([0.3 * FIRST.sum(axis=1), 0.3 * SECOND.sum(axis=1)])[:, None]
NONE = np.zeros(2, dtype=bool)


def model(columns: np.ndarray, residual: np.ndarray | None = None) -> LinearModel:
    return LinearModel(RNG.normal(size=len(columns)) if residual is None else residual, columns)


def test_what_one_fit_takes_from_another_passes_on_with_its_correlation() -> None:
    """Two fits, one after the other, and an error that both feel: the covariance is that of draws, and the common cause is no sum of
    squares."""
    first = model(FIRST)
    budget = combined(first, first.covariance(("a", "b")), {"load cell": COMMON[:N]})
    passed = {cause: OF_FIRST @ rows for cause, rows in budget.parts.items() if cause != NOISE}
    second = model(SECOND)
    causes = {"load cell": COMMON[N:] + passed["load cell"], "noise of first": OF_FIRST @ budget.parts[NOISE]}
    found = combined(second, second.covariance(("c", "d")), causes)

    noise, error = RNG.normal(size=(DRAWS, 2 * N)), RNG.normal(size=DRAWS)
    seen = noise + error[:, None] * COMMON[:, 0]
    told = -seen[:, :N] @ np.linalg.pinv(FIRST).T
    drawn = -(seen[:, N:] + told @ OF_FIRST.T) @ np.linalg.pinv(SECOND).T
    assert np.allclose(np.cov(drawn.T), found.covariance, rtol=0.1, atol=0.03 * found.covariance.max())
    apart = {**causes, "load cell": COMMON[N:], "first's": passed["load cell"]}
    assert not np.allclose(combined(second, second.covariance(("c", "d")), apart).sigma, found.sigma, rtol=0.02)


def test_parts_add_up_and_come_largest_first() -> None:
    fit = model(FIRST)
    spread = fit.covariance(("a", "b"))
    found = combined(fit, spread, {"thickness": 30.0 * COMMON[:N], "width": 0.01 * COMMON[:N]})
    rows = found.largest_first("a")
    assert [cause for cause, _ in rows] == ["thickness", NOISE, "width"]
    assert found.sigma[0] == pytest.approx(np.sqrt(sum(size**2 for _, size in rows)))
    assert next(iter(found.shares())) == "thickness" and sum(found.shares().values()) == pytest.approx(1.0)
    assert np.allclose(found.of(NOISE), spread.sigma_unit)


def test_what_noise_holds_already_is_told_apart_and_not_added() -> None:
    fit = model(FIRST)
    spread = fit.covariance(("a", "b"))
    row = np.eye(N, 1)
    found = combined(fit, spread, {}, within={"reading": row})
    assert np.allclose(found.covariance, spread.matrix_unit)
    assert np.allclose(found.parts["reading"], moves(fit, row, NONE)) and found.of("reading")[0] > 0.0


def test_noise_is_told_by_channel() -> None:
    """Shares of two channels against draws of the noise of one alone; one parameter that only the second feels."""
    columns = FIRST.copy()
    columns[:20, 1] = 0.0
    fit, channels = model(columns), {"du": slice(0, 20), "dtheta": slice(20, N)}
    found = combined(fit, fit.covariance(("a", "b")), {}, channels=channels)
    noise = np.where(np.arange(N) < 20, RNG.normal(size=(DRAWS, N)), 0.0)
    drawn = np.var(noise @ np.linalg.pinv(columns).T, axis=0) / np.diag(found.covariance)
    assert np.allclose(found.noise_of["du"], drawn, rtol=0.1, atol=0.01)
    assert np.allclose(found.noise_of["du"] + found.noise_of["dtheta"], 1.0)
    most, share = found.largest_noise()
    assert most == "dtheta" and share == pytest.approx(float(np.mean(found.noise_of["dtheta"])))


def test_a_parameter_at_its_bound_stays_there_and_one_that_is_not_felt_is_open() -> None:
    columns = np.column_stack([FIRST, np.zeros(N)])
    fit = model(columns)
    spread = fit.covariance(("a", "b", "c"), np.array([False, True, False]))
    found = combined(fit, spread, {"thickness": COMMON[:N]})
    assert found.of("thickness")[1] == 0.0 and found.sigma[1] == pytest.approx(spread.sigma_unit[1])
    assert np.isinf(found.sigma[2]) and not found.covariance[2].any()


def test_misfit_that_rows_have_in_common_widens_the_interval_and_white_noise_does_not() -> None:
    groups, z = np.repeat(np.arange(40), 25), []
    columns = np.column_stack([np.ones(1000), np.repeat(RNG.normal(size=40), 25)])
    for _ in range(300):
        residual = RNG.normal(size=1000) + 0.5 * np.repeat(RNG.normal(size=40), 25)
        fit = LinearModel(residual, columns)
        at = LinearModel(residual + columns @ fit.free_step, columns)
        found = combined(at, at.covariance(("a", "b")), {}, groups=groups)
        z.append(fit.free_step / found.sigma)
    assert 0.85 < np.sqrt(np.mean(np.square(z))) < 1.15
    wide = []
    for _ in range(50):
        fit = LinearModel(RNG.normal(size=1000), columns)
        at = LinearModel(fit.left, columns)
        wide.append(combined(at, at.covariance(("a", "b")), {}, groups=groups).of(MISFIT) / at.covariance(("a", "b")).sigma_unit)
    assert np.median(wide) < 0.3 and np.mean(wide) < 0.3


def test_where_every_parameter_is_at_a_bound_no_misfit_moves_it() -> None:
    fit, held = model(FIRST), np.ones(2, dtype=bool)
    found = combined(fit, fit.covariance(("a", "b"), held), {"mesh": COMMON[:N]}, groups=np.arange(N) // 5)
    assert not found.parts[MISFIT].size and not found.of("mesh").any()


def test_root_of_a_covariance_of_mixed_units() -> None:
    scale = np.diag([1e6, 1.0, 1e-6])
    matrix = scale @ (FIRST[:3] @ FIRST[:3].T + 0.1 * np.eye(3)) @ scale
    assert np.allclose(root_of(matrix) @ root_of(matrix).T / matrix, 1.0)
