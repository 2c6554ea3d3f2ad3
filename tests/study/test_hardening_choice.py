"""Hardening laws in a study: chosen by name or by the models of the thesis, what is freed, what is true of a virtual material."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from thermofit.core.errors import StudyError
from thermofit.law.hardening.catalogue import hardening_laws
from thermofit.study.study import Study, load_study

BOUNDED = {"E": 7e4, "nu": 0.3, "M_y0": 130.0, "M_yinf": 290.0, "H_exp": 11.0, "F": 0.5, "beta": 1.0}


def study(folder: Path, **changes: Any) -> Study:
    tree = {
        "name": "one",
        "simulate": {"truth": {"M_y0": 130.0, "theta_air": 297.0, "theta_clamp": 297.0}},
        "parameters": BOUNDED,
        **changes,
    }
    path = folder / "one.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return load_study(path)


@pytest.mark.parametrize(
    ("keys", "law"),
    [
        ({}, "model2"),
        ({"model": 1}, "voce"),
        ({"model": 2}, "model2"),
        ({"hardening": "linear"}, "linear"),
        ({"hardening": "voce", "model": 1}, "voce"),
    ],
)
def test_which_law(tmp_path: Path, keys: dict[str, Any], law: str) -> None:
    assert study(tmp_path, **keys, parameters={**BOUNDED, "H_lin": 100.0}).hardening_law == law


def test_stage_plastic_frees_what_the_law_has(tmp_path: Path) -> None:
    assert study(tmp_path).stages.plastic.free == ("M_y0", "M_yinf", "H_exp", "F")
    assert study(tmp_path, model=1).stage("plastic").free == ("M_y0", "M_yinf", "H_exp", "F")
    more = {**BOUNDED, "H_lin": 100.0}
    assert study(tmp_path, hardening="linear", parameters=more).stages.plastic.free == ("M_y0", "H_lin", "F")
    own = {"plastic": {"free": ["M_y0"]}, "elastic": {"free": ["E"]}}
    assert study(tmp_path, hardening="linear", parameters=more, stages=own).stages.plastic.free == ("M_y0",)
    others = {"plastic": {"window": "all"}, "elastic": {"free": ["E"]}}
    assert study(tmp_path, hardening="linear", parameters=more, stages=others).stages.plastic.free == ("M_y0", "H_lin", "F")


def test_a_law_whose_start_is_missing_is_told(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"'parameters\.H_lin' is missing, but stage plastic identifies it: add its start"):
        study(tmp_path, hardening="linear")


def test_what_must_rise_is_that_of_the_chosen_law(tmp_path: Path) -> None:
    falling = {**BOUNDED, "M_yinf": 100.0, "H_lin": 10.0}
    with pytest.raises(StudyError, match=r"'parameters\.M_yinf' is 100 MPa; expected more than M_y0 = 130 MPa"):
        study(tmp_path, parameters=falling)
    assert study(tmp_path, hardening="linear", parameters=falling).hardening_law == "linear"
    virtual = {"hardening": "table", "truth": {"M_y0": 300.0, "theta_air": 297.0, "theta_clamp": 297.0}}
    with pytest.raises(StudyError, match=r"'simulate\.truth\.table\.stress1' is 140 MPa; expected more than M_y0 = 300 MPa"):
        study(tmp_path, simulate=virtual)


def test_what_is_true_of_a_virtual_material(tmp_path: Path) -> None:
    """A parameter of another law than the virtual material's has no true value; what it leaves out is neutral."""
    same = study(tmp_path)
    assert same.truth_of("M_yinf") == 290.0 and same.truth_of("M_y0") == 130.0 and same.truth_of("E") == 69000.0
    virtual = {"hardening": "linear", "truth": {"M_y0": 130.0, "theta_air": 297.0, "theta_clamp": 297.0}}
    other = study(tmp_path, simulate=virtual)
    assert other.truth_of("M_yinf") is None and other.truth_of("H_exp") is None and other.truth_of("H_lin") == 0.0
    assert other.truth_of("M_y0") == 130.0


def test_candidates_choose_laws(tmp_path: Path) -> None:
    found = study(tmp_path, compare={law.name: {"hardening": law.name} for law in hardening_laws()})
    assert {name: c.hardening for name, c in found.compare.items()} == {law.name: law.name for law in hardening_laws()}
    with pytest.raises(StudyError, match=r"'compare\.one\.hardening' is linear, but model 1 is voce; give one of them"):
        study(tmp_path, compare={"one": {"hardening": "linear", "model": 1}})
