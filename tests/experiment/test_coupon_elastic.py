"""The elastic part of a coupon record: slope, zero of strain, and where the line ends."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.experiment.coupon_elastic import contradicts, elastic_line, first_branch

E, YIELD = 200e3, 300.0


def record(n: int = 400, noise: float = 1e-6, offset: float = 3e-4, toe: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A bilinear record to 1 % strain whose strain is off by `offset`, soft by `toe` (strain) at its beginning."""
    true = np.linspace(0.0, 0.01, n)
    stress = np.where(true < YIELD / E, E * true, YIELD + 2e3 * (true - YIELD / E))
    strain = true + offset - toe * np.exp(-stress / 10.0) + noise * np.random.default_rng(1).normal(size=n)
    return np.linspace(0.0, 100.0, n), strain, stress


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_slope_zero_and_end(sign: float) -> None:
    time, strain, stress = record()
    found = elastic_line(time, sign * strain, sign * stress, 1e-6)
    assert found is not None
    assert found.slope == pytest.approx(E, rel=5e-3)
    assert found.offset == pytest.approx(sign * 3e-4, abs=5e-6)
    assert 0.75 * YIELD < abs(found.stress) < 1.02 * YIELD
    assert stress[found.end] <= 1.02 * YIELD


def test_toe_is_left_out() -> None:
    found = elastic_line(*record(toe=1e-4), noise=1e-6)
    assert found is not None
    assert found.slope == pytest.approx(E, rel=0.03)


@pytest.mark.parametrize("drift", [-1.0, 1.0])
def test_rest_before_the_load_is_no_branch(drift: float) -> None:
    """The stress drifts and comes back, the strain the other way: the line is that of the loading, and no sign is suspected."""
    time, strain, stress = record()
    rest = np.array([0.0, 0.5, 1.0, 0.4, -0.6, 0.2])
    stress = np.concatenate([drift * rest, stress])
    strain = np.concatenate([strain[0] - 2e-6 * drift * rest, strain])
    time = np.concatenate([np.arange(-6, 0) * time[1], time])
    assert first_branch(stress) == len(stress)
    assert not contradicts(strain, stress)
    found = elastic_line(time, strain, stress, 1e-6)
    assert found is not None
    assert found.slope == pytest.approx(E, rel=5e-3)


def test_no_line_without_samples() -> None:
    time, strain, stress = record(n=12)
    assert elastic_line(time, strain, stress, 1e-6) is None
    assert elastic_line(time, strain, np.zeros(12), 1e-6) is None


def test_first_branch_ends_at_the_reversal() -> None:
    stress = np.concatenate([np.linspace(0.0, 200.0, 51), np.linspace(200.0, -300.0, 101)[1:]])
    assert first_branch(stress) == 51
    assert first_branch(np.linspace(0.0, 10.0, 7)) == 7


def test_a_record_that_begins_at_rest_has_its_line() -> None:
    """The noise of a rest turns back and forth by more than a tenth of what it reaches: no reversal ends the branch there."""
    _, strain, stress = record(offset=0.0)
    noise = 0.8 * np.random.default_rng(2).normal(size=440)
    at_rest = np.concatenate([np.zeros(40), stress]) + noise
    found = elastic_line(np.arange(440.0), np.concatenate([np.zeros(40), strain]), at_rest, 1e-6)
    assert found is not None and found.slope == pytest.approx(E, rel=0.01)
