"""A virtual material of another model than the one that is identified (`simulate.model`)."""

from __future__ import annotations

from pathlib import Path

import pytest
import tiny

from thermofit.core.errors import StudyError
from thermofit.study.study import load_study


def dissipated(folder: Path, *overrides: str) -> float:
    """Heat of plastic flow of the virtual experiment in mJ."""
    outcome = tiny.stage_run("simulate")(load_study(tiny.write(folder, tiny.tree(folder / "run")), overrides))
    return float(outcome.record.summary["energy_mJ"]["dissipated"])


def test_material_is_that_of_simulate_and_not_that_of_the_study(tmp_path: Path) -> None:
    """Model 2 dissipates more than model 1 once the hardening is not stored; only the model of the virtual material counts."""
    folders = [tmp_path / name for name in ("one", "two", "other")]
    for folder in folders:
        folder.mkdir()
    one, two = dissipated(folders[0], "model=1"), dissipated(folders[1], "model=2")
    assert two > 1.05 * one
    assert dissipated(folders[2], "model=2", "simulate.model=1") == pytest.approx(one, rel=1e-12)
    study = load_study(folders[2] / "tiny.yaml", ["model=1", "simulate.model=1"])
    assert tiny.stage_run("simulate")(study).fresh


def test_truth_value_is_no_model(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"simulate\.model.*expected 1 or 2"):
        load_study(tiny.write(tmp_path, tiny.tree(tmp_path / "run")), ["simulate.model=true"])


@pytest.mark.parametrize("name", ["ir_clock.offset", "bending.curvature", "machine_compliance.compliance", "jaw_slip.slip"])
def test_truth_that_no_virtual_test_would_show_is_refused(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It would be left out without a word, and nobody would find what is not there; so it is where a record with it is fresh."""
    content = tiny.tree(tmp_path / "run")
    content["simulate"]["truth"] = {**content["simulate"]["truth"], name: 1e-6}
    path = tiny.write(tmp_path, content)
    simulate = tiny.stage_run("simulate")
    with monkeypatch.context() as before:
        before.setattr("thermofit.stages.simulate.refuse_unseen", lambda study: None)
        simulate(load_study(path))
    with pytest.raises(StudyError, match=f"simulate.truth.{name}' belongs to {name.split('.')[0]}, which acts on the measurement"):
        simulate(load_study(path))


def test_truth_that_changes_the_force_on_the_specimen_acts(tmp_path: Path) -> None:
    (tmp_path / "right").mkdir()
    (tmp_path / "less").mkdir()
    whole = dissipated(tmp_path / "right")
    content = tiny.tree(tmp_path / "less" / "run")
    content["simulate"]["truth"] = {**content["simulate"]["truth"], "force_scale.gain": 0.02}
    outcome = tiny.stage_run("simulate")(load_study(tiny.write(tmp_path / "less", content)))
    assert abs(float(outcome.record.summary["energy_mJ"]["dissipated"]) / whole - 1.0) > 0.01
