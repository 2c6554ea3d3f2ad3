"""Effects planted into measured data: what is added is the difference of two predictions, and nothing else changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_coupon_model import TRUTH, coupon, study

from thermofit.core.errors import NumericsError
from thermofit.experiment.coupon import CouponExperiment, UnseenRecords
from thermofit.experiment.coupon_model import coupon_model, coupon_run
from thermofit.experiment.coupon_records import CouponData, CouponTest

PLANTED: tuple[dict[str, float], ...] = ({"rate_power.K": 20.0, "rate_power.m": 0.25}, {"ir_gain.gain": 0.05}, {"ir_lag.time": 1.5})
IDS = ("material", "sensor", "lag of the sensor")
NAMES = ("time", "strain", "stress", "theta", "lateral")
FREE = ("M_y0", "beta")


def wavy(values: np.ndarray, seed: int, size: float) -> np.ndarray:
    """Scatter that no model has: it must stay."""
    return values + size * np.random.default_rng(seed).normal(size=len(values))


def measured(control: str = "strain") -> CouponData:
    """Two records with scatter, the second with a temperature, a strain across the load and all samples of its first loading."""
    back = np.concatenate([np.linspace(0.0, 0.02, 120), np.linspace(0.02, 0.012, 40)[1:]])
    cold, warm = coupon("cold", 293.0, np.linspace(0.0, 0.03, 100), hot=False), coupon("warm", 313.0, back)
    assert warm.theta is not None
    cold = replace(cold, stress=wavy(cold.stress, 1, 1.0))
    scattered = {"stress": wavy(warm.stress, 2, 1.0), "theta": wavy(warm.theta, 3, 0.05), "lateral": wavy(-0.3 * warm.strain, 4, 1e-4)}
    warm = replace(warm, **scattered, noise={**warm.noise, "lateral": 1e-4})
    if control == "stress":
        warm = replace(warm, stress=np.linspace(0.0, 380.0, len(warm.time)))
        return CouponData((warm,), control)
    return CouponData((cold, replace(warm, first_loading=replace(warm, lateral=None))), control)


def experiment(folder: Path, control: str = "strain", data: CouponData | None = None) -> CouponExperiment:
    found = study(folder)
    section = found.coupon_section.model_copy(update={"control": control})
    found = found.model_copy(update={"coupon": section})
    return CouponExperiment(found, given=measured(control) if data is None else data, held=())


def values_of(test: CouponTest) -> dict[str, np.ndarray]:
    return {name: value for name in NAMES if (value := getattr(test, name)) is not None}


def test_nothing_planted_changes_nothing(tmp_path: Path) -> None:
    here = experiment(tmp_path)
    base = TRUTH.with_free(FREE)
    for old, new in zip(here.data.tests, here.planted(base, base.replace(**{"ir_gain.gain": 0.0})).data.tests, strict=True):
        for name, value in values_of(old).items():
            assert np.array_equal(value, values_of(new)[name]), name


@pytest.mark.parametrize("planted", PLANTED, ids=IDS)
def test_what_is_added_is_the_difference_of_two_predictions(tmp_path: Path, planted: dict[str, float]) -> None:
    """So the model with the effect misses the planted data by what it misses the others without it, to rounding; noise stays."""
    here, base = experiment(tmp_path), TRUTH.with_free(FREE)
    there = here.planted(base, base.replace(**planted))
    settings = here.study.stage("plastic").model_copy(update={"free": FREE, "window": "all"})
    settings = settings.model_copy(update={"channels": dict.fromkeys(("stress", "lateral", "dtheta"), settings.channels["stress"])})
    old, new = (coupon_model(one.study, one.data, settings, base) for one in (here, there))
    without = old.residual(base)
    assert np.abs(without).max() > 2.0, "the data hold scatter"
    assert new.residual(base.replace(**planted)) == pytest.approx(without, rel=1e-9, abs=1e-9)
    assert np.abs(new.residual(base) - without).max() > 1.0, "the effect is plain"
    for first, second in zip(here.data.tests, there.data.tests, strict=True):
        assert np.array_equal(first.strain, second.strain) and first.noise == second.noise


@pytest.mark.parametrize("planted", PLANTED, ids=IDS)
def test_all_samples_of_the_first_loading_are_planted_too(tmp_path: Path, planted: dict[str, float]) -> None:
    here, base = experiment(tmp_path), TRUTH.with_free(FREE)
    _, warm = here.planted(base, base.replace(**planted)).data.tests
    assert warm.first_loading is not None
    for name in ("stress", "theta"):
        assert np.array_equal(getattr(warm, name), getattr(warm.first_loading, name))


def test_under_stress_the_strain_is_planted(tmp_path: Path) -> None:
    here, base = experiment(tmp_path, "stress"), TRUTH.with_free(FREE)
    after = base.replace(M_y0=290.0)
    (old,), (new,) = here.data.tests, here.planted(base, after).data.tests
    assert np.array_equal(old.stress, new.stress)
    run = coupon_run(here.study, here.data, base.free)
    more = run.history(after, old).strain - run.history(base, old).strain
    assert new.strain - old.strain == pytest.approx(more, abs=1e-15) and more.max() > 1e-4


def test_work_of_the_planted_stress_heats(tmp_path: Path) -> None:
    """Where the measured stress heats, a higher measured stress heats more; with the law's heat a sensor effect alone would."""
    base = TRUTH.with_free(FREE)
    after = base.replace(**{"rate_power.K": 60.0, "rate_power.m": 0.25})
    here = experiment(tmp_path)
    run = replace(coupon_run(here.study, here.data, base.free), measured_work=True)
    warm = here.data.tests[1]
    new = run.planted(warm, base, after)
    assert new.theta is not None and warm.theta is not None
    added = run.history(after, new).theta_sensor - run.history(base, warm).theta_sensor
    assert new.theta - warm.theta == pytest.approx(added, abs=1e-12)
    stays = run.history(after, warm).theta_sensor - run.history(base, warm).theta_sensor
    assert np.abs(added - stays).max() > 0.01


def test_held_out_records_are_planted_alike(tmp_path: Path) -> None:
    cold, warm = measured().tests
    here, base = experiment(tmp_path, data=CouponData((cold,), "strain")), TRUTH.with_free(FREE)
    unseen = UnseenRecords(experiment(tmp_path, data=CouponData((warm,), "strain")))
    there = replace(here, held=(unseen,)).planted(base, base.replace(**PLANTED[0]))
    (found,) = there.unseen[0].experiment.data.tests
    both = experiment(tmp_path, data=CouponData((warm,), "strain")).planted(base, base.replace(**PLANTED[0]))
    assert np.array_equal(found.stress, both.data.tests[0].stress) and not np.array_equal(found.stress, warm.stress)


def test_an_effect_that_cannot_be_run_is_an_error(tmp_path: Path) -> None:
    here, base = experiment(tmp_path, "stress"), TRUTH.with_free(FREE)
    with pytest.raises(NumericsError, match="warm: material point"):
        here.planted(base, base.replace(M_y0=100.0, M_yinf=120.0))
