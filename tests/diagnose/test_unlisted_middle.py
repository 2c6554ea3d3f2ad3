"""The middle of an offset of the infrared camera that grows along the load."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.diagnose.held_out import Rows, Split
from thermofit.diagnose.unlisted_field import Basis, MissingField, field_of, roughness
from thermofit.diagnose.unlisted_middle import about, found_middle, with_middle
from thermofit.experiment.missing import Grid, hats
from thermofit.fit.linear_model import LinearModel

TIME, HEIGHT, NOISE = np.linspace(0.0, 100.0, 21), np.linspace(-30.0, 30.0, 25), 1.0
T, Y = (v.ravel() for v in np.meshgrid(TIME, HEIGHT, indexing="ij"))
FITTED = np.stack([np.ones_like(T), Y / 30.0], axis=1)
"""A level of the whole image, and a slope of it that stays."""


def whitened(grid: Grid) -> Basis:
    """Hats g(t) (y - y_0) of mK/mm, in units of a noise of 10 mK."""
    chosen = np.arange(grid.size)
    columns = hats(grid.time, T) * (Y - grid.y[0])[:, None] / 10.0
    return Basis("gradient", "mK/mm", grid, chosen, np.arange(len(T)), columns, roughness(grid, chosen))


def tilted(middle: float, amount: float = 8.0) -> tuple[LinearModel, Rows, Split]:
    """What a fit leaves of a camera that tilts by `amount` mK/mm over the test about a height."""
    truth = amount * T / 100.0 * (Y - middle) / 10.0
    residual = -truth + NOISE * np.random.default_rng(3).standard_normal(len(T))
    rows = Rows(np.zeros(len(T), dtype=int), T, np.stack([0.0 * Y, Y], axis=1), np.zeros(len(T), dtype=int))
    fifths = tuple(np.arange(len(T)) // 5 % 5 == k for k in range(5))
    return LinearModel(residual, FITTED), rows, Split(fifths, fifths, "fifths")


def settled(model: LinearModel, rows: Rows, split: Split, grid: Grid) -> MissingField:
    """The term where its middle has settled."""
    term = field_of(model, whitened(found_middle(model, whitened, grid, rows, split)), rows, split)
    for _ in range(4):
        term = field_of(model, with_middle(whitened, term), rows, split)
    return term


@pytest.mark.parametrize("middle", [-21.0, 0.0, 7.5])
def test_middle_is_found(middle: float) -> None:
    """Within half a millimetre, and what the camera adds with it; held in the middle of the specimen, more than noise is left of it."""
    model, rows, split = tilted(middle)
    grid = Grid(TIME, np.zeros(len(TIME), dtype=int), np.zeros(1), np.zeros(1))
    first = found_middle(model, whitened, grid, rows, split)
    assert first.y[0] == pytest.approx(middle, abs=2.5)
    term = settled(model, rows, split, grid)
    assert about(term).y[0] == pytest.approx(middle, abs=0.5) and abs(term.q[-1]) < 0.05
    assert np.ptp(term.values) == pytest.approx(8.0, rel=0.1)
    left = float(np.mean(term.residual**2))
    held = float(np.mean(field_of(model, whitened(grid), rows, split).residual ** 2))
    assert left < 1.05 and (middle == 0.0 or held > 1.5)


def test_middle_is_no_farther_than_a_camera_sees() -> None:
    """An offset that is the same everywhere has none: it would lie at infinity."""
    model, rows, split = tilted(1e4, 0.02)
    grid = Grid(TIME, np.zeros(len(TIME), dtype=int), np.zeros(1), np.zeros(1))
    assert found_middle(model, whitened, grid, rows, split).y[0] == pytest.approx(90.0)


def test_what_is_constant_says_nothing_of_the_middle() -> None:
    """A level of the whole image of 30 mK beside a camera that tilts about a height, where no parameter takes it."""
    model, rows, split = tilted(10.0)
    other = LinearModel(model.residual - 3.0, np.sin(7.0 * T)[:, None])
    grid = Grid(TIME, np.zeros(len(TIME), dtype=int), np.zeros(1), np.zeros(1))
    assert found_middle(other, whitened, grid, rows, split).y[0] == pytest.approx(10.0, abs=2.5)
