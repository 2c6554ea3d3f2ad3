"""The page of the operating figures: amplitudes are compared where an effect was found in the form in which it was planted."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"


@pytest.fixture(scope="module")
def page() -> Iterator[Any]:
    sys.path.insert(0, str(SCRIPTS))
    try:
        yield importlib.import_module("operating_page")
    finally:
        sys.path.remove(str(SCRIPTS))


def found(name: str, amplitude: float, **others: float) -> dict[str, Any]:
    """A run with an effect planted at amplitude 1 and found at another, with these values of its other Params."""
    first = {"rate_logarithmic": "C", "latent_heat": "heat", "clamp_drift": "rate"}[name]
    values = {f"{name}.{key}": value for key, value in {first: amplitude, **others}.items()}
    return {"kind": name, "planted": {f"{name}.{first}": 1.0}, "estimates": {name: values}}


WINDOW = {"centre": 0.02, "width": 0.02, "rounding": 0.1}


@pytest.mark.parametrize(
    ("run", "alike"),
    [
        (found("rate_logarithmic", 1.1, reference=5e-5), True),
        (found("rate_logarithmic", 1.1, reference=3.5e-4), True),
        (found("rate_logarithmic", 14.0, reference=1e-2), False),
        (found("rate_logarithmic", 0.3, reference=1e-6), False),
        (found("latent_heat", 0.9, **WINDOW), True),
        (found("latent_heat", -0.7, **{**WINDOW, "centre": 0.0044}), False),
        (found("clamp_drift", 1.0, time=18000.0), True),  # a straight line, as with the planted 100000 s
        (found("clamp_drift", 1.0, time=300.0), False),
    ],
)
def test_form_of_an_effect(page: Any, run: dict[str, Any], alike: bool) -> None:
    assert page.as_planted(run, run["kind"]) is alike


def test_bias_is_that_of_one_form_and_says_of_how_many(page: Any) -> None:
    near = [found("rate_logarithmic", value, reference=1e-4) for value in (0.9, 1.0, 1.2)]
    far = found("rate_logarithmic", 14.0, reference=1e-2)
    assert page.bias(near) == "+0 %" and page.bias([far]) == "other form in 1"
    assert page.bias([near[2], far]) == "+20 % in 1, other form in 1"
    assert page.bias([{**far, "estimates": {}}]) == "-"
