"""Significance of a local balance: N(0, 1) where nothing is missing, at its place and time where something is, blind to the parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermofit.diagnose.significance import LEVEL, significance
from thermofit.experiment.local_balance import LocalBalance

N_T, N_Y = 12, 6
ROW, COLUMN = (v.ravel() for v in np.meshgrid(np.arange(N_T), np.arange(N_Y), indexing="ij"))
NAMES = ("kappa", "c0", "beta")
SPREAD = 0.5 + 0.5 * np.eye(N_T * N_Y)[0] + np.linspace(0.0, 1.0, N_T * N_Y)


def correlation() -> np.ndarray:
    """Neighbours share half of their noise, as cells that overlap do."""
    far = np.hypot(ROW[:, None] - ROW, COLUMN[:, None] - COLUMN)
    return np.where(far == 0.0, 1.0, np.where(far == 1.0, 0.2, 0.0))


NOISE = correlation() * np.outer(SPREAD, SPREAD)
ROOT = np.linalg.cholesky(NOISE)
COLUMNS = np.stack([np.cos(0.4 * ROW), 0.2 * (ROW - 5.0), 0.05 * ROW * (COLUMN - 2.5)], axis=1)
FORCE = np.where(ROW == 4, 3.0, 0.0)[:, None]


def balance(amount: np.ndarray, **changes: object) -> LocalBalance:
    made = LocalBalance(
        kind="heat",
        channel="dtheta",
        unit="mW/mm^3",
        amount=amount,
        covariance=NOISE,
        columns=COLUMNS,
        names=NAMES,
        value=np.array([100.0, 2.4, 0.8]),
        bounds=(np.array([1.0, 0.5, 0.0]), np.array([1000.0, 10.0, 5.0])),
        told=np.zeros((0, 3)),
        beside=FORCE,
        y=5.0 * COLUMN,
        time=2.0 * ROW + 1.0,
        row=ROW,
        column=COLUMN,
        extent=10.0,
        duration=np.full(len(ROW), 4.0),
        dropped=0,
        volume=np.full(len(ROW), 100.0),
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def noise(seed: int, force: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return ROOT @ rng.normal(size=len(ROW)) + force * FORCE[:, 0] * rng.normal()


def test_a_balance_that_misses_nothing_is_standard_normal_whatever_its_parameters() -> None:
    maps = [significance(balance(noise(s) + COLUMNS @ np.random.default_rng(900 + s).normal(size=3))) for s in range(200)]
    z = np.concatenate([m.z for m in maps])
    assert z.std() == pytest.approx(1.0, abs=0.02) and abs(z.mean()) < 0.02
    assert np.mean(np.abs(z) > 3.0) == pytest.approx(0.0027, abs=0.0015)
    ratio = np.mean([m.chi2 for m in maps]) / np.mean([m.degrees for m in maps])
    assert ratio == pytest.approx(1.0, abs=0.03)
    assert sum(m.stands_out for m in maps) <= 6  # LEVEL of 200: two
    assert np.mean([m.chance_peak < 0.1 for m in maps]) == pytest.approx(0.1, abs=0.06)
    assert LEVEL == 0.01


def test_what_is_missing_is_found_at_its_place_and_time() -> None:
    planted = np.where((ROW >= 6) & (ROW <= 8) & (COLUMN >= 3) & (COLUMN <= 4), 6.0, 0.0)
    found = significance(balance(noise(1) + planted))
    assert found.stands_out and found.block.amount == pytest.approx(6.0, abs=4.0 * found.block.sigma)
    assert found.block.y == (12.5, 22.5) and found.block.time == (12.0, 18.0)
    peak = found.peak
    assert 6 <= ROW[peak] <= 8 and 3 <= COLUMN[peak] <= 4
    # Parameters are fitted beside it: it is not spread over the other cells.
    assert np.abs(found.z[planted == 0.0]).max() < 4.5 and found.amount[planted > 0.0].mean() == pytest.approx(6.0, rel=0.2)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_is_missing_in_one_place_is_not_spread_by_the_parameters(seed: int) -> None:
    planted = np.where((ROW >= 6) & (ROW <= 8) & (COLUMN >= 3) & (COLUMN <= 4), 30.0, 0.0)
    found = significance(balance(noise(seed) + planted))
    assert np.abs(found.z[planted == 0.0]).max() < 4.5 and found.amount[planted > 0.0].mean() == pytest.approx(30.0, rel=0.05)


def test_what_parameters_could_make_is_nobodys_loss() -> None:
    assert not significance(balance(noise(3) + COLUMNS @ np.array([30.0, 3.0, 2.0]))).stands_out
    firm = balance(noise(3) + COLUMNS @ np.array([30.0, 3.0, 2.0]), told=1e3 * np.eye(3))
    assert significance(firm).stands_out, "a change that the other channels forbid is missing"


def test_errors_beside_count_as_noise() -> None:
    shifted = noise(5) + 4.0 * FORCE[:, 0]
    assert not significance(balance(noise(5) + 1.5 * FORCE[:, 0])).stands_out
    assert significance(balance(shifted, beside=np.zeros((len(ROW), 0)))).stands_out


def test_a_cell_that_parameters_determine_says_nothing() -> None:
    columns = COLUMNS.copy()
    columns[:, 2] = np.where((ROW == 3) & (COLUMN == 2), 1e3, 0.0)
    alone = {"covariance": np.diag(SPREAD**2), "beside": np.zeros((len(ROW), 0))}
    found = significance(balance(noise(6), columns=columns, **alone))
    assert found.taken == 1 and np.isnan(found.z[(ROW == 3) & (COLUMN == 2)]).all()


def scanned(made: LocalBalance, exact: np.ndarray, grows: float = 2.0, to: float = 16.0) -> LocalBalance:
    """A balance whose amount is linear in the first parameter, and whose noise grows with a power of it; scanned up to `to` times it."""

    def follow(x: np.ndarray) -> LocalBalance:
        factor = ((made.value[0] + x[0]) / made.value[0]) ** grows
        return replace(made, amount=made.amount + exact * x[0], covariance=factor * made.covariance)

    grid = np.zeros((33, 3))
    grid[:, 0] = made.value[0] * (np.geomspace(1.0 / 16.0, to, 33) - 1.0)
    return replace(made, follow=follow, scan=tuple(grid))


def test_a_balance_closes_with_the_parameter_that_the_fit_has_missed() -> None:
    exact = 0.1 * np.sin(0.9 * ROW + COLUMN)
    # At 100 the noise is that of a conductivity of 100; the truth is 300.
    made = balance(3.0 * noise(7, 0.0) - 200.0 * exact, beside=np.zeros((len(ROW), 0)))
    found = significance(scanned(made, exact))
    assert not found.stands_out and found.asks is not None and found.asks.name == "kappa"
    assert found.asks.value == pytest.approx(300.0, abs=3.0 * found.asks.sigma) and found.asks.sigma < 100.0 and found.asks.fitted == 100.0


def test_a_source_is_not_taken_for_a_parameter() -> None:
    planted = np.where((ROW >= 6) & (ROW <= 8) & (COLUMN >= 3) & (COLUMN <= 4), 9.0, 0.0)
    found = significance(scanned(balance(noise(8) + planted), 0.01 * np.sin(0.9 * ROW + COLUMN)))
    assert found.stands_out and found.asks is None


def test_what_a_parameter_leaves_missing_is_not_closed_by_it() -> None:
    # The truth is 300, which the likelihood asks for by far, and heat is missing in two places as well.
    exact = 0.05 * np.sin(0.9 * ROW + COLUMN)
    two = np.where((ROW <= 2) & (COLUMN <= 1), 9.0, 0.0) - np.where((ROW >= 9) & (COLUMN >= 4), 9.0, 0.0)
    made = balance(noise(9, 0.0) - 200.0 * exact + two, beside=np.zeros((len(ROW), 0)))
    assert significance(scanned(replace(made, amount=made.amount - two), exact, 0.0)).asks is not None
    found = significance(scanned(made, exact, 0.0))
    assert found.stands_out and found.asks is None


def test_a_parameter_at_the_end_of_its_scan_is_not_asked_for() -> None:
    exact = 0.05 * np.sin(0.9 * ROW + COLUMN)
    made = balance(noise(9, 0.0) - 200.0 * exact, beside=np.zeros((len(ROW), 0)))
    at_the_end = scanned(made, exact, 0.0, to=2.95)
    assert at_the_end.follow is not None and not significance(at_the_end.follow(at_the_end.scan[-1])).stands_out
    found = significance(at_the_end)
    assert found.stands_out and found.asks is None
