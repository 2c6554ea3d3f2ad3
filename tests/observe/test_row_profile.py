"""Profiles along the load: integrals against a bump are exact for what a grid can hold, and noise is propagated."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.observe.profile import bump, excess_noise, integrals, profile_of, spans_piece

KNOTS = np.linspace(-20.0, 20.0, 17)
CENTRE, HALF = 1.3, 8.0


def against(field: np.ndarray) -> np.ndarray:
    return integrals(KNOTS, CENTRE, HALF) @ field


def test_a_constant_has_no_slope_and_a_straight_line_no_bend() -> None:
    whole = HALF * 16.0 / 15.0
    assert against(np.ones(17)) == pytest.approx([whole, 0.0, 0.0], abs=1e-4 * whole)
    value, slope, bend = against(KNOTS)
    assert value == pytest.approx(whole * CENTRE, rel=1e-3)
    # int w y' = -int w' y; the weight is even about the centre.
    assert -slope == pytest.approx(whole, rel=1e-3) and bend == pytest.approx(0.0, abs=1e-3 * whole)


def test_a_bend_is_found_without_differentiating() -> None:
    # Straight pieces between knots stand for the parabola: its bend is the limit of a fine grid.
    fine = np.linspace(-20.0, 20.0, 161)
    assert integrals(fine, CENTRE, HALF)[2] @ (0.5 * fine**2) == pytest.approx(HALF * 16.0 / 15.0, rel=2e-3)


def test_the_weight_vanishes_with_its_slope_at_the_rims() -> None:
    s = np.array([-1.0, -0.999999, 0.999999, 1.0, 1.7])
    w, slope, _ = bump(s)
    assert np.abs(w).max() < 1e-11 and np.abs(slope).max() < 1e-5


def test_rows_are_means_over_the_width_of_what_is_measured() -> None:
    x, y = np.meshgrid(np.linspace(-5.0, 5.0, 4), np.linspace(-9.0, 9.0, 7))
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    mask = np.ones((3, len(xy)), dtype=bool)
    mask[1, :2], mask[2, :4] = False, False
    made = profile_of(xy, mask)
    assert np.allclose(made.y, np.linspace(-9.0, 9.0, 7))
    field = np.where(mask, xy[:, 0] + 10.0 * xy[:, 1], np.nan)
    assert np.allclose(made.mean(field)[0], 10.0 * made.y)
    assert made.mean(field)[1, 0] == pytest.approx(xy[2:4, 0].mean() - 90.0) and made.count[2, 0] == 0
    sigma = made.sigma(np.full(mask.shape, 0.4))
    assert sigma[0, 0] == pytest.approx(0.2) and sigma[1, 0] == pytest.approx(0.4 / np.sqrt(2.0))


def test_scattered_points_are_put_in_bands() -> None:
    xy = np.random.default_rng(2).uniform(-10.0, 10.0, size=(400, 2))
    made = profile_of(xy, np.ones((1, 400), dtype=bool))
    assert 10 < len(made.y) < 60 and np.all(np.diff(made.y) > 0.0) and made.count.sum() == 400


def test_a_piece_with_a_gap_is_not_spanned() -> None:
    assert spans_piece(KNOTS, 0.0, 8.0, 5.0)
    assert not spans_piece(KNOTS[np.abs(KNOTS) > 6.0], 0.0, 8.0, 5.0)
    assert not spans_piece(KNOTS[KNOTS < 4.0], 0.0, 8.0, 5.0)


@pytest.mark.parametrize("factor", [1.0, 1.6])
def test_noise_that_neighbours_share_is_measured_in_time(factor: float) -> None:
    rng = np.random.default_rng(4)
    time = np.cumsum(rng.uniform(0.5, 2.0, 80))
    smooth = 5.0 * np.sin(time / 40.0)[:, None] * np.ones(12)
    value = smooth + factor * rng.normal(size=(80, 12))
    found = excess_noise(value, np.ones((80, 12)), time, np.ones((80, 12), dtype=bool))
    assert found == (1.0 if factor == 1.0 else pytest.approx(factor, rel=0.15))
