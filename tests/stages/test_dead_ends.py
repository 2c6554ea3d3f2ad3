"""A forward model that cannot carry the measured force is not the end of an identification."""

from __future__ import annotations

import json
from pathlib import Path

import dead_ends
import pytest
import tiny

from thermofit.records.result import result_of


@pytest.mark.parametrize("seed", [0])
def test_a_law_that_lacks_something_strong_is_no_dead_end(tmp_path: Path, seed: int) -> None:
    path, _ = dead_ends.made(tmp_path, seed)
    records = dead_ends.ended(path)
    assert records["identify-plastic"].parameters["M_yinf"].free
    drives = {records[name].summary["drive"] for name in ("identify-plastic", "identify-thermal", "verify")}
    assert len(drives) == 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(50))
def test_fifty_random_materials_and_starts(tmp_path: Path, seed: int) -> None:
    path, _ = dead_ends.made(tmp_path, 100 + seed)
    dead_ends.ended(path)


def test_sections_drive_where_the_force_is_near_its_maximum(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All later stages follow, a second run finds them fresh, one remark says why, and the force is a channel."""
    content = tiny.tree(tmp_path / "run")
    content["simulate"]["programme"] = [
        *tiny.PROGRAMME[:1],
        {"crosshead_to": 9.0, "rate": 0.14},
        tiny.PROGRAMME[2],
        {"hold_force_until": 160.0},
    ]
    content["simulate"]["dic"] = {"stages": 90, "spacing": 2.0}
    path = tiny.write(tmp_path, content)
    monkeypatch.setattr("thermofit.experiment.drive.FLAT", 10.0)
    tiny.stage_run("simulate")(tiny.load_study(path))
    records = dead_ends.ended(path)
    plastic, verified = records["identify-plastic"], records["verify"]
    assert [records[name].summary["drive"] for name in dead_ends.STAGES[2:]] == ["force", "sections", "sections", "sections"]
    said = [text for text in plastic.summary["remarks"] if "driven by the motion of the sections" in text]
    assert len(said) == 1 and "hardly grows" in said[0] and said[0] in json.dumps(result_of(plastic))
    assert {"du", "force"} <= set(plastic.summary["channels"]) and "force" in verified.summary["channels"]
    assert verified.summary["channels"]["force"]["chi2_reduced"] < 2.0 and verified.summary["channels"]["du"]["chi2_reduced"] < 2.0
    for name in ("M_y0", "M_yinf", "H_exp"):
        assert plastic.parameters[name].value == pytest.approx(tiny.TRUTH[name], rel=0.03), name
    assert all(tiny.stage_run(name)(tiny.load_study(path)).fresh for name in dead_ends.STAGES)
