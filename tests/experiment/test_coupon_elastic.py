"""The elastic part of a coupon record: slope, zero of strain, and where the line ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermofit.experiment.coupon_elastic import ElasticLine, contradicts, elastic_line, first_branch, modulus_error, proof_stress

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
    assert 0.45 * YIELD < abs(found.stress) < 0.55 * YIELD, "half of the proof stress, which is near yield"
    assert abs(stress[found.begin]) == pytest.approx(0.1 * abs(found.stress), rel=0.4) and found.error < 2e-3


def test_toe_is_left_out() -> None:
    found = elastic_line(*record(toe=1e-4), noise=1e-6)
    assert found is not None
    assert found.slope == pytest.approx(E, rel=0.03)


def test_microplasticity_below_yield_bends_the_slope_by_little() -> None:
    """Ramberg and Osgood: 2 % off the line in strain at 250 MPa would be some 10 % of slope over all that counts as straight."""
    stress = np.linspace(0.0, 420.0, 300)
    strain = stress / E + 0.002 * (stress / 400.0) ** 7
    found = elastic_line(np.arange(300.0), strain, stress, 1e-7)
    assert found is not None and found.slope == pytest.approx(E, rel=0.02) and found.stress < 210.0
    assert proof_stress(strain, stress, E, 0.0) == pytest.approx(400.0, abs=2.0)


def test_where_few_samples_lie_below_half_of_the_proof_stress_the_whole_line_counts() -> None:
    stress = np.concatenate([np.linspace(0.0, 300.0, 7), np.linspace(310.0, 400.0, 30)])
    strain = stress / E + np.maximum(stress - 300.0, 0.0) * 1e-4
    found = elastic_line(np.arange(37.0), strain, stress, 1e-7)
    assert found is not None and found.stress > 220.0 and found.slope == pytest.approx(E, rel=1e-3)


def test_error_of_a_modulus_is_that_of_the_lines_or_of_their_scatter() -> None:
    line = ElasticLine(E, 0.0, 10, 100.0, error=0.01)
    assert modulus_error([line]) == 0.01 and modulus_error([line] * 4) == pytest.approx(0.005) and modulus_error([]) == np.inf
    apart = [replace(line, slope=s, error=0.0) for s in (190e3, 210e3)]
    assert modulus_error(apart) == pytest.approx(0.05, rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_error_of_a_slope_is_its_scatter_over_many_records(seed: int) -> None:
    """Strain noise of 2e-5: the slopes of noisy copies scatter as each says."""
    _, strain, stress = record(offset=0.0, noise=0.0)
    lines = []
    for k in range(60):
        noise = 2e-5 * np.random.default_rng([seed, k]).normal(size=400)
        found = elastic_line(np.arange(400.0), strain + noise, stress, 2e-5)
        assert found is not None
        lines.append(found)
    scatter = float(np.std([line.slope for line in lines]) / E)
    assert scatter == pytest.approx(float(np.mean([line.error for line in lines])), rel=0.35)


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
