"""From raw files to a named effect, and to a term without a name where the catalogue does not hold it: small enough for every run."""

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
from thermofit.experiment import coupon
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


def hardens_twice(tmp_path: Path) -> Path:
    """Study of one record of a pull, in percent and MPa; the base model knows one hardening term, the record holds two."""
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
    return study


def test_a_coupon_that_hardens_twice_is_told_so(tmp_path: Path) -> None:
    result = call("close-loop", hardens_twice(tmp_path), "--json")
    assert result.exit_code in (0, 5), result.output
    found = json.loads(result.stdout)
    (name,) = found["accepted"]
    trial = next(t for t in found["rounds"][0]["tried"] if t["accepted"])
    assert "second_hardening" in (name, *trial["family"]), found["verdict"]
    assert found["after"]["fit"]["stress"] < 1.05 * NOISE["stress"] < 2.0 * NOISE["stress"] < found["before"]["fit"]["stress"]


IMITATE = ("second_hardening", "backstress_first", "backstress_second", "linear_hardening", "yield_plateau")
"""What a single pull cannot tell from a second hardening, or can in part."""


def test_an_effect_that_is_taken_out_of_the_catalogue_is_unlisted_and_no_other_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Knock-out: the record hardens twice, and nothing that hardens is in the catalogue. The missing term is a stress."""
    whole = coupon.effects_of_point
    assert set(IMITATE) <= {e.name for e in whole(sensor=False)}
    monkeypatch.setattr(coupon, "effects_of_point", lambda **how: tuple(e for e in whole(**how) if e.name not in IMITATE))
    result = call("close-loop", hardens_twice(tmp_path), "--json")
    found = json.loads(result.stdout)
    assert result.exit_code == 5 and found["accepted"] == [] and found["grade"] == "unlisted", found["verdict"]
    term = found["unlisted"]
    assert term["channel"] == term["kind"] == "stress" and term["where"] == {"record": "pull"}
    assert term["after"]["held_out"]["stress"] < 0.5 * term["before"]["held_out"]["stress"] and Path(term["effect_file"]).is_file()
