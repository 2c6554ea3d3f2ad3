"""Several virtual experiments through the whole chain: one material, two boundaries, a third test that no fit has seen."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.diagnose.case import rows_of_tests
from thermofit.diagnose.held_out import Proof, compared
from thermofit.experiment.fields import with_identified
from thermofit.experiment.forms import experiment_of
from thermofit.experiment.verification import fitted_parameters, identified_stages
from thermofit.records.artefact import open_record
from thermofit.study.study import load_study

pytestmark = pytest.mark.slow

SECOND = {"theta_air": 299.0, "theta_clamp": 295.9, "alpha_air": 40.0}
OTHER_PROGRAMME = [
    {"hold": 3.0},
    {"crosshead_to": 2.6, "rate": 0.2},
    {"force_to": 0.0, "rate": -0.14},
    {"hold_force_until": 50.0},
]


def tree(run_dir: Path) -> dict[str, Any]:
    whole = tiny.tree(run_dir)
    whole["parameters"]["kappa"] = 133.0
    whole["simulate"]["ir"]["frames"] = 56  # 14 tell the scale of the thermal parameters to 2 % only
    whole["parameters"]["alpha_air"] = {"start": 25.0, "bounds": [0.0, 200.0]}
    whole["stages"] = {"thermal": {"free": ["alpha_exp", "c0", "beta", "alpha_air"]}}
    whole["experiments"] = {
        "first": {},
        "second": {"simulate": {"truth": SECOND, "programme": OTHER_PROGRAMME}},
        "third": {"held_out": True, "simulate": {"seed": 40, "programme": OTHER_PROGRAMME}},
    }
    whole["literature"] = {"E": [67000, 69000], "c_p": {"value": 2.3, "sigma": 0.1}}
    for key in ("gridsearch", "sensitivity"):
        whole.pop(key)
    return whole


def call(*arguments: Any) -> tuple[int, dict[str, Any]]:
    result = CliRunner().invoke(app, [*(str(a) for a in arguments), "--json"])
    return result.exit_code, json.loads(result.stdout)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("several")
    return tiny.write(folder, tree(folder / "run"))


@pytest.fixture(scope="module")
def chain(path: Path) -> dict[str, Any]:
    code, found = call("run", path)
    assert code in (0, 5), found
    return found


def test_chain_finds_one_material_and_two_boundaries(chain: dict[str, Any], path: Path) -> None:
    found = chain["parameters"]
    assert {"E", "M_y0", "c0", "alpha_air@first", "alpha_air@second"} <= set(found) and "alpha_air" not in found
    rows = {row["name"]: row for row in chain["table"]}
    assert rows["alpha_air@second"]["true"] == 40.0 and rows["alpha_air@first"]["true"] == 14.7
    for name, within in (("E", 0.02), ("M_y0", 0.02), ("c0", 0.05), ("beta", 0.05)):
        assert abs(rows[name]["deviation"]) < within, rows[name]
    apart = found["alpha_air@second"]["value"] - found["alpha_air@first"]["value"]
    assert apart > 3.0 * np.hypot(found["alpha_air@second"]["sigma"], found["alpha_air@first"]["sigma"])
    assert {"du@first", "du@second", "dtheta@second"} <= set(chain["channels"]) and "du@third" not in chain["channels"]
    assert {row["experiment"] for row in open_record(path.parent / "run" / "verify.h5").summary["phases"]} == {"first", "second"}
    assert (path.parent / "run" / "second" / "report.md").exists() and chain["figures"]
    assert all(step["fresh"] for step in call("run", path)[1]["steps"] if "fresh" in step)


def test_held_out_experiment_is_predicted(chain: dict[str, Any], path: Path) -> None:
    _, found = call("validate", path)
    assert set(found["channels"]) >= {"du@third", "dtheta@third"} and "du@first" not in found["channels"]
    assert "valid: third" in found["verdict"] or "third: " in found["verdict"]
    for channel in ("du@third", "dtheta@third"):
        assert found["channels"][channel]["chi2_reduced"] < 4.0, found["channels"][channel]
    assert any("alpha_air" in text and "mean of 2 fitted experiments" in text for text in found["remarks"])
    assert {row["parameter"] for row in found["literature"]} == {"E", "c_p"}
    _, fitted = call("validate", path, "--set", "experiments.third.fit_own=[alpha_air]")
    assert any("fitted on its own data" in text for text in fitted["remarks"])
    assert fitted["channels"]["dtheta@third"]["chi2_reduced"] < found["channels"]["dtheta@third"]["chi2_reduced"]
    assert not list((path.parent / "run").glob(".validate*")), "what a fit kept goes when the record is there"


def test_a_change_of_the_model_is_proved_on_the_held_out_experiment(chain: dict[str, Any], path: Path) -> None:
    """The interface of the loop: the same held-out rows before and after."""
    study = load_study(path)
    stages = identified_stages(study)
    experiment = experiment_of(study)
    base, _ = with_identified(study, experiment.start(), stages)
    identified = [name for name, result in fitted_parameters(study, base, stages).items() if result.free]
    (third,) = experiment.unseen
    after = third.predicted(base, identified)
    problem = third.problem(experiment.joint_settings(), after, ())
    before, then = (problem.model.residual(p) for p in (after.replace(M_yinf=1.03 * after["M_yinf"]), after))
    found = compared(before, then, rows_of_tests(problem.each, problem.spans), 1)
    assert isinstance(found, Proof) and found.gain > 3.0 * found.sigma > 0.0 and found.folds == 1


def test_compare_fits_candidates_on_all_experiments(chain: dict[str, Any], path: Path) -> None:
    """The held-out test with its own film coefficient given: that of the fitted ones would be twice as large and hide the difference."""
    own = ("--set", "experiments.third.parameters={alpha_air: 14.7}")
    _, found = call("compare", path, "--set", "compare={model-1: {model: 1}}", *own)
    rows = {row["model"]: row for row in found["models"]}
    assert set(rows) == {"tiny", "model-1"} and found["held_out"] == "experiment third, which no fit has seen"
    assert rows["model-1"]["fitted"] == rows["tiny"]["fitted"]
    assert rows["tiny"]["BIC - best"] == 0.0 and rows["tiny"]["held out over noise"] < rows["model-1"]["held out over noise"], found[
        "verdict"
    ]


def test_raw_folder_is_predicted_by_an_option(chain: dict[str, Any], path: Path) -> None:
    """A study of one experiment keeps its form; a folder on the command line is read, interpolated and predicted."""
    alone = tree(path.parent / "alone")
    alone |= {"experiments": {}, "experiment": str(path.parent / "run" / "first" / "raw"), "name": "alone"}
    alone.pop("simulate")
    file = tiny.write(path.parent, alone).rename(path.parent / "alone.yaml")
    tiny.write(path.parent, tree(path.parent / "run"))
    for command in ("calibrate-ir", "interpolate", "identify-elastic", "identify-plastic", "identify-thermal"):
        call(command, file)
    _, found = call("validate", file, "--experiment", path.parent / "run" / "third" / "raw")
    assert "du@raw" in found["channels"] and found["channels"]["du@raw"]["chi2_reduced"] < 6.0
    assert any("alpha_air" in text and "identified on the fitted experiment" in text for text in found["remarks"])
