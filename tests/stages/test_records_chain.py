"""Records of coupons through the command line: planted parameters come back, real records run to intervals."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from record_studies import FIXED, MECHANICAL, THERMAL, TRUTH, call, record, write_record

from thermofit.records.artefact import open_record

ROOT = Path(__file__).resolve().parents[2]
REAL = ("lp9", "c9", "hem320", "304l", "6061", "gl", "dp", "qp")


@pytest.fixture
def twin(tmp_path: Path) -> Path:
    """Two virtual coupons at two temperatures: one unloads, rests and is pulled on faster, one is cycled."""
    write_record(tmp_path / "pull.csv", [(0.0, 0.0), (60.0, 0.03), (64.0, 0.027), (120.0, 0.027), (124.0, 0.03), (134.0, 0.05)], 23.0, 1)
    write_record(tmp_path / "cycle.csv", [(0.0, 0.0), (40.0, 0.01), (80.0, -0.01), (100.0, 0.02), (160.0, 0.02)], 60.0, 2)
    tree = {
        "name": "twin",
        "run_dir": str(tmp_path / "run"),
        "model": 1,
        "coupon": {"records": [record("pull", 23.0), record("cycle", 60.0)]},
        "parameters": {
            "E": {"start": 180e3, "bounds": [1e5, 3e5]},
            "M_y0": {"start": 250.0, "bounds": [50.0, 1000.0]},
            "M_yinf": {"start": 700.0, "bounds": [100.0, 2000.0]},
            "H_exp": {"start": 8.0, "bounds": [0.1, 100.0]},
            "alpha_exp": {"start": 8e-6, "bounds": [0.0, 5e-5]},
            "beta": {"start": 0.6, "bounds": [0.0, 5.0]},
            "tau": {"start": 60.0, "bounds": [1.0, 1e5]},
            "lag": {"start": 0.3, "bounds": [0.0, 20.0]},
            **FIXED,
        },
        # Heat strains a held specimen: the last stage lets everything move together.
        "stages": {"thermal": {"free": [*MECHANICAL, *THERMAL], "channels": {"stress": {}, "dtheta": {}}}},
    }
    path = tmp_path / "twin.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


def test_planted_parameters_come_back_with_their_intervals(twin: Path) -> None:
    """The whole chain on two records: within four standard errors and 1 %, verified at the noise, exit 0; then all is fresh."""
    result = call("run", twin, "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    for name, true in TRUTH.items():
        p = found["parameters"][name]
        assert p["free"] and p["sigma"] > 0.0
        assert p["value"] == pytest.approx(true, rel=0.03 if name == "lag" else 0.01), name
        assert abs(p["value"] - true) < 4.5 * p["sigma"] + 2e-4 * true, name
    for channel in ("stress", "dtheta"):
        assert found["channels"][channel]["chi2_reduced"] == pytest.approx(1.0, abs=0.15)
    skipped = {step["stage"]: step["skipped"] for step in found["steps"] if "skipped" in step}
    assert skipped["calibrate-ir"] == "the experiment is a record of coupons"
    again = json.loads(call("run", twin, "--json").stdout)
    assert all(step["fresh"] for step in again["steps"] if "fresh" in step)


def test_commands_one_by_one(twin: Path) -> None:
    """Every command says what it did; show and report know the records; a missing stage names its command."""
    early = call("identify-plastic", twin)
    assert early.exit_code == 2 and "thermofit interpolate" in early.output
    shown = call("interpolate", twin)
    assert shown.exit_code == 0 and "pull" in shown.output and "2 records" in shown.output
    elastic = call("identify-elastic", twin, "--verbose")
    assert elastic.exit_code == 0 and "elastic range: pull up to" in elastic.output
    found = open_record(twin.parent / "run" / "identify-elastic.h5")
    assert found["covariance"].units == found["evaluations/x"].units == ("MPa",), "squares of MPa are no plain numbers"
    assert call("identify-plastic", twin).exit_code == 0
    assert "have not run" in (text := call("verify", twin).output) or "identify-thermal has not run" in text
    assert call("identify-thermal", twin).exit_code == 0
    verified = call("verify", twin)
    assert verified.exit_code == 0 and "pull: " in verified.output and "cycle: " in verified.output
    assert call("report", twin).exit_code == 0
    run_dir = twin.parent / "run"
    text = (run_dir / "report.md").read_text(encoding="utf-8")
    assert "| pull |" in text and "alpha_exp" in text and "independent" in text
    for name in ("stress-strain", "stress-time", "temperature", "objective", "correlation"):
        assert (run_dir / "figures" / f"{name}.png").stat().st_size > 5000
        assert f"figures/{name}.png" in text
    listed = json.loads(call("show", run_dir / "verify.h5", "--json").stdout)
    assert listed["channels"]["stress"]["n_independent"] > 0.5 * listed["channels"]["stress"]["n"], "noise alone does not remember"


def test_other_starts_and_other_values(twin: Path) -> None:
    """gridsearch and sensitivity take records as they take fields: one optimum from two starts; the capacity moves nothing mechanical."""
    tree = yaml.safe_load(twin.read_text(encoding="utf-8"))
    tree["gridsearch"] = {"stage": "plastic", "starts": [{"M_y0": 200.0, "H_exp": 30.0}, {"M_yinf": 900.0}]}
    tree["sensitivity"] = {"stage": "plastic", "quantity": "E", "values": [190e3, 205e3]}
    twin.write_text(yaml.safe_dump(tree), encoding="utf-8")
    for command in ("interpolate", "identify-elastic", "identify-plastic"):
        assert call(command, twin).exit_code == 0
    found = call("gridsearch", twin, "--json")
    assert found.exit_code == 0 and json.loads(found.stdout)["verdict"].startswith("unique: one optimum, 2 of 2 starts")
    moved = json.loads(call("sensitivity", twin, "--json").stdout)
    assert 0.001 < moved["largest_change"]["M_y0"] < 0.2


def test_a_missing_effect_is_said(twin: Path) -> None:
    """Heat that the model does not know (too small a fixed expansion): not verified, exit 5, and the misfit counts as few values."""
    arguments = ("--set", "parameters.alpha_exp=0", "--set", "stages.thermal.free=[beta, tau, lag]")
    result = call("run", twin, *arguments, "--json")
    assert result.exit_code == 5
    verdict = json.loads(result.stdout)
    assert "not verified: " in verdict["verdict"] and "dtheta is " in verdict["verdict"]
    remarks = [text for step in verdict["steps"] for text in step.get("remarks") or ()]
    assert any("misfit is that of the model" in text for text in remarks)


@pytest.fixture
def data_folder() -> Path:
    given = os.environ.get("THERMOFIT_DATA")
    if not given or not (Path(given) / "real").is_dir():
        pytest.skip("THERMOFIT_DATA is not set: the real records lie in its folder real/")
    return Path(given)


@pytest.fixture
def real_run(data_folder: Path, tmp_path: Path) -> Callable[[str], dict[str, Any]]:
    """The chain of a study on real records in a folder of the test; what it says as JSON."""

    def run(name: str) -> dict[str, Any]:
        result = call("run", ROOT / "configs" / f"real-{name}.yaml", "--run-dir", tmp_path / name, "--json")
        assert result.exit_code in (0, 5), result.output
        return dict(json.loads(result.stdout))

    return run


def test_lp9_cools_in_tension(real_run: Callable[[str], dict[str, Any]]) -> None:
    """The cyclic record with a sensor: Young's modulus of steel, expansion of its size and sign, a lag; the rest waits for backstress."""
    found = real_run("lp9")
    p = found["parameters"]
    assert 170e3 < p["E"]["value"] < 215e3
    assert 5e-6 < p["alpha_exp"]["value"] < 1.5e-5 and p["alpha_exp"]["sigma"] < 5e-6
    assert 0.1 < p["lag"]["value"] < 3.0
    assert found["verdict"].startswith("verify: not verified: stress")


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_real_records_run_to_intervals(real_run: Callable[[str], dict[str, Any]], name: str) -> None:
    """From native files to parameters with standard errors in less than two minutes."""
    found = real_run(name)
    assert found["wall_s"] < 120.0
    for parameter in ("E", "M_y0", "M_yinf", "H_exp"):
        p = found["parameters"][parameter]
        assert p["sigma"] is not None and p["sigma"] > 0.0, parameter
        assert not p["at_bound"], parameter
