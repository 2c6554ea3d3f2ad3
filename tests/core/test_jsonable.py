"""JSON of results: plain types, no NaN."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from thermofit.core.jsonable import json_text, jsonable


@dataclass(frozen=True)
class Count:
    n: int
    rms: float


def test_types_of_results_become_plain() -> None:
    value = {
        "count": Count(np.int32(3), np.float32(0.5)),  # type: ignore[arg-type]
        "flag": np.bool_(True),
        "array": np.array([[1.0, np.nan], [np.inf, 2.0]]),
        "path": Path("a"),
        "names": ("E", "nu"),
        "set": frozenset({"b", "a"}),
        1: None,
    }
    plain = jsonable(value)
    assert plain == {
        "count": {"n": 3, "rms": 0.5},
        "flag": True,
        "array": [[1.0, None], [None, 2.0]],
        "path": "a",
        "names": ["E", "nu"],
        "set": ["a", "b"],
        "1": None,
    }
    assert json.loads(json_text(value)) == plain


def test_what_has_no_form_in_json_is_refused() -> None:
    with pytest.raises(TypeError, match="complex"):
        jsonable({"z": 1j})
