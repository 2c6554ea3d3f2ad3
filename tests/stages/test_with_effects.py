"""What `close-loop` writes can be run again: a study with the effects switched on, whose paths hold from anywhere."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from pulled import HEAT, pulled_study
from record_studies import call, record, write_record

from thermofit.diagnose.loop import Closed
from thermofit.diagnose.study_with_effects import study_text
from thermofit.study.study import load_study


@pytest.fixture
def looped(tmp_path: Path) -> tuple[Path, dict[str, Any]]:
    """A coupon pulled, unloaded and pulled on, whose model does not expand; a second record that no fit sees. After `close-loop`."""
    write_record(tmp_path / "other.csv", [(0.0, 0.0), (30.0, 0.02), (38.0, 0.016), (60.0, 0.04)], 25.0, 2)
    path = pulled_study(tmp_path, HEAT, ({**record("other", 25.0), "held_out": True},))
    result = call("close-loop", path, "--run-dir", tmp_path / "run", "--set", "parameters.alpha_exp=0", "--json")
    assert result.exit_code in (0, 5), result.output
    return tmp_path / "run" / "with-effects.yaml", dict(json.loads(result.stdout))


def test_held_out_record_proves_the_effect_and_the_study_of_the_end_runs(looped: tuple[Path, dict[str, Any]]) -> None:
    path, found = looped
    assert found["accepted"] == ["thermal_expansion"] and found["ranking"][0]["effect"] == "thermal_expansion"
    assert {"lamp", "dic_scale"} <= set(found["not_asked"]) and not {"thermal_expansion", "backstress_first"} & set(found["not_asked"])
    trial = next(t for t in found["rounds"][0]["tried"] if t["accepted"])
    assert trial["held_out_on"] == "record other" and trial["estimate"]["alpha_exp"]["value"] == pytest.approx(11.5e-6, rel=0.05)
    assert found["held_out"].startswith("record other, which no fit has seen")
    before, after = (found[word]["held_out"]["dtheta@record other"] for word in ("before", "after"))
    assert after < 0.5 * before and after == pytest.approx(found["after"]["floor"]["dtheta@record other"], rel=0.15)

    result = call("run", path, "--until", "verify", "--json")
    assert result.exit_code in (0, 5), result.output
    again = json.loads(result.stdout)
    assert again["run_dir"] == str(path.parent / "with-effects")
    assert load_study(path).setting("alpha_exp") == pytest.approx(trial["estimate"]["alpha_exp"]["value"], rel=1e-12)
    for name in ("beta", "tau", "lag"):
        assert again["parameters"][name]["value"] == pytest.approx(found["parameters"][name]["value"], rel=0.03), name
    assert again["channels"]["dtheta"]["rms"] == pytest.approx(found["after"]["fit"]["dtheta"], rel=0.05)


def test_paths_are_those_of_the_first_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Relative ones stand below its folder, those with a variable as they are; a held-out test stays without an effect of another."""
    from types import SimpleNamespace
    from typing import cast

    from thermofit.core.parameters import Parameters

    tree: dict[str, Any] = {
        "name": "two",
        "experiment": "raw/first",
        "experiments": {
            "second": {"experiment": "${WHERE}/second", "held_out": True},
            "third": {"experiment": "raw/third", "held_out": True},
        },
        "parameters": {"E": {"start": 68000.0}, "M_y0": {"start": 190.0}, "alpha_air": 14.7},
    }
    file = tmp_path / "two.yaml"
    file.write_text(yaml.safe_dump(tree), encoding="utf-8")
    monkeypatch.setenv("WHERE", "/data")
    study = load_study(file, [f"run_dir={tmp_path / 'run'}", "model=1"])
    found = {"E": 7e4, "M_y0": 129.5, "ir_drift.rate": 1e-3, "rate_power.K": 4.0, "rate_power.m": 1.0}
    parameters = Parameters.of(found, ("E", "ir_drift.rate", "rate_power.K"))
    closed = SimpleNamespace(accepted=("ir_drift", "rate_power"), last=SimpleNamespace(case=SimpleNamespace(parameters=parameters)))
    written = yaml.safe_load(study_text(study, cast(Closed, closed)))
    assert written["experiment"] == str(tmp_path / "raw/first") and written["model"] == 1
    assert written["experiments"]["second"]["experiment"] == "${WHERE}/second"
    assert written["experiments"]["third"] == {
        "experiment": str(tmp_path / "raw/third"),
        "held_out": True,
        "parameters": {"ir_drift.rate": 0.0},
    }
    assert written["parameters"] == {
        "E": {"start": 7e4},
        "M_y0": {"start": 129.5},  # identified by the study, and held by the loop
        "alpha_air": 14.7,
        "ir_drift.rate": 1e-3,
        "rate_power.K": 4.0,
        "rate_power.m": 1.0,
    }
