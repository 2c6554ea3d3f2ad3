"""The verdict on made-up walls and coupons: what moves together, what is at a bound, what an error of the prescribed does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up import WALL_NAMES, WALL_TRUTH, wall_model, wall_observations
from repeated_coupon import FREE, TRUTH, bench, intervals

from thermofit.experiment.coupon import planned_records
from thermofit.experiment.coupon_model import coupon_model
from thermofit.experiment.coupon_records import CouponData
from thermofit.fit.information import Flat, Invariant
from thermofit.identify.identifiability import analysed, mend, relation
from thermofit.identify.intervals import allowed_rises, laplace
from thermofit.identify.linear import Linear, Shift, linear_of, moved
from thermofit.observe.comparison import plain


def wall(names: tuple[str, ...] = WALL_NAMES, before: bool = True, **bounds: tuple[float, float]) -> Linear:
    observations = wall_observations()
    model = wall_model((plain(observations["u"]), plain(observations["theta"])), observations)
    base = WALL_TRUTH.with_free(names)
    residual, jacobian = model.linearised(base, names)
    x = base.vector()
    low = np.array([bounds.get(name, (0.0, 0.0))[0] for name in names])
    high = np.array([bounds.get(name, (0.0, 1e9))[1] for name in names])
    return Linear(model, base, names, x, low, high, np.abs(x), np.abs(x), residual, jacobian, before)


def test_unique_wall_and_its_standard_errors() -> None:
    linear = wall()
    analysis = analysed(linear)
    assert analysis.kind == "unique" and analysis.verdict.startswith("unique: the data determine E, nu, kappa, alpha_clamp")
    sigma = np.sqrt(np.diag(np.linalg.inv(linear.jacobian.T @ linear.jacobian)))
    assert analysis.sigma == pytest.approx(sigma, rel=1e-6)
    half = laplace(linear, analysis)["E"]
    assert half.high - half.low == pytest.approx(2 * 1.96 * sigma[0], rel=1e-3)
    assert allowed_rises(linear, analysis) == pytest.approx(3.841, rel=1e-3)


def test_parameter_that_is_not_felt() -> None:
    linear = wall()
    jacobian = linear.jacobian.copy()
    jacobian[:, 2] = 0.0
    analysis = analysed(replace(linear, jacobian=jacobian))
    assert analysis.kind == "undetermined" and "kappa is not determined (+- any amount)" in analysis.verdict
    assert analysis.fixing == (("kappa",),)
    interval = laplace(linear, analysis)["kappa"]
    assert interval.open_low and interval.open_high and interval.high == 1e9


def test_valley_of_two() -> None:
    linear = wall()
    jacobian = linear.jacobian.copy()
    jacobian[:, 3] = -jacobian[:, 2] * linear.x[2] / linear.x[3]
    analysis = analysed(replace(linear, jacobian=jacobian))
    assert analysis.kind == "valley" and "kappa, alpha_clamp can move together (the model leaves it open)" in analysis.verdict
    assert "alpha_clamp/kappa" in analysis.verdict or "kappa/alpha_clamp" in analysis.verdict
    assert "fix one of" in analysis.verdict


@pytest.mark.parametrize(("sigma", "kind"), [(0.05, "unique"), (0.3, "weak"), (0.95, "weak"), (1.1, "valley"), (20.0, "valley")])
def test_a_direction_is_weak_from_ten_per_cent_and_a_valley_from_a_factor_e(sigma: float, kind: str) -> None:
    """Two columns that differ by so little that a common change of both parameters is told to `sigma`."""
    linear = wall()
    jacobian = linear.jacobian.copy()
    apart = np.linalg.qr(jacobian)[0][:, 3]  # what neither of the others does
    jacobian[:, 3] = (-jacobian[:, 2] * linear.x[2] + np.sqrt(2.0) / sigma * apart) / linear.x[3]
    analysis = analysed(replace(linear, jacobian=jacobian))
    assert analysis.spectrum.sigma.max() == pytest.approx(sigma, rel=0.01)
    assert analysis.kind == kind and analysis.verdict.startswith("weak: one optimum, but " if kind == "weak" else f"{kind}: ")
    assert (analysis.fixing == ((),)) == (kind == "unique")
    if kind != "unique":
        assert "kappa, alpha_clamp can move together" in analysis.verdict and "fix one of" in analysis.verdict


@pytest.mark.parametrize(("scale", "kind", "said"), [(0.3, "weak", "hardly"), (5.0, "undetermined", "not")])
def test_a_single_parameter_that_is_told_poorly(scale: float, kind: str, said: str) -> None:
    linear = wall()
    jacobian = linear.jacobian.copy()
    jacobian[:, 2] = np.linalg.qr(jacobian)[0][:, 2] / (scale * linear.x[2])
    analysis = analysed(replace(linear, jacobian=jacobian))
    assert analysis.kind == kind and f"kappa is {said} determined" in analysis.verdict


def test_what_is_told_poorly_makes_no_valley_of_what_is_not_felt() -> None:
    linear = wall()
    jacobian = linear.jacobian.copy()
    apart = np.linalg.qr(jacobian)[0][:, 1]
    jacobian[:, 1] = (-jacobian[:, 0] * linear.x[0] + 5.0 * apart) / linear.x[1]
    jacobian[:, 2] = 0.0
    analysis = analysed(replace(linear, jacobian=jacobian))
    assert analysis.kind == "undetermined" and len(analysis.spectrum.flat) == 2


def test_parameter_at_a_bound_closes_the_valley() -> None:
    """At the optimum a parameter on its bound is held there; before a test nothing is."""
    linear = wall(before=False, kappa=(130.0, 1e3))
    jacobian = linear.jacobian.copy()
    jacobian[:, 3] = jacobian[:, 2] * linear.x[2] / linear.x[3]
    found = analysed(replace(linear, jacobian=jacobian))
    assert found.kind == "unique" and found.names == ("E", "nu", "alpha_clamp") and "kappa at its bound and held there" in found.verdict
    assert analysed(replace(linear, jacobian=jacobian, before=True)).kind == "valley"


def test_move_by_something_prescribed() -> None:
    """An error of the data that a change of E by one percent would make moves E by minus that."""
    linear = wall()
    shift = Shift(0.01 * linear.x[0] * linear.jacobian[:, 0], "a test")
    assert moved(linear, shift) == pytest.approx([-0.01, 0.0, 0.0, 0.0], abs=1e-9)


def test_words() -> None:
    product = Invariant("a", -1.0, -1, 0.0, 0.01)
    power = Invariant("c", 0.5, None, np.inf, 0.02)
    text = relation(Flat(np.ones(3), 4.0, False, ("a", "b", "c"), "b", (product, power)))
    assert text == "a, b, c can move together (+- 4e+02 % along it); constant along it: a*b, c/b^0.5, which the data give to 2 %"
    assert mend((("a",), ("b",))) == "fix one of a, b" and mend((("a", "b"), ("a", "c"))) == "fix {a, b} or {a, c}"


def test_planned_coupon_predicts_what_a_repeat_finds(tmp_path: Path) -> None:
    """The plan of the record's own programme has the standard errors of a fit to noisy data, and its residual is zero."""
    made = bench(tmp_path, 200)
    settings = made.study.stage("plastic")
    data = planned_records(made.study, CouponData((made.test,), "strain"), "own", TRUTH)
    linear = linear_of(made.study, settings, coupon_model(made.study, data, settings, TRUTH), TRUTH, True)
    assert np.abs(linear.residual).max() < 1e-6
    analysis = analysed(linear)
    found = intervals(made, 0.0, 11, profile=False)["laplace"]
    for i, name in enumerate(FREE):
        assert found[name].high - found[name].low == pytest.approx(2 * 1.96 * analysis.sigma[i], rel=0.25)


def test_planned_coupon_of_a_named_programme(tmp_path: Path) -> None:
    """Half as much strain tells less of where hardening ends; cycles go into compression; the record's own response is not used."""
    made = bench(tmp_path, 200)
    silent = replace(made.test, stress=np.full(200, 1e3))
    cycles = planned_records(made.study, CouponData((silent,), "strain"), "cycles", TRUTH).tests[0]
    assert cycles.strain.min() == pytest.approx(-cycles.strain.max()) and cycles.strain.max() == pytest.approx(0.06)
    assert cycles.stress.min() < -300.0 and cycles.stress.max() < 700.0 and cycles.name == "cycles"
