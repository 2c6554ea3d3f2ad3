"""Buffers beside held-out blocks: shares of time and length, or as far as the noise hangs together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from seen_field import N_T, case_of

from thermofit.diagnose.held_out import Rows, split_by_blocks
from thermofit.diagnose.trace import split_of

SPAN, LENGTH = 120.0, 40.0


def flat(rows: Rows) -> np.ndarray:
    """One parameter that all rows tell alike."""
    return np.ones((len(rows.time), 1))


@pytest.mark.parametrize("together", [0.0, 1.9, 2.0])
def test_noise_that_hangs_together_within_five_per_cent_changes_nothing(together: float) -> None:
    case = replace(case_of(1), correlation_length=together)
    rows, weight = case.rows, np.ones(len(case.rows.time))
    found, plain = split_of(case, rows, flat(rows)), split_by_blocks(rows, (25, 5), (0.01 * SPAN, 0.05 * LENGTH), weight=weight)
    assert found.by == plain.by and found.by.endswith("buffers 1.2 s and 2 mm")
    for one, other in ((found.held_out, plain.held_out), (found.buffer, plain.buffer)):
        assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_no_point_is_seen_whose_noise_hangs_together_with_a_held_out_one() -> None:
    """At the time of a held-out row, and as near as the noise goes."""
    case = replace(case_of(1), correlation_length=5.0)
    rows = case.rows
    split, plain = (split_of(c, rows, flat(rows)) for c in (case, case_of(1)))
    assert split.by.endswith("buffers 1.2 s and 5 mm")
    near = []
    for one in (split, plain):
        held, seen = one.held_out[0], ~(one.held_out[0] | one.buffer[0])
        distance = [
            np.abs(rows.xy[seen & (rows.time == t), 1][:, None] - rows.xy[held & (rows.time == t), 1]) for t in np.unique(rows.time)
        ]
        near.append(min(float(d.min()) for d in distance if d.size))
    assert near[1] < 4.0 < 5.0 < near[0]


def test_the_clock_of_coupons_is_the_sample() -> None:
    case = replace(case_of(1), cheap=True)
    said = split_of(case, case.rows, flat(case.rows)).by
    assert said.endswith(f"buffers {0.01 * (N_T - 1):.3g} samples and 2 mm")
