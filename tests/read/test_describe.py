"""`new --raw`: a folder of measured files gets its experiment.yaml, with what is missing marked, and a study that fits it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from seen_test import SPECIMEN, pulled, watched, write_raw
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.core.errors import DataError
from thermofit.read.describe import describe, material_of
from thermofit.read.plausible import asked
from thermofit.read.raw import read_experiment
from thermofit.study.materials import MATERIALS, class_of
from thermofit.study.study import load_study

TEST = watched(pulled(70e3, 150.0))
VALUES = {
    **{("gripped_length_each_end" if key == "gripped_length" else key) + "_mm": value for key, value in vars(SPECIMEN).items()},
    "theta_air_degC": 22.9,
    "theta_clamp_degC": 22.8,
}


def bare(folder: Path) -> Path:
    """The files of a test without a description."""
    write_raw(folder, TEST)
    (folder / "experiment.yaml").unlink()
    return folder


def filled(path: Path, **more: object) -> None:
    """What a person fills in."""
    text = path.read_text(encoding="utf-8")
    for key, value in {**VALUES, **more}.items():
        text = re.sub(rf"(  {key}:)[ ]+#.*", rf"\1 {value}", text)
    path.write_text(text, encoding="utf-8")


def command(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    return result.exit_code, " ".join(result.output.split())


def test_from_files_to_a_study_by_what_the_terminal_says(tmp_path: Path) -> None:
    """inspect names new, new names what to fill in and the next two commands, a command too early names the key."""
    raw, study = bare(tmp_path / "raw"), tmp_path / "study.yaml"
    code, said = command("inspect", raw)
    assert code == 0 and f"thermofit new study.yaml --raw {raw}" in said
    code, said = command("new", study, "--raw", raw, "--json")
    made = json.loads(said)
    assert code == 0 and made["missing"] == list(VALUES)
    assert made["found"] == ["force record force.csv", "41 DIC stages in dic/", "20 infrared frames in ir/"]
    assert f"fill in 9 values in {raw / 'experiment.yaml'}" in made["verdict"] and "--force" in made["verdict"]
    code, said = command("inspect", raw)
    assert code == 3 and "gauge_width_mm" in said
    filled(raw / "experiment.yaml", material="aluminium sheet")
    code, said = command("inspect", raw)
    assert code == 0 and "ready for a study" in said
    code, said = command("new", study, "--raw", raw, "--force")
    assert code == 0 and "bounds by the elastic slope" in said and "for aluminium" in said and f"thermofit run {study}" in said
    loaded, read = load_study(study), read_experiment(raw)
    assert loaded.experiment == raw and loaded.bounds("E")[0] < 70e3 < loaded.bounds("E")[1]
    assert loaded.bounds("kappa") == MATERIALS["aluminium"].values["kappa"][1:]
    assert asked(read) == () and read.ir is not None and read.dic is not None


def test_a_description_that_is_there_is_kept(tmp_path: Path) -> None:
    raw = tmp_path / "raw"
    write_raw(raw, TEST)
    before = (raw / "experiment.yaml").read_bytes()
    code, said = command("new", tmp_path / "study.yaml", "--raw", raw)
    assert code == 0 and "bounds by the elastic slope" in said
    assert (raw / "experiment.yaml").read_bytes() == before
    assert command("new", tmp_path / "b.yaml", "--raw", raw, "--experiment", raw)[0] == 2
    assert command("new", tmp_path / "b.yaml", "--raw", tmp_path / "nowhere")[0] == 3
    assert command("new", tmp_path / "b.yaml", "--material", "stel")[0] == 2


def native(folder: Path) -> Path:
    """Exports as a correlation system and a testing machine write them; the units of the machine are kN and ms."""
    assert TEST.dic is not None
    (folder / "exports").mkdir(parents=True)
    for n, (time, moved) in enumerate(zip(TEST.dic.time, TEST.dic.displacement, strict=True)):
        rows = np.column_stack([TEST.dic.point_id, TEST.dic.reference + moved, moved])
        rows = rows[np.isfinite(rows).all(axis=1)]
        head = [
            "# Units: length:mm angle:deg time:s",
            f"# Stage: Stage {n}",
            "stage;index;relative_time;date",
            f'"Stage {n}";{n};{time};"2023-02-10T13:54:18.404"',
            "# Name : Surface component 1",
            "id;x;y;z;displacement_x;displacement_y;displacement_z",
        ]
        text = [";".join([str(int(row[0])), *(f"{v:.6f}" for v in row[1:])]) for row in rows]
        (folder / "exports" / f"Surface component 1_{n:03d}.csv").write_text("\r\n".join([*head, *text]) + "\r\n", encoding="utf-8")
    rows = [f"{1e3 * t:.6g},{1e-3 * f:.9g},{0.02 * k:.4g}" for k, (t, f) in enumerate(zip(TEST.force.time, TEST.force.force, strict=True))]
    (folder / "machine.csv").write_text("\n".join(["Time [ms],Force [kN],Crosshead [mm]", *rows]) + "\n", encoding="utf-8")
    return folder


def test_native_exports_are_described_and_the_force_is_converted(tmp_path: Path) -> None:
    raw = native(tmp_path / "raw")
    made = describe(raw)
    assert made.missing == (*VALUES, "side") and any(text.startswith("force.csv written from machine.csv") for text in made.found)
    tree = yaml.safe_load(made.file.read_text(encoding="utf-8"))
    assert tree["dic"]["files"] == "exports/Surface component 1_0*.csv" and "ir" not in tree
    filled(made.file, side="front")
    read = read_experiment(raw)
    assert read.dic is not None and TEST.dic is not None
    np.testing.assert_allclose(read.force.time, TEST.force.time, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(read.force.force, TEST.force.force, rtol=1e-6)
    assert read.force.crosshead is not None and asked(replace(read, specimen=SPECIMEN)) == ()


def test_what_cannot_be_told_apart_is_said(tmp_path: Path) -> None:
    """Two records, two series of stages, a file of another content called force.csv, or nothing at all."""
    two = native(tmp_path / "two")
    (two / "other.csv").write_bytes((two / "machine.csv").read_bytes())
    with pytest.raises(DataError, match="2 records hold a force"):
        describe(two)
    again = native(tmp_path / "again")
    (again / "more").mkdir()
    for path in (again / "exports").iterdir():
        (again / "more" / path.name).write_bytes(path.read_bytes())
    with pytest.raises(DataError, match="2 groups of files hold DIC stages"):
        describe(again)
    silent = native(tmp_path / "silent")
    text = (silent / "machine.csv").read_text(encoding="utf-8").replace("[kN]", "").replace("[ms]", "")
    (silent / "machine.csv").write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match="the unit of column"):
        describe(silent)
    empty = tmp_path / "empty"
    empty.mkdir()
    (empty / "notes.txt").write_text("nothing here\n", encoding="utf-8")
    with pytest.raises(DataError, match="neither displacements nor a force"):
        describe(empty)
    assert not list(tmp_path.rglob("experiment.yaml"))


@pytest.mark.parametrize(
    ("note", "name"),
    [
        ("steel sheet DC04, 1.5 mm", "steel"),
        ("aluminium sheet AW-6016", "aluminium"),
        ("6061-T6", "aluminium"),
        ("Ti-6Al-4V", "titanium"),
        ("Inconel 718", "nickel"),
        ("AZ41D", "magnesium"),
        ("brass", "copper"),
        ("something", ""),
        ("steel on aluminium", ""),
    ],
)
def test_a_note_names_the_class(tmp_path: Path, note: str, name: str) -> None:
    assert class_of(note) == name
    (tmp_path / "experiment.yaml").write_text(yaml.safe_dump({"specimen": {"material": note}}), encoding="utf-8")
    assert material_of(tmp_path) == name


@pytest.mark.parametrize("name", MATERIALS)
def test_a_study_of_every_class_loads_within_its_bounds(tmp_path: Path, name: str) -> None:
    assert command("new", tmp_path / "study.yaml", "--material", name)[0] == 0
    study = load_study(tmp_path / "study.yaml")
    for parameter, (start, low, high) in MATERIALS[name].values.items():
        assert study.bounds(parameter) == pytest.approx((low, high), rel=0.06) and low < start < high
