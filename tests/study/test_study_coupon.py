"""Section `coupon` of the study file: what it accepts, its defaults, and one sentence for what it does not."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from thermofit.core.errors import StudyError
from thermofit.study.coupon import StrainSource
from thermofit.study.study import load_study

RECORD = "{file: a.csv, time: t, strain: e, stress: s}"
STUDY = f"name: bar\ncoupon:\n  records: [{RECORD}]\n"


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    def written(text: str) -> Path:
        path = tmp_path / "study.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return written


def test_a_study_of_records_alone(write: Callable[[str], Path]) -> None:
    study = load_study(write(STUDY))
    assert study.coupon is not None and not study.virtual
    (record,) = study.coupon.records
    assert (study.coupon.control, record.label, record.tension, record.until, record.points) == ("strain", "a", "positive", "end", None)
    assert study.config_of("coupon")["coupon"]["records"][0]["file"] == "a.csv"


def test_sources_in_their_long_form(write: Callable[[str], Path]) -> None:
    text = STUDY.replace("strain: e", "strain: {extension: x, gauge_length: 8.0}").replace(
        "stress: s", "stress: {force: F, diameter: 5.98}"
    )
    study = load_study(write(text.replace("time: t", "time: {column: t, unit: min}, temperature: {column: T, file: b.xlsx, offset_s: 17}")))
    assert study.coupon is not None
    (record,) = study.coupon.records
    assert isinstance(record.strain, StrainSource) and record.strain.name == "x"
    assert record.model_dump()["temperature"]["offset_s"] == 17.0


SENTENCES: list[tuple[dict[str, Any], str]] = [
    ({"strian": "e"}, "key 'coupon.records.0.strian' is not known; did you mean 'strain'?"),
    ({"strain": {"extension": "x", "column": "e"}}, "key 'coupon.records.0.strain' gives column and extension; expected exactly one of"),
    (
        {"strain": {"unit": "%"}},
        "key 'coupon.records.0.strain' gives none of them; expected exactly one of column, true_strain, plastic_strain,",
    ),
    ({"strain": 3.5}, "key 'coupon.records.0.strain' is 3.5; expected the name of a column or {column: ...}"),
    ({"strain": 0}, "key 'coupon.records.0.strain' is 0; expected the name of a column or its number, the first is 1"),
    (
        {"lateral": {"width": 3}},
        "key 'coupon.records.0.lateral' gives none of them; expected exactly one of column, true_strain, extension",
    ),
    ({"lateral": {"column": "x", "width": 3}}, "key 'coupon.records.0.lateral.width' is given without 'extension'"),
    (
        {"stress": {"column": "s", "repeats": "F"}},
        "key 'coupon.records.0.stress.repeats' is given without 'file', 'test' or 'time' of another",
    ),
    ({"leave_out": [3, 1]}, "key 'coupon.records.0.leave_out' is not increasing"),
    ({"strain_zero": "no"}, "key 'coupon.records.0.strain_zero' is 'no'; expected 'elastic-line' or 'as-measured'"),
    ({"strain": {"column": "e", "gauge_length": 8}}, "key 'coupon.records.0.strain.gauge_length' is given without 'extension'"),
    ({"stress": {"force": "F", "area": 3, "diameter": 2}}, "gives the cross-section more than once"),
    ({"stress": {"force": "F", "area": -3}}, "key 'coupon.records.0.stress.area' is -3; expected more than 0"),
    ({"stress": {"column": "s", "area": 3}}, "key 'coupon.records.0.stress.area' is given without 'force'"),
    ({"rate": 1e-3}, "gives time and rate; expected exactly one of time, rate"),
    ({"sampling_rate": 1e-3}, "gives time and sampling_rate; expected exactly one of time, rate, sampling_rate"),
    ({"temperature": {"column": "T", "offset_s": 3}}, "key 'coupon.records.0.temperature.offset_s' is given without 'file'"),
    ({"temperature": {"column": "T", "file": "b", "offset_s": "soon"}}, "expected 'auto'"),
    ({"tension": "down"}, "key 'coupon.records.0.tension' is 'down'; expected 'positive' or 'negative'"),
    ({"window": [3, 1]}, "key 'coupon.records.0.window' is not increasing"),
    ({"jumps": [5, 5]}, "key 'coupon.records.0.jumps' is not increasing"),
    ({"initial_temperature_degC": 296000}, "key 'coupon.records.0.initial_temperature_degC' is 296000; expected less than 3000"),
    ({"points": 3}, "key 'coupon.records.0.points' is 3; expected at least 10"),
]


@pytest.mark.parametrize(("change", "words"), SENTENCES, ids=[str(change) for change, _ in SENTENCES])
def test_what_is_wrong_is_one_sentence(write: Callable[[str], Path], change: dict[str, Any], words: str) -> None:
    record: dict[str, Any] = {"file": "a.csv", "time": "t", "strain": "e", "stress": "s", **change}
    with pytest.raises(StudyError) as caught:
        load_study(write(f"name: bar\ncoupon:\n  records: [{json.dumps(record)}]\n"))
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_records_need_different_names(write: Callable[[str], Path]) -> None:
    with pytest.raises(StudyError, match=r"key 'coupon.records.1.name' is 'a' again; expected another name for every record"):
        load_study(write(STUDY.replace(f"[{RECORD}]", f"[{RECORD}, {RECORD}]")))


def test_a_study_without_any_data_says_what_it_may_have(write: Callable[[str], Path]) -> None:
    with pytest.raises(StudyError, match=r"key 'experiment' is missing: .*'simulate' or records under 'coupon'"):
        load_study(write("name: bar\n"))
