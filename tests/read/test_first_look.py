"""Starts and bounds of a new study come from the data where these show them, and hold for any metal where they do not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from seen_test import pulled, write_raw
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.read.plausible import FirstLook, looked_at
from thermofit.study.study import load_study

METALS = {
    "lead": {"E": 16e3, "M_y0": 10.0, "M_yinf": 20.0, "kappa": 35.0, "c0": 1.45, "alpha_exp": 29e-6},
    "aluminium": {"E": 69e3, "M_y0": 130.0, "M_yinf": 290.0, "kappa": 150.0, "c0": 2.4, "alpha_exp": 23e-6},
    "copper": {"E": 125e3, "M_y0": 40.0, "M_yinf": 350.0, "kappa": 400.0, "c0": 3.45, "alpha_exp": 17e-6},
    "titanium": {"E": 114e3, "M_y0": 900.0, "M_yinf": 1200.0, "kappa": 6.7, "c0": 2.4, "alpha_exp": 8.6e-6},
    "steel": {"E": 210e3, "M_y0": 400.0, "M_yinf": 900.0, "kappa": 45.0, "c0": 3.7, "alpha_exp": 12e-6},
    "maraging steel": {"E": 190e3, "M_y0": 2400.0, "M_yinf": 2800.0, "kappa": 25.0, "c0": 3.6, "alpha_exp": 11e-6},
    "invar": {"E": 141e3, "M_y0": 270.0, "M_yinf": 500.0, "kappa": 10.0, "c0": 4.2, "alpha_exp": 0.6e-6},
    "tungsten": {"E": 405e3, "M_y0": 1300.0, "M_yinf": 1500.0, "kappa": 170.0, "c0": 2.55, "alpha_exp": 4.5e-6},
}


@pytest.mark.parametrize("metal", METALS)
def test_bounds_of_a_new_study_hold_for_every_metal(tmp_path: Path, metal: str) -> None:
    made = CliRunner().invoke(app, ["new", str(tmp_path / "study.yaml")])
    assert made.exit_code == 0, made.output
    study = load_study(tmp_path / "study.yaml")
    for name, value in METALS[metal].items():
        low, high = study.bounds(name)
        assert low < value < high, f"{name} = {value:g} of {metal}, bounds {low:g} to {high:g}"


@pytest.mark.parametrize("metal", ["lead", "aluminium", "titanium", "steel", "tungsten"])
def test_the_elastic_slope_is_read_off(metal: str) -> None:
    values = METALS[metal]
    found = looked_at(pulled(values["E"], values["M_y0"]))
    assert isinstance(found, FirstLook), found
    # Lead yields below the first stage that stands clear of the noise: the slope is then too low, by less than the bounds allow.
    assert found.modulus == pytest.approx(values["E"], rel=0.7 if metal == "lead" else 0.12)
    assert found.strain == pytest.approx(0.03, rel=0.02) and found.stress > values["M_y0"]


def test_bounds_follow_the_data(tmp_path: Path) -> None:
    """A virtual experiment on a metal as stiff as steel: starts and bounds are not those of aluminium, and hold the truth."""
    raw = tmp_path / "raw"
    write_raw(raw, pulled(210e3, 400.0))
    made = CliRunner().invoke(app, ["new", str(tmp_path / "study.yaml"), "--experiment", str(raw)])
    assert made.exit_code == 0 and "elastic slope 2" in made.output, made.output
    study = load_study(tmp_path / "study.yaml")
    assert study.start_parameters(pulled(210e3, 400.0))["E"] == pytest.approx(210e3, rel=0.12)
    low, high = study.bounds("E")
    assert 50e3 < low < 100e3 and 500e3 < high < 800e3
    assert study.bounds("M_y0")[0] < 400.0 < study.bounds("M_y0")[1] < 10e3
    assert "elastic slope" in (tmp_path / "study.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda e: replace(e, force=replace(e.force, force=1e3 * e.force.force)), "no metal"),
        (lambda e: replace(e, force=replace(e.force, force=-e.force.force)), "no metal"),
        (lambda e: replace(e, force=replace(e.force, force=0.0 * e.force.force)), "stands clear"),
        (lambda e: replace(e, dic=replace(e.dic, displacement=e.dic.displacement[:, :3], reference=e.dic.reference[:3])), "0 stages"),
        (lambda e: replace(e, dic=replace(e.dic, displacement=0.0 * e.dic.displacement)), "stands clear"),
    ],
)
def test_data_that_show_no_slope_are_told(change, words: str) -> None:
    said = looked_at(change(pulled(70e3, 150.0)))
    assert isinstance(said, str) and words in said


def test_a_folder_that_cannot_be_read_yet_still_gets_its_study(tmp_path: Path) -> None:
    raw = tmp_path / "raw"
    raw.mkdir()
    (raw / "experiment.yaml").write_text("", encoding="utf-8")
    made = CliRunner().invoke(app, ["new", str(tmp_path / "study.yaml"), "--experiment", str(raw)])
    assert made.exit_code == 0 and "metals in general (the data cannot be read yet" in made.output
    assert load_study(tmp_path / "study.yaml").bounds("E")[1] > 400e3
