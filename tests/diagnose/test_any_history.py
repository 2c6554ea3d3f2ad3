"""Parameters beside a history that nobody knows: hidden frames judge by the smoothest one, the likeliest one is told."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.diagnose.held_out import Rows
from thermofit.diagnose.unlisted import over_time
from thermofit.diagnose.unlisted_field import Basis, field_of, roughness
from thermofit.experiment.missing import Grid, hats
from thermofit.fit.linear_model import LinearModel

FRAMES, POINTS, KNOTS, DRAWS = 150, 4, 75, 40
TIME = np.linspace(0.0, 1.0, FRAMES)
GRID = Grid(np.linspace(0.0, 1.0, KNOTS), np.zeros(KNOTS, dtype=int), np.zeros(1), np.zeros(1))
ACROSS = np.linspace(-1.0, 1.0, POINTS)


def over(history: np.ndarray, shape: np.ndarray) -> np.ndarray:
    return np.outer(history, shape).ravel()


COLUMNS = 50.0 * np.stack(
    [
        over(TIME, 1.0 + 0.3 * ACROSS),
        over(1.0 - np.exp(-4.0 * TIME), 1.0 - 0.2 * ACROSS),
        over(np.sin(3.0 * TIME), 1.0 + 0.1 * ACROSS**2),
    ],
    axis=1,
)
"""What three parameters do, nearly the same at all points: between points they are told beside any history."""
ROWS = Rows(
    np.zeros(FRAMES * POINTS, dtype=int),
    np.repeat(TIME, POINTS),
    np.zeros((FRAMES * POINTS, 2)),
    np.zeros(FRAMES * POINTS, dtype=int),
)
FOLDS = [(held, held) for held in (np.repeat(np.floor(15.0 * TIME).astype(int) % 5 == k, POINTS) for k in range(5))]
HERE: Any = SimpleNamespace(rows=ROWS, split=SimpleNamespace(folds=FOLDS, held_out=[held for held, _ in FOLDS]))
HAT = Basis(
    "jaws",
    "K",
    GRID,
    np.arange(KNOTS),
    np.arange(FRAMES * POINTS),
    np.repeat(hats(GRID.time, TIME), POINTS, axis=0),
    roughness(GRID, np.arange(KNOTS)),
)


def history(kind: str, random: np.random.Generator) -> np.ndarray:
    if kind == "wanders":
        return 1.2 * np.cumsum(random.normal(size=FRAMES))
    return {"oscillates": 3.0 * np.sin(16.0 * np.pi * TIME), "warms up": 4.0 * TIME**2}[kind]


def off_by(kind: str) -> dict[str, np.ndarray]:
    """Error of the parameters (3,) over its standard error, rms of many draws, beside the history that is told and the smoothest one."""
    off: dict[str, list[np.ndarray]] = {"told": [], "smoothest": []}
    for seed in range(DRAWS):
        random = np.random.default_rng(seed)
        seen = LinearModel(random.normal(size=FRAMES * POINTS) + np.repeat(history(kind, random), POINTS), COLUMNS)
        told, smoothest = over_time(seen, HAT, HERE), field_of(seen, HAT, ROWS, HERE.split)
        assert told.proof == smoothest.proof and np.array_equal(told.after, smoothest.after), "hidden frames judge by the smoothest"
        for name, term in (("told", told), ("smoothest", smoothest)):
            off[name].append(term.step / term.uncertainty)
    return {name: np.sqrt(np.mean(np.square(values), axis=0)) for name, values in off.items()}


@pytest.mark.parametrize("kind", ["oscillates", "wanders"])
def test_the_likeliest_history_leaves_the_parameters_alone(kind: str) -> None:
    """The one that predicts hidden frames best is too smooth for one that wanders; what is left of it drives the parameters off."""
    rms = off_by(kind)
    assert np.all((0.6 < rms["told"]) & (rms["told"] < 1.7)), rms
    assert kind == "oscillates" or rms["smoothest"].max() > 2.5, rms


def test_one_that_warms_up_is_smoother_than_that() -> None:
    """A limit, as docs/diagnosis.md says: steps that all go one way are not independent, and parameters that look like them take a part."""
    assert off_by("warms up")["told"].max() > 5.0
