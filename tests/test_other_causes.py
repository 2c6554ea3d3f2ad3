"""Causes that the catalogue does not hold: their files load, are off at neutral, and act; what counts as an answer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from thermofit.effects import catalogue
from thermofit.effects.catalogue import effects, load_effect


@pytest.fixture
def study(scripts: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(catalogue, "EFFECTS", dict(catalogue.EFFECTS))
    return scripts("other_causes")


def test_every_cause_is_an_effect_file_that_loads(study: Any, tmp_path: Path) -> None:
    """Loading tries the function, at neutral and off it, and its derivatives."""
    for name, cause in study.CAUSES.items():
        path = tmp_path / f"{name.replace('-', '_')}_planted.py"
        path.write_text(study.effect_file(name, cause), encoding="utf-8")
        load_effect(path)
    assert len(study.RUNS) >= 24 and len(study.SPECIMENS) == 2
    assert {cause for run in study.RUNS.values() for cause in run} == set(study.CAUSES)


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
