"""The residual of coupon records: exact derivatives, records of their own temperature, noise of both channels, what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from thermofit.core.errors import DataError, NumericsError, StudyError
from thermofit.core.experiment import CouponRecord
from thermofit.core.parameters import Parameters
from thermofit.experiment.coupon_model import coupon_model, observations, segments
from thermofit.experiment.coupon_records import CouponData, CouponTest, coupon_test
from thermofit.experiment.fields import TestPhase
from thermofit.identify.stage import memory_remarks
from thermofit.point.driver import PointSettings, Programme, simulate
from thermofit.study.study import Study, load_study

TRUTH = Parameters.of(
    {
        **{"E": 200e3, "nu": 0.3, "M_y0": 300.0, "M_yinf": 500.0, "H_exp": 30.0, "alpha_exp": 12e-6, "c0": 3.65, "beta": 1.2},
        **{"tau": 40.0, "lag": 0.7},
    }
)


def coupon(name: str, theta_air: float, strain: np.ndarray, *, hot: bool = True) -> CouponTest:
    """A record without noise of the truth at its own temperature."""
    time = np.linspace(5.0, 5.0 + 0.5 * len(strain), len(strain))
    truth = TRUTH.replace(theta_air=theta_air, theta_ref=theta_air + 0.5)
    found = simulate(truth, Programme.by_strain(time, strain, theta_air + 0.5), PointSettings(model=1))
    noise = {"strain": 1e-6, "stress": 0.3, "theta": 0.01}
    phases = (TestPhase(5.0, float(time[-1]), "loading"),)
    return CouponTest(name, time, strain, found.stress, found.theta_sensor if hot else None, theta_air, theta_air + 0.5, noise, phases)


def two_records() -> CouponData:
    """A monotonic record without temperature at 20 degC and one that reverses, with temperature, at 40 degC."""
    back = np.concatenate([np.linspace(0.0, 0.02, 300), np.linspace(0.02, 0.012, 100)[1:]])
    return CouponData((coupon("cold", 293.0, np.linspace(0.0, 0.03, 400), hot=False), coupon("warm", 313.0, back)), "strain")


def study(folder: Path, **changes: object) -> Study:
    tree = {
        "name": "coupons",
        "model": 1,
        "coupon": {"records": [{"file": "a.csv", "time": "t", "strain": "e", "stress": "s", "initial_temperature_degC": 20.0}]},
        "parameters": {name: TRUTH[name] for name in ("E", "nu", "M_y0", "M_yinf", "H_exp", "alpha_exp", "c0", "beta", "tau", "lag", "F")},
        **changes,
    }
    path = folder / "coupons.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return load_study(path)


def test_exact_jacobian_of_several_records(tmp_path: Path) -> None:
    """Against central differences of the residual; at the truth, with records at temperatures of their own, it vanishes in model 1."""
    free = ["E", "M_y0", "M_yinf", "H_exp", "alpha_exp", "beta", "tau", "lag"]
    made = study(tmp_path, stages={"thermal": {"free": free, "channels": {"stress": {}, "dtheta": {}}}})
    settings = made.stage("thermal")
    model = coupon_model(made, two_records(), settings, TRUTH.with_free(free))
    assert np.abs(model.residual(TRUTH)).max() < 1e-6
    assert model.segments == (399, 400, 399), "dtheta of the warm record, stress of both"
    away = TRUTH.replace(E=190e3, M_y0=320.0, tau=30.0, lag=0.9)
    residual, jacobian = model.linearised(away, tuple(free))
    assert residual == pytest.approx(model.residual(away), rel=1e-12, abs=1e-9)
    for k, name in enumerate(free):
        h = 1e-5 * away[name]
        difference = (model.residual(away.replace(**{name: away[name] + h})) - model.residual(away.replace(**{name: away[name] - h}))) / (
            2 * h
        )
        assert np.abs(jacobian[:, k] - difference).max() < 1e-5 * np.abs(jacobian[:, k]).max(), name


def test_stress_control_compares_the_strain(tmp_path: Path) -> None:
    made = study(tmp_path, coupon={**study(tmp_path).config_of("coupon")["coupon"], "control": "stress"})
    settings = made.stage("plastic")
    assert tuple(settings.channels) == ("strain",)
    data = CouponData(two_records().tests[:1], "stress")
    assert np.abs(coupon_model(made, data, settings, TRUTH).residual(TRUTH)).max() < 1e-3


def test_elastic_stage_uses_the_straight_part(tmp_path: Path) -> None:
    """E alone, from the elastic range of each record, without plastic flow."""
    made = study(tmp_path, parameters={**study(tmp_path).config_of("parameters")["parameters"], "E": {"start": 190e3}})
    settings = made.stage("elastic")
    assert settings.free == ("E",)
    model = coupon_model(made, two_records(), settings, TRUTH.with_free(("E",)))
    assert "elastic range: cold up to" in model.remark and "warm up to" in model.remark
    assert 10 < sum(model.segments or ()) < 60
    assert np.abs(model.residual(TRUTH)).max() < 1e-6


def test_noise_of_what_is_prescribed_counts() -> None:
    data = two_records()
    whole = [(float(t.time[0]), float(t.time[-1])) for t in data.tests]
    seen = observations(data, ["stress", "strain"], whole, 200e3)
    assert np.nanmax(seen["stress"].sigma) == pytest.approx(np.hypot(0.3, 0.2))
    assert np.nanmax(seen["strain"].sigma) == pytest.approx(np.hypot(1e-6, 0.3 / 200e3))
    assert np.all(np.diff(seen["stress"].time) > 0.0), "records follow one another"


def test_a_record_that_fails_is_named(tmp_path: Path) -> None:
    made = study(tmp_path, coupon={**study(tmp_path).config_of("coupon")["coupon"], "control": "stress"})
    data = CouponData(two_records().tests[:1], "stress")
    model = coupon_model(made, data, made.stage("plastic"), TRUTH)
    with pytest.raises(NumericsError, match=r"cold: material point: stress .* is not reached"):
        model.residual(TRUTH.replace(M_y0=100.0, M_yinf=120.0))


def test_windows_without_data(tmp_path: Path) -> None:
    made = study(tmp_path, stages={"plastic": {"free": ["M_y0"], "window": [500.0, 600.0]}})
    with pytest.raises(DataError, match="no record holds stress within the window"):
        coupon_model(made, two_records(), made.stage("plastic"), TRUTH)


@pytest.mark.parametrize(
    ("stage", "settings", "message"),
    [
        ("elastic", {"free": ["E", "nu"]}, "holds nu, which records of coupons do not determine without the channel lateral"),
        ("plastic", {"free": ["M_y0", "F"]}, "holds F, which"),
        ("plastic", {"channels": {"du": {}}}, "stages.plastic.channels' holds du; records of coupons have stress"),
        ("plastic", {"channels": {"strain": {}}}, "holds strain, which is prescribed"),
    ],
)
def test_what_a_coupon_cannot_say(tmp_path: Path, stage: str, settings: dict[str, object], message: str) -> None:
    with pytest.raises(StudyError, match=message):
        study(tmp_path, stages={stage: settings}).stage(stage)


def test_memory_is_told(tmp_path: Path) -> None:
    made = study(tmp_path)
    model = coupon_model(made, two_records(), made.stage("plastic"), TRUTH)
    (said,) = memory_remarks(model, model.residual(TRUTH.replace(M_y0=330.0)))
    assert said.startswith("stress: 799 values count as ")
    assert float(said.split("count as ")[1].split()[0]) < 60.0
    assert segments(model.comparisons, two_records()) == (400, 399)


def test_strain_is_counted_from_the_elastic_line() -> None:
    """A record whose extensometer starts off zero is moved, and says so; one that is right is left alone."""
    test = two_records().tests[0]
    for offset in (0.0, 4e-4):
        record = CouponRecord("bar", test.time, test.strain + offset, test.stress, None, 293.0, dict(test.noise), (), (), 293.5)
        ready, remarks = coupon_test(record)
        assert np.abs(ready.strain - test.strain).max() < 2e-5
        assert any("moved by" in text for text in remarks) == (offset > 0.0)
        assert ready.theta_start == 293.5 and ready.phases[0].label == "loading"


def test_a_zero_below_the_noise_of_one_strain_is_told_by_the_line() -> None:
    """Thirty samples tell the zero to a fifth of the noise of one. The model goes through zero: left there, it has another slope."""
    test = two_records().tests[0]
    noise = {"strain": 2e-4, "stress": 1.0}
    for shift, moved in ((3e-4, True), (2e-5, False)):
        record = CouponRecord("bar", test.time, test.strain + shift, test.stress, None, 293.0, dict(noise))
        ready, remarks = coupon_test(record)
        assert any("moved by" in text for text in remarks) == moved
        assert abs(float(np.mean(ready.strain - test.strain))) < (3e-5 if moved else 5e-5)


def test_the_elastic_stage_takes_all_samples_of_a_first_loading(tmp_path: Path) -> None:
    """Of a thinned record with three samples in its elastic range; E and the record of `interpolate` are those of all."""
    test = two_records().tests[0]
    line = test.line
    assert line is not None
    kept = np.union1d([0, line.begin, (line.begin + line.end) // 2, line.end], np.arange(line.end + 20, len(test.time), 20))
    few = replace(test, time=test.time[kept], strain=test.strain[kept], stress=test.stress[kept], theta=None)
    assert few.line is None
    thin = replace(few, first_loading=replace(test, theta=None))
    made, data = study(tmp_path), CouponData((thin,), "strain")
    assert thin.line is not None and thin.line.slope == line.slope
    model = coupon_model(made, data, made.stage("elastic"), TRUTH)
    assert sum(c.n for c in model.comparisons) == line.samples
    assert sum(c.n for c in coupon_model(made, data, made.stage("plastic"), TRUTH).comparisons) == len(kept)


@pytest.mark.parametrize(("noise", "own"), [(1e-6, True), (2e-4, False)])
def test_a_bend_is_told_by_what_thinning_has_left_and_noise_by_all_samples(noise: float, own: bool) -> None:
    """Records of one bend, of an even machine and of one that starts slowly, with nine tenths of its samples below three quarters of the
    stress. Where they bend more than they are noisy, slope and zero are the same."""
    lines = []
    for slow in (1.0, 3.0):
        stress = 350.0 * np.linspace(0.0, 1.0, 6000) ** slow
        strain = stress / 200e3 + 1e-4 * (stress / 200.0) ** 2 + 0.05 * np.clip(stress / 300.0 - 1.0, 0.0, None) ** 2
        strain = strain + noise * np.random.default_rng(9).normal(size=6000)
        every = CouponRecord("bar", np.arange(6000.0), strain, stress, None, 293.0, {"strain": noise, "stress": 0.1})
        kept = np.searchsorted(stress, np.linspace(0.0, 350.0, 300)).clip(0, 5999)
        thin = replace(every, time=every.time[kept], strain=strain[kept], stress=stress[kept], first_loading=every)
        test, _ = coupon_test(thin)
        assert test.line is not None and (test.elastic is test) is own
        lines.append((test.line.slope, float(np.mean(test.strain - strain[kept]))))
    if own:
        assert lines[1][0] == pytest.approx(lines[0][0], rel=1e-3)
        assert lines[1][1] == pytest.approx(lines[0][1], abs=1e-6)


def test_noisy_small_steps_are_remarked() -> None:
    test = two_records().tests[0]
    record = CouponRecord("bar", test.time, test.strain, test.stress, None, 293.0, {"strain": 1e-3, "stress": 1.0})
    assert any("thin the record" in text for text in coupon_test(record)[1])
