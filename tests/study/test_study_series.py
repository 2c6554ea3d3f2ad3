"""Entries for many files alike: patterns, lists, values of each file, and what is wrong with them in one sentence."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from thermofit.core.errors import StudyError
from thermofit.study.coupon import CouponRecordSettings, StressSource
from thermofit.study.study import load_study

COMMON = {"strain": "e", "stress": {"force": "F"}}


def records(folder: Path, series: dict[str, Any], files: Sequence[str] = ()) -> tuple[CouponRecordSettings, ...]:
    """The records of a study with one entry of many files; the files are made, empty."""
    for name in files:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("", encoding="utf-8")
    path = folder / "study.yaml"
    path.write_text("name: bar\ncoupon:\n  series: " + json.dumps([{**COMMON, **series}]) + "\n", encoding="utf-8")
    study = load_study(path)
    assert study.coupon is not None and not study.coupon.series
    return study.coupon.records


def test_temperature_and_rate_of_the_name_of_the_file(tmp_path: Path) -> None:
    """In the order of the numbers as written; what was taken is said; K, degC and F; decimal p and comma."""
    files = [f"data/flow_{t}C_{r}.csv" for t in (300, 20) for r in ("1e-3", "0p5", "1,5")] + ["data/other.csv"]
    found = records(tmp_path, {"files": "data/flow_{temperature_C}C_{rate}.csv"}, files)
    assert [(r.initial_temperature_degC, r.rate) for r in found] == [(t, r) for t in (20.0, 300.0) for r in (0.5, 1.5, 1e-3)]
    assert found[0].file == "data/flow_20C_0p5.csv" and found[0].label == "flow_20C_0p5"
    assert found[0].taken == ("temperature_C 20.0 from the name of the file", "rate 0.5 from the name of the file")
    assert found[0].place == "coupon.series.0"
    (kelvin,) = records(tmp_path, {"files": "data/T{temperature_K}.csv", "time": "t"}, ["data/T293.15.csv"])
    (fahrenheit,) = records(tmp_path, {"files": "data/{temperature_degF}F.csv", "time": "t"}, ["data/68F.csv"])
    assert kelvin.initial_temperature_degC == pytest.approx(20.0) and fahrenheit.initial_temperature_degC == pytest.approx(20.0)


def test_lists_and_values_of_each_file(tmp_path: Path) -> None:
    each = {"rate": [1e-3, 1], "temperature_K": [293.15, 393.15], "area": [28.0, 28.5], "name": ["cold", "hot"], "held_out": [False, True]}
    cold, hot = records(tmp_path, {"files": ["a.csv", "sub/b.csv"], "each": each})
    assert (cold.label, cold.rate, cold.initial_temperature_degC, cold.held_out) == ("cold", 1e-3, pytest.approx(20.0), False)
    assert isinstance(hot.stress, StressSource) and (hot.stress.area, hot.stress.force, hot.held_out) == (28.5, "F", True)
    tests = records(tmp_path, {"files": "book.xlsx", "time": 1, "each": {"test": ["one", "two"]}})
    assert [(r.file, r.test, r.label, r.time) for r in tests] == [("book.xlsx", n, n, "column 1") for n in ("one", "two")]
    rows = records(tmp_path, {"files": "long.csv", "time": "t", "each": {"where.file": ["A 1", "B"]}})
    assert [(r.where, r.label) for r in rows] == [({"file": "A 1"}, "A 1"), ({"file": "B"}, "B")]


def test_patterns_of_the_shell_and_of_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = ["d/10/x.csv", "d/2/x.csv", "d/2/y.csv", "d/z[1].csv"]
    found = records(tmp_path, {"files": "d/{name}/x.csv", "time": "t"}, files)
    assert [(r.name, r.file) for r in found] == [("2", "d/2/x.csv"), ("10", "d/10/x.csv")]
    assert [r.file for r in records(tmp_path, {"files": "d/**/?.csv", "time": "t", "each": {"name": ["a", "b", "c"]}})] == [
        "d/2/x.csv",
        "d/2/y.csv",
        "d/10/x.csv",
    ]
    monkeypatch.setenv("RECORDS", str(tmp_path / "d"))
    (bracket,) = records(tmp_path, {"files": "${RECORDS}/z[1]*.csv", "time": "t"})
    assert bracket.file == "${RECORDS}/z[1].csv", "the variable stays in the study"


SENTENCES: list[tuple[dict[str, Any], str]] = [
    ({"files": "no_{rate}.csv"}, "key 'coupon.series.0.files' is 'no_{rate}.csv', which fits no file in"),
    ({"files": "x_{rte}.csv"}, "holds {rte}, which is not known; did you mean 'rate'?"),
    ({"files": "x_{rate}_{rate}.csv"}, "holds a field twice"),
    ({"files": "x_{rate}.csv"}, "but a field of x_fast.csv is no number; expected numbers there, or a list of files"),
    (
        {"files": "x_*.csv", "each": {"rate": [1, 2]}},
        "key 'coupon.series.0.each.rate' has 2 values for 3 files; expected one for each file",
    ),
    ({"files": ["a", "b"], "each": {"rates": [1, 2]}}, "key 'coupon.series.0.each.rates' is not known; did you mean 'rate'?"),
    ({"files": ["a", "b"], "each": {"rate": ["x", 2]}}, "key 'coupon.series.0.each.rate' holds 'x'; expected numbers"),
    ({"files": ["a", "b"], "each": {"rate": [-1, 2]}}, "file a: key 'rate' is -1.0; expected more than 0"),
    ({"files": "x_{rate}.csv", "time": "t"}, "a field of x_fast.csv is no number"),
    ({"files": "y_{rate}.csv", "time": "t"}, "gives time and rate; expected exactly one of"),
    ({"files": "y_{rate}.csv", "each": {"rate": [1]}}, "each.rate' is in the pattern of the files, too; expected it in one place"),
    ({"files": ["a"], "stress": "s", "each": {"area": [3]}}, "each.area' needs {force: COLUMN} under 'stress'"),
    ({"files": ["u/a.csv", "v/a.csv"]}, "the records of u/a.csv and v/a.csv are both called 'a'; give them names"),
    ({"files": ["a"], "file": "b"}, "key 'coupon.series.0.file' is given in a series; expected its files under 'files'"),
    ({"time": "t"}, "key 'coupon.series.0.files' is missing"),
    ({"files": ["a", "b"], "each": {"held_out": [True, True]}}, "holds out all records; expected at least one that is fitted"),
    ({"files": "${NOT_SET}/*.csv"}, "the environment variable NOT_SET is not set"),
]


@pytest.mark.parametrize(("series", "words"), SENTENCES, ids=[words[:50] for _, words in SENTENCES])
def test_what_is_wrong_is_one_sentence(tmp_path: Path, series: dict[str, Any], words: str) -> None:
    with pytest.raises(StudyError) as caught:
        records(tmp_path, series, ["x_1.csv", "x_2.csv", "x_fast.csv", "y_1.csv"])
    assert words in str(caught.value) and "\n" not in str(caught.value) and "study.yaml" in str(caught.value)


def test_a_coupon_without_records_says_so(tmp_path: Path) -> None:
    path = tmp_path / "study.yaml"
    path.write_text("name: bar\ncoupon: {control: strain}\n", encoding="utf-8")
    with pytest.raises(StudyError, match=r"key 'coupon.records' is missing: name the records, or many files alike under 'series'"):
        load_study(path)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=20)
@given(st.dictionaries(st.integers(-100, 1500), st.floats(1e-5, 1e4), min_size=1, max_size=4))
def test_every_file_of_a_pattern_is_a_record_with_its_own_numbers(tmp_path_factory: pytest.TempPathFactory, made: dict[int, float]) -> None:
    folder = tmp_path_factory.mktemp("series")
    found = records(folder, {"files": "t{temperature_C}_r{rate}.csv"}, [f"t{t}_r{r!r}.csv" for t, r in made.items()])
    assert {(r.initial_temperature_degC, r.rate) for r in found} == {(float(t), r) for t, r in made.items()}
