"""What `close-loop` writes can be run again: a study with the effects switched on, whose paths hold from anywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from thermofit.core.study import load_study
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.study_with_effects import study_text


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
        "parameters": {"E": {"start": 68000.0}, "alpha_air": 14.7},
    }
    file = tmp_path / "two.yaml"
    file.write_text(yaml.safe_dump(tree), encoding="utf-8")
    monkeypatch.setenv("WHERE", "/data")
    study = load_study(file, [f"run_dir={tmp_path / 'run'}", "model=1"])
    found = {"E": 7e4, "ir_drift.rate": 1e-3, "rate_power.K": 4.0, "rate_power.m": 1.0}
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
        "alpha_air": 14.7,
        "ir_drift.rate": 1e-3,
        "rate_power.K": 4.0,
        "rate_power.m": 1.0,
    }
