"""The rules of held-out data, one at a time: what convinces, what noise adds, how folds of several records lie, what is never held out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from thermofit.diagnose.held_out import Proof, Rows, Split, compared, groups_of, scatter, split_by_blocks, split_by_phase
from thermofit.diagnose.other_tests import proof_of_change
from thermofit.fit.linear_model import LinearModel

GOOD = Proof(2.0, 1.0, {}, 0.5, 0.01, 5)


@pytest.mark.parametrize(
    ("gain", "sigma", "convinces"),
    [(0.1, 0.049, True), (0.1, 0.051, False), (0.0031, 1e-6, True), (0.0029, 1e-6, False), (-0.5, 0.01, False)],
)
def test_a_gain_convinces_by_two_standard_errors_and_by_what_is_worth_an_effect(gain: float, sigma: float, convinces: bool) -> None:
    assert replace(GOOD, gain=gain, sigma=sigma).convinces is convinces


@pytest.mark.parametrize(("more", "equal"), [(0.049, True), (0.051, False), (-0.2, True)])
def test_gains_are_equal_within_the_errors_of_both(more: float, equal: bool) -> None:
    one, other = replace(GOOD, sigma=0.03), replace(GOOD, gain=0.5 + more, sigma=0.04)
    assert one.not_less_than(other) is equal


def line(n: int, records: int = 1, apart: float = 0.0) -> Rows:
    """Rows of one point at n times of 1 s, the same for every record, which begin so far apart."""
    time = np.concatenate([np.arange(float(n)) + apart * k for k in range(records)])
    return Rows(np.zeros(len(time), dtype=int), time, np.zeros((len(time), 2)), np.repeat(np.arange(records), n))


def of_records(n: int, records: int) -> np.ndarray:
    return np.repeat(np.arange(records), n)


def test_of_equal_records_no_fold_holds_out_the_same_phase_of_all() -> None:
    """Two, three and five equal records: each fold sees every moment in one of them at least."""
    n = 50
    for records in (2, 3, 5):
        split = split_by_blocks(line(n, records), (5, 1), (0.0, 0.0), part=of_records(n, records))
        for held in split.held_out:
            assert held.any() and not held.reshape(records, n).all(axis=0).any()
        assert np.all(sum(held.astype(int) for held in split.held_out) == 1)
    assert f"5 x 1 blocks of time and length of each of {records} tests, 5 folds" in split.by


def test_records_are_dealt_out_alone_however_their_times_lie() -> None:
    """At the same times, and one after the other: the same folds, no block reaches from one into the other."""
    n = 50
    together, after = (split_by_blocks(line(n, 2, apart), (10, 1), (1.5, 0.0), part=of_records(n, 2)) for apart in (0.0, 1000.0))
    for one, other in zip(together.held_out, after.held_out, strict=True):
        assert np.array_equal(one, other)
    for held, near in zip(together.held_out, together.buffer, strict=True):
        for k in range(2):
            own = slice(k * n, (k + 1) * n)
            beside, out = np.flatnonzero(near[own]), np.flatnonzero(held[own])
            assert np.abs(beside[:, None] - out).min(axis=1).max() <= 4, "a buffer is beside a block of its own record"


def test_every_record_has_one_block_for_each_fold_at_least() -> None:
    n = 50
    split = split_by_blocks(line(n, 8), (10, 1), (0.0, 0.0), part=of_records(n, 8))
    assert all(9 <= held[k * n : (k + 1) * n].sum() <= 11 for held in split.held_out for k in range(8))


def test_buffers_of_records_are_shorter_as_their_blocks_are() -> None:
    """They are the same share of a block: 4 s of 9.9 s, whatever time passes between two records."""
    whole = split_by_blocks(line(100), (10, 1), (4.0, 0.0))
    halves = split_by_blocks(line(50, 2, 50.0), (10, 1), (4.0, 0.0), part=of_records(50, 2))
    longer = split_by_blocks(line(50, 2, 1000.0), (10, 1), (4.0, 0.0), part=of_records(50, 2))
    assert "buffers 4 s" in whole.by and "buffers 3.96 s" in halves.by and "buffers 0.374 s" in longer.by


def test_buffers_are_not_seen() -> None:
    """What lies within the buffer of a fold does not move its prediction; what lies beyond does."""
    rows = line(100)
    split = split_by_blocks(rows, (10, 1), (3.0, 0.0))
    held, near = split.held_out[0], split.buffer[0]
    assert 4 <= near.sum() <= 16 and not (near & held).any()
    columns, residual = np.ones((100, 1)), np.zeros(100)
    assert LinearModel(residual + 5.0 * near, columns).predicted(split.folds)[held] == pytest.approx(0.0, abs=1e-12)
    assert np.all(LinearModel(residual + 5.0 * ~(near | held), columns).predicted(split.folds)[held] < -4.9)


def test_phases_have_buffers() -> None:
    rows = replace(line(100), phase=(np.arange(100) >= 50).astype(int))
    split = split_by_phase(rows, ("loading", "cooling"), 3.5)
    assert split is not None
    assert np.flatnonzero(split.buffer[0]).tolist() == [50, 51, 52] and np.flatnonzero(split.buffer[1]).tolist() == [47, 48, 49]


def told_by(inside: float, n: int = 100) -> np.ndarray:
    """Columns of an even parameter and of one of which the third block, rows 19 to 28, tells this part and the others the rest."""
    block = np.zeros(n)
    block[19:29] = np.sqrt(inside / 10.0) * np.array([1.0, -1.0] * 5)
    rest = np.sqrt((1.0 - inside) / 90.0) * np.tile([1.0, -1.0], n // 2)
    return np.stack([np.ones(n), np.where(block == 0.0, rest, block)], axis=1)


@pytest.mark.parametrize(("inside", "kept"), [(1.0, True), (0.82, True), (0.72, False)])
def test_a_block_that_alone_determines_a_parameter_is_never_held_out(inside: float, kept: bool) -> None:
    """A fold sees a fifth of what all rows tell of it at least."""
    rows = line(100)
    split = split_by_blocks(rows, (10, 1), (0.0, 0.0), fitted=told_by(inside))
    never = ~np.any(split.held_out, axis=0)
    assert never.any() == kept and ("blocks never held out, because a parameter rests on them" in split.by) == kept
    if kept:
        assert np.flatnonzero(never).tolist() == list(range(19, 29)) and "1 of 10 blocks never held out" in split.by


def test_what_the_buffer_hides_counts_as_hidden() -> None:
    """Half of a parameter is told on each side of an edge: with either block held out the buffer hides the other half."""
    fitted = np.stack([np.ones(100), np.zeros(100)], axis=1)
    fitted[[27, 28, 29, 30], 1] = 1.0, -1.0, 1.0, -1.0
    rows = line(100)
    bare, buffered = (split_by_blocks(rows, (10, 1), (reach, 0.0), fitted=fitted) for reach in (0.0, 4.0))
    assert np.all(np.any(bare.held_out, axis=0))
    assert np.flatnonzero(~np.any(buffered.held_out, axis=0)).tolist() == list(range(19, 39))


def test_direction_not_column_counts() -> None:
    """Two columns that differ in one block alone: neither is lost with it, but their difference is."""
    fitted = np.stack([np.ones(100), np.ones(100)], axis=1)
    fitted[19:29, 1] = 1.5
    split = split_by_blocks(line(100), (10, 1), (0.0, 0.0), fitted=fitted)
    assert np.flatnonzero(~np.any(split.held_out, axis=0)).tolist() == list(range(19, 29))


def test_blocks_of_time_hold_equal_shares_of_what_rows_tell() -> None:
    """Ten rows tell half of all: they are half of the blocks."""
    weight = np.where(np.arange(110) < 10, 0.05, 0.005)
    split = split_by_blocks(line(110), (10, 1), (0.0, 0.0), weight=weight)
    short = [int(held[:10].sum()) for held in split.held_out]
    assert sum(short) == 10 and min(short) >= 1, "every fold sees and holds out a part of them"


EVEN = np.tile([1.0, -1.0], 300)


def compare_of(noise: Any = None, left: Any = None) -> Proof:
    """A change in a twelfth of the test of which noise of 1 is left: the scatter of the gain is large, that of the noise small."""
    rows = line(600)
    after = EVEN
    return compared(after + np.where(rows.time < 50.0, 2.0, 0.0), after, rows, 5, noise, left)


def test_correlated_noise_makes_a_gain_less_sure() -> None:
    """Variance nine times as large as for independent noise: three times the standard error, 2 sqrt(d.C d) / r.r."""
    plain, nine = compare_of(), compare_of(lambda v: 9.0 * v)
    total = 600 * plain.without
    assert plain.sigma == pytest.approx(2.0 * np.sqrt(50 * 4.0) / total, rel=1e-6) and nine.sigma == pytest.approx(3.0 * plain.sigma)


def test_noise_that_groups_of_rows_show_makes_a_gain_less_sure() -> None:
    """What is left hangs together over a group: that counts, though the noise was said to be independent."""
    found = compare_of(left=3.0 * np.ones(600))
    assert found.sigma > 2.0 * compare_of().sigma


def test_groups_that_agree_by_chance_make_no_gain_surer_than_independent_noise() -> None:
    """The same change everywhere of which the same is left everywhere: the scatter of the gain is nothing."""
    rows = line(600)
    found = compared(np.full(600, 1.1), np.ones(600), rows, 5)
    assert found.sigma == pytest.approx(2.0 * np.sqrt(600 * 0.01) / (600 * 1.21))


def test_the_scatter_of_the_gain_is_the_other_bound() -> None:
    """A change that is the same in every group is sure, however much of its noise would hang together."""
    rows, after = line(600), 0.1 * EVEN
    found = compared(2.0 + after, after, rows, 5, lambda v: 1e6 * v)
    assert found.convinces and found.sigma < 0.05


def test_scatter_counts_groups_as_one_value_each() -> None:
    """Sums 2 and -2 of two groups: 2 / (2 - 1) x 8."""
    assert scatter(np.array([1.0, 1.0, -1.0, -1.0]), np.array([0, 0, 1, 1])) == 16.0
    assert len(np.unique(groups_of(line(600), np.ones(600, dtype=bool)))) == 12


def test_rows_that_no_fold_holds_out_are_not_compared() -> None:
    split = Split((np.arange(10) < 4,), (np.zeros(10, dtype=bool),), "")
    found = LinearModel(np.ones(10), np.zeros((10, 1))).predicted(split.folds)
    assert np.isfinite(found).sum() == 4 and compared(found, 0.5 * found, line(10), 1).gain == pytest.approx(0.75)


class UnseenColumns:
    """A held-out test of 600 rows."""

    noise, name, residual, rows = None, "second", np.zeros(600), line(600)


@pytest.mark.parametrize(
    ("before", "after", "judged"),
    [(1.0, 0.83, True), (1.0, 0.84, False), (10.0, 9.4, True), (10.0, 9.5, False), (1.0, 1.17, True)],
    ids=["falls", "lost in noise", "falls enough", "of no worth", "rises"],
)
def test_a_held_out_test_judges_where_it_feels_the_change(before: float, after: float, judged: bool) -> None:
    """d.d has to be above two standard errors 2 sqrt(d.d) of the noise, which is a change of 4 / sqrt(600) = 0.163 in each of 600 rows, and
    above 0.003 r.r, which is one of 0.0548 times r."""
    one, other = np.full(600, before), np.full(600, after)
    beyond: Any = [UnseenColumns()]
    found = proof_of_change(one, other, beyond)
    assert (found is not None) is judged
    assert found is None or (found.on == "second" and (found.gain > 0.0) is (after < before))
