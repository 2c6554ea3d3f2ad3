"""Scatter between specimens: records that differ by a factor, groups by rate and temperature, none where nothing is repeated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermofit.report.html.gather import FirstLoading, first_loading, scatter_of

TIME = np.linspace(0.0, 100.0, 401)
STRAIN = np.interp(TIME, [0.0, 60.0, 80.0, 100.0], [0.001, 0.061, 0.041, 0.101])


def stress(factor: float = 1.0) -> np.ndarray:
    return factor * 400.0 * (1.0 - np.exp(-60.0 * (STRAIN - 0.001)))


def record(factor: float = 1.0, rate: float = 1.0, theta: float = 293.0, sense: float = 1.0) -> FirstLoading:
    made = first_loading(TIME / rate, sense * STRAIN, sense * stress(factor), theta)
    assert made is not None
    return made


def test_the_first_loading_ends_at_the_first_turn() -> None:
    made = record(sense=-1.0)
    assert made.strain[-1] == pytest.approx(0.06) and made.rate == pytest.approx(-1e-3) and (np.diff(made.strain) > 0).all()
    assert made.stress[-1] == pytest.approx(400.0 * (1.0 - np.exp(-3.6)))
    assert first_loading(TIME[:5], STRAIN[:5], stress()[:5], 293.0) is None


def test_records_that_differ_by_a_factor() -> None:
    """Factors 0.97, 1, 1.03: at every strain the deviation is 3 % of the stress."""
    made = [record(f) for f in (0.97, 1.0, 1.03)]
    level = np.linspace(0.2 * 0.06, 0.06, 100)
    expected = 0.03 * np.sqrt(np.mean((400.0 * (1.0 - np.exp(-60.0 * level))) ** 2))
    assert scatter_of(made) == pytest.approx(expected, rel=1e-3)


def test_only_tests_of_one_rate_temperature_and_sense_are_repeated() -> None:
    alone = [record(1.0), record(1.1, rate=10.0), record(0.8, theta=573.0), record(1.05, sense=-1.0)]
    assert scatter_of(alone) is None
    pair = [record(1.0, theta=573.0), replace(record(1.02, theta=573.0))]
    assert scatter_of([*alone[:2], *pair]) == pytest.approx(scatter_of(pair))
