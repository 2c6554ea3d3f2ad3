"""The JSON of a result keeps the contract, and the layout of an artefact is read without its values."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thermofit.core.errors import DataError
from thermofit.records.artefact import Dataset, DatasetLayout, ParameterResult, Record, RecordContent, layout, write_record
from thermofit.records.result import description_of, is_trustworthy, result_of

CONTRACT = ("stage", "verdict", "parameters", "channels", "evaluations")


def record(path: Path, summary: dict[str, Any]) -> Record:
    datasets = {
        "a/field": Dataset(np.ones((3, 5), dtype=np.float32), "K", ("time", "point")),
        "names": Dataset(np.array(["E", "nu"]), "1", ("parameter",)),
        "count": Dataset(np.array(7), "1", ()),
    }
    parameters = {"E": ParameterResult(7e4, None, "MPa", True, True, 6e4, 3e4, 7e4)}
    return write_record(path / "x.h5", RecordContent("verify", {"k": 1}, {}, datasets, parameters, summary))


def test_result_has_the_keys_of_the_contract(tmp_path: Path) -> None:
    result = result_of(record(tmp_path, {"verdict": "verified", "channels": {"du": {"rms": np.nan}}, "energy": {"work": 1.0}}))
    assert tuple(key for key in result if key in CONTRACT) == CONTRACT
    assert result["channels"] == {"du": {"rms": None}}
    assert result["evaluations"] == {} and result["energy"] == {"work": 1.0}
    assert result["parameters"]["E"] == {
        "value": 7e4, "sigma": None, "unit": "MPa", "free": True, "at_bound": True, "start": 6e4, "lower": 3e4, "upper": 7e4,
        "sigma_noise": None
    }  # fmt: skip
    json.dumps(result, allow_nan=False)


def test_summary_cannot_hide_the_parameters(tmp_path: Path) -> None:
    result = result_of(record(tmp_path, {"verdict": "v", "parameters": "wrong", "stage": "other"}))
    assert result["stage"] == "verify" and set(result["parameters"]) == {"E"}


@pytest.mark.parametrize(("summary", "expected"), [({}, True), ({"trustworthy": True}, True), ({"trustworthy": False}, False)])
def test_only_a_stage_that_doubts_itself_is_not_trusted(tmp_path: Path, summary: dict[str, Any], expected: bool) -> None:
    made = record(tmp_path, summary)
    assert is_trustworthy(made) is expected and result_of(made)["trustworthy"] is expected


def test_description_holds_provenance_and_layout(tmp_path: Path) -> None:
    description = description_of(record(tmp_path, {"verdict": "v"}))
    assert description["datasets"]["a/field"] == {"unit": "K", "dims": ["time", "point"], "shape": [3, 5], "dtype": "float32"}
    assert description["config"] == {"k": 1} and description["attributes"]["packages"]["numpy"] == np.__version__
    json.dumps(description, allow_nan=False)


def test_layout_without_values(tmp_path: Path) -> None:
    made = record(tmp_path, {})
    assert layout(made) == {
        "a/field": DatasetLayout("K", ("time", "point"), (3, 5), "float32"),
        "count": DatasetLayout("1", (), (), "int64"),
        "names": DatasetLayout("1", ("parameter",), (2,), "text"),
    }
    made.path.write_bytes(b"no artefact any more")
    with pytest.raises(DataError, match="cannot be read"):
        layout(made)
