"""Named test programmes of a coupon: they go where their words say, and all are as many samples."""

from __future__ import annotations

import numpy as np
import pytest
from coupons import SHEET

from thermofit.core.errors import StudyError
from thermofit.point.driver import simulate
from thermofit.point.programmes import FASTER, NAMES, REST, SAMPLES, WARMER, Usual, programme

USUAL = Usual(peak=0.04, rate=1e-3, theta_start=296.7)
COOLING = SHEET.replace(tau=30.0)


@pytest.mark.parametrize("name", NAMES)
def test_every_programme_can_be_driven(name: str) -> None:
    """Increasing time, the largest strain is the peak, no jump between samples, and the number of samples is alike."""
    made = programme(name, USUAL, COOLING)
    history = simulate(COOLING, made)
    assert np.abs(history.strain).max() == pytest.approx(USUAL.peak, rel=1e-9)
    assert 0.9 * SAMPLES < len(made.time) < 1.2 * SAMPLES
    assert np.abs(np.diff(history.strain)).max() < 0.06 * USUAL.peak
    assert np.abs(np.diff(history.stress[2:])).max() < 0.45 * history.stress.max()


def test_unloading_ends_without_stress_and_the_rest_cools() -> None:
    history = simulate(COOLING, programme("load-unload-cool", USUAL, COOLING))
    assert abs(history.stress[-1]) < 1e-6
    resting = history.time > history.time[-1] - REST
    assert np.abs(history.stress[resting]).max() < 1e-6
    rise = history.theta - history.theta[0]
    assert rise[-1] < 0.1 * rise.max()
    half = np.abs(history.strain - 0.5 * USUAL.peak).argmin()
    assert np.any(np.abs(history.stress[half : half + 60]) < 1e-6), "unloaded half way"


def test_stepped_rates_jump_and_warm_starts_warm() -> None:
    stepped = programme("stepped-rates", USUAL, COOLING)
    rate = np.diff(stepped.value) / np.diff(stepped.time)
    assert rate.max() / rate.min() == pytest.approx(FASTER)
    assert programme("warm", USUAL, COOLING).theta_start == pytest.approx(USUAL.theta_start + WARMER)
    assert programme("monotonic", USUAL, COOLING).theta_start == pytest.approx(USUAL.theta_start)


def test_what_cannot_be_meant_is_refused() -> None:
    with pytest.raises(StudyError, match=r"'pulling' is not known; expected one of monotonic, "):
        programme("pulling", USUAL, COOLING)
    with pytest.raises(StudyError, match=r"rate above 0"):
        programme("monotonic", Usual(0.04, 0.0, 296.7), COOLING)
