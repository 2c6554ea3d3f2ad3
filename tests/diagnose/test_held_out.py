"""Held-out proof: folds, buffers, and what the proof says where an effect is there and where it is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from thermofit.diagnose.held_out import (
    Proof,
    Rows,
    Split,
    compared,
    groups_of,
    proof,
    rms_with_error,
    split_by_blocks,
    split_by_phase,
)
from thermofit.fit.linear_model import LinearModel

N_T, N_S = 60, 50


def free(n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.full(n, -np.inf), np.full(n, np.inf)


def rows() -> Rows:
    t, s = np.meshgrid(np.linspace(0.0, 100.0, N_T), np.arange(N_S), indexing="ij")
    xy = np.stack([s.ravel() % 5, s.ravel() // 5], axis=1).astype(float)
    time = t.ravel()
    return Rows(np.zeros(len(time), dtype=int), time, xy, (time > 60.0).astype(int))


def test_blocks_hold_out_every_row_once_with_a_buffer_around() -> None:
    here = rows()
    split = split_by_blocks(here, (10, 5), (2.0, 0.6))
    assert np.all(sum(h.astype(int) for h in split.held_out) == 1)
    for held, near in zip(split.held_out, split.buffer, strict=True):
        assert not np.any(held & near) and near.any()
        seen = ~(held | near)
        for k in np.flatnonzero(held)[::97]:
            close = (np.abs(here.time[seen] - here.time[k]) < 1.0) & (np.abs(here.xy[seen, 1] - here.xy[k, 1]) < 0.3)
            assert not close.any()


def test_phases_are_folds_and_one_phase_is_none() -> None:
    here = rows()
    split = split_by_phase(here, ("loading", "cooling"), 3.0)
    assert split is not None and len(split.held_out) == 2 and "cooling" in split.by
    assert not np.any(split.held_out[0] & split.held_out[1])
    assert split_by_phase(Rows(here.channel, here.time, here.xy, np.zeros(len(here.time), dtype=int)), ("loading",), 3.0) is None


def test_held_out_residual_is_that_of_a_fit_to_the_other_rows() -> None:
    random, here = np.random.default_rng(1), rows()
    split = split_by_blocks(here, (5, 2), (2.0, 0.6))
    columns, residual = random.normal(size=(len(here.time), 3)), random.normal(size=len(here.time))
    found = LinearModel(residual, columns).predicted(split.folds)
    held, seen = split.held_out[0], ~(split.held_out[0] | split.buffer[0])
    step = np.linalg.lstsq(columns[seen], -residual[seen], rcond=None)[0]
    assert found[held] == pytest.approx(residual[held] + columns[held] @ step, abs=1e-10)


@pytest.mark.parametrize("size", [0.0, 0.3])
def test_an_effect_is_proved_only_where_it_is(size: float) -> None:
    here = rows()
    split = split_by_blocks(here, (10, 5), (2.0, 0.6))
    fitted = np.stack([np.ones(len(here.time)), here.time / 100.0], axis=1)
    effect = np.sin(here.time / 9.0)[:, None]
    gains = []
    for seed in range(20):
        random = np.random.default_rng(seed)
        residual = random.normal(size=len(here.time)) - size * effect[:, 0]
        found = proof(LinearModel(residual, fitted, bounds=free(2)), effect, free(1), here, split)
        gains.append((found.gain, found.sigma))
        assert found.folds == 5 and found.by_channel[0][0] == pytest.approx(found.without)
    sure = np.mean([gain > 2.0 * sigma for gain, sigma in gains])
    assert sure > 0.95 if size else sure < 0.15
    if size:
        assert np.mean([g for g, _ in gains]) == pytest.approx(0.5 * size**2 / (1.0 + 0.5 * size**2), rel=0.2)


def test_the_standard_error_is_that_of_the_gain_over_repeats() -> None:
    """An effect that the fitted parameters nearly take up, predicted imperfectly in every fold, at three times what can be detected."""
    here = rows()
    split = split_by_blocks(here, (10, 5), (2.0, 0.6))
    t = here.time / 100.0
    fitted = np.stack([np.ones(len(t)), t, t**2, np.sin(7.0 * t)], axis=1)
    effect = np.exp(-3.0 * t)[:, None]
    beyond = effect - fitted @ np.linalg.lstsq(fitted, effect, rcond=None)[0]
    size, gains = 8.0 / float(np.linalg.norm(beyond)), []
    for seed in range(200):
        residual = np.random.default_rng(seed).normal(size=len(t)) - size * effect[:, 0]
        found = proof(LinearModel(residual, fitted, bounds=free(4)), effect, free(1), here, split)
        gains.append((found.gain, found.sigma))
    gain, sigma = np.array(gains).T
    assert 0.8 < sigma.mean() / gain.std() < 1.25, (sigma.mean(), gain.std())
    assert np.mean(gain > 2.0 * sigma) > 0.95


def test_a_parameter_stays_within_its_room_and_the_others_step_anew() -> None:
    """As a bounded least squares of the rows that are seen."""
    random, here = np.random.default_rng(7), rows()
    split = split_by_blocks(here, (5, 2), (2.0, 0.6))
    columns = random.normal(size=(len(here.time), 3)) @ np.array([[1.0, 0.4, 0.0], [0.0, 1.0, 0.3], [0.0, 0.0, 1.0]])
    residual = random.normal(size=len(here.time)) - columns @ [0.5, -0.2, 0.1]
    room = (np.array([-1.0, -0.05, -1.0]), np.array([0.2, 1.0, 1.0]))
    found = LinearModel(residual, columns, bounds=room).predicted(split.folds)
    held, seen = split.held_out[1], ~(split.held_out[1] | split.buffer[1])
    expected = lsq_linear(columns[seen], -residual[seen], bounds=room, tol=1e-14).x
    assert found[held] == pytest.approx(residual[held] + columns[held] @ expected, abs=1e-6)


def test_standard_error_of_a_gain_is_the_smaller_of_its_bounds() -> None:
    """Where structure stays, the scatter between groups; where the effect shows in one place alone, the noise."""
    here, random = rows(), np.random.default_rng(3)
    noise = random.normal(size=len(here.time))
    even = compared(noise + 3.0, noise + 1.0, here, 5)
    assert even.gain == pytest.approx(0.8, abs=0.02) and even.sigma < 0.03
    begin = here.time < 100.0 / 12.0
    change = np.where(begin, -3.0, 0.0)
    uneven = compared(noise - change, noise, here, 5)
    expected = 2.0 * float(np.sqrt(change @ change)) / float(np.sum((noise - change) ** 2))
    assert uneven.sigma == pytest.approx(expected, rel=0.4)


@pytest.mark.parametrize("together", [False, True], ids=["white", "one value per group"])
def test_the_standard_error_of_an_rms_is_its_scatter_over_repeats(together: bool) -> None:
    """Of n independent values 1 / sqrt(2 n); of groups that err as one as many values as there are groups."""
    here = rows()
    every = np.ones(len(here.time), dtype=bool)
    groups = groups_of(here, every)
    n, found = int(groups.max()) + 1 if together else len(groups), []
    for seed in range(300):
        random = np.random.default_rng(seed)
        found.append(rms_with_error(3.0 * (random.normal(size=n)[groups] if together else random.normal(size=n)), here, every))
    rms, sigma = np.array(found).T
    assert rms.std() == pytest.approx(3.0 / np.sqrt(2.0 * n), rel=0.12)
    assert sigma.mean() == pytest.approx(rms.std(), rel=0.12)


def test_an_rms_of_one_group_has_no_standard_error() -> None:
    here = rows()
    first = (here.time == 0.0) & (here.xy[:, 1] == 0.0)
    rms, sigma = rms_with_error(np.ones(len(here.time)), here, first)
    assert rms == 1.0 and np.isnan(sigma)


def test_a_proof_says_whether_the_error_falls_or_rises() -> None:
    said = {gain: Proof(1.0, 1.0 - gain, {}, gain, 0.01, 5, "second").words for gain in (0.2, -0.2, -9.0)}
    assert said[0.2] == "held-out error on second falls by 20.00 % +- 1.00 %"
    assert said[-0.2] == "held-out error on second rises by 20.00 % +- 1.00 %"
    assert said[-9.0] == "held-out error on second rises to 10 times as much"


def test_an_effect_of_one_phase_is_told_by_blocks_of_it_and_not_by_the_other_phases() -> None:
    """Why blocks are the default: held out whole, the phase is predicted as well without the effect."""
    here = rows()
    fitted = np.stack([np.ones(len(here.time)), here.time / 100.0], axis=1)
    effect = np.where(here.phase == 1, np.sin(here.time / 5.0), 0.0)[:, None]
    residual = 0.6 * effect[:, 0] + np.random.default_rng(5).normal(size=len(here.time))
    blocks, phases = split_by_blocks(here, (10, 5), (2.0, 0.6)), split_by_phase(here, ("loading", "cooling"), 3.0)
    assert phases is not None

    def error(split: Split, columns: np.ndarray) -> float:
        """Held-out mean square in the phase in which the effect acts."""
        return float(np.mean(LinearModel(residual, columns).predicted(split.folds)[here.phase == 1] ** 2))

    both = np.hstack([fitted, effect])
    assert proof(LinearModel(residual, fitted, bounds=free(2)), effect, free(1), here, blocks).convinces
    assert error(blocks, both) < 0.9 * error(blocks, fitted)
    assert error(phases, both) == pytest.approx(error(phases, fitted), rel=1e-9)
