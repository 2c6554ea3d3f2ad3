"""`inspect` on files that the test writes itself: own and native formats, clocks, signs, noise, study lines, folders, bad input."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.core.errors import DataError
from thermofit.read.coupon import read_coupon
from thermofit.records.artefact import RecordContent, write_record
from thermofit.stages.inspect import inspect
from thermofit.study.coupon import Coupon


def call(*arguments: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    return result.exit_code, result.stdout, result.stderr


def look(path: Path) -> dict[str, Any]:
    """The JSON of the command, which is alone on stdout."""
    code, out, error = call("inspect", path, "--json")
    assert code == 0, error
    found: dict[str, Any] = json.loads(out)
    return found


def column(result: dict[str, Any], name: str) -> dict[str, Any]:
    found: dict[str, Any] = next(c for c in result["parts"][0]["columns"] if c["name"] == name)
    return found


def coupon_rows(noise: float = 0.0, sign: float = 1.0, n: int = 600) -> list[tuple[float, float, float, float]]:
    """Time s, strain, stress MPa, temperature degC of two elastic cycles of 200 MPa; the specimen cools in tension."""
    random = np.random.default_rng(4)
    time = np.linspace(0.0, 60.0, n)
    stress = 200.0 * np.sin(2.0 * np.pi * time / 30.0)
    heat = 23.0 - 1.0e-3 * stress + 1e-4 * random.standard_normal(n)
    load = sign * (stress + noise * random.standard_normal(n))
    return list(zip(time, sign * stress / 2.0e5, load, heat, strict=True))


def write_coupon(path: Path, rows: list[tuple[float, float, float, float]]) -> Path:
    lines = ["Time [s],Strain [1],Stress [MPa],Temperature [degC]", *(",".join(f"{value:.9g}" for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def stage_text(stage: int, time: float, noise: float = 0.0) -> str:
    """An ARAMIS stage of 12 x 12 points with a displacement linear in place and time."""
    random = np.random.default_rng(stage)
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(12.0), np.arange(12.0)))
    u, v = 1e-3 * time * x + noise * random.standard_normal(144), -3e-4 * time * y
    head = [
        "# Units: length:mm angle:deg time:s",
        f"# Stage: Stage {stage}",
        "stage;index;relative_time;date",
        f'"Stage {stage}";{stage};{time};"2023-02-10T13:54:18.404"',
        "# Name : Surface component 1",
        "id;x;y;z;displacement_x;displacement_y;displacement_z",
    ]
    rows = (f"{k};{x[k] + u[k]:.6f};{y[k] + v[k]:.6f};0.0;{u[k]:.6f};{v[k]:.6f};0.0" for k in range(144))
    return "\r\n".join([*head, *rows]) + "\r\n"


def test_record_with_units_gives_lines_that_a_study_takes(tmp_path: Path) -> None:
    """Columns, units, where they come from, clock and noise; the suggested section is valid and reads the file."""
    path = write_coupon(tmp_path / "test.csv", coupon_rows(noise=0.5))
    result = look(path)
    assert (result["kind"], result["points"], result["missing"]) == ("record", 600, 0)
    assert result["units"] == ["s", "1", "MPa", "degC"]
    stress = column(result, "Stress [MPa]")
    assert (stress["meaning"], stress["unit"], stress["unit_from"], stress["fixed_unit"]) == ("stress", "MPa", "file", "MPa")
    assert stress["noise"] == pytest.approx(0.5, rel=0.2)
    assert column(result, "Temperature [degC]")["low"] == pytest.approx(273.15 + 22.8, abs=0.01)
    facts = result["parts"][0]["facts"]
    assert (facts["gaps"], facts["repeated times"], facts["step s"]) == (0, 0, pytest.approx(60.0 / 599.0, rel=1e-6))
    settings = Coupon.model_validate(yaml.safe_load(result["suggestion"])["coupon"])
    (record,) = read_coupon(settings, tmp_path)
    assert len(record.time) == 600 and np.max(record.stress) == pytest.approx(200.0, abs=3.0)
    assert record.temperature is not None


def test_temperature_that_rises_in_tension_means_a_flipped_sign(tmp_path: Path) -> None:
    """The suspicion is said, the study line offered with a comment; with the right sign neither is there."""
    flipped = look(write_coupon(tmp_path / "flipped.csv", coupon_rows(sign=-1.0)))
    assert any("looks flipped" in remark for remark in flipped["remarks"])
    assert "tension: negative     # suspected" in flipped["suggestion"]
    right = look(write_coupon(tmp_path / "right.csv", coupon_rows()))
    assert not any("flipped" in remark for remark in right["remarks"])
    assert "tension" not in right["suggestion"]


def test_columns_that_mirror_each_other(tmp_path: Path) -> None:
    path = tmp_path / "mirror.csv"
    strain = np.linspace(0.0, 0.02, 50)
    rows = (f"{k},{-100 * e},{-e},{100 * e * (1 + e)},{np.log1p(e)}" for k, e in enumerate(strain))
    path.write_text("Time[s],Stress[MPa],Strain[1],true stress[MPa],true strain[1]\n" + "\n".join(rows) + "\n", encoding="utf-8")
    remarks = look(path)["remarks"]
    assert any(remark.startswith("true stress[MPa] and Stress[MPa] have opposite signs") for remark in remarks)
    assert any(remark.startswith("true strain[1] and Strain[1] have opposite signs") for remark in remarks)


def test_unit_that_is_not_written_must_be_given(tmp_path: Path) -> None:
    """No unit is invented: neither in the column nor in the study line."""
    path = tmp_path / "plain.csv"
    path.write_text("time,strain,force\n" + "\n".join(f"{k},{0.001 * k},{2.0 * k}" for k in range(40)) + "\n", encoding="utf-8")
    result = look(path)
    assert result["units"] == []
    assert column(result, "force")["unit_from"] == "unknown"
    assert "the file does not say the unit of time, strain, force: a study must" in result["remarks"]
    lines = yaml.safe_load(result["suggestion"])["coupon"]["records"][0]
    assert lines["time"] == {"column": "time", "unit": None}
    assert lines["stress"] == {"force": "force", "unit": None, "area": None}
    assert lines["initial_temperature_degC"] is None


def test_strain_in_percent_without_saying_so_is_suspected(tmp_path: Path) -> None:
    path = tmp_path / "percent.csv"
    path.write_text("Time [s],Strain [-],Stress [MPa]\n" + "\n".join(f"{k},{0.2 * k},{9 * k}" for k in range(40)) + "\n", encoding="utf-8")
    assert any(remark.startswith("Strain [-]: strains up to 7.8; is the unit % or mm") for remark in look(path)["remarks"])


def test_gaps_repeated_and_backward_times_are_counted(tmp_path: Path) -> None:
    time = [0.1 * k for k in range(50)]
    time[20:] = [t + 5.0 for t in time[20:]]
    time[30] = time[29]
    time[40:] = [t - 6.0 for t in time[40:]]
    rows = [(t, 1e-4 * k, 20.0 * k, 23.0) for k, t in enumerate(time)]
    result = look(write_coupon(tmp_path / "clock.csv", rows))
    facts = result["parts"][0]["facts"]
    assert (facts["gaps"], facts["repeated times"], facts["backward times"]) == (1, 1, 1)
    remarks = "\n".join(result["remarks"])
    assert "1 gaps of more than 5 median steps, the longest 5.1 s after 1.9 s" in remarks
    assert "the time goes back at 1 places, first from 8.9 s to 3 s: another clock or test?" in remarks


def test_two_clocks_are_said(tmp_path: Path) -> None:
    path = tmp_path / "two.csv"
    rows = (f"{0.1 * k},{k},{10 * k},{23 + 0.01 * k}" for k in range(40))
    path.write_text("Time fast [s],Force [N],Time slow [s],Temperature [degC]\n" + "\n".join(rows) + "\n", encoding="utf-8")
    assert any(remark.startswith("2 columns of time (Time fast [s], Time slow [s]): which channel") for remark in look(path)["remarks"])


def test_missing_values_are_counted_by_column(tmp_path: Path) -> None:
    path = write_coupon(tmp_path / "holes.csv", coupon_rows(n=60))
    lines = path.read_text(encoding="utf-8").splitlines()
    for k in (5, 9, 12):
        cells = lines[k].split(",")
        lines[k] = ",".join([*cells[:3], "NaN"])
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    result = look(path)
    assert result["missing"] == 3
    assert column(result, "Temperature [degC]")["missing"] == 3
    assert column(result, "Stress [MPa]")["missing"] == 0


def test_stage_of_full_field(tmp_path: Path) -> None:
    """Extent, spacing, noise in space of one stage, and lines of an experiment.yaml that leave the side open."""
    path = tmp_path / "Stage_2.5 s.csv"
    path.write_text(stage_text(3, 2.5, noise=0.002), encoding="utf-8")
    result = look(path)
    assert (result["kind"], result["points"], result["missing"], result["units"]) == ("DIC stage", 144, 0, ["mm"])
    assert result["format"].startswith("ARAMIS")
    assert result["written"] == {"encoding": "utf-8", "separator": "semicolon", "decimal sign": "point"}
    facts = result["parts"][0]["facts"]
    assert (facts["stage"], facts["time s"]) == (3, 2.5)
    assert facts["spacing"].endswith("mm")
    assert column(result, "displacement_x")["noise"] == pytest.approx(0.002, rel=0.3)
    assert yaml.safe_load(result["suggestion"]) == {"dic": {"files": str(path), "side": None}}


def test_pixels_ask_for_a_scale(tmp_path: Path) -> None:
    path = tmp_path / "DICe_solution_1.txt"
    rows = (f"{k},{k % 8},{k // 8},0.1,0.2,{-1 if k == 3 else 0.01},0.1,0.1,4" for k in range(64))
    names = "SUBSET_ID,COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y,SIGMA,GAMMA,BETA,STATUS_FLAG"
    path.write_text(names + "\n" + "\n".join(rows) + "\n", encoding="utf-8")
    result = look(path)
    assert (result["points"], result["missing"]) == (64, 1)
    lines = yaml.safe_load(result["suggestion"])["dic"]
    assert lines["mm_per_pixel"] is None and lines["axes"] == {"y": "-y"} and lines["rate"] is None


def test_folder_is_one_line_for_each_sequence(tmp_path: Path) -> None:
    """Stages in one line with range of numbers and times, gap between them; a broken one is counted and quoted; strangers are listed."""
    folder = tmp_path / "lab"
    (folder / "dic").mkdir(parents=True)
    for k in (0, 1, 2, 3, 7, 8, 9, 10, 11):
        (folder / "dic" / f"Surface 1_{k * 0.5} s.csv").write_text(stage_text(k, k * 0.5), encoding="utf-8")
    (folder / "dic" / "Surface 1_99.5 s.csv").write_text(stage_text(99, 99.5).split("0;")[0], encoding="utf-8")
    write_coupon(folder / "machine.csv", coupon_rows())
    (folder / "notes.txt").write_text("the specimen slipped\n", encoding="utf-8")
    (folder / ".hidden").write_text("x", encoding="utf-8")
    result = look(folder)
    groups = {group["files"]: group for group in result["groups"]}
    assert set(groups) == {"dic/Surface 1_* s.csv", "machine.csv", "notes.txt"}
    stages = groups["dic/Surface 1_* s.csv"]
    assert (stages["count"], stages["points"], stages["missing"]) == (10, 9 * 144, 0)
    assert "stages 0 to 11" in stages["summary"] and "times s 0 to 5.5" in stages["summary"]
    assert any("1 of 10 files cannot be read; the first: " in remark and "99.5 s.csv" in remark for remark in stages["remarks"])
    assert any("3 stages are missing between number 0 and 11: 4, 5, 6" in remark for remark in stages["remarks"])
    assert groups["notes.txt"]["format"] == "not recognised"
    assert result["verdict"].startswith("12 files in 3 groups, 11 of native formats")
    code, out, _ = call("inspect", folder)
    assert code == 0 and "dic/Surface 1_* s.csv" in out and out.strip().splitlines()[-1].startswith("verdict")


def raw_folder(folder: Path) -> Path:
    """A small raw folder of thermofit's own."""
    (folder / "dic").mkdir(parents=True)
    lengths = ("gauge_width", "thickness", "parallel_length", "shoulder_radius", "grip_width", "total_length", "gripped_length_each_end")
    specimen = "".join(f"  {name}_mm: {value}\n" for name, value in zip(lengths, (25, 1.2, 100, 25, 35, 150, 10), strict=True))
    text = f"specimen:\n{specimen}temperatures: {{theta_air_degC: 24.0, theta_clamp_degC: 23.0}}\n"
    (folder / "experiment.yaml").write_text(text + "force: {file: force.csv}\ndic: {folder: dic, side: front}\n", encoding="utf-8")
    random = np.random.default_rng(1)
    force = ("time_s,force_N", *(f"{0.1 * k:.1f},{100 * k + 2 * random.standard_normal():.3f}" for k in range(101)))
    (folder / "force.csv").write_text("\n".join(force) + "\n", encoding="utf-8")
    for k in range(5):
        rows = (f"{i},{i % 6},{i // 6},0,{1e-3 * random.standard_normal():.5f},0,0" for i in range(36))
        (folder / "dic" / f"stage_{k:04d}.csv").write_text(
            f"# time_s: {2.0 * k}\nid,x_mm,y_mm,z_mm,ux_mm,uy_mm,uz_mm\n" + "\n".join(rows) + "\n", encoding="utf-8"
        )
    return folder


def test_raw_folder_is_recognised_and_read(tmp_path: Path) -> None:
    folder = raw_folder(tmp_path / "raw")
    result = look(folder)
    assert result["format"] == "thermofit raw folder"
    parts = {part["name"]: part for part in result["parts"]}
    assert set(parts) == {"force", "dic"}
    assert (parts["force"]["facts"]["rows"], parts["dic"]["facts"]["stages"], parts["dic"]["facts"]["points"]) == (101, 5, 36)
    assert parts["force"]["columns"][0]["noise"] == pytest.approx(2.0, rel=0.4)
    (folder / "dic" / "stage_0003.csv").write_text("# time_s: 6\n", encoding="utf-8")
    code, _, error = call("inspect", folder)
    assert code == DataError.exit_code and "stage_0003.csv" in error


@pytest.mark.parametrize(
    ("name", "format_"),
    [
        ("dic/stage_0001.csv", "thermofit DIC stage"),
        ("force.csv", "thermofit force record"),
        ("experiment.yaml", "thermofit experiment.yaml"),
    ],
)
def test_files_of_a_raw_folder_point_to_the_folder(tmp_path: Path, name: str, format_: str) -> None:
    result = look(raw_folder(tmp_path / "raw") / name)
    assert result["format"] == format_
    assert "inspect the folder" in result["verdict"]


def test_study_artefact_and_picture(tmp_path: Path) -> None:
    study = tmp_path / "s.yaml"
    study.write_text("name: a\nexperiment: raw\nparameters: {E: 70000}\n", encoding="utf-8")
    assert look(study)["verdict"] == f"thermofit study: `thermofit run {study}` runs it"
    artefact = tmp_path / "verify.h5"
    write_record(artefact, RecordContent("verify", {}, {}, {}, {}, {"verdict": "good"}))
    result = look(artefact)
    assert result["format"] == "thermofit artefact" and "of stage 'verify'" in result["verdict"]
    picture = tmp_path / "ut_151.tif"
    picture.write_bytes(b"II*\x00" + bytes(100))
    assert look(picture)["format"] == "picture (TIFF)"


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"Dear Sir,\nplease find enclosed\n", "its first line is 'Dear Sir,'"),
        (bytes(range(256)) * 40, "it is no text and begins with the bytes 00 01 02 03"),
        (b"\x89HDF\r\n\x1a\n" + bytes(2000), "begins with the bytes 89 48 44 46"),
        (b"MATLAB 5.0 MAT-file, truncated" + bytes(10), ""),
        (b"PK\x03\x04" + bytes(300), ""),
        (b"name: [unclosed\n", "its first line is 'name: [unclosed'"),
        (b"\xff\xfe\x00\xd8", ""),
        (b"\n\n   \n", ""),
    ],
)
def test_what_is_not_recognised_ends_with_one_sentence(tmp_path: Path, content: bytes, found: str) -> None:
    path = tmp_path / "unknown.dat"
    path.write_bytes(content)
    code, out, error = call("inspect", path, "--json")
    assert code == DataError.exit_code, out
    assert json.loads(out)["exit_code"] == DataError.exit_code
    assert error.count("error: ") == 1 and "unknown.dat" in error and found in error
    assert "Traceback" not in error and "unexpected" not in error


def test_empty_missing_and_unreadable(tmp_path: Path) -> None:
    empty = tmp_path / "empty.csv"
    empty.touch()
    (tmp_path / "void").mkdir()
    for path, words in (
        (empty, "is empty"),
        (tmp_path / "gone.csv", "no such file or folder"),
        (tmp_path / "void", "no files in the folder"),
    ):
        code, _, error = call("inspect", path)
        assert code == DataError.exit_code and words in error
    locked = write_coupon(tmp_path / "locked.csv", coupon_rows())
    locked.chmod(0)
    if os.access(locked, os.R_OK):
        pytest.skip("this user reads every file whatever its rights")
    code, _, error = call("inspect", locked)
    assert code == DataError.exit_code and "cannot be read" in error


def test_folder_of_strangers(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("hello\n", encoding="utf-8")
    code, _, error = call("inspect", tmp_path)
    assert code == DataError.exit_code and "no known format recognised in any of its files (a.txt)" in error


@pytest.mark.parametrize("share", [0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99])
def test_truncated_files_are_read_or_refused(tmp_path: Path, share: float) -> None:
    """A file cut anywhere is described, or ends with exit code 3 and one sentence; never with a mistake of the program."""
    whole = stage_text(3, 2.5).encode()
    coupon = write_coupon(tmp_path / "whole.csv", coupon_rows()).read_bytes()
    for name, data in (("stage.csv", whole), ("coupon.csv", coupon)):
        path = tmp_path / name
        path.write_bytes(data[: int(share * len(data))])
        code, _, error = call("inspect", path)
        assert code in (0, DataError.exit_code), error
        assert "unexpected" not in error


def test_large_group_is_read_in_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("thermofit.read.look.MOST_BYTES", 1000)
    for k in range(30):
        (tmp_path / f"s_{k}.csv").write_text(stage_text(k, 1.0 * k), encoding="utf-8")
    (group,) = inspect(tmp_path)["groups"]
    assert group["points"] == 20 * 144
    assert any(remark.startswith("20 of 30 files were read, evenly taken") for remark in group["remarks"])


def test_result_does_not_depend_on_the_name(tmp_path: Path) -> None:
    """Recognised by content: another name and suffix change nothing but the path."""
    first = write_coupon(tmp_path / "record.csv", coupon_rows())
    shutil.copy(first, tmp_path / "picture.png")
    a, b = inspect(first), inspect(tmp_path / "picture.png")
    assert (a["format"], a["parts"]) == (b["format"], b["parts"])
