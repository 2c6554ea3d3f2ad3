"""`close-loop` begins with the joint fit that `diagnose` has made, and ends where it ends without it."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pulled import HEAT, pulled_study
from record_studies import call

from thermofit.diagnose import refit, whole_loop
from thermofit.diagnose.beside_source import BesideSource
from thermofit.diagnose.prepared import diagnosis_job, prepared
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.records.artefact import Record, open_record
from thermofit.stages import close_loop, diagnose
from thermofit.study.study import load_study

COUNTS = ("evaluations", "created", "wall_s")


def without_counts(summary: dict[str, Any], folder: Path) -> Any:
    """A summary without what was run and when, and without its folder."""
    left = {key: value for key, value in summary.items() if key not in COUNTS}
    return {key: str(value).replace(str(folder), "FOLDER") for key, value in left.items()}


@pytest.fixture
def labels(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Labels of the fits that are made."""
    made: list[str] = []
    real = refit.JointFit.minimised_on

    def noted(self: refit.JointFit, start: Any, model: Any, label: str, *how: Any, **more: Any) -> Any:
        made.append(label)
        return real(self, start, model, label, *how, **more)

    monkeypatch.setattr(refit.JointFit, "minimised_on", noted)
    return made


def same(one: Record, other: Record) -> None:
    assert one.names == other.names and one.parameters == other.parameters
    for name in one.names:
        np.testing.assert_array_equal(one[name].value, other[name].value, err_msg=name)


def test_the_loop_takes_over_the_joint_fit_and_ends_the_same(tmp_path: Path, labels: list[str]) -> None:
    path = pulled_study(tmp_path, (*HEAT, "theta_air"), alpha_exp=0.0)
    assert call("run", path, "--until", "identify-thermal").exit_code == 0
    study = load_study(path)
    alone = close_loop.run(study).record
    assert labels.count("joint") == 1
    shutil.move(study.run_dir / "close-loop.h5", tmp_path / "alone.h5")
    assert call("diagnose", path).exit_code in (0, 5)
    labels.clear()
    after = close_loop.run(study).record
    assert "joint" not in labels and labels, "effects are still tried"
    assert after.summary["evaluations"]["forward"] == 0 and after.summary["evaluations"]["replayed"] > 0
    assert without_counts(dict(alone.summary), tmp_path) == without_counts(dict(after.summary), tmp_path)
    kept = open_record(tmp_path / "alone.h5")
    same(kept, after)
    # What was found with other settings, or is asked for anew, is not taken over.
    for change, force in (("diagnosis.held_out=blocks", True), ("diagnosis.held_out=phases", False)):
        labels.clear()
        close_loop.run(load_study(path, ["diagnosis.max_effects=0", change]), force=force)
        assert labels.count("joint") == 1, change


def test_what_a_heat_has_driven_off_has_no_standard_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it is not told beside the heat: that of the joint fit says how well the data hold what it is not. Of `diagnose` as of the
    loop."""
    path = pulled_study(tmp_path, (*HEAT, "theta_air"), alpha_exp=0.0)
    assert call("run", path, "--until", "identify-thermal").exit_code == 0
    study = load_study(path, ["diagnosis.max_effects=0"])
    for told in (None, BesideSource({}, {}, "not settled"), BesideSource({"beta": 0.9}, {"beta": 0.01})):
        for stage, asks in ((diagnose, diagnose), (close_loop, whole_loop)):
            monkeypatch.setattr(asks, "beside_source", lambda *_, told=told: told)
            found = stage.run(study, force=True).record.parameters
            known = {n for n, p in found.items() if p.free and p.sigma is not None}
            felt = set(acting_on_temperatures([n for n, p in found.items() if p.free]))
            assert felt == {"beta", "theta_air"} and known >= {"lag", "tau"}
            assert known & felt == (felt if told is None else set(told.value))


def test_a_fit_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    from dataclasses import fields, replace

    from thermofit.diagnose.known_fit import KnownFit, known_fit, known_fit_datasets
    from thermofit.records.artefact import RecordContent, write_record

    path = pulled_study(tmp_path, (*HEAT, "theta_air"), alpha_exp=0.0)
    assert call("run", path, "--until", "identify-thermal").exit_code == 0
    study = load_study(path)
    task, stages = diagnosis_job(study, "diagnose")
    found = prepared(study, task, stages)
    ends = {"key": (found.case.parameters.replace(beta=0.1), ("it failed",))}
    datasets = known_fit_datasets(KnownFit(found.case.parameters, found.fit, ("one failed",), ends))
    write_record(task.path, RecordContent(task.stage, task.config, task.inputs, datasets))
    known = known_fit(task)
    assert known is not None and known.parameters == found.case.parameters
    assert (known.failures, known.ends) == (("one failed",), ends)
    assert list(known.parameters.values) == list(found.case.parameters.values)
    for name in (f.name for f in fields(found.fit)):
        one, other = getattr(found.fit, name), getattr(known.fit, name)
        if name == "counts":
            assert other.forward == 0 and other.replayed == one.forward + one.replayed
        elif name == "covariance":
            for part in (f.name for f in fields(one)):
                np.testing.assert_array_equal(getattr(one, part), getattr(other, part), err_msg=part)
        elif name == "log":
            assert [replace(e, x=(), replayed=True) for e in one] == [replace(e, x=()) for e in other]  # type: ignore[arg-type]
        elif name == "optimality":
            assert one == other
        else:
            np.testing.assert_array_equal(one, other, err_msg=name)
    assert known_fit(replace(task, config={**task.config, "other": 1})) is None
