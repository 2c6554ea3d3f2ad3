"""A test with load cell and infrared camera alone: its motion is computed with known mechanical parameters."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny
import yaml
from record_studies import call, told
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.core.errors import DataError, NumericsError, StudyError
from thermofit.experiment.fields import measured, read_field
from thermofit.experiment.forms import experiment_of
from thermofit.experiment.known_effects import effects_of_fields
from thermofit.experiment.priors import pose_bounds
from thermofit.records.artefact import open_record
from thermofit.report.tables import budget_lines
from thermofit.study.study import Study, load_study
from thermofit.study.template import write_template

MECHANICAL = ("E", "nu", "M_y0", "M_yinf", "H_exp", "F")
THERMAL = ("kappa", "c0", "alpha_exp", "beta", "alpha_air", "alpha_clamp")


def content(run: Path, raw: Path) -> dict[str, Any]:
    """A study as a user writes it: what is known as numbers, the rest with starts far off."""
    found = {key: value for key, value in tiny.tree(run).items() if key not in ("simulate", "gridsearch", "sensitivity", "stages")}
    films = {"alpha_air": {"start": 10.0, "bounds": [0.0, 200.0]}, "alpha_clamp": {"start": 300.0, "bounds": [1.0, 5000.0]}}
    parameters = {**found["parameters"], **{name: tiny.TRUTH[name] for name in MECHANICAL}, **films}
    return {**found, "experiment": str(raw), "parameters": parameters}


@pytest.fixture(scope="module")
def ready(finished: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study file of the tiny test without DIC, whose camera is calibrated."""
    folder = tmp_path_factory.mktemp("alone")
    path = tiny.write(folder, content(folder / "run", tiny.without_camera(finished / "raw", folder / "raw", "dic")))
    tiny.stage_run("calibrate-ir")(load_study(path))
    return path


@pytest.fixture(scope="module")
def alone(ready: Path) -> Path:
    """The same, whose chain has run. Not to be written into."""
    told("run", ready)
    return ready


def changed(ready: Path, folder: Path, **parameters: Any) -> dict[str, Any]:
    """The content of that study with a run folder of its own that holds the calibration, and other settings of parameters."""
    (folder / "run").mkdir()
    shutil.copy(ready.parent / "run" / "calibrate-ir.h5", folder / "run")
    found: dict[str, Any] = {**yaml.safe_load(ready.read_text(encoding="utf-8")), "run_dir": str(folder / "run")}
    found["parameters"] = {**found["parameters"], **parameters}
    return found


def study_of(folder: Path, tree: dict[str, Any]) -> Study:
    return load_study(tiny.write(folder, tree))


def test_thermal_parameters_come_back(alone: Path) -> None:
    """All six within three combined standard errors of the planted ones, the mechanical ones as they were given."""
    record = open_record(alone.parent / "run" / "refine.h5")
    free = {name: one for name, one in record.parameters.items() if one.free}
    study = load_study(alone)
    pose = pose_bounds(study, measured(study).registration)
    assert len(pose) == 4, "the camera lies beside the specimen by an error of its landmarks, which is fitted with everything else"
    assert set(free) == {*THERMAL, "theta_air", "theta_clamp", *pose} and record.summary["refined"]
    assert {name: (free[name].lower, free[name].upper) for name in pose} == pose
    for name in THERMAL:
        assert free[name].sigma is not None and 0.0 < free[name].sigma < 0.2 * free[name].value, name
        assert abs(free[name].value - tiny.TRUTH[name]) < 3.0 * free[name].sigma, name
    assert all(record.parameters[name].value == tiny.TRUTH[name] for name in MECHANICAL)
    assert set(open_record(alone.parent / "run" / "verify.h5").summary["channels"]) == {"dtheta", "theta"}


def test_material_is_followed_as_the_measured_motion_follows_it(alone: Path, finished: Path) -> None:
    """Nodal temperatures are those that DIC gives, up to the slip that it alone has seen; at rest pixels they are others."""
    record = open_record(alone.parent / "run" / "interpolate.h5")
    here, there = (read_field(r, "theta") for r in (record, open_record(finished / "interpolate.h5")))
    shared = [np.isin(np.round(a.time, 6), np.round(b.time, 6)) for a, b in ((here, there), (there, here))]
    place = [np.flatnonzero((np.abs(there.xy - xy) < 1e-6).all(axis=1)) for xy in here.xy]
    both = [(k, int(at[0])) for k, at in enumerate(place) if len(at)]
    i, j = (np.array(column) for column in zip(*both, strict=True))
    ours, theirs = here.value[shared[0]][:, i, 0], there.value[shared[1]][:, j, 0]
    used = here.mask[shared[0]][:, i] & there.mask[shared[1]][:, j]
    assert len(i) > 100 and used.sum() > 1000
    away = np.sqrt(np.mean((ours - theirs)[used] ** 2))
    assert away < np.nanmedian(here.sigma), "what is left is slip: a few other pixels at the rims of the patches"


def test_the_record_says_that_the_motion_is_computed(alone: Path) -> None:
    record = open_record(alone.parent / "run" / "interpolate.h5")
    assert not record.has("u/value") and not record.has("elongation/value"), "what is computed is no datum"
    motion = record.summary["motion"]
    assert motion["parameters"] == {name: tiny.TRUTH[name] for name in MECHANICAL}
    # 3.5 mm of crosshead, half of it in the middle; a pixel is 0.4 mm wide, nodes are 1 mm apart.
    assert 1.0 < motion["largest_mm"] < 3.5 and motion["largest_px"] == pytest.approx(motion["largest_mm"] / 0.4, rel=0.02)
    assert motion["largest_patches"] == pytest.approx(motion["largest_mm"] / 1.04, rel=0.05)
    (said,) = (text for text in record.summary["remarks"] if "motion is computed" in text)
    assert "E = 68000 MPa" in said and "pixels" in said and "distance of two nodes" in said
    assert measured(load_study(alone)).displacement is None
    thermal = open_record(alone.parent / "run" / "identify-thermal.h5")
    assert any("E, nu, M_y0, M_yinf, H_exp, F are taken as exact" in text for text in thermal.summary["remarks"])
    for stage in ("elastic", "plastic"):
        verdict = open_record(alone.parent / "run" / f"identify-{stage}.h5").summary["verdict"]
        assert verdict.startswith("nothing to identify: the experiment has no displacements: "), stage
    assert "the motion of the specimen was computed under the measured force" in (alone.parent / "run" / "methods.md").read_text()


def test_the_loop_finds_nothing_where_nothing_is_missing(alone: Path) -> None:
    """Complete, and effects that temperatures alone would tell badly are not asked."""
    assert call("close-loop", alone).exit_code == 0
    record = open_record(alone.parent / "run" / "close-loop.h5")
    assert record.summary["grade"] == "complete" and set(record.summary["channels"]) == {"dtheta"}
    assert {"rate_power", "thermal_softening", "force_scale", "dic_tilt", "bending"} <= set(record.summary["not_asked"])
    assert not {"clamp_drift", "lamp", "ir_drift", "stored_energy"} & set(record.summary["not_asked"])
    assert any("E, nu, M_y0, M_yinf, H_exp, F are taken as exact" in text for text in record.summary["remarks"])
    local = record.summary["local_balances"]
    assert [one["balance"] for one in local["maps"]] == ["heat"] and local["where"] == "none"
    assert [text.partition(":")[0] for text in local["without"]] == ["force through sections"]


def test_effects_that_are_asked_act_on_temperatures_alone() -> None:
    asked = {e.slot for e in effects_of_fields(displacements=False, infrared=True)}
    assert {"heat_source", "boundary_temperature", "dissipation", "sensor"} <= asked
    assert not asked & {"base", "yield_stress", "yield_factor", "backstress", "load", "kinematics", "camera", "elasticity"}


@pytest.mark.parametrize(
    ("parameters", "more", "words"),
    [
        ({"E": {"start": 6e4, "bounds": [3e4, 1e5]}}, {}, r"parameters E have a start.*temperatures alone do not tell them.*\(E: 60000\)"),
        ({"nu": None}, {}, r"key 'parameters\.nu' is missing: the experiment has no displacements"),
        ({}, {"stages": {"thermal": {"free": ["kappa", "M_y0"]}}}, r"key 'stages\.thermal\.free' holds M_y0, but"),
        ({}, {"diagnosis": {"free": ["E", "c0"]}}, r"key 'diagnosis\.free' holds E, but"),
        ({}, {"force": {"drives": "dic"}}, r"key 'force\.drives' is dic, but the experiment has no displacements"),
    ],
    ids=["start", "missing", "thermal", "diagnosis", "drive"],
)
def test_what_temperatures_do_not_tell_is_refused(
    ready: Path, tmp_path: Path, parameters: dict[str, Any], more: dict[str, Any], words: str
) -> None:
    tree = {**changed(ready, tmp_path, **parameters), **more}
    tree["parameters"] = {name: value for name, value in tree["parameters"].items() if value is not None}
    with pytest.raises(StudyError, match=words) as refused:
        tiny.stage_run("interpolate")(study_of(tmp_path, tree))
    assert "\n" not in str(refused.value)


def test_a_mechanical_parameter_that_is_freed_later_is_refused(alone: Path) -> None:
    """Also where the temperatures lie on their nodes already: by the stage, and by the joint fit."""
    study = load_study(alone, ["stages.thermal.free=[kappa, M_y0]", "diagnosis.free=[E, c0]"])
    with pytest.raises(StudyError, match=r"'stages\.thermal\.free' holds M_y0"):
        experiment_of(study).stage("thermal")
    with pytest.raises(StudyError, match=r"'diagnosis\.free' holds E"):
        experiment_of(study).joint_settings()


def test_parameters_that_cannot_carry_the_force_are_refused(ready: Path, tmp_path: Path) -> None:
    tree = changed(ready, tmp_path, M_y0=20.0, M_yinf=60.0)
    with pytest.raises(NumericsError, match=r"the motion cannot be computed with E = 68000 MPa.*M_y0 = 20 MPa.*correct these parameters"):
        tiny.stage_run("interpolate")(study_of(tmp_path, tree))


def test_a_folder_without_any_camera_is_refused(ready: Path, tmp_path: Path) -> None:
    raw = tiny.without_camera(ready.parent / "raw", tmp_path / "raw", "ir")
    with pytest.raises(DataError, match="declares neither displacements nor infrared frames"):
        tiny.stage_run("interpolate")(study_of(tmp_path, {**changed(ready, tmp_path), "experiment": str(raw)}))


def test_tests_with_and_without_displacements_are_not_mixed(ready: Path, finished: Path, tmp_path: Path) -> None:
    tree = {**changed(ready, tmp_path), "experiments": {"other": {"experiment": str(finished / "raw"), "held_out": True}}}
    with pytest.raises(StudyError, match=r"tiny\.yaml has no displacements, but other has: identify the mechanical parameters"):
        tiny.stage_run("interpolate")(study_of(tmp_path, tree))


def test_stated_errors_of_the_mechanics_enter_the_budget(alone: Path, tmp_path: Path) -> None:
    """An error of E moves the thermoelastic cooling, and with it what alpha_exp stands for: sigma grows, and its cause has a name."""
    shutil.copytree(alone.parent / "run", tmp_path / "run")
    tree = {**yaml.safe_load(alone.read_text(encoding="utf-8")), "run_dir": str(tmp_path / "run")}
    exact = open_record(tmp_path / "run" / "identify-thermal.h5")
    study = study_of(tmp_path, {**tree, "uncertainty": {"parameters": {"E": 2000.0, "M_y0": 4.0}}})
    record = tiny.stage_run("identify-thermal")(study).record
    causes = {row["cause"] for row in record.summary["budget"]["beta"]}
    assert {"E", "M_y0"} <= causes and not {"E", "M_y0"} & {row["cause"] for row in exact.summary["budget"]["beta"]}
    sigma = [r.parameters["beta"].sigma for r in (exact, record)]
    assert sigma[0] is not None and sigma[1] is not None and sigma[1] > 1.1 * sigma[0]
    assert any("nu, M_yinf, H_exp, F are taken as exact" in text for text in record.summary["remarks"])


def test_what_is_not_stated_is_shown_with_the_budget(alone: Path) -> None:
    """On the terminal, in its JSON and in the report."""
    path = alone.parent / "run" / "identify-thermal.h5"
    words = "not stated under 'uncertainty', and counted as exact: force_class, thickness, width, infrared_gain"
    shown, told = (CliRunner().invoke(app, ["show", str(path), "--budget", *more]).stdout for more in ((), ("--json",)))
    assert words in shown and json.loads(told)["exact"] == ["force_class", "thickness", "width", "infrared_gain"]
    record = open_record(path)
    assert budget_lines(record, {"identify-thermal": record})[-1] == f"{words[0].upper()}{words[1:]}."
    silent = replace(record, summary={**record.summary, "exact": []})
    assert "exact" not in " ".join(budget_lines(silent, {"identify-thermal": silent}))


def test_a_new_study_leaves_the_mechanics_to_be_put_in(ready: Path, tmp_path: Path) -> None:
    """No number of the template passes for a known one; the study loads, and its first stage says what is missing."""
    path = tmp_path / "new.yaml"
    said = write_template(path, str(ready.parent / "raw"), look=lambda _: "the experiment has no displacements")
    assert "put in the mechanical parameters as numbers" in said
    study = load_study(path)
    assert not set(MECHANICAL) & set(study.parameters) and set(THERMAL) <= set(study.parameters)
    assert not study.has_displacements


@pytest.mark.slow
def test_drifting_jaws_are_named(tmp_path: Path) -> None:
    """Planted by `simulate` on another mesh: the loop names them, or their family, and what they had driven off comes back."""
    tree = tiny.tree(tmp_path / "virtual" / "run")
    tree["simulate"]["truth"]["clamp_drift.rate"] = 0.03
    tree["simulate"] |= {"mesh": {"n_x": 3, "n_y": 32, "n_z": 1}, "ir": {"frames": 40, "image_shape": [150, 90]}}
    (tmp_path / "virtual").mkdir()
    tiny.stage_run("simulate")(load_study(tiny.write(tmp_path / "virtual", tree)))
    raw = tiny.without_camera(tmp_path / "virtual" / "run" / "raw", tmp_path / "raw", "dic")
    path = tiny.write(tmp_path, {**content(tmp_path / "run", raw), "mesh": {"n_x": 2, "n_y": 24, "n_z": 1}})
    assert call("run", path, "--until", "verify").exit_code == 5, "the base model does not explain the temperatures"
    ended = call("close-loop", path)
    record = open_record(tmp_path / "run" / "close-loop.h5")
    assert record.summary["accepted"] == ["clamp_drift"] and ended.exit_code == 0 and record.summary["grade"] == "named"
    found = record.parameters
    for name, truth in {
        **{name: tiny.TRUTH[name] for name in ("kappa", "c0", "alpha_exp", "beta", "alpha_air")},
        "clamp_drift.rate": 0.03,
    }.items():
        assert found[name].sigma is not None and abs(found[name].value - truth) < 3.0 * found[name].sigma, name
