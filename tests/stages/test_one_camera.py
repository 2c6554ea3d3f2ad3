"""A folder without an infrared camera: displacements alone go through the whole loop. Temperatures alone: `test_infrared_alone`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from record_studies import call, told
from tiny import tree, without_camera, write

from thermofit.records.artefact import open_record


def without(finished: Path, folder: Path, camera: str) -> Path:
    """A measured study on a copy of the tiny raw folder without one camera."""
    raw = without_camera(finished / "raw", folder / "raw", camera)
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
