"""Blocks for the bootstrap: as long as the memory of the residual, in time and in space."""

from __future__ import annotations

import numpy as np
import pytest
from made_up import XY, wall_model, wall_observations

from thermofit.experiment.model import StageModel
from thermofit.identify.blocks import LONGER, correlation_time, residual_blocks
from thermofit.observe.comparison import plain
from thermofit.observe.observation import FieldObservation


def records(n: int, lengths: tuple[int, ...], memory: float) -> tuple[StageModel, np.ndarray]:
    """A model of records whose residual is alike from sample to sample by the factor `memory`."""
    r = np.random.default_rng(2).normal(size=n)
    for k in range(1, n):
        r[k] = memory * r[k - 1] + np.sqrt(1.0 - memory**2) * r[k]
    return StageModel(lambda p: {}, (), {}, "", segments=lengths), r


def test_white_records_are_blocks_of_few_samples() -> None:
    model, r = records(1000, (600, 400), 0.0)
    blocks = residual_blocks(model, r)
    assert len(blocks.label) == 1000 and blocks.count > 200
    assert blocks.label[599] != blocks.label[600], "no block spans two records"


def test_memory_makes_blocks_longer() -> None:
    model, r = records(3000, (3000,), 0.9)
    blocks = residual_blocks(model, r)
    size = 3000 / blocks.count
    # Correlation time of this noise: (1 + 0.9)/(1 - 0.9) = 19 samples.
    assert size == pytest.approx(LONGER * 19.0, rel=0.4)


def test_correlation_time() -> None:
    assert correlation_time(np.array([1.0])) == 1.0
    assert correlation_time(np.array([1.0, 0.5, 0.25])) == pytest.approx(2.5)


def field(smooth: bool) -> tuple[StageModel, np.ndarray]:
    """A fine field of one component at 40 times; `smooth`: alike over some 6 mm."""
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(np.linspace(-10.0, 10.0, 21), np.linspace(-20.0, 20.0, 41))
    value = rng.normal(size=(40, *x.shape))
    if smooth:
        from scipy.ndimage import gaussian_filter

        value = gaussian_filter(value, (0.0, 2.0, 2.0))
    value = (value / value.std()).reshape(40, -1, 1)
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    observation = FieldObservation("theta", np.arange(40.0), xy, value, np.ones_like(value), np.ones(value.shape[:2], dtype=bool), "K")
    comparison = plain(observation)
    return StageModel(lambda p: {}, (comparison,), {"theta": observation}, ""), comparison.residual(value)


def test_field_alike_over_some_millimetres_has_larger_tiles() -> None:
    white, alike = (residual_blocks(*field(smooth)) for smooth in (False, True))
    n = 40 * 21 * 41
    assert n / white.count < 20.0
    assert n / alike.count > 10.0 * n / white.count
    assert alike.count >= 12


def test_offsets_of_points_span_all_times() -> None:
    """An error that each point keeps for good (a reference frame) makes blocks of all times."""
    model, r = field(False)
    rows = model.comparisons[0].rows
    kept = r + 3.0 * np.random.default_rng(3).normal(size=21 * 41)[rows[:, 1]]
    blocks = residual_blocks(model, kept)
    assert "40 times" in blocks.remark and blocks.count < 900


def test_priors_are_blocks_of_their_own() -> None:
    observations = wall_observations()
    model = wall_model((plain(observations["u"]), plain(observations["theta"])), observations)
    n = sum(c.n for c in model.comparisons)
    blocks = residual_blocks(model, np.random.default_rng(0).normal(size=n + 2))
    assert blocks.count > 2 and len(XY) == 25
    assert np.count_nonzero(blocks.label == blocks.label[-1]) == 1 and blocks.label[-1] != blocks.label[-2]
