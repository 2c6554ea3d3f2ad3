"""A virtual experiment so small that the whole chain runs in seconds."""

from __future__ import annotations

import importlib
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from thermofit.records.staging import Outcome
from thermofit.study.study import load_study

__all__ = ["CHAIN", "MESH", "TRUTH", "load_study", "stage_run", "tree", "without_camera", "write"]

MESH = {"n_x": 2, "n_y": 12, "n_z": 1}
TRUTH = {
    "E": 68000.0,
    "nu": 0.34,
    "M_y0": 129.0,
    "M_yinf": 293.0,
    "H_exp": 10.9,
    "F": 0.35,
    "alpha_exp": 20.2e-6,
    "kappa": 133.0,
    "c0": 2.22,
    "beta": 0.79,
    "alpha_air": 14.7,
    "alpha_clamp": 236.0,
    "theta_air": 297.4,
    "theta_clamp": 296.7,
}
PROGRAMME = [
    {"hold": 3.0},
    {"crosshead_to": 3.5, "rate": 0.14},
    {"force_to": 0.0, "rate": -0.14},
    {"hold_force_until": 60.0},
]


def tree(run_dir: Path) -> dict[str, Any]:
    """The study as nested dictionaries; a test changes what it needs."""
    return {
        "name": "tiny",
        "run_dir": str(run_dir),
        "mesh": dict(MESH),
        "numerics": {"threads": 1},
        "parameters": {
            "E": {"start": 60000.0, "bounds": [30000.0, 150000.0]},
            "nu": {"start": 0.3, "bounds": [0.05, 0.48]},
            "M_y0": {"start": 140.0, "bounds": [50.0, 250.0]},
            "M_yinf": {"start": 290.0, "bounds": [251.0, 1000.0]},
            "H_exp": {"start": 15.0, "bounds": [1.0, 60.0]},
            "F": {"start": 0.5, "bounds": [0.1, 1.5]},
            "alpha_exp": {"start": 23.0e-6, "bounds": [5.0e-6, 60.0e-6]},
            "kappa": {"start": 200.0, "bounds": [20.0, 600.0]},
            "c0": {"start": 2.43, "bounds": [0.8, 6.0]},
            "beta": {"start": 1.0, "bounds": [0.0, 4.0]},
            "alpha_air": 14.7,
            "alpha_clamp": 236.0,
        },
        "stages": {"thermal": {"free": ["alpha_exp", "c0", "beta"]}},
        "gridsearch": {
            "stage": "thermal",
            "starts": [{"alpha_exp": 23.0e-6, "c0": 2.43, "beta": 1.0}, {"alpha_exp": 12.0e-6, "c0": 4.0, "beta": 0.5}],
        },
        "sensitivity": {"stage": "thermal", "quantity": "kappa", "values": [100.0, 200.0]},
        "simulate": {
            "seed": 5,
            "mesh": dict(MESH),
            "truth": dict(TRUTH),
            "programme": [dict(item) for item in PROGRAMME],
            "dic": {"stages": 14, "spacing": 2.0},
            "ir": {"frames": 14, "image_shape": [150, 90]},
        },
    }


def write(folder: Path, content: dict[str, Any]) -> Path:
    """The study file in a folder."""
    path = folder / "tiny.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def without_camera(raw: Path, to: Path, camera: str) -> Path:
    """A copy of a raw folder without "dic" or "ir", experiment.yaml adjusted as a user would."""
    shutil.copytree(raw, to)
    shutil.rmtree(to / camera)
    description = yaml.safe_load((to / "experiment.yaml").read_text(encoding="utf-8"))
    del description[camera]
    (to / "experiment.yaml").write_text(yaml.safe_dump(description), encoding="utf-8")
    return to


CHAIN = ("simulate", "calibrate-ir", "interpolate", "identify-elastic", "identify-plastic", "identify-thermal", "gridsearch", "sensitivity")


def stage_run(name: str) -> Callable[..., Outcome]:
    """The function of a stage by its command."""
    run: Callable[..., Outcome] = importlib.import_module(f"thermofit.stages.{name.replace('-', '_')}").run
    return run
