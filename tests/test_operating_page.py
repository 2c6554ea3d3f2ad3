"""The page of the operating figures: amplitudes are compared where an effect was found in the form in which it was planted."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thermofit.effects.catalogue import effect, effects


@pytest.fixture(scope="module")
def page(scripts: Any) -> Any:
    return scripts("operating_page")


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


def test_intervals_are_counted_where_the_form_is_the_planted_one(page: Any) -> None:
    """An amplitude of 1.2 is held by a standard error of 0.11 and not by one of 0.1; one without an error counts nowhere."""
    near, far = found("rate_logarithmic", 1.2, reference=1e-4), found("rate_logarithmic", 14.0, reference=1e-2)
    runs = [{**near, "sigma": {"rate_logarithmic": sigma}} for sigma in (0.11, 0.1)]
    assert page.held([*runs, {**far, "sigma": {"rate_logarithmic": 9.0}}, near, {**near, "sigma": {}}]) == (1, 2)


def kept(driver: str, kind: str, times: float, first: str | None, seed: int = 0, **more: Any) -> dict[str, Any]:
    """A run as it is kept, in which what came first was accepted at its planted amplitude."""
    return {
        **{"source": "now", "scripts": "own", "driver": driver, "kind": kind, "times": times, "seed": seed, "cpu_s": 1800.0},
        **{"programme": "monotonic", "planted": {}, "estimates": {}, "unlisted": None, "after": {"u": 1.0}},
        **{"first": first, "first_family": [first] if first else [], "accepted": [first] if first else []},
        **{"families": {first: [first]} if first else {}, **more},
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
    assert "within the aim" in said and "above the aim" in page.walls(RUNS * 2)


def test_page_says_what_it_stands_on(page: Any, tmp_path: Path) -> None:
    page.write(RUNS, tmp_path, {"radiation": "too faint", "jaw_slip": "no crosshead", "machine_compliance": "no crosshead"})
    text = (tmp_path / "operating_figures.md").read_text()
    assert "(operating_figures.jsonl)" in text and "Rows, coupon records: 5, all of source now" in text
    assert "| radiation | too faint |" in text and "| jaw_slip, machine_compliance | no crosshead |" in text
    assert "When the error of the force counts" in text
    strong, faint = text.split("(1 times the smallest amplitude)")
    assert "| ir_drift | ir_drift 1, ir_gain 1 |" in strong and "| ir_drift+lamp | lamp 1 |" in strong and "| none | none 1 |" in strong
    assert "| ir_drift | none 1 |" in faint and "| lamp | clamp_drift 1 |" in faint
    for picture in ("operating_figures.png", "operating_confusion.png"):
        assert f"]({picture})" in text and (tmp_path / picture).stat().st_size > 0


def test_rows_of_two_sources_are_never_counted_together(page: Any) -> None:
    """Of each driver those of its last row count; drivers are counted apart, and may be of two sources."""
    own, said = page.of_one_source([{**RUNS[0], "source": "older"}, *RUNS[1:-1], {**RUNS[-1], "source": "newer"}])
    assert own == [*RUNS[1:-1], {**RUNS[-1], "source": "newer"}]
    assert "4, all of source now" in said[0] and "not counted: 1 rows of source older" in said[0]
    assert "1, all of source newer" in said[1] and "not counted" not in said[1]
    assert len(said) == 3 and "full fields of the full mesh, fitted on the coarse one: none" in said[2]


def test_what_other_sources_said_where_nothing_was_planted_is_told(page: Any) -> None:
    older = {**RUNS[0], "source": "older", "kind": "none", "times": 0.0, "accepted": [], "unlisted": None}
    of = [older, {**older, "accepted": ["lamp"], "unlisted": "stress"}, {**older, "unlisted": "dtheta"}, {**older, "kind": "lamp"}]
    _, said = page.of_one_source([*of, RUNS[0]])
    assert "4 rows of source older" in said[0] and "an effect or something unlisted in 2 of 3)" in said[0]
    _, said = page.of_one_source([{**older, "kind": "lamp"}, RUNS[0]])
    assert "not counted" in said[0] and "nothing planted" not in said[0]


def test_two_effects_are_named_only_by_two_accepted_ones(page: Any) -> None:
    alike = {"a": ["a", "lamp", "ir_drift"], "b": ["b", "lamp"]}
    run = kept("point", "ir_drift+lamp", 6.0, "a", families=alike)
    assert not page.named({**run, "accepted": ["a"]}) and not page.named({**run, "accepted": []})
    assert page.named({**run, "accepted": ["a", "b"]}) and page.named({**run, "accepted": ["b", "a"]})
    assert not page.named({**run, "accepted": ["b", "c"], "families": {"b": ["b", "lamp"], "c": ["lamp"]}})
    assert page.named({**run, "kind": "lamp", "accepted": ["a"]})


def test_planted_effect_itself_is_counted_beside_its_family(page: Any) -> None:
    run = kept("point", "lamp", 3.0, "air_drift", first_family=["air_drift", "lamp"])
    assert page.family_first(run) and not page.itself_first(run)
    assert page.itself_first({**run, "first": "lamp"}) and not page.family_first({**run, "first_family": ["air_drift"]})


def test_bounds_are_those_of_clopper_and_pearson(page: Any) -> None:
    """Nothing in n runs: 1 - 0.05^(1/n); all of n: 0.05^(1/n)."""
    assert page.at_most(0, 300) == "0 of 300 (<= 1.0 %)" and page.at_most(0, 50) == "0 of 50 (<= 6 %)"
    assert page.at_least(300, 300) == "300 of 300 (>= 99.0 %)" and page.at_least(10, 10) == "10 of 10 (>= 74 %)"
    assert page.at_most(0, 0) == "-"


def test_nothing_planted_counts_what_is_named_or_unlisted(page: Any, tmp_path: Path) -> None:
    nulls = [
        kept("point", "none", 0.0, name, k, unlisted=u) for k, (name, u) in enumerate([(None, None), ("lamp", "stress"), (None, "stress")])
    ]
    page.write(nulls, tmp_path, {})
    text = (tmp_path / "operating_figures.md").read_text()
    assert (
        "An effect was accepted in 1 of 3" in text and "Something unlisted was told in 2 of 3" in text and "one or both in 2 of 3" in text
    )


def knocked(kind: str, unlisted: str | None, accepted: list[str], seed: int, **more: Any) -> dict[str, Any]:
    """A run whose planted effect the catalogue did not hold, which shows in the temperatures alone."""
    shows = {kind: {"du": 0.1, "dtheta": 0.9}}
    own = {"knocked": True, "shows": shows, "unlisted": unlisted, "accepted": accepted, "where": {}, **more}
    return {**kept("body", kind, 10.0, None, seed), **own}


def test_what_the_catalogue_lacks_is_told_in_the_channel_that_shows_it(page: Any, tmp_path: Path) -> None:
    there = {"planted": {"local_source.place": 8.0, "local_source.start": 40.0}, "where": {"at": [0.0, 9.5], "when": [38.0, 99.0]}}
    runs = [
        knocked("local_source", "dtheta", [], 1, **there),
        knocked("local_source", "du", [], 2),
        knocked("local_source", None, ["lamp"], 3),
        knocked("local_source", None, [], 4),
    ]
    assert [page.right(r) for r in runs] == [True, False, False, False]
    assert [page.impostor(r) for r in runs] == [False, False, True, False] and [page.silent(r) for r in runs] == [False, False, False, True]
    page.write([*RUNS, *runs], tmp_path, {})
    text = (tmp_path / "operating_figures.md").read_text()
    assert "| local_source | 10 | 1 of 4" in text and "| 1.5 | 2 |" in text and "| local_source | lamp 1 |" in text
    assert "resh seeds" not in text
    again = [{**runs[0], "seed": page.FRESH}, {**runs[3], "seed": page.FRESH + 1}, {**runs[3], "seed": page.FRESH + 2}]
    (tmp_path / "more").mkdir()
    page.write([*RUNS, *runs, *again], tmp_path / "more", {})
    more = (tmp_path / "more" / "operating_figures.md").read_text()
    assert "| fresh seeds | 10 | 1 of 3" in more and "| all | 10 | 2 of 7" in more
    # They count nowhere else.
    summary = [line for line in text.splitlines() if line.startswith("| full fields")]
    assert summary and not any("of 5" in line for line in summary)


@pytest.fixture(scope="module")
def figures(page: Any) -> Any:
    return importlib.import_module("operating_figures")


def test_every_effect_is_planted_or_has_a_reason(figures: Any) -> None:
    planted = {n for d in figures.DRIVERS.values() for r in figures.plan("x", d) for n in r["kind"].split("+")} - {"none"}
    assert set(figures.unplanted()) == set(figures.UNPLANTED)
    assert planted | set(figures.UNPLANTED) == {e.name for e in effects() if not e.of_user} and not planted & set(figures.UNPLANTED)


def test_seeds_of_a_driver_are_its_own(figures: Any) -> None:
    """What one noise resembles by chance is counted once; runs of two amplitudes or kinds have noises of their own."""
    seeds = [run["seed"] for name, driver in figures.DRIVERS.items() for run in figures.plan(name, driver)]
    assert len(set(seeds)) == len(seeds)


def test_effects_outside_the_catalogue_are_runs_of_their_own(figures: Any) -> None:
    runs = [r for r in figures.plan("point", figures.DRIVERS["point"]) if r.get("knocked")]
    assert {r["times"] for r in runs} == {3.0, 10.0} and len(runs) == 12 * len(figures.DRIVERS["point"].effects)
    row = {**RUNS[1], "knocked": True}
    assert figures.key(row) != figures.key(RUNS[1]) and figures.kinds_of(row) == ("knocked",)


def test_number_of_nulls_is_as_asked(figures: Any) -> None:
    runs = figures.plan("point", figures.DRIVERS["point"], 7)
    assert sum(r["kind"] == "none" for r in runs) == 7
    assert ("yield_plateau", "ir_drift") in figures.DRIVERS["point"].pairs


def test_a_row_of_another_source_is_another_row(figures: Any, tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    rows = [RUNS[0], {**RUNS[0], "source": "older"}, {**RUNS[0], "first": "lamp"}]
    file.write_text("".join(json.dumps(r) + "\n" for r in rows), encoding="utf-8")
    kept_ = figures.kept_rows(file)
    assert len(kept_) == 2 and kept_[figures.key(RUNS[0])]["first"] == "lamp"
    assert figures.kept_rows(tmp_path / "none.jsonl") == {}


@pytest.fixture(scope="module")
def draw(page: Any) -> Any:
    return importlib.import_module("operating_draw")


def test_planted_values_lie_off_the_scanned_grid(draw: Any) -> None:
    """Not nearer to a scanned value than a tenth of the gap, by logarithms where these count, and in every gap."""
    random, p = np.random.default_rng(1), effect("backstress_first").params[1]
    tried = (10.0, 100.0, 1000.0)
    values = np.array([draw.off_grid(p, tried, random) for _ in range(200)])
    at = np.log(values / 10.0) / np.log(10.0) if p.logarithmic else np.interp(values, tried, [0.0, 1.0, 2.0])
    assert np.all((at % 1.0 >= 0.1 - 1e-9) & (at % 1.0 <= 0.9 + 1e-9)) and set(np.floor(at)) == {0.0, 1.0}


def test_world_follows_from_its_seed(draw: Any) -> None:
    names = ("one", "two", "three")
    found = [draw.worlds(seed, names, ("stress",)) for seed in range(60)]
    assert found[3] == draw.worlds(3, names, ("stress",)) and {w[0].programme for w in found} == set(names)
    assert all(0.5 <= w[0].noise <= 2.0 for w in found)
    assert 0.15 < np.mean([w[0].declared["stress"] != 1.0 for w in found]) < 0.55


def test_smallest_amplitudes_are_those_that_are_planted(
    figures: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The unit of a run at one times the smallest amplitude is what `--smallest` prints for its test, and for every effect asked."""
    run = importlib.import_module("operating_run")
    tests, name, seed = run.TESTS["point"], "linear_hardening", 7
    world = tests.candidates(seed)[0]
    unit = run.planted_in(tests.at_truth(world), [name], 1.0, world.random("secondary"), False).units[name]
    monkeypatch.setattr(
        "sys.argv", ["operating_figures.py", "--driver", "point", "--seed", str(seed), "--smallest", name, "film_by_height"]
    )
    figures.main()
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{world.programme}: H_lin from {unit:.3g} MPa on, bounds 0 to 100000"
    assert lines[1] == f"{world.programme}: film_by_height is not known to this test" and len(lines) == 2 * len(tests.candidates(seed))


def test_smallest_amplitudes_need_a_driver_and_known_effects(
    figures: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in (["--smallest", "lamp"], ["--driver", "body", "--smallest", "lamp", "lampe"]):
        monkeypatch.setattr("sys.argv", ["operating_figures.py", *words])
        with pytest.raises(SystemExit):
            figures.main()
        assert "effects of the catalogue" in capsys.readouterr().err
