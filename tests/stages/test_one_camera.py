"""A folder that lacks one camera: displacements alone go through the whole loop, temperatures alone are refused in one sentence."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml
from record_studies import call, told
from tiny import stage_run, tree, write

from thermofit.core.errors import DataError
from thermofit.records.artefact import open_record
from thermofit.study.study import load_study


def without(finished: Path, folder: Path, camera: str) -> Path:
    """A measured study on a copy of the tiny raw folder without one camera, experiment.yaml adjusted as a user would."""
    raw = folder / "raw"
    shutil.copytree(finished / "raw", raw)
    shutil.rmtree(raw / camera)
    description = yaml.safe_load((raw / "experiment.yaml").read_text(encoding="utf-8"))
    del description[camera]
    (raw / "experiment.yaml").write_text(yaml.safe_dump(description), encoding="utf-8")
    content: dict[str, Any] = {
        key: value for key, value in tree(folder / "run").items() if key not in ("simulate", "gridsearch", "sensitivity")
    }
    return write(folder, {**content, "experiment": str(raw)})


def test_displacements_without_temperatures_are_diagnosed(finished: Path, tmp_path: Path) -> None:
    """Nothing of heat is free or asked, and no parameter is told that no datum tells."""
    path = without(finished, tmp_path, "ir")
    told("run", path, "--until", "verify")
    for command in ("diagnose", "close-loop"):
        assert call(command, path).exit_code in (0, 5)
        record = open_record(tmp_path / "run" / f"{command}.h5")
        assert set(record.summary["channels"]) == {"du"}
        free = {name for name, one in record.parameters.items() if one.free}
        assert free == {"E", "nu", "M_y0", "M_yinf", "H_exp", "F"}
        assert {"lamp", "ir_drift", "stored_energy"} <= set(record.summary["not_asked"])
        assert not any("no standard error" in text for text in record.summary["doubts"])


def test_temperatures_without_displacements_are_refused_in_one_sentence(finished: Path, tmp_path: Path) -> None:
    path = without(finished, tmp_path, "dic")
    study = load_study(path)
    stage_run("calibrate-ir")(study)
    with pytest.raises(DataError, match=r"experiment\.yaml declares no displacements; add its dic section"):
        stage_run("interpolate")(study)
