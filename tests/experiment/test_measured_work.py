"""Temperature by the measured work: closed forms, the point driver where both mean the same, exact derivatives, signs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.experiment.coupon_model import coupon_model, coupon_run
from thermofit.experiment.coupon_records import CouponData, CouponTest
from thermofit.experiment.fields import TestPhase
from thermofit.experiment.measured_work import MeasuredCurve, with_measured_work
from thermofit.point.driver import PointHistory, PointSettings, Programme, simulate, simulate_rates
from thermofit.study.study import load_study

AIR = 296.0
TRUTH = Parameters.of(
    {
        **{"E": 200e3, "nu": 0.3, "M_y0": 400.0, "M_yinf": 400.0 + 1e-6, "H_exp": 1.0, "alpha_exp": 12e-6, "c0": 3.65, "beta": 0.8},
        **{"tau": 25.0, "lag": 0.6, "theta_air": AIR, "theta_ref": AIR},
    }
)
CAPACITY = 3.65 + 9.0 * 12e-6**2 * (200e3 / 1.2) * AIR
"""At constant pressure, mJ/(mm^3 K): c0 + 9 alpha^2 K theta."""
SETTINGS = PointSettings(model=1)
NAMES = ("E", "alpha_exp", "beta", "tau", "lag", "c0", "theta_air", "stored_energy.slope")


def cycle(n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Time s and strain: pulled, held, pushed, pulled again."""
    corners = np.array([[0.0, 0.0], [20.0, 0.015], [24.0, 0.015], [50.0, -0.012], [60.0, 0.02]])
    time = np.linspace(0.0, 60.0, n)
    return time, np.interp(time, *corners.T)


def heated(parameters: Parameters, work: MeasuredCurve) -> PointHistory:
    plain = simulate(parameters, Programme.by_strain(work.time, work.strain, AIR), SETTINGS)
    return with_measured_work(parameters, work, SETTINGS, (plain, None))[0]


def test_elastic_pull_cools_by_the_thermoelastic_law() -> None:
    """Adiabatic and uniaxial, d theta = -alpha theta d sigma / c_p, c_p = c0 + 9 alpha^2 K theta; a sensor with a lag shows it late."""
    time = np.linspace(0.0, 10.0, 200)
    parameters = TRUTH.replace(tau=1e9, lag=0.0)
    stress = 30.0 * time
    found = heated(parameters, MeasuredCurve(time, stress / 200e3, stress, AIR))
    assert found.theta - AIR == pytest.approx(-12e-6 * AIR * stress / CAPACITY, rel=4e-3, abs=1e-9)
    assert np.array_equal(found.theta, found.theta_sensor)
    late = heated(parameters.replace(lag=2.0), MeasuredCurve(time, stress / 200e3, stress, AIR)).theta_sensor - AIR
    slope = (found.theta[-1] - AIR) / 10.0
    assert late == pytest.approx(slope * (time - 2.0 * (1.0 - np.exp(-time / 2.0))), rel=1e-2, abs=1e-6)


def test_perfect_plasticity_is_the_point_driver() -> None:
    """Without hardening beta means the same in both: one temperature, apart from the intervals in which yielding begins."""
    time, strain = cycle(4000)
    law = simulate(TRUTH, Programme.by_strain(time, strain, AIR), SETTINGS)
    found = heated(TRUTH, MeasuredCurve(time, strain, law.stress, AIR))
    assert law.theta.max() - AIR > 1.0
    assert np.abs(found.theta - law.theta).max() < 2e-3
    assert np.abs(found.theta_sensor - law.theta_sensor).max() < 2e-3


def test_derivatives_are_exact() -> None:
    """Against central differences, for all that the temperature depends on, a dormant effect among them."""
    time, strain = cycle()
    work = MeasuredCurve(time, strain, simulate(TRUTH, Programme.by_strain(time, strain, AIR), SETTINGS).stress * 1.03, AIR)
    _, rates = with_measured_work(TRUTH, work, SETTINGS, simulate_rates(TRUTH, NAMES, Programme.by_strain(time, strain, AIR), SETTINGS))
    assert rates is not None
    for name in NAMES:
        h = 1e-5 * (TRUTH[name] or 1.0)
        there, back = (heated(TRUTH.replace(**{name: TRUTH[name] + x}), work).theta_sensor for x in (h, -h))
        slope = rates["theta_sensor"][:, NAMES.index(name)]
        assert np.abs(slope).max() > 0.0
        assert np.abs(slope - (there - back) / (2.0 * h)).max() < 1e-6 * np.abs(slope).max(), name


def test_no_hardening_law_reaches_the_temperature() -> None:
    """Parameters of flow change the stress of the law, and nothing of the temperature."""
    time, strain = cycle()
    work = MeasuredCurve(time, strain, 300.0 * np.sin(time / 6.0), AIR)
    soft = TRUTH.replace(M_y0=150.0, M_yinf=150.0 + 1e-6)
    assert np.array_equal(heated(TRUTH, work).theta, heated(soft, work).theta)
    assert not np.array_equal(heated(TRUTH, work).stress, heated(soft, work).stress)


def test_turned_signs_turn_the_thermoelastic_heat_only() -> None:
    """Tension for compression (1 / lambda, -tau): plastic heat stays, thermoelastic heat changes its sign."""
    time, strain = cycle()
    stress = simulate(TRUTH, Programme.by_strain(time, strain, AIR), SETTINGS).stress
    stretch = 1.0 + strain
    work, turned = MeasuredCurve(time, strain, stress, AIR), MeasuredCurve(time, 1.0 / stretch - 1.0, -stress * stretch**2, AIR)
    plastic = heated(TRUTH.replace(alpha_exp=0.0, c0=CAPACITY), work).theta - AIR
    one, other = (heated(TRUTH, w).theta - AIR for w in (work, turned))
    assert 0.5 * (one + other) == pytest.approx(plastic, abs=0.01 * plastic.max())
    odd = 0.5 * (one - other)
    assert odd[:30] == pytest.approx(-12e-6 * AIR * stress[:30] / CAPACITY, rel=0.2, abs=0.02), "cools in tension"
    assert np.abs(odd).max() > 0.3


def test_a_stress_that_cannot_be_is_refused() -> None:
    time, strain = cycle()
    with pytest.raises(NumericsError, match="no elastic stretch gives"):
        heated(TRUTH, MeasuredCurve(time, strain, np.full(len(time), -1e9), AIR))


def record(air: float) -> CouponTest:
    time, strain = cycle()
    hardening = TRUTH.replace(M_yinf=600.0, H_exp=40.0, theta_air=air, theta_ref=air)
    law = simulate(hardening, Programme.by_strain(time, strain, air), SETTINGS)
    theta = with_measured_work(hardening, MeasuredCurve(time, strain, law.stress, air), SETTINGS, (law, None))[0].theta_sensor
    return CouponTest(
        "a", time, strain, law.stress, theta, air, air, {"strain": 1e-7, "stress": 0.2, "theta": 0.01}, (TestPhase(0, 60, "x"),)
    )


def test_a_study_asks_for_it(tmp_path: Path) -> None:
    """coupon.heat: measured-work: the temperature is met although the hardening law is wrong; the air departs alike for all records."""
    tree = {
        "name": "work",
        "model": 1,
        "coupon": {
            "heat": "measured-work",
            "records": [{"file": "a.csv", "time": "t", "strain": "e", "stress": "s", "temperature": "c"}],
        },
        "parameters": {name: TRUTH[name] for name in ("E", "nu", "M_y0", "M_yinf", "H_exp", "alpha_exp", "c0", "beta", "tau", "lag")},
        "stages": {"thermal": {"free": ["beta", "tau", "theta_air"], "channels": {"dtheta": {}}}},
    }
    path = tmp_path / "work.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    study = load_study(path)
    data = CouponData((record(AIR), replace(record(AIR + 20.0), name="b")), "strain")
    settings = study.stage("thermal")
    base = TRUTH.with_free(settings.free)
    model = coupon_model(study, data, settings, base)
    assert np.abs(model.residual(base)).max() < 1e-9
    assert [(p.name, p.value, p.sigma) for p in model.priors] == [("theta_air", AIR, 0.1)]
    assert model.segments is not None and sum(model.segments) == len(model.residual(base))
    warmer = base.replace(theta_air=AIR + 0.3)
    assert model.residual(warmer)[-1] == pytest.approx(3.0)
    run = coupon_run(study, data, settings.free)
    rises = [run.parameters_of(warmer, test)["theta_air"] - test.theta_air for test in data.tests]
    assert rises == pytest.approx([0.3, 0.3])
    _, jacobian = model.linearised(base, settings.free)
    there, back = (model.residual(base.replace(theta_air=AIR + x)) for x in (1e-4, -1e-4))
    assert jacobian[:, 2] == pytest.approx((there - back) / 2e-4, rel=1e-6, abs=1e-6)
    law = load_study(path, ["coupon.heat=law"])
    assert np.abs(coupon_model(law, data, settings, base).residual(base)).max() > 10.0
