"""Yield surfaces in a study: chosen by name, what is freed, which parameters belong to which, templates, candidates, cards."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from published_surfaces import AA2090_T3

from thermofit.core.errors import StudyError
from thermofit.core.slots import Slots
from thermofit.diagnose.comparing import candidate_study
from thermofit.law.surface.catalogue import Surface, surfaces
from thermofit.study.study import Study, load_study
from thermofit.study.template import template

BASE = {"E": 7e4, "nu": 0.3, "M_y0": 130.0, "M_yinf": 290.0, "H_exp": 11.0, "beta": 1.0}
TRUTH = {"M_y0": 130.0, "theta_air": 297.0, "theta_clamp": 297.0}


def study(folder: Path, **changes: Any) -> Study:
    tree = {"name": "one", "simulate": {"truth": TRUTH}, "parameters": {**BASE, "F": 0.5}, **changes}
    path = folder / "one.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return load_study(path)


def test_which_surface_and_what_it_frees(tmp_path: Path) -> None:
    assert study(tmp_path).slots == Slots("model2", "hill") and study(tmp_path).stages.plastic.free[-1] == "F"
    found = study(tmp_path, yield_surface="hosford", hardening="voce", parameters={**BASE, "hosford.a": 8.0})
    assert found.slots == Slots("voce", "hosford") and found.stages.plastic.free == ("M_y0", "M_yinf", "H_exp", "hosford.a")
    for name in ("von_mises", "yld2004"):
        assert study(tmp_path, yield_surface=name, parameters=BASE).stages.plastic.free == ("M_y0", "M_yinf", "H_exp")
    own = {"plastic": {"free": ["M_y0", "yld2004.c1_12"]}, "elastic": {"free": ["E"]}}
    more = {**BASE, "yld2004.c1_12": 0.9}
    assert study(tmp_path, yield_surface="yld2004", parameters=more, stages=own).stages.plastic.free == ("M_y0", "yld2004.c1_12")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"yield_surface": "yld2005"}, r"'yield_surface' names no yield surface: 'yld2005' is not known.*yld2004"),
        ({"yield_surface": "hosford"}, r"'parameters\.F' is a parameter of yield surface hill, but yield_surface is hosford"),
        ({"yield_surface": "von_mises"}, r"yield_surface is von_mises, which has no parameters; leave it out"),
        ({"parameters": {**BASE, "F": 0.5, "hosford.a": 8.0}}, r"'parameters\.hosford\.a' is a parameter of yield surface hosford, but"),
        ({"yield_surface": "hosford", "parameters": BASE}, r"'parameters\.hosford\.a' is missing, but stage plastic identifies it"),
        ({"yield_surface": "hosford", "parameters": {**BASE, "hosford.a": 25.0}}, r"hosford\.a' is 25; expected 2 to 20"),
        (
            {"yield_surface": "yld2004", "parameters": BASE, "stages": {"plastic": {"free": ["M_y0", "F"]}}},
            r"'stages\.plastic\.free' holds F, which is a parameter of yield surface hill",
        ),
        ({"simulate": {"truth": {**TRUTH, "hosford.a": 6.0}}}, r"'simulate\.truth\.hosford\.a' is a parameter of yield surface hosford"),
    ],
)
def test_what_does_not_fit_together_is_told(tmp_path: Path, changes: dict[str, Any], told: str) -> None:
    with pytest.raises(StudyError, match=told):
        study(tmp_path, **changes)


def test_a_virtual_material_of_its_own(tmp_path: Path) -> None:
    virtual = {"yield_surface": "hosford", "truth": {**TRUTH, "hosford.a": 6.0}}
    found = study(tmp_path, simulate=virtual)
    assert found.truth_of("hosford.a") == 6.0 and found.truth_of("F") is None and found.truth_of("M_y0") == 130.0
    assert found.truth_parameters()["hosford.a"] == 6.0


def test_candidates(tmp_path: Path) -> None:
    """Params of the study's surface go, what the candidate's frees starts at a usual value."""
    found = study(tmp_path, compare={"eight": {"yield_surface": "hosford"}, "alloy": {"yield_surface": "yld2004", "parameters": AA2090_T3}})
    eight, alloy = (candidate_study(found, found.compare[name]) for name in ("eight", "alloy"))
    assert eight.slots.surface == "hosford" and "F" not in eight.parameters and eight.parameters["hosford.a"] == 8.0
    assert alloy.parameters["yld2004.c1_12"] == AA2090_T3["yld2004.c1_12"]
    wrong = study(tmp_path, compare={"one": {"yield_surface": "hosford", "parameters": {"F": 0.4}}})
    with pytest.raises(StudyError, match="key 'compare': F is a parameter of yield surface hill, but yield_surface is hosford"):
        candidate_study(wrong, wrong.compare["one"])


@pytest.mark.parametrize("one", surfaces(), ids=lambda one: one.name)
def test_template_of_every_surface(tmp_path: Path, one: Surface) -> None:
    text = template(yields=one)
    path = tmp_path / "one.yaml"
    path.write_text(text, encoding="utf-8")
    found = load_study(path)
    assert found.yield_surface == one.name and (f"\nyield_surface: {one.name} " in text) == (one.name != "hill")
    assert found.stage("plastic").free[3:] == one.fitted
    assert set(one.names) <= set(found.parameters) or one.name == "hill"


def test_coupons_do_not_tell_it(tmp_path: Path) -> None:
    record = {
        **{"file": "pull.csv", "time": {"column": "time_s", "unit": "s"}, "initial_temperature_degC": 22.85},
        **{"strain": {"column": "strain", "unit": "1"}, "stress": {"column": "stress", "unit": "MPa"}},
    }
    tree = {
        "name": "one",
        "yield_surface": "hosford",
        "coupon": {"records": [record]},
        "parameters": {**BASE, "hosford.a": 8.0},
        "stages": {"plastic": {"free": ["M_y0", "hosford.a"]}},
    }
    path = tmp_path / "one.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    with pytest.raises(StudyError, match=r"holds hosford\.a, which records of coupons do not determine without the channel lateral"):
        load_study(path).stage("plastic")
