"""A missing term over time as a few steps: which, how many, how sure, and hats where it is smooth."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.diagnose.held_out import Rows, Split
from thermofit.diagnose.unlisted_field import Basis, believed, field_of, moves_beside, roughness
from thermofit.diagnose.unlisted_steps import better, in_steps
from thermofit.experiment.missing import Grid, time_hats
from thermofit.fit.linear_model import LinearModel

N, KNOTS = 600, 61
TIME = np.linspace(0.0, 120.0, N)
GRID = Grid(np.linspace(0.0, 120.0, KNOTS), np.zeros(KNOTS, dtype=int), np.zeros(1), np.zeros(1))
HATS = time_hats(GRID, TIME, np.zeros(N, dtype=int))
WARMED = np.cumsum(HATS, axis=0) * (TIME[1] - TIME[0])
"""What a heat over time makes of a temperature that keeps it."""
FITTED = np.stack([TIME / 10.0, np.exp(-TIME / 40.0)], axis=1)
ROWS = Rows(np.zeros(N, dtype=int), TIME, np.zeros((N, 2)), np.zeros(N, dtype=int))
FOLD = (np.arange(N) // 20) % 5
SPLIT = Split(tuple(FOLD == k for k in range(5)), (np.zeros(N, dtype=bool),) * 5, "")
BASIS = Basis("heat", "mW/mm^3", GRID, np.arange(KNOTS), np.arange(N), WARMED, roughness(GRID, np.arange(KNOTS)))


def lit(begin: float, end: float, amount: float) -> np.ndarray:
    """A heat (61,) that is on between two times."""
    return amount * ((GRID.time >= begin) & (GRID.time < end))


def planted(heat: np.ndarray, seed: int = 0) -> LinearModel:
    """The residual with a heat in it that the model lacks, and two fitted parameters that are off by 2 and -3."""
    noise = np.random.default_rng(seed).normal(size=N)
    return LinearModel(noise - WARMED @ heat - FITTED @ np.array([2.0, -3.0]), FITTED)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_switched_on_and_off_is_two_steps(seed: int) -> None:
    """At the knots between which it was, and parameters come back within three standard errors, where beside hats they do not as surely."""
    known = planted(lit(30.0, 80.0, 0.8), seed)
    found = in_steps(known, BASIS, ROWS, SPLIT)
    assert found is not None and [t for t, _ in found.steps] == pytest.approx([29.0, 79.0], abs=0.5)
    assert [a for _, a in found.steps] == pytest.approx([0.8, -0.8], abs=0.05)
    assert np.cumsum(found.q)[-1] == pytest.approx(25 * 0.8, abs=0.5), "coefficients are those of the hats"
    assert np.abs(np.delete(found.q - lit(30.0, 80.0, 0.8), [14, 15, 16, 39, 40, 41])).max() < 0.05
    assert np.abs((found.step - [2.0, -3.0]) / found.uncertainty).max() < 3.0
    smooth = field_of(known, BASIS, ROWS, SPLIT)
    assert (found.uncertainty < 0.7 * smooth.uncertainty).all() and not better(found, smooth, ROWS, SPLIT)
    assert found.sigma[:, 0, 0, 0] == pytest.approx(np.sqrt(np.diag(found.covariance))), "and so are their standard errors"


def test_a_history_that_is_smooth_asks_for_hats() -> None:
    """More steps than there are at most would be needed."""
    known = planted(4.0 * np.sin(2.0 * np.pi * GRID.time / 17.0))
    found = in_steps(known, BASIS, ROWS, SPLIT)
    assert found is not None and better(found, field_of(known, BASIS, ROWS, SPLIT), ROWS, SPLIT)


def test_noise_asks_for_one_step_and_no_step_for_nothing() -> None:
    found = in_steps(planted(np.zeros(KNOTS)), BASIS, ROWS, SPLIT)
    assert found is not None and len(found.steps) == 1 and not believed(found)
    nothing = Basis("heat", "mW/mm^3", GRID, np.arange(KNOTS), np.arange(N), np.zeros((N, KNOTS)), BASIS.rough)
    assert in_steps(planted(np.zeros(KNOTS)), nothing, ROWS, SPLIT) is None


def test_a_step_that_was_taken_first_is_sought_again_beside_the_others() -> None:
    """The best single step for two pulses of either sign lies at neither of their ends."""
    heat = lit(20.0, 30.0, 1.5) + lit(70.0, 90.0, -1.0)
    found = in_steps(planted(heat), BASIS, ROWS, SPLIT)
    assert found is not None and [t for t, _ in found.steps] == pytest.approx([19.0, 29.0, 69.0, 89.0], abs=0.8)


def test_a_step_may_lie_between_two_knots() -> None:
    """Half of the way from 29 to 31 s, where the steps of the knots are, and from 77 to 79 s."""
    fine = np.linspace(0.0, 120.0, 2401)
    kept = np.interp(TIME, fine, np.cumsum(0.8 * ((fine >= 30.0) & (fine < 78.0))) * (fine[1] - fine[0]))
    noise = np.random.default_rng(7).normal(size=N)
    found = in_steps(LinearModel(noise - kept - FITTED @ np.array([2.0, -3.0]), FITTED), BASIS, ROWS, SPLIT)
    assert found is not None and [t for t, _ in found.steps] == pytest.approx([30.0, 78.0], abs=0.6)


def test_errors_of_the_residual_move_parameters_as_beside_the_steps() -> None:
    """Not as beside the hats, which would take up an error that no two steps can."""
    known = planted(lit(30.0, 80.0, 0.8))
    found = in_steps(known, BASIS, ROWS, SPLIT)
    assert found is not None and found.solved is not None
    error = np.sin(TIME / 5.0)[:, None]
    moved = moves_beside(known, found, error)[:, 0]
    columns = np.concatenate([FITTED, found.solved.columns], axis=1)
    assert moved == pytest.approx(-np.linalg.lstsq(columns, error[:, 0], rcond=None)[0][:2], rel=5e-3)
