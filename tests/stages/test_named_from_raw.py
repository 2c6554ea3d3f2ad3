"""From raw files to a named effect: one small body and one coupon record, whose models lack an effect that their data hold."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tiny
import yaml
from record_studies import FIXED, NOISE, TRUTH, call

from thermofit.core.experiment import CELSIUS
from thermofit.core.parameters import Parameters
from thermofit.point.driver import PointSettings, Programme, simulate
from thermofit.study.study import Study

PLANTED = {"second_hardening.Q": 60.0, "second_hardening.b": 90.0}


def test_a_body_that_expands_is_told_so(study_of: Callable[..., Study]) -> None:
    """Tension cools a metal that expands with temperature, and warm metal is longer; the model knows neither."""
    study = study_of(
        "parameters.alpha_exp=0",
        f"parameters.kappa={tiny.TRUTH['kappa']}",
        "stages.thermal.free=[c0,beta]",
        "diagnosis.free=[c0,beta]",
        "diagnosis.max_effects=1",
    )
    for name in ("identify-elastic", "identify-plastic", "identify-thermal"):
        tiny.stage_run(name)(study, force=True)
    found = tiny.stage_run("close-loop")(study).record.summary
    assert found["accepted"] == ["thermal_expansion"], found["verdict"]
    trial = next(t for t in found["rounds"][0]["tried"] if t["accepted"])
    assert trial["estimate"]["alpha_exp"]["value"] == pytest.approx(tiny.TRUTH["alpha_exp"], rel=0.1)
    assert found["after"]["held_out"]["dtheta"] < 0.5 * found["before"]["held_out"]["dtheta"]


def test_a_coupon_that_hardens_twice_is_told_so(tmp_path: Path) -> None:
    """One record of a pull, in percent and MPa; the base model knows one hardening term."""
    time = np.linspace(0.0, 100.0, 300)
    strain = 0.08 * (time / 100.0) ** 1.5
    parameters = Parameters.of({**TRUTH, **FIXED, **PLANTED, "theta_air": 23.0 + CELSIUS, "theta_ref": 23.0 + CELSIUS})
    stress = simulate(parameters, Programme.by_strain(time, strain, 23.0 + CELSIUS), PointSettings(model=1)).stress
    noise = np.random.default_rng(3).normal(size=(2, len(time)))
    columns = [time, 100.0 * (strain + NOISE["strain"] * noise[0]), stress + NOISE["stress"] * noise[1]]
    np.savetxt(tmp_path / "pull.csv", np.stack(columns, axis=1), delimiter=",", header="time,strain,stress", comments="", fmt="%.9g")
    record = {
        **{"file": "pull.csv", "time": {"column": "time", "unit": "s"}, "strain": {"column": "strain", "unit": "%"}},
        **{"stress": {"column": "stress", "unit": "MPa"}, "initial_temperature_degC": 23.0},
    }
    bounds = {"E": (190e3, 1e5, 3e5), "M_y0": (300.0, 50.0, 1000.0), "M_yinf": (580.0, 100.0, 2000.0), "H_exp": (12.0, 0.1, 100.0)}
    thermal = {name: TRUTH[name] for name in ("alpha_exp", "beta", "tau")}
    tree = {
        **{"name": "twice", "run_dir": str(tmp_path / "run"), "model": 1, "coupon": {"records": [record]}},
        "parameters": {**FIXED, **thermal, **{n: {"start": s, "bounds": [low, high]} for n, (s, low, high) in bounds.items()}},
        "diagnosis": {"max_effects": 1},
    }
    study = tmp_path / "twice.yaml"
    study.write_text(yaml.safe_dump(tree), encoding="utf-8")
    result = call("close-loop", study, "--json")
    assert result.exit_code in (0, 5), result.output
    found = json.loads(result.stdout)
    (name,) = found["accepted"]
    trial = next(t for t in found["rounds"][0]["tried"] if t["accepted"])
    assert "second_hardening" in (name, *trial["family"]), found["verdict"]
    assert found["after"]["fit"]["stress"] < 1.05 * NOISE["stress"] < 2.0 * NOISE["stress"] < found["before"]["fit"]["stress"]
