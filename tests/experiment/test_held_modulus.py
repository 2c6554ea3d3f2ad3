"""E of the elastic range stays where it is while the model misses more than noise, and what speaks against that."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from coupon_sets import TRUTH, pulled_record, study_of

from thermofit.core.parameters import Parameters
from thermofit.experiment.coupon import CouponExperiment
from thermofit.experiment.coupon_records import CouponData, CouponTest
from thermofit.study.study import Study

PLATEAU = {"yield_plateau.share": 0.9, "yield_plateau.length": 0.013}


def bar(name: str = "a", seed: int = 3, **law: float) -> CouponTest:
    return pulled_record(name, 1e-3, 293.15, seed, 1.0, 0.04, 120, **law)


def held(study: Study, *tests: CouponTest) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What is held of the joint fit that begins at the truth."""
    experiment = CouponExperiment(study, given=CouponData(tests, "strain"))
    settings = experiment.joint_settings()
    base = Parameters.of({**experiment.start().values, **TRUTH}, settings.free)
    return experiment.held(settings, base)


def test_a_modulus_that_its_elastic_range_has_told_stays_while_more_than_noise_is_missed(tmp_path: Path) -> None:
    names, said = held(study_of(tmp_path), bar(**PLATEAU))
    assert names == ("E",) and said[0].startswith("E stays at 2e+05 +- ") and "times its noise" in said[0]
    assert held(study_of(tmp_path), bar()) == ((), ()), "where nothing is missed all data tell it together"


def test_a_misfit_that_all_parameters_together_take_up_is_none(tmp_path: Path) -> None:
    """Another E than that of the truth, or another yield stress: one joint step makes up for it."""
    assert held(study_of(tmp_path), bar(E=203e3)) == ((), ()) and held(study_of(tmp_path), bar(M_y0=352.0)) == ((), ())


@pytest.mark.parametrize(
    ("study", "records"),
    [
        ({"stages": {"elastic": {"free": ["E"], "window": [0.0, 1.0]}, "plastic": {"free": ["M_y0", "M_yinf", "H_exp"]}}}, 1),
        ({"diagnosis": {"free": ["E", "M_y0", "M_yinf", "H_exp"]}}, 1),
        ({}, 2),
    ],
    ids=["a window by hand", "freed by the study", "elastic lines that scatter"],
)
def test_what_the_elastic_ranges_do_not_tell_or_the_study_frees_is_not_held(tmp_path: Path, study: dict[str, Any], records: int) -> None:
    others = (bar("b", 4, E=150e3, **PLATEAU),) if records == 2 else ()
    assert held(study_of(tmp_path, **study), bar(**PLATEAU), *others) == ((), ())


def test_the_diagnosed_problem_does_not_fit_what_is_held(tmp_path: Path) -> None:
    experiment = CouponExperiment(study_of(tmp_path), given=CouponData((bar(**PLATEAU), bar("b", 4, **PLATEAU)), "strain"))
    base = Parameters.of({**experiment.start().values, **TRUTH}, experiment.joint_settings().free)
    joint = experiment.diagnosed(base)
    assert joint.held == ("E",) and "E" not in joint.base.free and "E" not in joint.settings.free and len(joint.remarks) == 1
    whole = replace(experiment, given=CouponData((bar(),), "strain")).diagnosed(base)
    assert whole.held == () and "E" in whole.base.free and whole.remarks == ()
