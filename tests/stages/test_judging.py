"""validate and compare on records of coupons: a record that no fit has seen, models side by side, published values."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from record_studies import told

from thermofit.core.parameters import Parameters
from thermofit.point.driver import PointSettings, Programme, simulate

TRUTH = {"E": 198e3, "M_y0": 310.0, "M_yinf": 420.0, "H_exp": 80.0, "H_lin": 2000.0, "nu": 0.3, "c0": 3.65}
NOISE = {"strain": 2e-7, "stress": 0.4}
PULL = [(0.0, 0.0), (60.0, 0.03), (64.0, 0.027), (100.0, 0.05)]
CYCLE = [(0.0, 0.0), (40.0, 0.012), (80.0, -0.008), (100.0, 0.02)]
OTHER = [(0.0, 0.0), (30.0, 0.02), (40.0, 0.012), (90.0, 0.06)]


def write_record(path: Path, corners: list[tuple[float, float]], seed: int, **changes: float) -> None:
    times, strains = np.array(corners).T
    time = np.arange(0.0, times[-1], 0.5)
    strain = np.interp(time, times, strains)
    parameters = Parameters.of({**TRUTH, **changes, "theta_air": 296.0, "theta_ref": 296.0})
    found = simulate(parameters, Programme.by_strain(time, strain, 296.0), PointSettings(model=1))
    noise = np.random.default_rng(seed).normal(size=(2, len(time)))
    columns = [time, strain + NOISE["strain"] * noise[0], found.stress + NOISE["stress"] * noise[1]]
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",", header="time_s,strain,stress", comments="", fmt="%.9g")


def record(name: str, **more: Any) -> dict[str, Any]:
    return {
        "file": f"{name}.csv",
        "time": {"column": "time_s", "unit": "s"},
        "strain": {"column": "strain", "unit": "1"},
        "stress": {"column": "stress", "unit": "MPa"},
        "initial_temperature_degC": 22.85,
        "noise": NOISE,
        **more,
    }


def study(folder: Path, **changes: Any) -> Path:
    tree = {
        "name": "linear",
        "run_dir": str(folder / "run"),
        "model": 1,
        "coupon": {"records": [record("pull"), record("cycle"), record("other", held_out=True)]},
        "parameters": {
            "E": {"start": 190e3, "bounds": [1e5, 3e5]},
            "M_y0": {"start": 280.0, "bounds": [50.0, 390.0]},
            "M_yinf": {"start": 450.0, "bounds": [395.0, 2000.0]},
            "H_exp": {"start": 50.0, "bounds": [0.1, 500.0]},
            "H_lin": {"start": 1000.0, "bounds": [0.0, 9000.0]},
            "nu": 0.3,
            "c0": 3.65,
        },
        "stages": {"plastic": {"free": ["M_y0", "M_yinf", "H_exp", "H_lin"]}},
        "literature": {"E": [190e3, 210e3], "M_y0": {"value": 250.0, "sigma": 10.0, "source": "a data sheet"}},
        **changes,
    }
    path = folder / f"{tree['name']}.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two fitted records and one held out, identified with the right model."""
    place = tmp_path_factory.mktemp("judging")
    for number, (name, corners) in enumerate((("pull", PULL), ("cycle", CYCLE), ("other", OTHER))):
        write_record(place / f"{name}.csv", corners, number)
    path = study(place)
    for command in ("interpolate", "identify-elastic", "identify-plastic"):
        told(command, path)
    return place


def test_held_out_record_is_not_fitted_but_predicted(folder: Path) -> None:
    path = study(folder)
    seen = told("verify", path)
    unseen = told("validate", path)
    assert seen["verdict"].startswith("verified: stress") and unseen["verdict"].startswith("valid: stress")
    assert [row["record"] for row in seen["records"]] == ["pull", "cycle"]
    assert [row["record"] for row in unseen["records"]] == ["other"]
    assert unseen["channels"]["stress"]["n"] == 180 and unseen["channels"]["stress"]["chi2_reduced"] == pytest.approx(1.0, abs=0.3)
    for name in ("E", "M_y0", "H_lin"):
        p = unseen["parameters"][name]
        assert abs(p["value"] - TRUTH[name]) < 4.5 * p["sigma"], name


def test_another_material_is_not_valid(folder: Path, tmp_path: Path) -> None:
    write_record(tmp_path / "other.csv", OTHER, 7, M_yinf=430.0)
    records = [record("pull"), record("cycle"), {**record("other", held_out=True), "file": str(tmp_path / "other.csv")}]
    path = study(folder, coupon={"records": records}, name="another", run_dir=str(tmp_path / "run"))
    for command in ("interpolate", "identify-elastic", "identify-plastic"):
        told(command, path)
    found = told("validate", path, code=5)
    assert found["verdict"].startswith("not valid: stress is ") and found["trustworthy"] is False
    assert told("verify", path)["trustworthy"]


def test_published_values_stand_beside_those_found(folder: Path) -> None:
    rows = {row["parameter"]: row for row in told("verify", study(folder))["literature"]}
    assert rows["E"]["compared"] == "within" and rows["E"]["low"] == 190e3
    assert rows["M_y0"]["compared"].startswith("above 230 to 270 by ") and "standard errors" in rows["M_y0"]["compared"]
    assert rows["M_y0"]["source"] == "a data sheet" and rows["M_y0"]["value"] == pytest.approx(310.0, rel=0.02)


def test_the_right_model_is_preferred_by_criteria_and_held_out_record(folder: Path) -> None:
    """The model that lacks linear hardening misfits; one with an effect too many is as good, and costs its parameter."""
    candidates = {
        "no-linear": {"free": ["E", "M_y0", "M_yinf", "H_exp"], "parameters": {"H_lin": 0.0}},
        "too-many": {"add": ["rate_power"]},
    }
    found = told("compare", study(folder, compare=candidates))
    rows = {row["model"]: row for row in found["models"]}
    assert found["verdict"].startswith("linear is preferred and explains the data") and "no-linear is far worse" in found["verdict"]
    assert rows["linear"]["BIC - best"] == 0.0 and rows["no-linear"]["BIC - best"] > 10.0, rows
    assert rows["no-linear"]["stress over noise"] > 2.0 > 1.2 > rows["linear"]["stress over noise"]
    assert rows["no-linear"]["held out over noise"] > 2.0 * rows["linear"]["held out over noise"]
    assert rows["too-many"]["fitted"] == rows["linear"]["fitted"] + 1 and rows["too-many"]["AIC"] > rows["linear"]["AIC"] - 4.0
    assert 0.0 < rows["too-many"]["BIC - best"] < 12.0
    assert found["held_out"] == "record other, which no fit has seen"
    n = rows["linear"]["n_independent"]
    assert n == rows["no-linear"]["n_independent"] and 100.0 < n <= 400.0
    assert {row["parameter"] for row in found["fitted"]} == {"E", "M_y0", "M_yinf", "H_exp", "H_lin", "rate_power.K"}
    assert told("compare", study(folder, compare=candidates))["fresh"]


def test_other_studies_of_the_same_data_compete_and_of_others_are_refused(folder: Path, tmp_path: Path) -> None:
    plain = {"plastic": {"free": ["M_y0", "M_yinf", "H_exp"]}}
    first = study(folder)
    poor = study(folder, name="poor", run_dir=str(tmp_path / "poor"), stages=plain)
    text = yaml.safe_load(poor.read_text())
    text["parameters"]["H_lin"] = 0.0
    poor.write_text(yaml.safe_dump(text))
    for command in ("interpolate", "identify-elastic", "identify-plastic"):
        told(command, poor)
    found = told("compare", first, poor)
    assert found["verdict"].startswith("linear is preferred") and "poor is far worse" in found["verdict"]
    text["coupon"]["records"] = [record("pull"), record("other", held_out=True)]
    poor.write_text(yaml.safe_dump(text))
    for command in ("interpolate", "identify-elastic", "identify-plastic"):
        told(command, poor)
    assert "its data are not those of linear.yaml" in json.dumps(told("compare", first, poor, code=2))


def test_nothing_to_judge_is_one_sentence(folder: Path) -> None:
    path = study(folder, name="all", coupon={"records": [record("pull"), record("cycle")]})
    assert "nothing is held out; expected an entry with held_out: true under 'coupon.records'" in json.dumps(told("validate", path, code=2))
    assert "key 'compare' is missing" in json.dumps(told("compare", path, code=2))
    path = study(folder, name="none", coupon={"records": [record("pull", held_out=True)]})
    assert "are all held out" in json.dumps(told("validate", path, code=2))
