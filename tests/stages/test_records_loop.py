"""Diagnosis of coupon records through the command line: bad input is one sentence, and
what real records hold is named."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from pulled import HEAT, pulled_study
from record_studies import MECHANICAL, call

from thermofit.diagnose.prepared import freed_effects

ROOT = Path(__file__).resolve().parents[2]
Loop = Callable[..., dict[str, Any]]


@pytest.fixture
def pulled(tmp_path: Path) -> Path:
    """A study on one monotonic virtual record with temperature, whose model has no thermal expansion."""
    return pulled_study(tmp_path, (*HEAT, "theta_air"), alpha_exp=0.0)


@pytest.mark.parametrize(
    ("starts", "gamma", "said"),
    [
        ({"backstress_first.C": 500.0, "second_hardening.Q": 5.0}, 60.0, "backstress_first and second_hardening"),
        ({"backstress_second.C": 500.0, "H_lin": 50.0}, 0.0, "backstress_second and linear_hardening"),
    ],
    ids=["effects", "mechanism of the base law"],
)
def test_two_effects_of_one_family_are_not_freed_together(pulled: Path, starts: dict[str, float], gamma: float, said: str) -> None:
    """In monotonic tension a backstress is isotropic hardening, without recall linear hardening, which the base law has."""
    tree = yaml.safe_load(pulled.read_text(encoding="utf-8"))
    tree["parameters"] |= {name: {"start": start, "bounds": [0.0, 1e4 if start > 100.0 else 200.0]} for name, start in starts.items()}
    tree["parameters"] |= {"backstress_first.gamma": gamma, "backstress_second.gamma": gamma, "second_hardening.b": 60.0}
    tree["diagnosis"] = {"free": [*MECHANICAL, *starts], "channels": ["stress"]}
    pulled.write_text(yaml.safe_dump(tree), encoding="utf-8")
    result = call("diagnose", pulled)
    assert result.exit_code == 5 and "Traceback" not in result.output, result.output
    assert f"frees {said}, whose influence this test cannot tell apart" in " ".join(result.output.split())


def test_what_the_stages_identify_as_a_rule_is_fitted_together() -> None:
    """Films, conductivity and expansion are alike in most tests; only what a study frees beyond its stages is held to the rule."""
    free = ("E", "M_yinf", "kappa", "alpha_exp", "alpha_air", "alpha_clamp@second", "H_lin", "G", "L", "backstress_second.C")
    assert freed_effects(free[:6]) == {}
    assert freed_effects(free) == {"linear_hardening": [6], "hill_anisotropy": [7, 8], "backstress_second": [9]}
    assert freed_effects(("ir_drift.rate@second", "lamp.start")) == {"ir_drift@second": [0]}, "a Param that is scanned is no amplitude"


def test_a_fit_that_has_not_converged_is_not_diagnosed(pulled: Path) -> None:
    result = call("close-loop", pulled, "--set", "stages.plastic.max_evaluations=3", "--set", "parameters.M_y0.start=60")
    assert result.exit_code == 5, result.output
    assert "identify-plastic has not converged" in " ".join(result.output.split())


def test_fewer_independent_data_than_parameters_are_refused(pulled: Path) -> None:
    """A law far off leaves a misfit that hangs together: hundreds of values, worth fewer than the parameters."""
    names = "[E, M_y0, M_yinf, H_exp, beta, tau, lag]"
    arguments = ("--set", "stages.plastic.free=[H_exp]", "--set", "parameters.M_y0.start=200", "--set", f"diagnosis.free={names}")
    result = call("diagnose", pulled, *arguments, "--set", "diagnosis.channels=[stress]")
    assert result.exit_code == 5, result.output
    assert "independent ones" in " ".join(result.output.split()) and "free fewer" in " ".join(result.output.split())


@pytest.fixture
def real_loop(tmp_path: Path) -> Loop:
    """`close-loop` of a study on real records, from the native files on; what it says as JSON."""
    given = os.environ.get("THERMOFIT_DATA")
    if not given or not (Path(given) / "real").is_dir():
        pytest.skip("THERMOFIT_DATA is not set: the real records lie in its folder real/")

    def run(name: str, *arguments: str) -> dict[str, Any]:
        result = call("close-loop", ROOT / "configs" / f"real-{name}.yaml", "--run-dir", tmp_path / name, "--json", *arguments)
        assert result.exit_code in (0, 5), result.output
        return dict(json.loads(result.stdout))

    return run


def first(found: dict[str, Any]) -> str:
    """The effect named first."""
    return str(found["ranking"][0]["effect"])


def tried(found: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """All trials of an effect, round by round."""
    return [trial for turn in found["rounds"] for trial in turn["tried"] if trial["effect"] == name]


def halved(found: dict[str, Any], channel: str) -> bool:
    return bool(found["after"]["held_out"][channel] < 0.5 * found["before"]["held_out"][channel])


@pytest.mark.slow
def test_lp9_expands(real_loop: Loop) -> None:
    """Thermal expansion, absent from the model, is named first by the temperature; its coefficient is that of steel."""
    found = real_loop("lp9-temperature")
    assert first(found) == "thermal_expansion" and found["accepted"][0] == "thermal_expansion"
    assert halved(found, "dtheta")
    last = tried(found, "thermal_expansion")[-1]["estimate"]["alpha_exp"]
    assert 10e-6 < last["value"] < 13e-6 and last["sigma"] < 2e-6


@pytest.mark.slow
@pytest.mark.parametrize("turned", ["both", "stress"])
def test_lp9_with_the_sign_turned_does_not_expand(real_loop: Loop, tmp_path: Path, turned: str) -> None:
    """Tension taken for compression, in both channels or in the stress alone: no positive coefficient, whatever else is said."""
    tree = yaml.safe_load((ROOT / "configs" / "real-lp9-temperature.yaml").read_text(encoding="utf-8"))
    own = tree["coupon"]["records"][0]
    if turned == "both":
        own["tension"] = "positive"
    else:
        own["stress"]["tension"] = "positive"
    study = tmp_path / "turned.yaml"
    study.write_text(yaml.safe_dump(tree), encoding="utf-8")
    result = call("close-loop", study, "--run-dir", tmp_path / "run", "--json")
    assert result.exit_code in (0, 3, 5), result.output
    if turned == "stress":
        assert result.exit_code == 3 and "straight line" in result.output, "a record whose stress falls with the strain has no modulus"
        return
    found = json.loads(result.stdout)
    assert "thermal_expansion" not in found["accepted"]
    row = next(r for r in found["ranking"] if r["effect"] == "thermal_expansion")
    assert row["estimate"]["alpha_exp"]["value"] < 0.0 and "outside" in row["remark"]


@pytest.mark.slow
def test_hem320_has_backstress(real_loop: Loop) -> None:
    found = real_loop("hem320")
    assert first(found).startswith("backstress") and found["accepted"][0].startswith("backstress")
    assert found["after"]["held_out"]["stress"] < 0.75 * found["before"]["held_out"]["stress"]


@pytest.mark.slow
def test_304l_depends_on_rate(real_loop: Loop) -> None:
    """Seven decades of rate; named and added although bars of one rate differ by as much as two decades."""
    found = real_loop("304l")
    assert any(name.startswith("rate_") for name in found["accepted"])
    trial = next(t for t in (tried(found, "rate_logarithmic") or tried(found, "rate_power")) if t["accepted"])
    assert all(p["value"] > 2.0 * p["sigma"] for p in trial["estimate"].values())


@pytest.mark.slow
def test_6061_softens_with_temperature_and_knows_no_rate(real_loop: Loop) -> None:
    found = real_loop("6061")
    assert first(found) == "thermal_softening" and found["accepted"][0] == "thermal_softening"
    assert not any(name.startswith("rate_") for name in found["accepted"])
    assert tried(found, "thermal_softening")[0]["estimate"]["thermal_softening.slope"]["value"] > 1e-3


@pytest.mark.slow
def test_gl_has_a_plateau(real_loop: Loop) -> None:
    found = real_loop("gl-25")
    assert found["accepted"][0] == "yield_plateau" and halved(found, "stress")
    assert 0.5 < tried(found, "yield_plateau")[0]["estimate"]["yield_plateau.share"]["value"] < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dp", "qp"])
def test_dual_phase_and_partitioned_steels_have_no_plateau(real_loop: Loop, name: str) -> None:
    """Smooth curves: what is added is hardening; the plateau is neither added nor named among what it could be."""
    found = real_loop(name)
    assert found["accepted"] and "yield_plateau" not in found["accepted"]
    assert "yield_plateau" not in found["verdict"]
