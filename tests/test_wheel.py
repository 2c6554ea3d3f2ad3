"""The wheel works without a clone: the demo, a study of one's own, its version. Dependencies are those of the environment of the tests."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import thermofit

ROOT = Path(__file__).resolve().parents[1]
SMALL = (
    *("--set", "simulate.mesh={n_x: 2, n_y: 12, n_z: 1}", "--set", "simulate.dic={stages: 14, spacing: 2.0}"),
    *("--set", "simulate.ir={frames: 14, image_shape: [150, 90]}", "--set", "numerics.threads=1"),
    *("--set", "simulate.programme=[{hold: 3.0}, {crosshead_to: 3.5, rate: 0.14}, {force_to: 0.0, rate: -0.14}]"),
)
"""The demo in seconds."""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this tree."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(ROOT)]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr[-2000:]
    return next(folder.glob("thermofit-*.whl"))


@pytest.fixture(scope="module")
def command(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The command of an environment that holds the wheel, and beside it only what thermofit depends on."""
    folder = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    site = next(folder.glob("lib/python*/site-packages"))
    python = folder / "bin" / "python"
    arguments = ["install", "--quiet", "--no-deps", "--no-compile", "--ignore-installed", str(wheel)]
    subprocess.run([sys.executable, "-m", "pip", "--python", str(python), *arguments], check=True)
    others = next(Path(path) for path in sys.path if path.endswith("site-packages"))
    (site / "dependencies.pth").write_text(f"{others}\n")
    return folder / "bin" / "thermofit"


def run(command: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    return subprocess.run([command, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.slow
@pytest.mark.as_written
def test_wheel_holds_what_a_user_needs(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {
        "thermofit/study/quickstart.yaml",
        "thermofit/py.typed",
        "thermofit/__init__.pyi",
        "thermofit/read/sets/s235-plate-hole-dic.yaml",
    } <= names
    assert not {name for name in names if name.startswith(("tests", "docs", "configs"))}


@pytest.mark.slow
@pytest.mark.as_written
def test_demo_and_an_own_folder_run_without_a_clone(command: Path, tmp_path: Path) -> None:
    """demo, then inspect, new and run on the raw folder that it has made, as on one of a user's own."""
    assert run(command, tmp_path, "--version").stdout.strip() == f"thermofit {thermofit.__version__}"
    demo = run(command, tmp_path, "demo", "--until", "calibrate-ir", *SMALL, "--json")
    assert demo.returncode == 0, demo.stderr
    assert [step["stage"] for step in json.loads(demo.stdout)["steps"]] == ["simulate", "calibrate-ir"]
    raw = tmp_path / "thermofit-demo" / "run" / "raw"
    assert (tmp_path / "thermofit-demo" / "quickstart.yaml").is_file() and (raw / "experiment.yaml").is_file()
    own = tmp_path / "own"
    raw.rename(own)
    assert "ready for a study" in (seen := run(command, tmp_path, "inspect", "own")).stdout, seen.stderr
    assert (new := run(command, tmp_path, "new", "study.yaml", "--experiment", "own")).returncode == 0, new.stderr
    done = run(command, tmp_path, "run", "study.yaml", "--set", "mesh=coarse", "--until", "interpolate", "--json")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "runs" / "study" / "interpolate.h5").is_file()


def test_versions_of_python_are_declared() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    minors = {line.rpartition("3.")[2] for line in project["classifiers"] if line.startswith("Programming Language :: Python :: 3.")}
    assert project["requires-python"] == ">=3.11" and minors == {"11", "12", "13"}
