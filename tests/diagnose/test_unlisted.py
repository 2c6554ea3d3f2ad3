"""Unlisted effects of a body: a source that the catalogue does not know, its place, power, window; nothing where nothing is missing."""

from __future__ import annotations

import importlib.util
import io
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from refits import fitted, refitting
from rich.console import Console
from strip import MODEL, THICK, Source, numerical, spot, strip_case

from thermofit.cli.printing import unlisted_lines
from thermofit.core.errors import NumericsError
from thermofit.core.jsonable import jsonable
from thermofit.diagnose import unlisted as module
from thermofit.diagnose.beside_source import Spot, beside_source
from thermofit.diagnose.case import RefinedProblem
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.trace import Traced, traced
from thermofit.diagnose.unlisted import Unlisted, best_listed, structured, unlisted, volumes
from thermofit.diagnose.unlisted_effect import heat_file
from thermofit.diagnose.unlisted_hints import hints
from thermofit.diagnose.unlisted_loop import ended
from thermofit.diagnose.unlisted_place import compact, place_of, when_of
from thermofit.diagnose.unlisted_structure import structures
from thermofit.experiment.residuals import Span
from thermofit.report.html.gather import unlisted_words
from thermofit.report.unlisted import described, in_words, summary_of, unlisted_datasets, with_unlisted
from thermofit.study.study import Study

PATCH = (8.0, 7.5)
"""Distance of hats in mm, more than that with which the term is sought."""


def diagnosed(seed: int, source: Source | None = None, **planted: float) -> tuple[Traced, Unlisted | None]:
    here = traced(fitted(strip_case(seed, source, **planted))[0], numerical())
    return here, unlisted(here, structured(here, numerical()), [s.effect for s in here.promising()])


def looped(seed: int, source: Source | None = None, **planted: float) -> tuple[Closed, Unlisted | None]:
    case, fit = fitted(strip_case(seed, source, **planted))
    refit = refitting(case.model)
    return ended(close_loop(case, fit, refit, 3, numerical()), refit, numerical(), "auto")


@pytest.mark.parametrize(("power", "at", "when"), [(30.0, (-5.0, 8.0), (40.0, 75.0)), (15.0, (4.0, -14.0), (20.0, 50.0))])
def test_a_spot_is_found_where_when_and_as_strong_as_it_is(power: float, at: tuple[float, float], when: tuple[float, float]) -> None:
    here, found = diagnosed(2, spot(power, *at, when))
    assert found is not None and found.place is not None and found.field is not None
    assert found.listed[1] < 0.5
    assert found.place.size == pytest.approx(power, rel=0.15)
    assert found.place.total == pytest.approx(power * (when[1] - when[0]), rel=0.15)
    assert abs(found.place.centroid[0] - at[0]) < 0.5 * PATCH[0] and abs(found.place.centroid[1] - at[1]) < 0.5 * PATCH[1]
    assert found.place.when == pytest.approx(when, abs=3.0)
    said = summary_of(here, found, None)
    assert said["channel"] == "theta" and said["kind"] == "heat source" and said["unit"] == "mW"
    assert said["after"]["held_out"]["theta"] < 0.5 * said["before"]["held_out"]["theta"] + 0.5 * 0.02
    assert said["after"]["fit"]["theta"] == pytest.approx(0.02, rel=0.1)
    words = with_unlisted({"verdict": "x", "trustworthy": True}, said)
    assert words["trustworthy"] is False and "heat source" in words["verdict"] and in_words(said) in words["verdict"]


def even(power: float, when: tuple[float, float]) -> Source:
    """A heat in mW/mm^2 of the face that is the same everywhere, on between two times."""
    return lambda x, _, t: power / THICK * (when[0] < t < when[1]) + 0.0 * x


@pytest.mark.parametrize(("power", "when"), [(0.036, (24.0, 62.0)), (-0.048, (80.0, 104.0))])
def test_a_heat_through_the_free_surface_is_told_as_such(tmp_path: Path, power: float, when: tuple[float, float]) -> None:
    """As it is switched on and off; conductivity and dissipation beside it are what they are without it, and its file says the same."""
    here = traced(fitted(strip_case(3, even(power, when)))[0], numerical())
    found = unlisted(here, structured(here, numerical()), [])
    assert found is not None and found.field is not None and found.place is not None
    assert found.field.basis.kind == "flux"
    large = [(t, a) for t, a in found.field.steps if abs(a) > 0.2 * abs(power)]  # the error of the mesh may make one more
    assert [t for t, _ in large] == pytest.approx(when, abs=2.0) and [a for _, a in large] == pytest.approx([power, -power], rel=0.12)
    beside = beside_source(here, found)
    clean, driven = fitted(strip_case(3))[0].parameters, here.case.parameters
    assert beside is not None and all(abs(beside.value[n] / clean[n] - 1.0) < 0.01 for n in ("kappa", "beta")), beside
    assert max(abs(driven[n] / clean[n] - 1.0) for n in ("kappa", "beta")) > 0.03
    study = cast(Study, SimpleNamespace(name="strip", run_dir=tmp_path / "run"))
    said = described(study, here, found, beside)
    assert said is not None and said["where"] == {"surface": "all"} and said["unit"] == "mW/mm^2" and said["energy_mJ"] is None
    assert beside.second and set(beside.second) == {"offset"} and said["parameters"]["second"] == beside.second
    for one, travels in ((Spot(1.5, None), (None, None, None)), (Spot(1.5, 2.0, (0.12, 0.01), 50.0), (0.12, 0.01, 50.0))):
        told = described(study, here, found, replace(beside, spot=one))
        assert told is not None and told["parameters"]["spot"] == {
            **{"y_mm": 1.5, "spread_mm": one.spread},
            **dict(zip(("velocity_mm_per_s", "velocity_sigma", "at_s"), travels, strict=True)),
        }
    assert "the same everywhere from" in in_words(said) and f"mW/mm^2 at {said['steps'][0]['time_s']:.4g} s" in in_words(said)
    module = _loaded(Path(said["effect_file"]))
    shown = module.surface_flux(np.full(2, 300.0), 0.5 * sum(when), np.full(2, 297.0), 1.0)
    assert shown == pytest.approx(2 * [-power], rel=0.12) and module.ON == ("air",)
    text = io.StringIO()
    unlisted_lines(Console(file=text, width=120), cast(Any, jsonable(said)))
    assert "steps" in text.getvalue() and "unlisted: a heat through the free surface in theta" in text.getvalue()


def other_data(case: Any, parameters: Any, moved: float) -> Any:
    """The model of a case with data that its prediction would have with beta moved, and what it makes of temperatures."""
    change = case.model.linearised(parameters, ("beta",))[1][:, 0] * moved
    first = case.model.errors

    def errors(p: Any) -> Any:
        return {"theta": first(p)["theta"] - 0.02 * change.reshape(first(p)["theta"].shape)}

    def linearise(p: Any, names: tuple[str, ...]) -> Any:
        return errors(p), case.model.linearise(p, names)[1]

    return replace(case.model, errors=errors, linearise=linearise)


def test_errors_of_the_mesh_are_told_anew_beside_what_is_the_same_everywhere() -> None:
    """With what the term adds to the temperatures, at the parameters beside it, which follow. A run that fails leaves them as they were,
    in words."""
    here = traced(fitted(strip_case(3, even(0.036, (24.0, 62.0))))[0], numerical())
    before = unlisted(here, structured(here, numerical()), [])
    assert before is not None and before.field is not None
    asked: list[Any] = []

    def refined(parameters: Any, beside: Any = None) -> Any:
        asked.append((parameters, beside))
        model = other_data(here.case, parameters, 0.05)
        return RefinedProblem(model, None, cast(Any, None), cast(Any, None), np.zeros(1), doubts={"mesh": np.zeros(len(here.rows.time))})

    found = unlisted(replace(here, case=replace(here.case, refined_at=refined)), structured(here, numerical()), [])
    assert found is not None and found.case is not None and set(found.case.doubts) == {"mesh"}
    assert [term.kind for _, term in asked] == ["flux", "offset"], "and beside a rival"
    there, beside = asked[0]
    assert found.field is not None and found.field.basis.kind == "flux"
    assert there["kappa"] == before.parameters["kappa"] and beside.kind == "flux"
    assert np.array_equal(beside.amount, before.field.q), "with its errors"
    ones = np.sum(beside.by_units(here.case.model.missing, there)["theta"], axis=-1)[np.searchsorted(MODEL.time, 62.0)].max() / THICK
    assert 62.0 / 3.6 / THICK > ones > 5.0, "1 mW/mm^2 on a sheet for 62 s warms by 14 K what loses none"
    assert found.parameters["beta"] - before.parameters["beta"] == pytest.approx(0.05, abs=0.01), "where the data told anew have it"
    told = beside_source(here, found)
    assert told is not None and told.value["beta"] == found.parameters["beta"]

    def fails(*_: Any) -> Any:
        raise NumericsError("no run there")

    kept = unlisted(replace(here, case=replace(here.case, refined_at=fails)), structured(here, numerical()), [])
    assert kept is not None and kept.parameters == before.parameters
    assert "those at the optimum without the term" in kept.remark and "no run there" in kept.remark


def test_the_amount_has_a_standard_error_that_holds_it() -> None:
    """Knots are 2.5 s apart: beside that doubt of the window what noise makes of the power is small, but not where it is weak."""
    strong, weak = [], []
    for seed in (0, 1, 4):
        here, found = diagnosed(seed, spot(30.0, -5.0, 8.0, (40.0, 75.0)))
        assert found is not None and found.place is not None
        assert found.field is not None
        strong.append(found.place)
        said = summary_of(here, found, None)
        assert said["amount"] == {"value": found.place.size, "sigma": found.place.doubt, "unit": "mW"} and "+-" in in_words(said)
        bare = place_of(found.field, volumes(here.case, found.field.basis)).doubt
        assert bare < found.place.doubt < 2.0 * bare, "parameters that follow the term move it"
        loose = replace(found.field, posterior=400.0 * found.field.posterior)
        weak.append(place_of(loose, volumes(here.case, loose.basis)))
    assert all(0.02 < p.doubt / p.size < 0.06 and abs(p.size - 30.0) < 3.0 * p.doubt for p in strong)
    assert all(w.size == pytest.approx(p.size) and w.doubt > 4.0 * p.doubt for w, p in zip(weak, strong, strict=True))


@pytest.mark.parametrize(
    ("worth", "spread", "told"),
    [(0.0, 1.0, True), (1.0, 1.0, True), (1.0, 50.0, False), (0.0, 50.0, True)],
    ids=["clear", "small", "nothing", "vague"],
)
def test_a_small_term_that_is_not_away_from_nothing_is_said_but_not_told(
    monkeypatch: pytest.MonkeyPatch, worth: float, spread: float, told: bool
) -> None:
    """Of less worth it has to be away from nothing; what is worth it may be of a kind that is not known."""

    def place(field: Any, of: Any) -> Any:
        found = place_of(field, of)
        return replace(found, doubt=spread * found.doubt)

    monkeypatch.setattr(module, "place_of", place)
    monkeypatch.setattr(module, "WORTH", worth)
    here, words = traced(fitted(strip_case(2, spot(30.0, -5.0, 8.0, (40.0, 75.0))))[0], numerical()), list[str]()
    found = unlisted(here, structured(here, numerical()), (), remark=words.append)
    assert (found is not None) is told and bool(words) is not told
    if words:
        assert words[0].startswith("theta: heat source (30 +- 5e+01 mW, 39.81 to 74.61 s) is not told, for it is not away from nothing")
        case, fit = fitted(here.case)
        refit = refitting(case.model)
        closed, missing = ended(close_loop(case, fit, refit, 0, numerical()), refit, numerical(), "auto")
        assert missing is None and any("not away from nothing" in remark for remark in closed.remarks)


@pytest.mark.parametrize(("local", "balance"), [(None, "heat"), ("inside", "heat"), ("outside", "boundary")])
def test_which_balance_lacks_it(tmp_path: Path, local: str | None, balance: str) -> None:
    """A heat that the balance of observed pieces does not miss comes from outside the observed field."""
    here, found = diagnosed(2, spot(30.0, -5.0, 8.0, (40.0, 75.0)))
    maps = [{"balance": "force", "channel": "du", "where": "outside"}, {"balance": "heat", "channel": "theta", "where": local}]
    study = cast(Study, SimpleNamespace(name="strip", run_dir=tmp_path / "run"))
    said = described(study, here, found, None, None if local is None else {"maps": maps})
    assert said is not None and said["balance"] == balance


WANDERING = [
    lambda t: 0.15 * np.sin(2.0 * np.pi * t / 37.0),
    lambda t: 0.15 * (t > 47.0),
    lambda t: 0.1 * np.abs((t / 25.0) % 2.0 - 1.0) + 0.1 * (t > 80.0),
]
"""Offsets of a camera in K over s: one that sways, one that steps, one that saws and steps."""


@pytest.mark.parametrize(("offset", "steady"), list(zip(WANDERING, (True, False, False), strict=True)))
def test_a_camera_that_wanders_is_no_heat_source(tmp_path: Path, offset: Any, steady: bool) -> None:
    """The offset over time is told as what it is. Conductivity and dissipation beside it are what they were, where a plain fit is 7 % off
    unless the camera sways about nothing (`steady`)."""
    here = traced(fitted(strip_case(3, offset=offset))[0], numerical())
    found = unlisted(here, structured(here, numerical()), [])
    assert found is not None and found.field is not None and found.place is not None and found.field.basis.kind == "offset"
    history = found.field.values[:, 0, 0, 0]
    assert len(history) >= len(here.case.model.observations["theta"].time), "a camera jumps from one frame to the next"
    planted = offset(found.field.basis.grid.time)
    away = (history - history.mean()) - (planted - planted.mean())
    assert np.sqrt(np.mean(away**2)) < 0.25 * np.std(planted)
    beside = beside_source(here, found)
    assert beside is not None and set(beside.value) == {"kappa", "beta"} and set(beside.second) == {"flux"}
    assert np.all(np.abs(found.field.step) < 0.3 * found.field.uncertainty), "they have come to where they belong beside it"
    clean, driven = fitted(strip_case(3))[0].parameters, here.case.parameters
    off = {n: (beside.value[n] / clean[n] - 1.0, driven[n] / clean[n] - 1.0) for n in beside.value}
    assert all(abs(after) < 0.006 for after, _ in off.values()), f"the error of the mesh makes that much: {off}"
    assert steady or abs(off["kappa"][1]) > 0.07, off
    study = cast(Study, SimpleNamespace(name="strip", run_dir=tmp_path / "run"))
    said = described(study, here, found, beside)
    assert said is not None and said["balance"] == "camera" and said["where"] == {"image": "all"} and said["unit"] == "K"
    assert (
        "a offset" not in in_words(said)
        and "an offset of the infrared camera of " in in_words(said)
        and "in all of the image" in in_words(said)
    )
    assert in_words(said).partition(" (")[0] in unlisted_words(said)
    module = _loaded(Path(said["effect_file"]))
    scene: Any = SimpleNamespace(name="", time=found.field.basis.grid.time)
    theta = np.zeros((len(history), 2))
    assert module.sensor(theta, scene, 1.0) == pytest.approx(np.repeat(history[:, None], 2, axis=1), abs=1e-5)
    text = io.StringIO()
    unlisted_lines(Console(file=text, width=120), cast(Any, jsonable(said)))
    assert "an offset of the infrared camera" in text.getvalue()


def test_nothing_is_unlisted_where_nothing_is_missing() -> None:
    assert [diagnosed(seed)[1] for seed in range(6)] == [None] * 6
    assert with_unlisted({"verdict": "x", "trustworthy": True}, None) == {"verdict": "x", "trustworthy": True, "unlisted": None}


def test_a_listed_effect_is_not_unlisted() -> None:
    """Before it is added a family explains it; once it is accepted nothing is left."""
    here, found = diagnosed(1, **{"ir_drift.rate": 2e-3})
    structure = structures(here.case, here.rows, here.problem.model.left, None)[0]
    assert structure.stands_out and best_listed(here, structure, ["ir_drift", "ir_gain"]) == (
        "ir_drift",
        pytest.approx(1.0, abs=0.05),
    )
    assert found is None
    closed, left = looped(1, **{"ir_drift.rate": 2e-3})
    assert closed.accepted == ("ir_drift",) and left is None


def test_without_the_term_of_the_catalogue_it_would_be_unlisted() -> None:
    """The criterion bites: the same data, with a catalogue that does not know the effect."""
    case = strip_case(1, **{"ir_drift.rate": 2e-3})
    blind = replace(case, known=tuple(e for e in case.known if e.name != "ir_drift"))
    here = traced(fitted(blind)[0])
    assert unlisted(here, structured(here, None), ()) is not None


def test_what_only_resembles_is_taken_back_and_what_is_there_beside_stays() -> None:
    """A spot with a drift of the camera: the drift stays accepted, the spot is unlisted."""
    closed, found = looped(8, spot(30.0, 4.0, 5.0, (40.0, 80.0)), **{"ir_drift.rate": 4e-3})
    assert found is not None and found.place is not None
    assert "ir_drift" in closed.accepted and "ir_drift" not in found.resembles
    assert found.place.size == pytest.approx(30.0, rel=0.15)


def test_the_effect_file_holds_the_source(tmp_path: Path) -> None:
    """The file is of the kind that a user writes; its power over the strip, run through the model, is the reconstructed temperature."""
    here, found = diagnosed(2, spot(30.0, -5.0, 8.0, (40.0, 75.0)))
    assert found is not None and found.field is not None
    grid = found.field.basis.grid
    path = tmp_path / "unlisted_heat.py"
    path.write_text(heat_file("unlisted_heat", "a test", grid, found.field.values[..., 0], False), encoding="utf-8")
    module = _loaded(path)
    middle = 0.5 * (MODEL.time[1:] + MODEL.time[:-1])
    power = np.stack([module.heat_source(float(t), MODEL.x, MODEL.y, 1.0) for t in middle])
    assert np.all(module.heat_source(50.0, MODEL.x, MODEL.y, 0.0) == 0.0)
    warmed = MODEL.run(found.parameters, power[:, :, None])[:, :, 0]
    missing = here.case.model.missing
    assert missing is not None
    expected = missing.answers("heat", found.parameters, grid, found.field.basis.chosen)["theta"][:, :, 0, :] @ found.field.q
    assert np.abs(warmed - expected).max() < 1e-4 * np.abs(expected).max()


def test_figure_and_file_are_written_into_the_run_folder(tmp_path: Path) -> None:
    here, found = diagnosed(2, spot(30.0, -5.0, 8.0, (40.0, 75.0)))
    said = described(cast(Study, SimpleNamespace(name="strip", run_dir=tmp_path / "run")), here, found)
    assert said is not None
    assert Path(said["figure"]).stat().st_size > 10_000 and Path(said["effect_file"]).name == "unlisted_heat.py"
    assert {"unlisted/value", "unlisted/strength"} <= set(unlisted_datasets(found))
    console = Console(record=True, width=150, file=io.StringIO())
    unlisted_lines(console, jsonable(said))
    shown = console.export_text()
    assert "unlisted: a heat source in theta" in shown and "held-out theta without, with" in shown and "unlisted_heat.py" in shown


def _loaded(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_hints_name_the_state_variable_that_the_term_follows() -> None:
    rng, time = np.random.default_rng(3), np.linspace(0.0, 100.0, 60)
    rate = np.sin(time / 9.0)[:, None] * np.linspace(0.5, 1.5, 8)
    states = {"strain rate": rate, "strain": np.cumsum(np.abs(rate), axis=0), "y": np.tile(np.linspace(-1.0, 1.0, 8), (60, 1))}
    spans = (Span("loading", 0.0, 50.0), Span("cooling", 50.0, 100.0))
    found = hints(3.0 * rate + 0.3 * rng.normal(size=rate.shape), states, time, spans)
    assert found[0].variable == "strain rate" and found[0].frequency > 0.95 and found[0].sign == 1
    assert all(h.frequency < 0.5 for h in found[1:])


def test_windows_and_places() -> None:
    time = np.arange(0.0, 11.0)
    level = np.array([0.0, 0.1, 0.0, 0.9, 1.0, 1.1, 1.0, 0.2, 0.0, 0.4, 0.0])
    a, b = when_of(time, np.zeros(11, dtype=int), -level)
    assert 2.4 < a < 2.7 and 6.5 < b < 6.8
    values = np.zeros((3, 5, 4, 1))
    values[:, 1:3, 1, 0], values[:, 4, 3, 0] = 1.0, 0.9
    assert compact(values, np.ones_like(values)).sum() == 2, "the second spot does not hang together with the first"
