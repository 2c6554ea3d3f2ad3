"""A sheet cut across its rolling direction, from the study file to the identified parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tiny

from thermofit.study.study import load_study


def written(folder: Path, angle: float, hill: dict[str, float]) -> Path:
    folder.mkdir()
    content = tiny.tree(folder / "run")
    content["material_axes"] = {"angle": angle}
    content["simulate"]["truth"] |= hill
    content["parameters"] |= hill
    return tiny.write(folder, content)


def test_raw_data_are_those_of_the_sheet_with_exchanged_hill_parameters(tmp_path: Path) -> None:
    """G and H change places, in the programme of the machine (uniaxial closed form) and in the body; the angle decides what is fresh."""
    forces = []
    for name, angle, hill in (("across", 90.0, {"G": 0.4, "H": 0.8}), ("along", 0.0, {"G": 0.8, "H": 0.4})):
        study = load_study(written(tmp_path / name, angle, hill))
        tiny.stage_run("simulate")(study)
        forces.append(np.loadtxt(study.run_dir / "raw" / "force.csv", delimiter=",", skiprows=1))
        assert tiny.stage_run("simulate")(study).fresh
    assert forces[0] == pytest.approx(forces[1], abs=1e-6)
    turned = load_study(tmp_path / "across" / "tiny.yaml", ["material_axes.angle=0"])
    assert not tiny.stage_run("simulate")(turned).fresh


@pytest.mark.slow
def test_parameters_of_a_sheet_cut_across_come_back(tmp_path: Path) -> None:
    study = load_study(written(tmp_path / "across", 90.0, {"G": 0.4, "H": 0.8}))
    for name in tiny.CHAIN[:4]:
        tiny.stage_run(name)(study)
    found = tiny.stage_run("identify-plastic")(study).record
    for name in ("M_y0", "M_yinf", "F"):
        assert found.parameters[name].value == pytest.approx(tiny.TRUTH[name], rel=0.05), name
