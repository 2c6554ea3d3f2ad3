"""E of the elastic range stays within what that range has told, and what speaks against that."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coupon_sets import TRUTH, pulled_record, study_of

from thermofit.core.parameters import Parameters
from thermofit.experiment.coupon import POINT, STRAIGHT, CouponExperiment
from thermofit.experiment.coupon_elastic import ElasticLine, slope_scatter
from thermofit.experiment.coupon_records import CouponData, CouponTest
from thermofit.identify.solve import within
from thermofit.study.study import Study


def bar(name: str = "a", seed: int = 3, sigma: float = 1.0, **law: float) -> CouponTest:
    return pulled_record(name, 1e-3, 293.15, seed, sigma, 0.04, 120, **law)


def told(study: Study, *tests: CouponTest) -> dict[str, tuple[float, float]]:
    """What the elastic ranges tell of a joint fit that begins at the truth."""
    experiment = CouponExperiment(study, given=CouponData(tests, "strain"))
    return experiment.told(Parameters.of({**experiment.start().values, **TRUTH}, experiment.joint_settings().free))


def test_a_modulus_stays_within_what_its_elastic_range_tells(tmp_path: Path) -> None:
    """Three of its standard errors, STRAIGHT at least, and within the bounds of the study."""
    study = study_of(tmp_path)
    assert told(study, bar())["E"] == pytest.approx((200e3 * (1.0 - STRAIGHT), 200e3 * (1.0 + STRAIGHT)))
    low, high = told(study, bar(sigma=3.0))["E"]
    assert 0.035 < high / 200e3 - 1.0 < 0.15 and 1.0 - low / 200e3 == pytest.approx(high / 200e3 - 1.0)
    narrow = within(study, Parameters.of({"E": 200e3}), {"E": (199e3, 201e3)})
    assert told(narrow, bar())["E"] == (199e3, 201e3)


@pytest.mark.parametrize(
    ("study", "records"),
    [
        ({"stages": {"elastic": {"free": ["E"], "window": [0.0, 1.0]}, "plastic": {"free": ["M_y0", "M_yinf", "H_exp"]}}}, 1),
        ({"diagnosis": {"free": ["E", "M_y0", "M_yinf", "H_exp"]}}, 1),
        ({}, 2),
    ],
    ids=["a window by hand", "freed by the study", "elastic lines that scatter"],
)
def test_what_the_elastic_ranges_do_not_tell_or_the_study_frees_has_the_bounds_of_the_study(
    tmp_path: Path, study: dict[str, Any], records: int
) -> None:
    others = (bar("b", 4, E=150e3),) if records == 2 else ()
    assert told(study_of(tmp_path, **study), bar(), *others) == {}


@pytest.mark.parametrize(("theta", "one"), [(340.0, True), (346.0, False)])
def test_elastic_ranges_far_apart_in_temperature_tell_a_modulus_each(tmp_path: Path, theta: float, one: bool) -> None:
    """Further apart than a modulus that falls with temperature needs to be told (50 K), E has the bounds of the study."""
    hot = replace(bar("hot", 4), theta_start=theta)
    assert bool(told(study_of(tmp_path), replace(bar(), theta_start=293.15), hot)) is one


def elastic_modulus(study: Study, *tests: CouponTest) -> tuple[float, float]:
    """E and its standard error in MPa by least squares of the elastic stage, whose model is linear in it."""
    experiment = CouponExperiment(study, given=CouponData(tests, "strain"))
    settings, _ = experiment.stage("elastic")
    base = Parameters.of({**experiment.start().values, **TRUTH}, settings.free)
    model = experiment.model(settings, base, POINT)
    residual, columns = model.linearised(base, ("E",))
    size = float(columns[:, 0] @ columns[:, 0])
    return base["E"] - float(columns[:, 0] @ residual) / size, size**-0.5


def test_records_whose_slopes_scatter_count_alike(tmp_path: Path) -> None:
    """Else the one with the least noise says E alone, with an error of its noise."""
    moduli = (185e3, 195e3, 205e3, 235e3)
    tests = tuple(bar(str(n), n, 0.02 if n == 3 else 1.0, E=E) for n, E in enumerate(moduli))
    E, sigma = elastic_modulus(study_of(tmp_path), *tests)
    assert pytest.approx(205e3, rel=0.01) == E
    assert sigma == pytest.approx(float(np.std(moduli, ddof=1)) / 2.0, rel=0.1)


def test_slopes_that_differ_by_their_noise_are_weighted_by_it(tmp_path: Path) -> None:
    """Scatter between records is what the errors of their lines do not explain."""
    lines = [ElasticLine(slope, 0.0, 9, 100.0, error=0.05) for slope in (190e3, 200e3, 210e3)]
    assert slope_scatter(lines) == (pytest.approx(200e3), 0.0)
    apart = [replace(line, error=0.03) for line in lines]
    assert slope_scatter(apart) == (200e3, 0.0), "Q of 5.6, which is chance"
    apart = [replace(line, error=0.02) for line in lines]
    assert slope_scatter(apart) == (200e3, pytest.approx((0.05**2 - 0.02**2 * 1.00167) ** 0.5, rel=1e-3)), "Q of 12.6"
    tests = (bar("a", 0, 3.0), bar("b", 1, 3.0), bar("c", 2, 0.02))
    assert elastic_modulus(study_of(tmp_path), *tests)[1] < 50.0


def test_the_joint_fit_and_its_judges_keep_to_what_is_told(tmp_path: Path) -> None:
    study = study_of(tmp_path)
    experiment = CouponExperiment(study, given=CouponData((bar(),), "strain"))
    base = Parameters.of({**experiment.start().values, **TRUTH}, experiment.joint_settings().free)
    joint = experiment.diagnosed(base)
    assert "E" in joint.base.free and within(study, base, joint.told).bounds("E") == joint.told["E"] == pytest.approx((194e3, 206e3))
    kept = within(study, base, joint.told)
    assert kept.bounds("M_y0") == study.bounds("M_y0") and kept.scale("E") == study.scale("E") and within(study, base, {}) is study
