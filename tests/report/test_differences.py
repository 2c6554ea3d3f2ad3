"""diff: what differs between two results, in words and numbers."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.core.errors import StudyError
from thermofit.records.artefact import Dataset, ParameterResult, RecordContent, write_record
from thermofit.report.differences import compared

F = ParameterResult(0.35, 0.003, "1", True, False, 0.5, 0.1, 1.5)
E = ParameterResult(68000.0, 200.0, "MPa", True, False, 60000.0, 3e4, 1.5e5)
NU = ParameterResult(0.3, None, "1", False, False, 0.3, 0.0, 0.5)


def written(folder: Path, parameters: dict[str, ParameterResult], *, rms: float = 1.5e-3, mesh: str = "coarse", **more: Any) -> Path:
    path = folder / "verify.h5"
    channels = {"du": {"n": 10, "rms": rms, "floor_rms": 1.5e-3, "unit": "mm", "chi2_reduced": (rms / 1.5e-3) ** 2}}
    values = more.pop("values", np.linspace(0.0, 1.0, 5))
    data = {"curve/force": Dataset(values, "N", ("time",))}
    summary = {"verdict": "verified", "channels": channels, **more}
    folder.mkdir(exist_ok=True)
    write_record(path, RecordContent("verify", {"mesh": mesh}, {}, data, parameters, summary))
    return path


def words(first: Path, second: Path) -> list[str]:
    return list(compared(first, second)["stages"]["verify"]["words"])


def test_equal_results_are_called_so(tmp_path: Path) -> None:
    a, b = (written(tmp_path / name, {"E": E, "nu": NU}) for name in "ab")
    assert compared(a, b)["verdict"] == "no difference in verify"
    assert compared(a, b)["stages"]["verify"]["same"]


def test_parameters_are_compared_in_their_standard_errors(tmp_path: Path) -> None:
    moved = {"E": replace(E, value=68100.0), "F": replace(F, value=0.37, sigma=0.004), "nu": replace(NU, value=0.31)}
    a, b = written(tmp_path / "a", {"E": E, "F": F, "nu": NU}), written(tmp_path / "b", moved)
    told = words(a, b)
    assert told[0] == "F differs by 4.0 combined standard errors, 0.35 to 0.37"
    assert "nu differs, 0.3 to 0.31; it has no standard error" in told
    assert "within 3 combined standard errors: E +0.35" in told
    rows = {row["parameter"]: row for row in compared(a, b)["stages"]["verify"]["parameters"]}
    assert rows["F"]["z"] == pytest.approx(0.02 / 0.005) and rows["E"]["z"] == pytest.approx(100.0 / (200.0 * math.sqrt(2.0)))
    assert rows["E"]["relative"] == pytest.approx(100.0 / 68000.0)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"rms": 1.8e-3}, "error of du rises by 20 %, 0.0015 to 0.0018 mm"),
        ({"mesh": "full"}, "settings differ: mesh"),
        ({"trustworthy": False}, "only the first is trustworthy"),
        ({"values": np.linspace(0.0, 1.1, 5)}, "dataset curve/force: differs by 0.1 N at most, of 1"),
        ({"values": np.zeros(4)}, "dataset curve/force: shape 5 and 4"),
        ({"values": np.array([0.0, 0.25, 0.5, np.nan, 1.0])}, "1 values are missing in one"),
    ],
)
def test_each_difference_has_its_words(tmp_path: Path, change: dict[str, Any], expected: str) -> None:
    a, b = written(tmp_path / "a", {"E": E}), written(tmp_path / "b", {"E": E}, **change)
    assert any(expected in text for text in words(a, b)), words(a, b)


def test_run_folders_are_compared_stage_by_stage(tmp_path: Path) -> None:
    written(tmp_path / "a", {"E": E})
    written(tmp_path / "b", {"E": replace(E, free=False)})
    write_record(tmp_path / "b" / "report.h5", RecordContent("report", {}, {}, {}, {}, {}))
    result = CliRunner().invoke(app, ["diff", str(tmp_path / "a"), str(tmp_path / "b"), "--json"])
    told = json.loads(result.stdout)
    assert told["only_in_second"] == ["report.h5"] and "identified only in the first" in told["verdict"]
    human = CliRunner().invoke(app, ["diff", str(tmp_path / "a"), str(tmp_path / "b")]).stdout
    assert "identified only in the first" in human and "only in the second: report.h5" in human
    with pytest.raises(StudyError, match="one of each"):
        compared(tmp_path / "a", tmp_path / "b" / "verify.h5")
    (tmp_path / "c").mkdir()
    with pytest.raises(StudyError, match="no artefact in common"):
        compared(tmp_path / "a", tmp_path / "c")
