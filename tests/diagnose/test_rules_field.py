"""The rules of a missing term, one at a time: how smooth it is, who says so, what it may not see, how sure it is, what it goes with."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from virtual_pulls import TRUTH, model, study

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case
from thermofit.diagnose.held_out import Rows, Split
from thermofit.diagnose.unlisted import basis
from thermofit.diagnose.unlisted_field import SIZE, Basis, MissingField, field_of, roughness
from thermofit.diagnose.unlisted_hints import hints
from thermofit.diagnose.unlisted_structure import shared_part
from thermofit.experiment.missing import KINDS, Grid, time_hats
from thermofit.fit.linear_model import LinearModel

N, KNOTS = 240, 12
TIME = np.linspace(0.0, 120.0, N)
GRID = Grid(np.linspace(0.0, 120.0, KNOTS), np.zeros(KNOTS, dtype=int), np.zeros(1), np.zeros(1))
HATS = time_hats(GRID, TIME, np.zeros(N, dtype=int))
FITTED = 50.0 * np.sin(3.0 * TIME)[:, None]
"""Column of one fitted parameter, far longer than one."""
ROWS = Rows(np.zeros(N, dtype=int), TIME, np.zeros((N, 2)), np.zeros(N, dtype=int))


def basis_of(grid: Grid = GRID) -> Basis:
    return Basis("stress", "MPa", grid, np.arange(KNOTS), np.arange(N), HATS, roughness(grid, np.arange(KNOTS)))


def folds(count: int = 5) -> Split:
    """Blocks of a sixtieth of the time in turn."""
    block = (np.arange(N) // 4) % count
    return Split(tuple(block == k for k in range(count)), (np.zeros(N, dtype=bool),) * count, "")


def found_in(residual: np.ndarray, split: Split | None = None) -> MissingField:
    return field_of(LinearModel(residual, FITTED), basis_of(), ROWS, split or folds())


def test_roughness_is_the_squared_difference_of_neighbours_of_one_record() -> None:
    """Two records of two hats; then only those that are chosen, and a little of q itself."""
    grid = Grid(np.arange(4.0), np.array([0, 0, 1, 1]), np.zeros(1), np.zeros(1))
    pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
    assert roughness(grid, np.arange(4), 0.0) == pytest.approx(np.kron(np.eye(2), pair))
    assert roughness(grid, np.array([0, 2, 3]), 0.5) == pytest.approx(np.diag([0.5, 0.5, 0.5]) + np.pad(pair, ((1, 0), (1, 0))))
    from_rest = np.kron(np.eye(2), pair) + np.diag([1.0, 0.0, 0.0, 0.0])
    assert roughness(grid, np.arange(4), from_nothing=True) == pytest.approx(from_rest), "nothing at first, and any level later"
    face = Grid(np.zeros(1), np.zeros(1, dtype=int), np.arange(2.0), np.arange(2.0))
    square = 2.0 * np.eye(4) - np.kron(np.eye(2), [[0.0, 1.0], [1.0, 0.0]]) - np.kron([[0.0, 1.0], [1.0, 0.0]], np.eye(2))
    assert roughness(face, np.arange(4), 0.0) == pytest.approx(square), "and of neighbours in x and y"


@pytest.mark.parametrize(("kind", "rests"), [("scale", True), ("strain", True), ("displacement", False)])
def test_displacement_cameras_drift_from_the_rest(kind: str, rests: bool) -> None:
    """Displacements are told from the rest, where there is no error of theirs; later nothing holds the level of one. It shows in the
    temperatures too, whose rows stand behind and prove nothing."""
    joint = model(study())
    case = Case(joint, Parameters.of(TRUTH), (), (), frozenset())
    assert joint.missing is not None
    grid = joint.missing.grid(kind, (6, 1, 1))
    hats = np.arange(grid.size)
    found = basis(case, cast(Any, SimpleNamespace(blocks=SimpleNamespace(channel="du"))), kind, grid, hats)
    assert np.allclose(found.rough, roughness(grid, hats, from_nothing=rests)) and KINDS[kind].from_rest is rests
    n_u, n_theta = (c.n for c in joint.comparisons)
    assert len(found.own) == n_u and len(found.rows) == (n_u + n_theta if rests else n_u)
    assert found.columns.shape == (len(found.rows), grid.size)


def test_a_term_and_the_step_of_the_fitted_parameters_are_found_together() -> None:
    """What is missing has the other sign than the residual; the step is one of the parameter, however long its column."""
    q = np.where(np.arange(KNOTS) % 3 == 0, 40.0, -20.0)
    noise = np.random.default_rng(2).normal(size=N)
    found = found_in(noise - HATS @ q - 0.7 * FITTED[:, 0])
    assert found.q == pytest.approx(q, abs=2.0) and found.step == pytest.approx([0.7], abs=0.01)
    assert np.std(found.residual) == pytest.approx(1.0, abs=0.1) and found.proof.gain > 0.95


def test_held_out_data_say_how_smooth_a_term_is() -> None:
    """Noise alone asks for the smoothest, a large zigzag for none."""
    unit = float(np.trace(HATS.T @ HATS) / np.trace(basis_of().rough))
    noise = np.random.default_rng(3).normal(size=N)
    zigzag = HATS @ np.where(np.arange(KNOTS) % 2 == 0, 200.0, -200.0)
    assert found_in(noise).weight > 10.0 * unit and found_in(noise + zigzag).weight < 1e-3 * unit
    assert found_in(noise).proof.gain < 0.02


def test_rows_in_a_buffer_tell_nothing_of_those_held_out() -> None:
    held, near = (TIME > 50.0) & (TIME < 60.0), (np.abs(TIME - 55.0) < 8.0) & ~((TIME > 50.0) & (TIME < 60.0))
    split, residual = Split((held,), (near,), ""), np.random.default_rng(4).normal(size=N)
    one, other = found_in(residual, split), found_in(residual + 1e3 * near, split)
    assert one.after[held] == pytest.approx(other.after[held], rel=1e-6) and one.before[held] == pytest.approx(other.before[held])
    assert np.isnan(one.after[~held]).all()


def test_the_standard_error_is_that_of_the_noise_through_the_smoothing() -> None:
    """A^-1 G A^-1 with A = G + lambda R: less than the error A^-1 that a prior of that roughness would have."""
    found = found_in(np.random.default_rng(5).normal(size=N))
    both = np.hstack([FITTED, HATS])
    gram = both.T @ both
    whole = gram.copy()
    whole[1:, 1:] += found.weight * basis_of().rough
    inverse = np.linalg.inv(whole)
    assert found.covariance == pytest.approx((inverse @ gram @ inverse)[1:, 1:], rel=1e-4)
    assert SIZE > 0.0 and found.sigma.shape == (KNOTS, 1, 1, 1)


def states() -> dict[str, np.ndarray]:
    """Five variables of which none goes with another."""
    time = np.linspace(0.0, 1.0, 240)[:, None]
    return {f"v{k}": np.sin(2.0 * np.pi * 7.0 * (k + 3) * time) * np.ones((1, 4)) for k in range(5)}


@pytest.mark.parametrize(("square", "often"), [(0.008, False), (0.05, True)])
def test_a_variable_is_a_hint_from_two_hundredths_of_the_term_on(square: float, often: bool) -> None:
    own, time = states(), np.linspace(0.0, 100.0, 240)
    term = np.sqrt(1.0 - square) * own["v0"] - np.sqrt(square) * own["v1"]
    found = {h.variable: h for h in hints(term, own, time, ())}
    assert found["v0"].frequency == 1.0 and found["v0"].sign == 1
    frequency = found["v1"].frequency if "v1" in found else 0.0
    assert (frequency > 0.95) if often else (frequency < 0.05)
    assert not often or found["v1"].sign == -1


def test_at_most_three_variables_are_taken_from_each_half() -> None:
    own = states()
    term = sum(v for v in own.values())
    found = hints(np.asarray(term), own, np.linspace(0.0, 100.0, 240), ())
    assert sum(h.frequency for h in found) == pytest.approx(3.0)


def test_what_the_noise_of_the_reference_has_in_common_is_no_structure() -> None:
    """Rows that err together with correlation 0.25 in a block of four: 0.25 x 3 more; of displacements nothing."""

    def noise(v: np.ndarray) -> np.ndarray:
        return np.asarray(0.75 * v + 0.25 * v.sum(axis=0))

    block, count = np.repeat([0, 1], 4), np.full(2, 4.0)
    for channel, expected in (("dtheta", 0.75), ("dtheta@second", 0.75), ("du", 0.0)):
        case: Any = SimpleNamespace(model=SimpleNamespace(comparisons=(SimpleNamespace(channel=channel, noise=noise, n=8),)))
        assert shared_part(case, np.arange(8), block, count, np.ones(8)) == pytest.approx([expected] * 2)
