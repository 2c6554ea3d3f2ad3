"""Every bad input ends in the right error class with one sentence, and the artefact that was there before is still there."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny
import yaml

from thermofit.core.errors import DataError, StudyError, ThermofitError
from thermofit.records.artefact import open_record
from thermofit.records.staging import artefact_path
from thermofit.study.study import Study, load_study

StudyOf = Callable[..., Study]
Damage = Callable[[Path], None]


def describe(change: Callable[[dict[str, Any]], Any]) -> Damage:
    """Damage to experiment.yaml."""

    def damage(raw: Path) -> None:
        path = raw / "experiment.yaml"
        content = yaml.safe_load(path.read_text())
        change(content)
        path.write_text(yaml.safe_dump(content, sort_keys=False))

    return damage


def landmarks(**marks: dict[str, list[float]]) -> Damage:
    """Other landmarks."""
    return describe(lambda content: [content["ir"]["landmarks"][name].update(points) for name, points in marks.items()])


def lines(name: str, change: Callable[[list[str]], list[str]]) -> Damage:
    """Damage to the lines of one file."""

    def damage(raw: Path) -> None:
        path = raw / name
        path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")

    return damage


def cell(row: int, column: int, text: str) -> Callable[[list[str]], list[str]]:
    """One cell of a comma separated table replaced."""

    def change(rows: list[str]) -> list[str]:
        cells = rows[row].split(",")
        cells[column] = text
        return [*rows[:row], ",".join(cells), *rows[row + 1 :]]

    return change


def swap_edges(content: dict[str, Any]) -> None:
    """The other side of the specimen: left and right edge exchanged."""
    marks = content["ir"]["landmarks"]
    left, right = marks["edge_left"], marks["edge_right"]
    shift = right["p1"][1] - left["p1"][1]
    left["p1"][1] += shift
    left["p2"][1] += shift
    right["p1"][1] -= shift


FRAME, STAGE = "ir/frame_0003.csv", "dic/stage_0004.csv"
COLLINEAR = {"p1": [40.0, 45.0], "p2": [60.0, 45.0], "p3": [80.0, 45.0]}
OUTSIDE = {"p1": [400.0, 20.0], "p2": [10.0, 20.0]}

CASES: dict[str, tuple[str, Damage, str]] = {
    "collinear-landmarks": ("calibrate-ir", landmarks(circle=COLLINEAR), r"ir\.landmarks\.circle.*(line|collinear)"),
    "landmark-outside": ("calibrate-ir", landmarks(edge_left=OUTSIDE), r"ir\.landmarks\.edge_left.*outside"),
    "wrong-side": ("calibrate-ir", describe(swap_edges), r"(edge_left|edge_right|side)"),
    "no-landmarks": ("calibrate-ir", describe(lambda c: c["ir"].pop("landmarks")), r"landmarks"),
    "misspelt-landmark": (
        "calibrate-ir",
        describe(lambda c: c["ir"]["landmarks"].update(edge_lft=c["ir"]["landmarks"].pop("edge_left"))),
        "edge_l",
    ),
    "frame-size": ("calibrate-ir", lines(FRAME, lambda rows: rows[:-3]), r"frame_0003\.csv"),
    "frame-width": ("calibrate-ir", lines(FRAME, lambda rows: [rows[0], *[r.rpartition(",")[0] for r in rows[1:]]]), r"frame_0003\.csv"),
    "frame-without-time": ("calibrate-ir", lines(FRAME, lambda rows: rows[1:]), r"frame_0003\.csv.*time"),
    "frame-nan": ("calibrate-ir", lines(FRAME, cell(20, 7, "nan")), r"frame_0003\.csv"),
    "frame-text": ("calibrate-ir", lines(FRAME, cell(20, 7, "warm")), r"frame_0003\.csv.*warm"),
    "frame-times": ("calibrate-ir", lines(FRAME, lambda rows: ["# time_s: 0.000", *rows[1:]]), r"frame_0003\.csv.*time"),
    "no-thickness": ("interpolate", describe(lambda c: c["specimen"].pop("thickness_mm")), r"thickness_mm"),
    "misspelt-temperature": (
        "interpolate",
        describe(lambda c: c["temperatures"].update(theta_ar_degC=c["temperatures"].pop("theta_air_degC"))),
        r"theta_air_degC",
    ),
    "stage-without-time": ("interpolate", lines(STAGE, lambda rows: rows[1:]), r"stage_0004\.csv.*time"),
    "stage-nan": ("interpolate", lines(STAGE, cell(9, 5, "nan")), r"stage_0004\.csv"),
    "stage-text": ("interpolate", lines(STAGE, cell(9, 5, "0,1x")), r"stage_0004\.csv"),
    "stage-columns": (
        "interpolate",
        lines(STAGE, lambda rows: [rows[0], rows[1].replace("uy_mm", "uy"), *rows[2:]]),
        r"stage_0004\.csv.*uy",
    ),
    "stage-times": ("interpolate", lines(STAGE, lambda rows: ["# time_s: 0.000", *rows[1:]]), r"stage_0004\.csv.*time"),
    "stage-empty": ("interpolate", lines(STAGE, lambda rows: rows[:2]), r"stage_0004\.csv"),
    "force-short": ("interpolate", lines("force.csv", lambda rows: rows[:200]), r"force.*(short|end|cover)"),
    "force-nan": ("interpolate", lines("force.csv", cell(50, 1, "nan")), r"force\.csv.*51"),
    "force-times": (
        "interpolate",
        lines("force.csv", lambda rows: [*rows[:50], rows[60], *rows[50:60], *rows[61:]]),
        r"force\.csv.*increas",
    ),
    "force-header": ("interpolate", lines("force.csv", lambda rows: ["t,F,c", *rows[1:]]), r"force\.csv.*time_s"),
    "no-description": ("interpolate", lambda raw: (raw / "experiment.yaml").unlink(), r"experiment\.yaml"),
    "no-stages": ("interpolate", lambda raw: [path.unlink() for path in (raw / "dic").iterdir()] and None, r"dic"),
    "beside-the-specimen": (
        "interpolate",
        lambda raw: [shift_stage(path, 300.0) for path in (raw / "dic").glob("*.csv")] and None,
        r"(outside|no node|field)",
    ),
}


def shift_stage(path: Path, by: float) -> None:
    """All points of a stage moved along y."""
    rows = path.read_text().splitlines()
    table = np.loadtxt(rows[2:], delimiter=",")
    table[:, 2] += by
    body = ["%d,%.4f,%.4f,%.4f,%.5f,%.5f,%.5f" % tuple(row) for row in table.tolist()]  # noqa: UP031
    path.write_text("\n".join([*rows[:2], *body]) + "\n")


def one_sentence(error: ThermofitError) -> None:
    text = str(error)
    assert "\n" not in text and 20 < len(text) < 500, text
    assert "Traceback" not in text and "Errno" not in text


@pytest.mark.parametrize("case", CASES)
def test_bad_raw_data(study_of: StudyOf, case: str) -> None:
    stage, damage, text = CASES[case]
    study = study_of()
    path = artefact_path(study.run_dir, stage)
    before = path.read_bytes()
    damage(study.experiment)
    with pytest.raises(DataError) as caught:
        tiny.stage_run(stage)(study)
    one_sentence(caught.value)
    assert re.search(text, str(caught.value), re.IGNORECASE), str(caught.value)
    assert path.read_bytes() == before and open_record(path).summary["verdict"]
    assert not [p.name for p in study.run_dir.iterdir() if p.name.startswith(".")]


def test_stages_in_another_order_are_sorted_and_counted(study_of: StudyOf) -> None:
    """The time inside the file counts, not its name."""
    study = study_of()
    whole = open_record(artefact_path(study.run_dir, "interpolate"))["u/value"].value
    dic = study.experiment / "dic"
    for old, new in (("0004", "keep"), ("0005", "0004"), ("keep", "0005")):
        (dic / f"stage_{old}.csv").rename(dic / f"stage_{new}.csv")
    with pytest.raises(StudyError, match=r"calibrate-ir\.h5 is stale: experiment '.*raw' has changed since"):
        tiny.stage_run("interpolate")(study)
    tiny.stage_run("calibrate-ir")(study)
    record = tiny.stage_run("interpolate")(study).record
    assert any("2 stages sorted by time" in repair for repair in record.summary["repairs"])
    assert np.array_equal(record["u/value"].value, whole, equal_nan=True)


def test_points_outside_the_field_are_left_out_and_counted(study_of: StudyOf) -> None:
    """Half of the field lost: its nodes are masked, none is extrapolated."""
    study = study_of()
    whole = open_record(artefact_path(study.run_dir, "interpolate"))
    for path in (study.experiment / "dic").glob("*.csv"):
        rows = path.read_text().splitlines()
        path.write_text("\n".join([*rows[:2], *[row for row in rows[2:] if float(row.split(",")[2]) < 5.0]]) + "\n")
    tiny.stage_run("calibrate-ir")(study)
    record = tiny.stage_run("interpolate")(study).record
    counts, full = record.summary["displacement"], whole.summary["displacement"]
    assert counts["nodes_outside"] > full["nodes_outside"] and counts["masked"] > full["masked"]
    outside = record["u/xy"].value[:, 1] > 5.5
    assert outside.any() and not record["u/mask"].value[:, outside].any()


def test_simulate_refuses_what_the_material_cannot_carry(study_of: StudyOf) -> None:
    content = study_of()
    before = artefact_path(content.run_dir, "simulate").read_bytes(), sorted(p.name for p in content.experiment.rglob("*"))
    simulate = {**tiny.tree(content.run_dir)["simulate"], "programme": [{"crosshead_to": 90.0, "rate": 0.14}]}
    study = study_of(simulate=simulate)
    with pytest.raises(StudyError, match="past the largest force") as caught:
        tiny.stage_run("simulate")(study)
    one_sentence(caught.value)
    assert (artefact_path(study.run_dir, "simulate").read_bytes(), sorted(p.name for p in study.experiment.rglob("*"))) == before


STUDY_ERRORS: dict[str, tuple[dict[str, Any], str]] = {
    "misspelt": ({"meshh": "coarse"}, r"'meshh' is not known.*'mesh'"),
    "no-data": ({"simulate": None}, r"experiment"),
    "negative-beta": ({"parameters": {"beta": -0.1}}, r"parameters\.beta.*0 to"),
    "truth-beta": ({"simulate": {"truth": {**tiny.TRUTH, "beta": -1.0}}}, r"simulate\.truth\.beta"),
    "degC": ({"parameters": {"theta_air": 24.0}}, r"297\.15 K"),
    "start-outside": ({"parameters": {"nu": {"start": 0.6}}}, r"parameters\.nu"),
}


@pytest.mark.parametrize("case", STUDY_ERRORS)
def test_bad_study(tmp_path: Path, case: str) -> None:
    changes, text = STUDY_ERRORS[case]
    path = tiny.write(tmp_path, {**tiny.tree(tmp_path / "run"), **changes})
    with pytest.raises(StudyError) as caught:
        load_study(path)
    one_sentence(caught.value)
    assert re.search(text, str(caught.value)), str(caught.value)
    assert "tiny.yaml" in str(caught.value)


@pytest.mark.parametrize(
    ("stage", "missing"),
    [
        ("interpolate", "calibrate-ir"),
        ("identify-elastic", "interpolate"),
        ("identify-plastic", "identify-elastic"),
        ("identify-thermal", "identify-plastic"),
    ],
)
def test_missing_artefact_names_the_command_that_makes_it(study_of: StudyOf, stage: str, missing: str) -> None:
    study = study_of()
    artefact_path(study.run_dir, missing).unlink()
    with pytest.raises(StudyError, match=rf"run `thermofit {missing} tiny\.yaml` first"):
        tiny.stage_run(stage)(study)
    assert artefact_path(study.run_dir, stage).exists()


def test_damaged_artefact_names_the_command_that_makes_it(study_of: StudyOf) -> None:
    study = study_of()
    path = artefact_path(study.run_dir, "interpolate")
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(DataError, match=r"interpolate"):
        tiny.stage_run("identify-elastic")(study)


@pytest.mark.parametrize("stage", ["calibrate-ir", "interpolate"])
def test_missing_raw_folder_names_the_mend(tmp_path: Path, stage: str) -> None:
    study = load_study(tiny.write(tmp_path, tiny.tree(tmp_path / "run")))
    with pytest.raises(DataError, match=r"raw folder does not exist; run `thermofit simulate tiny\.yaml` first"):
        tiny.stage_run(stage)(study)
    measured = load_study(tiny.write(tmp_path, {**tiny.tree(tmp_path / "run"), "experiment": "nowhere"}))
    with pytest.raises(DataError, match="correct the key 'experiment'"):
        tiny.stage_run(stage)(measured)


def test_elastic_window_with_plastic_points_is_a_warning_with_numbers(study_of: StudyOf) -> None:
    study = study_of("stages.elastic.window=[0.0, 20.0]", "stages.plastic.max_evaluations=6")
    elastic = tiny.stage_run("identify-elastic")(study).record
    said = " ".join(elastic.summary["remarks"])
    assert re.search(r"elastic window ends at 20\.00 s, after the force bends at \d+\.\d\d s", said), said
    plastic = tiny.stage_run("identify-plastic")(study).record
    remarks = " ".join(plastic.summary["remarks"])
    assert re.search(r"elastic window up to 20\.00 s holds \d+ plastic of 192 points, the first at \d+\.\d\d s", remarks), remarks
