"""Native exports in a raw experiment folder: the keys of `dic` and `ir` in experiment.yaml that read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from thermofit.core.errors import DataError
from thermofit.read.raw import read_experiment

SPECIMEN = {
    **{"gauge_width_mm": 25.0, "thickness_mm": 1.2, "parallel_length_mm": 100.0, "shoulder_radius_mm": 25.0, "grip_width_mm": 35.0},
    **{"total_length_mm": 150.0, "gripped_length_each_end_mm": 10.0},
}
HEADER = "x-coordinate [mm],y-coordinate [mm],x-displacement [mm],y-displacement [mm]"


def make(folder: Path, dic: dict[str, object]) -> Path:
    """Three stages of a general table at 0, 1 and 2 s when read at 1/s."""
    (folder / "exports").mkdir(parents=True)
    tree = {
        "specimen": SPECIMEN,
        "temperatures": {"theta_air_degC": 24.4, "theta_clamp_degC": 23.6},
        "force": {"file": "force.csv"},
        "dic": dic,
    }
    (folder / "experiment.yaml").write_text(yaml.safe_dump(tree))
    (folder / "force.csv").write_text("time_s,force_N\n" + "".join(f"{t / 2},{100 * t}\n" for t in range(12)))
    for k in range(3):
        rows = [f"{x},{y},{0.01 * k},{0.1 * k + 0.001 * x}" for x in range(3) for y in range(3)]
        (folder / "exports" / f"stage_{k}.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    return folder


def test_exports_are_read_in_place_of_a_folder(tmp_path: Path) -> None:
    keys = {"files": "exports/*.csv", "rate": 1, "time_offset_s": 0.5, "axes": {"x": "y", "y": "-x"}, "origin_mm": [1, 1, 0], "stages": 4}
    experiment = read_experiment(make(tmp_path / "e", keys))
    assert experiment.dic is not None
    assert experiment.dic.time.tolist() == [0.5, 1.5, 2.5]
    np.testing.assert_allclose(experiment.dic.reference[1, :2], [0.0, 1.0])
    np.testing.assert_allclose(experiment.dic.displacement[2, 1, :2], [0.2, -0.02])
    assert any("taken as reference" in repair for repair in experiment.repairs)
    assert any("3 stages found, 4 declared" in repair for repair in experiment.repairs)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"files": "exports/*.csv"}, "3 of 3 stages have no time, neither in the file nor in its name; give 'times'"),
        ({"files": "exports/*.csv", "rate": 0}, "key 'dic.rate' is 0; expected a number above 0"),
        ({"files": "exports/*.csv", "times": [0, "x", 2]}, "key 'dic.times' is .* expected a list of the numbers"),
        ({"files": "exports/*.csv", "rate": 1, "folder": "dic"}, "key 'dic.files' is given besides 'folder'"),
        ({"files": "../exports/*.csv", "rate": 1}, "expected files inside"),
        ({"files": "/exports/*.csv", "rate": 1}, "expected files inside"),
        ({"files": "exports/*.txt", "rate": 1}, "no file found, expected exports of a DIC system"),
        ({"files": "exports/*.csv", "rate": 1, "axes": {"x": "y"}}, "expected x, y and z of the file, each once"),
        ({"files": "exports/*.csv", "rate": 1, "axes": {"x": "y", "y": "x", "w": "z"}}, "expected x, y and z of the file, each once"),
        ({"files": "exports/*.csv", "rate": 1, "axes": [1, 2, 3]}, "expected x, y and z of the file, each once"),
        ({"files": "exports/*.csv", "rate": 1, "origin_mm": [1, 2]}, "key 'dic.origin_mm' is .* expected a list of 3 numbers"),
        ({"files": "exports/*.csv", "rate": 1, "coordinates_of": "both"}, "expected reference or deformed"),
        ({"files": "exports/*.csv", "rate": 1, "mm_per_pixel": -1}, "key 'dic.mm_per_pixel' is -1; expected a number above 0"),
        ({"files": "exports/*.csv", "rate": 0.1}, "the force record ends .* s before the last DIC stage"),
        ({"file": "exports/*.csv", "rate": 1, "folder": "dic", "mm_per_pixel": 0.1}, "key 'dic.mm_per_pixel' is for native exports"),
    ],
)
def test_wrong_keys_are_named(tmp_path: Path, keys: dict[str, object], message: str) -> None:
    with pytest.raises(DataError, match=message):
        read_experiment(make(tmp_path / "e", keys))


def test_infrared_section_takes_exports(tmp_path: Path) -> None:
    folder = make(tmp_path / "e", {"files": "exports/*.csv", "rate": 1})
    tree = yaml.safe_load((folder / "experiment.yaml").read_text())
    tree["ir"] = {"files": "exports/*.csv", "side": "back", "rate": 1}
    (folder / "experiment.yaml").write_text(yaml.safe_dump(tree))
    with pytest.raises(DataError, match="expected frames of an infrared camera"):
        read_experiment(folder, ("force", "ir"))
