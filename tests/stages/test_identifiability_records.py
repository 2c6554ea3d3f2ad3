"""`identifiability` on a coupon, from its file to intervals by every way; a killed analysis resumes with the same answer."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.core.errors import UntrustworthyError
from thermofit.core.parameters import Parameters
from thermofit.point.driver import PointSettings, Programme, simulate
from thermofit.stages import identifiability, identify_elastic, identify_plastic, interpolate
from thermofit.stages.identifiability import IdentifiabilityOptions
from thermofit.study.study import Study, load_study

ROOT = Path(__file__).resolve().parents[2]
TRUTH = {"E": 198e3, "M_y0": 310.0, "M_yinf": 560.0, "H_exp": 14.0}
NAMES = ("M_y0", "M_yinf", "H_exp")


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Study file of a coupon whose elastic and plastic parameters are identified."""
    folder = tmp_path_factory.mktemp("coupon")
    parameters = Parameters.of({**TRUTH, "nu": 0.3, "theta_air": 293.0, "theta_ref": 293.0})
    time_s, strain = np.linspace(0.0, 60.0, 301), np.linspace(0.0, 0.06, 301)
    found = simulate(parameters, Programme.by_strain(time_s, strain, 293.0), PointSettings(model=1))
    stress = found.stress + 1.5 * np.random.default_rng(4).normal(size=301)
    np.savetxt(folder / "a.csv", np.stack([time_s, strain, stress], axis=1), delimiter=",", header="t,e,s", comments="", fmt="%.9g")
    units = {"time": ("t", "s"), "strain": ("e", "1"), "stress": ("s", "MPa")}
    record = {"file": "a.csv", "initial_temperature_degC": 19.85, "noise": {"strain": 1e-8, "stress": 1.5}}
    record |= {key: {"column": column, "unit": unit} for key, (column, unit) in units.items()}
    tree = {
        "name": "coupon",
        "model": 1,
        "run_dir": str(folder / "run"),
        "coupon": {"records": [record]},
        "parameters": {
            "nu": 0.3,
            "E": {"start": 150e3, "bounds": [50e3, 400e3]},
            "M_y0": {"start": 250.0, "bounds": [50.0, 450.0]},
            "M_yinf": {"start": 500.0, "bounds": [455.0, 2000.0]},
            "H_exp": {"start": 20.0, "bounds": [0.5, 200.0]},
        },
    }
    path = folder / "coupon.yaml"
    path.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    study = load_study(path)
    for stage in (interpolate, identify_elastic, identify_plastic):
        stage.run(study)
    return path


@pytest.fixture
def study(identified: Path) -> Study:
    return load_study(identified)


def width(ways: dict[str, dict[str, float]], way: str) -> float:
    return ways[way]["high"] - ways[way]["low"]


def test_intervals_by_every_way_agree(identified: Path) -> None:
    """Data of the model itself: all ways hold nearly the same interval; --json holds them under `intervals`."""
    pytest.importorskip("emcee")
    result = CliRunner().invoke(app, ["identifiability", str(identified), "--bootstrap", "400", "--profile", "--mcmc", "--json"])
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    assert answer["kind"] == "unique" and answer["stage_analysed"] == "plastic"
    for name in NAMES:
        ways = answer["intervals"][name]
        assert set(ways) == {"laplace", "bootstrap", "profile", "mcmc"}
        laplace = width(ways, "laplace")
        assert width(ways, "profile") == pytest.approx(laplace, rel=0.15)
        assert width(ways, "mcmc") == pytest.approx(laplace, rel=0.25)
        assert 0.5 < width(ways, "bootstrap") / laplace < 2.0
        assert ways["laplace"]["low"] - laplace < TRUTH[name] < ways["laplace"]["high"] + laplace
    assert all(Path(path).exists() for path in answer["figures"])


def test_full_bootstrap_agrees_with_the_linearised_one(study: Study) -> None:
    x = identifiability.run(study, IdentifiabilityOptions(repeats=30)).record["bootstrap/x"].value
    y = identifiability.run(study, IdentifiabilityOptions(repeats=30, refit=True)).record["bootstrap/x"].value
    assert x.shape == y.shape == (30, 3)
    for k in range(3):
        assert np.corrcoef(x[:, k], y[:, k])[0, 1] > 0.95
        assert y[:, k].std() == pytest.approx(x[:, k].std(), rel=0.3)


def test_plan_and_comparison(study: Study) -> None:
    """The plan of the record's own programme predicts its standard errors; programmes are ranked."""
    found = identifiability.run(study).record
    planned = identifiability.run(study, IdentifiabilityOptions(before=True)).record
    for name in NAMES:
        assert planned.parameters[name].sigma == pytest.approx(found.parameters[name].sigma, rel=0.5)
    rows = identifiability.run(study, IdentifiabilityOptions(compare=("monotonic", "load-unload"))).record.summary["programmes"]
    assert [row["rank"] for row in rows] == [1, 2] and rows[0]["D"] <= rows[1]["D"]


def test_too_few_blocks_are_refused(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    from thermofit.fit.bootstrap import Blocks
    from thermofit.identify import intervals

    monkeypatch.setattr(intervals, "residual_blocks", lambda model, r: Blocks(np.arange(len(r)) * 3 // len(r), 3, "3 blocks"))
    with pytest.raises(UntrustworthyError, match="3 blocks"):
        identifiability.run(study, IdentifiabilityOptions(repeats=20), force=True)


@pytest.mark.parametrize("asked", [["--profile"], ["--bootstrap", "40", "--refit"]], ids=["profile", "bootstrap"])
def test_killed_analysis_resumes(study: Study, asked: list[str]) -> None:
    """Killed with parts of the work on disk, the same command ends with the same answer and computes none of these again."""
    command = ["identifiability", str(study.source), "--json", "--force", *asked]
    whole = json.loads(CliRunner().invoke(app, command).stdout)["intervals"]
    done = study.run_dir / ".identifiability.parts.evaluations" / "done"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    run = [sys.executable, "-m", "thermofit.cli", *command]
    with subprocess.Popen(run, env=environment, stdout=subprocess.DEVNULL) as process:
        deadline = time.monotonic() + 300.0
        while len(list(done.glob("*.npz"))) < 2:
            assert process.poll() is None and time.monotonic() < deadline, "ended before two parts were on disk"
            time.sleep(0.001)
        process.send_signal(signal.SIGKILL)
    before = {path.name: path.stat().st_mtime_ns for path in done.glob("*.npz")}
    seen: dict[str, int] = {}
    original = identifiability.discard_checkpoints

    def watched(task: object) -> None:
        seen.update({path.name: path.stat().st_mtime_ns for path in done.glob("*.npz")})
        original(task)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identifiability, "discard_checkpoints", watched)
        again = json.loads(CliRunner().invoke(app, command).stdout)["intervals"]
    assert again == whole and len(before) >= 2
    assert all(seen[name] == at for name, at in before.items()), "a finished part was computed again"
    assert not list(study.run_dir.glob(".identifiability*"))
