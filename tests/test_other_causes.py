"""Causes that the catalogue does not hold: their files load, are off at neutral, and act; what counts as an answer."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.effects import catalogue
from thermofit.effects.catalogue import effect, effects, load_effect


@pytest.fixture
def study(scripts: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(catalogue, "EFFECTS", dict(catalogue.EFFECTS))
    return scripts("other_causes")


def test_every_cause_is_an_effect_file_that_loads(study: Any, tmp_path: Path) -> None:
    """Loading tries the function, at neutral and off it, and its derivatives."""
    for name, cause in study.CAUSES.items():
        if callable(cause.function):  # what a camera writes
            continue
        path = tmp_path / f"{name.replace('-', '_')}_planted.py"
        path.write_text(study.effect_file(name, cause), encoding="utf-8")
        load_effect(path)
    assert len(study.RUNS) >= 24 and len(study.SPECIMENS) == 3
    assert {cause for run in study.RUNS.values() for cause in run} == set(study.CAUSES)


def test_causes_of_cameras_change_what_they_wrote(study: Any, tmp_path: Path) -> None:
    """Temperatures by time and place, displacements and no places; heads of files stay. Landmarks as the laboratory writes them."""
    (tmp_path / "experiment.yaml").write_text("ir: {landmarks: {length: {p1: [4, 1], p2: [0, 1], length_mm: 20.0}}}", encoding="utf-8")
    for name in ("ir", "dic"):
        (tmp_path / name).mkdir()
    (tmp_path / "ir" / "frame_0001.csv").write_text("# time_s: 200.000\n" + "20.000,21.000\n" * 5, encoding="ascii")
    stage = "# time_s: 200.000\nid,x_mm,y_mm,z_mm,ux_mm,uy_mm,uz_mm\n7,1.5,-20,0.6,0.1,2,0.01\n"
    (tmp_path / "dic" / "stage_0001.csv").write_text(stage, encoding="ascii")
    study.change_raw(tmp_path, study.CAUSES["camera-steps"], 0.15)
    study.change_raw(tmp_path, study.CAUSES["camera-tilts"], 0.4)
    head, *rows = (tmp_path / "ir" / "frame_0001.csv").read_text(encoding="ascii").splitlines()
    assert head == "# time_s: 200.000"
    # Rows are 5 mm apart, the first one at y = 10 mm: 0.4 K per 20 mm and 400 s.
    assert [row.split(",")[1] for row in rows] == ["21.250", "21.200", "21.150", "21.100", "21.050"]
    study.change_raw(tmp_path, study.CAUSES["clock-runs-slow"], 0.01)
    assert (tmp_path / "ir" / "frame_0001.csv").read_text(encoding="ascii").splitlines() == ["# time_s: 202.000", *rows]
    study.change_raw(tmp_path, study.CAUSES["dic-drifts"], 0.1)
    lines = (tmp_path / "dic" / "stage_0001.csv").read_text(encoding="ascii").splitlines()
    assert lines[:2] == stage.splitlines()[:2] and lines[2] == "7,1.5,-20,0.6,0.105,2.1,0.0105"


def test_a_camera_that_slides_shows_its_neighbours_and_keeps_its_noise(study: Any) -> None:
    """A gradient of 0.1 K/mm seen from 0.4 mm further on, and what one pixel alone has stays in it."""
    y = 0.3 * (20.0 - np.arange(41.0))[:, None]
    smooth, noise = 300.0 + 0.1 * y + np.zeros((41, 2)), np.zeros((41, 2))
    noise[20, 1] = 0.5
    seen = study.CAUSES["camera-slides"].function(smooth + noise, y, 200.0, 0.8)
    np.testing.assert_allclose(seen[12:-12, 0] - smooth[12:-12, 0], 0.1 * 0.4, atol=1e-9)
    assert seen[20, 1] - seen[20, 0] > 0.4


def test_families_are_effects_of_the_catalogue(study: Any) -> None:
    known = {e.name for e in effects()}
    assert {n for cause in study.CAUSES.values() for n in cause.family} <= known


@pytest.mark.parametrize(
    ("row", "answers", "impostors"),
    [
        ({"accepted": ["lamp"], "like": {}, "unlisted": None}, ["lamp", ""], []),
        ({"accepted": ["lamp"], "like": {}, "unlisted": "dtheta"}, ["lamp", "unlisted"], []),
        ({"accepted": ["backstress_first"], "like": {}, "unlisted": "du"}, ["", ""], ["backstress_first"]),
        (
            {"accepted": ["air_drift", "stored_energy"], "like": {"stored_energy": ["ir_drift"]}, "unlisted": None},
            ["air_drift", "stored_energy"],
            [],
        ),
        ({"accepted": ["ir_registration"], "like": {}, "unlisted": "theta@second"}, ["unlisted", "unlisted"], []),
    ],
)
def test_what_counts_as_an_answer(study: Any, row: dict[str, Any], answers: list[str], impostors: list[str]) -> None:
    """The family or its like, or something unlisted in a channel of its own. Another effect is an impostor; the pose is none."""
    told = {"run": "lamp pulse and camera step", **row}
    assert [study.answered(told, cause) for cause in study.RUNS[str(told["run"])]] == answers
    assert study.impostors(told) == impostors


def test_the_page_says_where_an_interval_is_too_wide_to_tell_anything(study: Any) -> None:
    """A parameter known to no better than its own size is within any number of its errors."""
    row = {
        **{
            "run": "one-jaw",
            "specimen": "steel",
            "source": "a",
            "accepted": ["clamp_drift"],
            "like": {},
            "unlisted": None,
            "grade": "named",
        },
        **{"exit": 0, "seconds": 1.0, "off": {"c0": 0.1, "E": -0.2}, "wide": {"c0": 0.72, "E": 0.02}},
    }
    said = study.page([row, {**row, "wide": {"c0": 0.4, "E": 0.02}}, {n: v for n, v in row.items() if n != "wide"}])
    assert "within 3 combined standard errors: **3 of 3**" in said
    assert "so that being within it says nothing: **1** of the 2 that keep widths" in said and "| E -0.2 | c0 72 % |" in said


def test_the_page_counts_second_histories_where_none_was_planted(study: Any) -> None:
    """Of runs of one cause that keep how likely another kind of history is; where two were planted, one may be there."""
    row = {
        **{"specimen": "steel", "source": "a", "accepted": [], "like": {}, "unlisted": "dtheta", "grade": "unlisted"},
        **{"exit": 5, "seconds": 1.0, "off": {"c0": 0.1}},
    }
    kept = [("camera-tilts", {"flux": 0.9}), ("camera-tilts", {"flux": 0.3, "jaws": 0.4}), ("lamp pulse and camera step", {"flux": 0.9})]
    said = study.page([{**row, "run": "camera-tilts"}, *({**row, "run": run, "second": second} for run, second in kept)])
    assert "likelier than not in **1** of the 2 that keep it" in said


def test_a_film_of_the_listed_form_leaves_its_constant_part_to_alpha_air(study: Any, tmp_path: Path) -> None:
    """Planted are 3 W/(m^2 K) (|d|^(1/4) - 1.5): beside the effect that has the first part, alpha_air is 4.5 smaller; beside others not."""
    own, run = study.CAUSES["film-by-difference"], "film-by-difference"
    path = tmp_path / "film_by_difference_planted.py"
    path.write_text(study.effect_file(run, own), encoding="utf-8")
    planted = load_effect(path)
    theta, air, amount = np.array([290.0, 297.05, 310.0]), np.full(3, 297.0), study.RUNS[run][run]
    beside, plain = (study.truth_beside(run, "aluminium", accepted)["alpha_air"] for accepted in (["free_convection"], ["lamp"]))
    assert plain == study.SPECIMENS["aluminium"]["truth"]["alpha_air"]
    listed = effect("free_convection").act(theta, 0.0, air, 0.0 * air, 1e3 * amount, 0.25) + 1e-3 * (beside - plain) * (theta - air)
    np.testing.assert_allclose(listed, planted.act(theta, 0.0, air, 0.0 * air, amount), rtol=1e-9)


@pytest.mark.parametrize(("accepted", "off"), [(["free_convection"], 0.0), ([], -9.0)])
def test_parameters_are_compared_with_those_beside_what_was_accepted(
    study: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, accepted: list[str], off: float
) -> None:
    """Alpha_air 4.5 below the planted one, by a standard error of 0.5."""
    value = study.SPECIMENS["steel"]["truth"]["alpha_air"] - 4.5
    said = {"accepted": accepted, "unlisted": None, "stand_ins": None, "grade": "named", "local_balances": {"where": "none"}}
    said |= {when: {"held_out": {}} for when in ("before", "after")}
    record = SimpleNamespace(summary=said, parameters={"alpha_air": SimpleNamespace(value=value, sigma=0.5, free=True)})
    monkeypatch.setattr(study.thermofit, "open_run", lambda _: SimpleNamespace(record=lambda _: record))
    assert study.answer(tmp_path, "film-by-difference", "steel", 0)["off"] == {"alpha_air": off}
