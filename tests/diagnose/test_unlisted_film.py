"""A film of the free surface that changes: what it lets out goes with temperatures, and these with what it has let out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from virtual_pulls import TRUTH, model, part, study

from thermofit.core import parameters as declared
from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose import unlisted as module
from thermofit.diagnose.held_out import Proof
from thermofit.diagnose.unlisted import basis, film_beside
from thermofit.diagnose.unlisted_effect import over_time_file
from thermofit.diagnose.unlisted_field import Basis, MissingField, best_beside
from thermofit.diagnose.unlisted_middle import about
from thermofit.diagnose.unlisted_structure import Structure
from thermofit.effects import catalogue
from thermofit.effects.catalogue import load_effect
from thermofit.experiment.missing import Grid
from thermofit.experiment.missing_body import BodyMissing

NONE = np.zeros(0)
NAME = "planted_film"


@pytest.fixture
def planted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Loads a history (n_k,) W/(m^2 K) of a grid as an effect."""
    monkeypatch.setattr(catalogue, "EFFECTS", dict(catalogue.EFFECTS))
    monkeypatch.setattr(declared, "OF_EFFECTS", dict(declared.OF_EFFECTS))

    def load(grid: Grid, values: np.ndarray) -> None:
        path = tmp_path / f"{NAME}.py"
        path.write_text(over_time_file("film", NAME, "a test", grid, values), encoding="utf-8")
        load_effect(path)

    return load


def term_of(hat: Basis, q: np.ndarray, weight: float) -> MissingField:
    """A term of hats with coefficients (m,)."""
    return MissingField(hat, q, np.zeros((len(q), len(q))), weight, NONE, NONE, NONE, NONE, Proof(1.0, 1.0, {}, 0.0, 1.0, 1))


def test_a_film_is_found_beside_parameters_that_stay(planted: Any) -> None:
    """The residual is that of a run whose film is up to four times as large, by an effect file. Taken to go with the temperatures of a run
    without it, it would be more than a fifth off."""
    joint, base = model(study()), Parameters.of(TRUTH)
    assert isinstance(joint.missing, BodyMissing)
    grid = joint.missing.grid("film", (8, 1, 1))
    values = 20.0 * (1.0 + np.cos(2.0 * np.pi * grid.time / grid.time[-1]))
    planted(grid, values)
    residual = joint.residual(base) - joint.residual(base.replace(**{f"{NAME}.scale": 1.0}))
    channels = tuple(c.channel for c in joint.comparisons)
    case: Any = SimpleNamespace(model=joint, channels=channels, parameters=base)
    structure: Any = SimpleNamespace(blocks=SimpleNamespace(channel="dtheta"))
    first = basis(case, structure, "film", grid, np.arange(grid.size))
    found = film_beside(residual, case, structure, term_of(first, np.zeros(grid.size), 1e-4))
    assert found.grid.level == pytest.approx(values, abs=0.1 * values.max()), "hats of late times are small"
    assert found.columns @ found.grid.level == pytest.approx(-residual[found.rows], abs=0.02 * np.abs(residual).max())
    plain, _ = best_beside(residual, first, 1e-4)
    assert np.abs(plain - values).max() > 0.2 * values.max()


def test_what_it_lets_out_goes_with_the_air_as_it_is(planted: Any) -> None:
    """Air that warms up by 0.2 K/s: at the end a film lets heat in."""
    joint, base = model(study()), Parameters.of({**TRUTH, "air_drift.rate": 0.2})
    assert isinstance(joint.missing, BodyMissing)
    grid = joint.missing.grid("film", (8, 1, 1))
    values = 5.0 * (1.0 + np.cos(2.0 * np.pi * grid.time / grid.time[-1]))
    planted(grid, values)
    change = (joint.residual(base.replace(**{f"{NAME}.scale": 1.0})) - joint.residual(base))[part(joint, "dtheta")]
    answers = joint.missing.answers("film", base, replace(grid, level=values), np.arange(grid.size))["theta"]
    (comparison,) = (c for c in joint.comparisons if c.channel == "dtheta")
    expected = comparison.residual(answers @ values)
    assert np.abs(expected - change).max() < 0.04 * np.abs(change).max()


def test_the_term_is_sought_where_parameters_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """At every step of the parameters, from the residual there."""
    hat = hats_of(0.1, monkeypatch)
    asked: list[Any] = []

    def beside(residual: np.ndarray, case: Any, structure: Any, term: Any) -> Basis:
        asked.append((residual.tolist(), term))
        return replace(hat, grid=replace(hat.grid, level=np.ones(2)))

    monkeypatch.setattr(module, "film_beside", beside)
    monkeypatch.setattr(module, "beside_term", lambda known, case, parameters, term, own: known)
    monkeypatch.setattr(module, "over_time", lambda known, own, here: own)
    there = SimpleNamespace(linearised=lambda *_: (np.arange(4.0), np.zeros((4, 0))), segments=None)
    case: Any = SimpleNamespace(parameters=Parameters.of(TRUTH), model=there)
    term = term_of(hat, np.zeros(2), 1e-9)
    found: Any = module.at_parameters(cast(Any, None), case, cast(Any, None), term)
    assert asked == [([0.0, 1.0, 2.0, 3.0], term)] and found.grid.level.tolist() == [1.0, 1.0]


def hats_of(share: float, monkeypatch: pytest.MonkeyPatch) -> Basis:
    """A film whose answer falls by a share of its level, in the place of that of a run."""
    grid = Grid(np.arange(2.0), np.zeros(2, dtype=int), np.zeros(1), np.zeros(1))

    def hats(case: Any, structure: Any, kind: str, asked: Grid) -> Basis:
        level = np.zeros(2) if asked.level is None else asked.level
        return Basis(kind, "W/(m^2 K)", asked, np.arange(2), np.arange(4), np.repeat(np.diag(1.0 - share * level), 2, axis=0), np.eye(2))

    monkeypatch.setattr(module, "every_hat", hats)
    return hats(None, None, "film", grid)


def test_it_is_sought_until_it_is_what_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """q (1 - q / 10) = 0.9 and 1.6: q = 1 and 2."""
    hat = hats_of(0.1, monkeypatch)
    residual = -np.array([0.9, 0.9, 1.6, 1.6])
    found = film_beside(residual, cast(Any, None), cast(Structure, None), term_of(hat, np.zeros(2), 1e-9))
    assert found.grid.level == pytest.approx([1.0, 2.0], rel=0.02)
    again = about(term_of(hat, np.array([1.0, 2.0]), 1e-9))
    assert again.level is not None and again.level.tolist() == [1.0, 2.0], "the grid of the term says which changes are there"
    assert about(term_of(replace(hat, kind="flux"), np.array([1.0, 2.0]), 1e-9)).level is None


def test_a_film_that_comes_to_no_end_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """q (1 - q / 2) is one half at most."""
    hat = hats_of(0.5, monkeypatch)
    with pytest.raises(NumericsError, match="do not settle"):
        film_beside(-np.full(4, 3.0), cast(Any, None), cast(Structure, None), term_of(hat, np.zeros(2), 1e-9))
