"""`calibrate-ir` without landmarks, with wrong ones, and with a hand that picks."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from seen_test import SPECIMEN, pose_at, pulled, watched, write_raw
from typer.testing import CliRunner

from thermofit.cli.app import app

TEST = watched(pulled(70e3, 150.0))
MARKS = TEST.landmarks
assert MARKS is not None
GIVEN = {
    "length": {"p1": MARKS.length[0].tolist(), "p2": MARKS.length[1].tolist(), "length_mm": 60.0},
    "edge_left": {"p1": MARKS.edge_left[0].tolist(), "p2": MARKS.edge_left[1].tolist()},
    "edge_right": {"p1": MARKS.edge_right.tolist()},
    "circle": {f"p{k + 1}": point.tolist() for k, point in enumerate(MARKS.circle)},
}


def calibrated(folder: Path, *more: str) -> tuple[int, dict[str, object], str]:
    """Exit code, JSON and stderr of `calibrate-ir` on the raw folder beside."""
    study = folder / "study.yaml"
    if not study.exists():
        assert CliRunner().invoke(app, ["new", str(study), "--experiment", str(folder / "raw")]).exit_code == 0
    result = CliRunner().invoke(app, ["calibrate-ir", str(study), "--run-dir", str(folder / "run"), "--json", *more])
    return result.exit_code, json.loads(result.stdout.splitlines()[-1] if result.exit_code else result.stdout), result.stderr


def test_landmarks_that_nobody_gives_are_found(tmp_path: Path) -> None:
    write_raw(tmp_path / "raw", TEST)
    code, result, said = calibrated(tmp_path)
    assert code == 0, said
    true, found = pose_at(), result["pose"]
    assert result["landmarks_from"] == "the frames" and "landmarks found in the frames" in str(result["verdict"])
    assert isinstance(found, dict) and found["origin_px"] == pytest.approx(true.origin.tolist(), abs=0.4)
    assert found["scale_mm_per_px"] == pytest.approx(true.scale, rel=3e-3)


def test_given_ones_win_and_a_disagreement_is_told(tmp_path: Path) -> None:
    write_raw(tmp_path / "raw", TEST)
    code, right, said = calibrated(tmp_path, "--set", f"ir.landmarks={json.dumps(GIVEN)}")
    assert code == 0 and right["landmarks_from"] == "hand" and right["remarks"] == [], said
    moved = {group: {key: [p[0] + 4.0, p[1]] if isinstance(p, list) else p for key, p in own.items()} for group, own in GIVEN.items()}
    code, wrong, said = calibrated(tmp_path, "--set", f"ir.landmarks={json.dumps(moved)}")
    assert code == 0, said
    (told,) = wrong["remarks"]  # type: ignore[misc]
    assert "4.0 px along the axis" in told or "3.9 px along the axis" in told or "4.1 px along the axis" in told
    assert wrong["pose"]["origin_px"][0] == pytest.approx(pose_at().origin[0] + 4.0, abs=0.3)  # type: ignore[index]


def test_where_no_shoulder_is_seen_the_user_is_asked_to_pick(tmp_path: Path) -> None:
    long = replace(SPECIMEN, parallel_length=130.0, total_length=200.0)
    write_raw(tmp_path / "raw", watched(replace(pulled(70e3, 150.0), specimen=long)))
    code, result, _ = calibrated(tmp_path)
    assert code == 3 and "no shoulder" in str(result["error"]) and "--pick" in str(result["error"])


def test_pick_needs_its_length_and_a_display(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_raw(tmp_path / "raw", TEST)
    code, result, _ = calibrated(tmp_path, "--pick")
    assert code == 2 and "--length-mm" in str(result["error"])
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    code, result, _ = calibrated(tmp_path, "--pick", "--length-mm", "60")
    assert code == 2 and "no display" in str(result["error"])
