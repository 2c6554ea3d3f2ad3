"""The page of the operating figures: amplitudes are compared where an effect was found in the form in which it was planted."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from thermofit.effects.catalogue import effects

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


def kept(driver: str, kind: str, times: float, first: str | None, seed: int = 0) -> dict[str, Any]:
    """A run as it is kept, in which what came first was accepted at its planted amplitude."""
    return {
        **{"driver": driver, "kind": kind, "times": times, "seed": seed, "wall_s": 1800.0, "planted": {}, "estimates": {}},
        **{"first": first, "first_family": [first] if first else [], "accepted": [first] if first else []},
        **{"families": {first: [first]} if first else {}, "held_out": {"after": {"u": 1.0}}},
    }


RUNS = [
    kept("point", "none", 0.0, None),
    kept("point", "ir_drift", 3.0, "ir_drift"),
    kept("point", "ir_drift", 10.0, "ir_gain", 1),
    kept("point", "ir_drift", 1.0, None),
    kept("point", "ir_drift+lamp", 6.0, "lamp"),
    kept("body", "lamp", 3.0, "clamp_drift"),
]


def test_confusion_counts_what_came_first(page: Any) -> None:
    rows, columns, count = page.confusion(
        [*(r for r in RUNS if r["driver"] == "point" and r["times"] != 1.0), kept("point", "none", 0.0, None, 1)]
    )
    assert rows == ["ir_drift", "ir_drift+lamp", "none"] and columns == ["ir_drift", "lamp", "ir_gain", "none"]
    assert count.tolist() == [[1, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 2]]


def test_time_is_that_of_every_run_beside_the_aim(page: Any) -> None:
    said = page.walls(RUNS)
    assert "6 runs took 3.00 h" in said and "coupon records 2.50 h" in said and "full fields on a small body 0.50 h" in said
    assert "above the aim" in said and "within the aim" in page.walls(RUNS[:5])


def test_page_says_what_it_stands_on(page: Any, tmp_path: Path) -> None:
    page.write(RUNS, tmp_path, {"radiation": "too faint", "jaw_slip": "no crosshead", "machine_compliance": "no crosshead"})
    text = (tmp_path / "operating_figures.md").read_text()
    assert "seeds in `DRIVERS` of `scripts/operating_figures.py`" in text.replace("\n", " ")
    assert "| radiation | too faint |" in text and "| jaw_slip, machine_compliance | no crosshead |" in text
    assert all(words in text for words in ("Unlisted sources", "Effects taken back", "When the error of the force is told"))
    strong, faint = text.split("(1 times the smallest amplitude)")
    assert "| ir_drift | ir_drift 1, ir_gain 1 |" in strong and "| ir_drift+lamp | lamp 1 |" in strong and "| none | none 1 |" in strong
    assert "| ir_drift | none 1 |" in faint and "| lamp | clamp_drift 1 |" in faint
    for picture in ("operating_figures.png", "operating_confusion.png"):
        assert f"]({picture})" in text and (tmp_path / picture).stat().st_size > 0


@pytest.fixture(scope="module")
def figures(page: Any) -> Any:
    return importlib.import_module("operating_figures")


def test_every_effect_is_planted_or_has_a_reason(figures: Any) -> None:
    planted = {n for d in figures.DRIVERS.values() for r in figures.plan("x", d, Everything()) for n in r["kind"].split("+")} - {"none"}
    assert set(figures.unplanted()) == set(figures.UNPLANTED)
    assert planted | set(figures.UNPLANTED) == {e.name for e in effects() if not e.of_user} and not planted & set(figures.UNPLANTED)


class Everything(dict[str, float]):
    """A smallest amplitude for whatever effect is asked for."""

    def __contains__(self, name: object) -> bool:
        return True

    def __missing__(self, name: str) -> float:
        return 1e-9


def test_seeds_of_runs_that_are_kept_stay(figures: Any) -> None:
    """Another seed would be another run: those that are kept would be lost, or counted for noise that they did not have."""
    seeds: dict[tuple[str, str], list[int]] = {}
    for name, driver in figures.DRIVERS.items():
        for run in figures.plan(name, driver, Everything()):
            if run["times"] in (3.0, 6.0):
                seeds.setdefault((name, run["kind"]), []).append(run["seed"])
    assert seeds["point", "second_hardening"] == [1000, 1001, 1002, 1003] and seeds["point", "ir_lag"] == [2100, 2101, 2102, 2103]
    assert seeds["point", "elastic_degradation+ir_drift"] == [2400, 2401, 2402, 2403]
    assert seeds["point", "rate_power"] == [2500, 2501] and seeds["point", "backstress_second"] == [2600, 2601]
    assert seeds["body", "bending"] == [2300, 2301] and seeds["body", "rate_logarithmic+ir_lag"] == [2600, 2601, 2602, 2603]
