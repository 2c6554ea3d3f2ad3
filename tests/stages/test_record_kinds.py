"""Coupons as people have them, through the command line: E prescribed, flow curves over plastic strain, records without an elastic range, a
strain across the load."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from record_studies import call

from thermofit.core.errors import StudyError
from thermofit.core.experiment import CouponRecord
from thermofit.core.parameters import Parameters
from thermofit.diagnose.unlisted import structured, unlisted
from thermofit.experiment import coupon_records as coupon_inputs
from thermofit.point.driver import PointSettings, Programme, simulate
from thermofit.records.artefact import open_record
from thermofit.stages import diagnose as stage
from thermofit.study.stages import ElasticStage, PlasticStage, coupon_stage
from thermofit.study.study import load_study

E, NU = 200e3, 0.3
LAW = {"E": E, "nu": NU, "M_y0": 300.0, "M_yinf": 500.0, "H_exp": 20.0}
STARTS = {
    "M_y0": {"start": 250.0, "bounds": [50.0, 1000.0]},
    "M_yinf": {"start": 600.0, "bounds": [100.0, 2000.0]},
    "H_exp": {"start": 10.0, "bounds": [0.1, 100.0]},
}
FREE_E = {"start": 150e3, "bounds": [1e5, 3e5]}

VOCE = ("M_y0", "M_yinf", "H_exp")
"""What the hardening law of the models of the thesis frees."""


def study(folder: Path, columns: dict[str, np.ndarray], record: dict[str, Any], **parameters: Any) -> Path:
    """A study on one record of the given columns."""
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(folder / "record.csv", table, delimiter=",", header=",".join(columns), comments="", fmt="%.12g")
    tree = {
        "name": "bar",
        "run_dir": str(folder / "run"),
        "model": 1,
        "coupon": {"records": [{"file": "record.csv", "initial_temperature_degC": 20.0, **record}]},
        "parameters": {**STARTS, "nu": NU, **parameters},
    }
    path = folder / "bar.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


def pulled(strain: np.ndarray, **law: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times s, stress MPa and strain across of a coupon that is pulled so at 1e-3 1/s; isothermal."""
    time = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(strain)))]) * 1e3
    parameters = Parameters.of({**LAW, **law, "tau": 1e-3, "theta_air": 293.15, "theta_ref": 293.15})
    found = simulate(parameters, Programme.by_strain(time, strain, 293.15), PointSettings(model=1))
    return time, found.stress, found.lateral_x


NAMED = {
    "time": {"column": "t", "unit": "s"},
    "strain": {"column": "e", "unit": "1"},
    "stress": {"column": "s", "unit": "MPa"},
    "noise": {"strain": 1e-7, "stress": 0.2},
}


def found_by(path: Path, *arguments: str) -> dict[str, Any]:
    result = call("run", path, "--json", *arguments)
    assert result.exit_code in (0, 5), result.output
    return dict(json.loads(result.stdout))


def elastic(path: Path) -> Any:
    return open_record(path.parent / "run" / "identify-elastic.h5")


def noisy(values: np.ndarray, sigma: float) -> np.ndarray:
    return values + sigma * np.random.default_rng(5).normal(size=len(values))


def test_a_prescribed_modulus_stays_prescribed(tmp_path: Path) -> None:
    """The record says 200 GPa, the study 185: without a start nothing replaces that; with one, or where the stage lists E, it is fitted."""
    strain = np.linspace(0.0, 0.03, 600)
    time, stress, _ = pulled(strain)
    columns = {"t": time, "e": strain, "s": noisy(stress, 0.2)}
    path = study(tmp_path, columns, NAMED, E=185e3)
    found = found_by(path)
    assert {"M_y0", "M_yinf", "H_exp"} == set(found["parameters"]), "E is none of the identified"
    record = elastic(path)
    assert record.parameters["E"].value == 185e3 and not record.parameters["E"].free
    assert record.summary["verdict"].startswith("nothing to identify: nothing is free: E is prescribed")
    assert open_record(tmp_path / "run" / "identify-plastic.h5").parameters["E"].value == 185e3
    assert call("report", path).exit_code == 0 and call("show", tmp_path / "run" / "identify-elastic.h5").exit_code == 0
    asked = found_by(path, "--set", "stages.elastic.free=[E]", "--until", "identify-elastic")
    assert asked["parameters"]["E"]["value"] == pytest.approx(E, rel=2e-3)
    started = found_by(study(tmp_path, columns, NAMED, E=FREE_E), "--until", "identify-elastic")
    assert started["parameters"]["E"]["value"] == pytest.approx(E, rel=2e-3)


def flow_curve(points: int = 60) -> dict[str, np.ndarray]:
    """True stress over logarithmic plastic strain of Voce's law, from the first plastic strain on."""
    e_p = np.linspace(0.0, 0.3, points) ** 1.5
    return {"ep": e_p, "sigma": 300.0 + 200.0 * -np.expm1(-20.0 * e_p)}


CURVE = {
    "rate": 1e-3,
    "strain": {"plastic_strain": "ep", "unit": "1"},
    "stress": {"true_stress": "sigma", "unit": "MPa"},
    "noise": {"strain": 1e-6, "stress": 1.0},
}


@pytest.mark.parametrize("modulus", [200e3, 120e3])
def test_flow_curves_over_plastic_strain(tmp_path: Path, modulus: float) -> None:
    """The elastic strain is added by whatever E is given, so that the hardening comes back and E is untouched."""
    path = study(tmp_path, flow_curve(), CURVE, E=modulus)
    found = found_by(path)
    for name in STARTS:
        assert found["parameters"][name]["value"] == pytest.approx(LAW[name], rel=3e-3), name
    read = open_record(tmp_path / "run" / "interpolate.h5")
    strain, stress = read["records/0/strain"].value, read["records/0/stress"].value
    assert strain[0] == pytest.approx(np.expm1(300.0 / modulus), rel=1e-9)
    assert np.log1p(strain[-1]) == pytest.approx(0.3**1.5 + flow_curve()["sigma"][-1] / modulus, rel=1e-9)
    assert stress[-1] * (1.0 + strain[-1]) == pytest.approx(flow_curve()["sigma"][-1], rel=1e-9)
    assert any("elastic strain of up to" in text for text in read.summary["remarks"])
    assert elastic(path).parameters["E"].value == modulus
    again = found_by(path, "--set", "parameters.E=190000", "--until", "interpolate")
    assert not next(step for step in again["steps"] if step["stage"] == "interpolate")["fresh"], "another E makes another strain"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"E": FREE_E}, "key 'parameters.E' is not prescribed, but record 'record' is a flow curve over plastic strain"),
        ({}, "key 'parameters.E' is not prescribed"),
        ({"E": 2e5, "stages": {"plastic": {"free": ["E", "M_y0"]}}}, "key 'stages.plastic.free' holds E, but record 'record' is a flow"),
        ({"E": 2e5, "diagnosis": {"free": ["E", "M_y0"]}}, "key 'diagnosis.free' holds E, but record 'record' is a flow curve"),
        ({"E": 2e5, "stress": {"column": "sigma", "unit": "MPa"}}, "key 'coupon.records.0.stress' is not a true stress"),
    ],
)
def test_what_a_flow_curve_cannot_tell_is_refused(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    record = {**CURVE, **{k: v for k, v in change.items() if k == "stress"}}
    path = study(tmp_path, flow_curve(), record, **{k: v for k, v in change.items() if k == "E"})
    tree = yaml.safe_load(path.read_text()) | {k: v for k, v in change.items() if k in ("stages", "diagnosis")}
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    result = call("interpolate", path)
    assert result.exit_code == 2 and said in " ".join(result.output.split()), result.output


def begins_in_flow() -> np.ndarray:
    return np.linspace(0.004, 0.08, 150)


def coarse() -> np.ndarray:
    return np.concatenate([[0.0], np.linspace(0.006, 0.1, 25)])


@pytest.mark.parametrize("strain", [begins_in_flow(), coarse()], ids=["begins in flow", "coarse"])
@pytest.mark.parametrize("given", [E, {"start": E, "bounds": [1e3, 3e5]}], ids=["number", "start"])
def test_records_without_an_elastic_range_get_no_modulus(tmp_path: Path, strain: np.ndarray, given: Any) -> None:
    """The hardening is straight for a while, too: it is no modulus and moves no strain. The chain goes on with the E of the study."""
    time, stress, _ = pulled(np.concatenate([[0.0], strain]) if strain[0] else strain)
    skip = int(strain[0] != 0.0)
    path = study(tmp_path, {"t": time[skip:] - time[skip], "e": strain, "s": noisy(stress[skip:], 0.2)}, NAMED, E=given)
    found = found_by(path)
    record = elastic(path)
    assert record.parameters["E"].value == E and not record.parameters["E"].free
    assert "nothing to identify" in record.summary["verdict"] and record.summary["trustworthy"]
    if isinstance(given, dict):
        assert "no record begins with an elastic range" in record.summary["verdict"] and "E = 200000 MPa" in record.summary["verdict"]
    for name in STARTS:
        assert found["parameters"][name]["value"] == pytest.approx(LAW[name], rel=0.02), name
    read = open_record(tmp_path / "run" / "interpolate.h5")
    assert read["records/0/strain"].value == pytest.approx(strain, abs=1e-12)
    assert found["channels"]["stress"]["chi2_reduced"] < 2.0


def test_a_modulus_that_is_not_given_is_asked_for(tmp_path: Path) -> None:
    strain = begins_in_flow()
    time, stress, _ = pulled(np.concatenate([[0.0], strain]))
    result = call("run", study(tmp_path, {"t": time[1:], "e": strain, "s": stress[1:]}, NAMED))
    assert result.exit_code == 2 and "key 'parameters.E' is missing" in " ".join(result.output.split())


@pytest.fixture
def across(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A record with the strain along the width of a sheet of nu = 0.3 and r-value F/H = 0.7/0.5; its extensometer begins off zero."""
    strain = np.concatenate([np.linspace(0.0, 0.006, 120), np.linspace(0.006, 0.06, 240)[1:]])
    time, stress, lateral = pulled(strain, F=0.7)
    read = coupon_inputs.read_coupon

    shown = noisy(lateral, 2e-6) + 3e-4
    shown[[7, 30, 31, 200]] = np.nan  # the camera lost it

    def with_lateral(*given: Any) -> tuple[CouponRecord, ...]:
        return tuple(replace(r, lateral=shown, noise={**r.noise, "lateral": 2e-6}) for r in read(*given))

    monkeypatch.setattr(coupon_inputs, "read_coupon", with_lateral)
    columns = {"t": time, "e": strain, "s": noisy(stress, 0.2)}
    starts: dict[str, Any] = {"nu": {"start": 0.4, "bounds": [0.0, 0.49]}, "F": {"start": 0.5, "bounds": [0.05, 5.0]}}
    low = {"M_y0": {"start": 120.0, "bounds": [50.0, 1000.0]}}  # below the elastic window, in which nothing flows
    path = study(tmp_path, columns, NAMED, E=FREE_E, **starts, **low)
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    both = {"stress": {}, "lateral": {}}
    tree["stages"] = {
        "elastic": {"free": ["E", "nu"], "channels": both},
        "plastic": {"free": ["M_y0", "M_yinf", "H_exp", "F"], "channels": both},
    }
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


def test_a_strain_across_the_load_tells_contraction_and_anisotropy(across: Path) -> None:
    """nu from the elastic range, F/H from the flow, stage by stage and then together; verify and report know the channel."""
    found = found_by(across)
    for name, true in {**LAW, "F": 0.7}.items():
        p = found["parameters"][name]
        assert p["value"] == pytest.approx(true, rel=1e-2) and p["sigma"] > 0.0, name
        assert abs(p["value"] - true) < 5.0 * p["sigma"] + 2e-3 * true, name
    assert found["channels"]["stress"]["chi2_reduced"] == pytest.approx(1.0, abs=0.2)
    assert found["channels"]["lateral"]["chi2_reduced"] == pytest.approx(1.0, abs=0.2)
    stages = [open_record(across.parent / "run" / f"identify-{stage}.h5").parameters["nu"] for stage in ("elastic", "plastic")]
    first, last = stages
    assert first.sigma is not None and last.sigma is not None and last.free and last.sigma < 0.2 * first.sigma, "told by all samples"
    assert last.lower == pytest.approx(0.97 * first.value) and last.upper == pytest.approx(1.03 * first.value)
    remarks = open_record(across.parent / "run" / "interpolate.h5").summary["remarks"]
    assert any("lateral strain is counted from where its elastic line meets zero stress: moved by -3.00e-04" in text for text in remarks)


def test_a_lateral_strain_is_diagnosed_with_the_others(across: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The joint fit compares both channels and holds E, nu and F; nothing is missing, and nothing is found. A term that is not told is
    said."""

    def untold(*given: Any, remark: Any) -> Any:
        remark("a heat source that is not away from nothing")
        return unlisted(*given)

    asked: list[Any] = []
    monkeypatch.setattr(stage, "unlisted", untold)
    monkeypatch.setattr(stage, "structured", lambda *given: asked.append(given) or structured(*given))
    found_by(across, "--until", "identify-plastic")
    result = call("diagnose", across, "--json")
    assert result.exit_code in (0, 5), result.output
    found = json.loads(result.stdout)
    assert {row["channel"] for row in found["lack_of_fit"]} == {"stress", "lateral"}
    assert not any(row["accepted"] for row in found["ranking"]), found["verdict"]
    assert found["unlisted"] is None and len(asked) == 1, "also of what no block shows"
    assert "a heat source that is not away from nothing" in found["remarks"]
    assert {"rate_power", "rate_logarithmic", "rate_by_temperature", "softening_power"} <= set(found["not_asked"])
    assert any("not asked for rate_power, rate_logarithmic: as measured, the records flow at one rate" in r for r in found["remarks"])


def test_a_lateral_strain_is_used_by_itself_where_the_study_gives_starts() -> None:
    """What a stage identifies by default: E, nu and F where they have a start, and the channel only where it tells one of them."""
    elastic, plastic = ElasticStage(), PlasticStage()
    made = {
        key: coupon_stage("bar.yaml", key, settings, "strain", hardening=VOCE, wanted=("E", "nu", "F"), lateral=True)
        for key, settings in (("elastic", elastic), ("plastic", plastic))
    }
    assert made["elastic"].free == ("E", "nu") and tuple(made["elastic"].channels) == ("stress", "lateral")
    assert made["plastic"].free == ("M_y0", "M_yinf", "H_exp", "F") and tuple(made["plastic"].channels) == ("stress", "lateral")
    plain = coupon_stage("bar.yaml", "elastic", elastic, "stress", hardening=VOCE, wanted=("E",), lateral=True)
    assert plain.free == ("E",) and tuple(plain.channels) == ("strain",)
    assert coupon_stage("bar.yaml", "elastic", elastic, "strain", hardening=VOCE, wanted=(), lateral=True).free == ()


def test_a_body_has_no_lateral_channel(tmp_path: Path) -> None:
    path = tmp_path / "body.yaml"
    path.write_text("name: body\nexperiment: raw\nstages: {plastic: {free: [M_y0], channels: {lateral: {}}}}\nparameters: {M_y0: 100}\n")
    with pytest.raises(StudyError, match=r"key 'stages.plastic.channels.lateral' is a channel of coupon records; expected strain or du"):
        load_study(path)
