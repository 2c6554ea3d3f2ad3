"""A coupon that hardens by another law than the study's: `compare` says which law the data prefer, `hardening` of a study chooses one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from record_studies import told
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.core.parameters import Parameters
from thermofit.point.driver import PointSettings, Programme, simulate

TRUTH = {"E": 70e3, "M_y0": 120.0, "M_yinf": 320.0, "H_exp": 8.0, "hockett_sherby.exponent": 0.6, "nu": 0.33, "c0": 2.4}
NOISE = {"strain": 2e-7, "stress": 0.3}
CORNERS = [(0.0, 0.0), (20.0, 0.002), (80.0, 0.06), (84.0, 0.057), (180.0, 0.16)]


def study(folder: Path, **changes: Any) -> Path:
    record = {
        "file": "pull.csv",
        "time": {"column": "time_s", "unit": "s"},
        "strain": {"column": "strain", "unit": "1"},
        "stress": {"column": "stress", "unit": "MPa"},
        "initial_temperature_degC": 22.85,
        "noise": NOISE,
    }
    tree = {
        "name": "voce",
        "run_dir": str(folder / "run"),
        "hardening": "voce",
        "coupon": {"records": [record]},
        "parameters": {
            "E": {"start": 65e3, "bounds": [3e4, 1e5]},
            "M_y0": {"start": 140.0, "bounds": [30.0, 250.0]},
            "M_yinf": {"start": 330.0, "bounds": [251.0, 2000.0]},
            "H_exp": {"start": 12.0, "bounds": [0.1, 500.0]},
            "nu": 0.33,
            "c0": 2.4,
        },
        **changes,
    }
    path = folder / f"{tree['name']}.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("laws")
    times, strains = np.array(CORNERS).T
    time = np.arange(0.0, times[-1], 0.5)
    strain = np.interp(time, times, strains)
    truth = Parameters.of({**TRUTH, "theta_air": 296.0, "theta_ref": 296.0})
    found = simulate(truth, Programme.by_strain(time, strain, 296.0), PointSettings("hockett_sherby"))
    noise = np.random.default_rng(3).normal(size=(2, len(time)))
    columns = [time, strain + NOISE["strain"] * noise[0], found.stress + NOISE["stress"] * noise[1]]
    np.savetxt(place / "pull.csv", np.stack(columns, axis=1), delimiter=",", header="time_s,strain,stress", comments="", fmt="%.9g")
    return place


def test_the_planted_law_is_preferred_and_its_parameters_come_back(folder: Path) -> None:
    """Candidates free what their laws have in place of what Voce's has, and start on its curve."""
    path = study(folder, compare={"hockett-sherby": {"hockett_sherby": {}}})
    told("interpolate", path, code=2)  # the near miss of a key is told
    path = study(folder, compare={"hockett-sherby": {"hardening": "hockett_sherby"}, "linear": {"hardening": "linear"}})
    for command in ("interpolate", "identify-elastic", "identify-plastic"):
        told(command, path)
    found = told("compare", path)
    rows = {row["model"]: row for row in found["models"]}
    assert found["verdict"].startswith("hockett-sherby is preferred and explains the data"), found["verdict"]
    assert "voce is far worse" in found["verdict"] and "linear is far worse" in found["verdict"]
    assert rows["hockett-sherby"]["stress over noise"] < 1.2 < rows["voce"]["stress over noise"] < rows["linear"]["stress over noise"]
    assert [rows[name]["fitted"] for name in ("voce", "hockett-sherby", "linear")] == [4, 5, 3]
    fitted = {row["parameter"]: row for row in found["fitted"]}
    assert set(fitted) == {"E", "M_y0", "M_yinf", "H_exp", "hockett_sherby.exponent", "H_lin"}
    for name in ("E", "M_y0", "M_yinf", "H_exp", "hockett_sherby.exponent"):
        row = fitted[name]
        assert abs(row["hockett-sherby"] - TRUTH[name]) < 4.5 * row["hockett-sherby +-"], name


def test_a_study_identifies_with_the_law_that_it_names(folder: Path, tmp_path: Path) -> None:
    """Stage plastic frees what the law has; starts of the study are those of the template for such a test."""
    text = yaml.safe_load(study(folder).read_text())
    more = {"hockett_sherby.exponent": {"start": 0.9, "bounds": [0.2, 2.0]}}
    path = study(folder, name="hs", run_dir=str(tmp_path / "run"), hardening="hockett_sherby", parameters={**text["parameters"], **more})
    for command in ("interpolate", "identify-elastic"):
        told(command, path)
    found = told("identify-plastic", path)
    free = {name: p for name, p in found["parameters"].items() if p["free"]}
    assert set(free) == {"M_y0", "M_yinf", "H_exp", "hockett_sherby.exponent"}
    assert found["channels"]["stress"]["chi2_reduced"] == pytest.approx(1.0, abs=0.3)
    assert abs(free["hockett_sherby.exponent"]["value"] - 0.6) < 4.5 * free["hockett_sherby.exponent"]["sigma"]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"hardening": "vocee"}, "names no hardening law: 'vocee' is not known"),
        ({"hardening": "linear", "model": 1}, "key 'hardening' is linear, but model 1 is voce; give one of them"),
        ({"hardening": "hockett_sherby"}, "parameters.hockett_sherby.exponent' is missing, but stage plastic identifies it"),
        ({"hardening": "table", "parameters": {"M_y0": 150.0}}, "expected more than M_y0 = 150 MPa (strains and yield stresses"),
    ],
)
def test_what_is_refused(folder: Path, tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    path = study(folder, name="wrong", run_dir=str(tmp_path / "run"), **changes)
    result = CliRunner().invoke(app, ["identify-plastic", str(path)])
    assert result.exit_code == 2 and said in " ".join(result.output.split()), result.output
