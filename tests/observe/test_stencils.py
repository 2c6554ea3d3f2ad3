"""Differences, gradients and strains on grids and on points that lie anywhere: exact for linear fields, blind to rigid motion."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.core.errors import DataError
from thermofit.observe.comparison import RelativeScheme, neighbour_differences
from thermofit.observe.observation import FieldObservation
from thermofit.observe.selection import inside, masked
from thermofit.observe.stencils import differences, neighbours
from thermofit.observe.strain import StrainScheme, strains
from thermofit.study.stages import Region

X, Y = np.meshgrid(np.linspace(-10.0, 10.0, 7), np.linspace(-20.0, 20.0, 11))
GRID = np.stack([X.ravel(), Y.ravel()], axis=1)
SCATTERED = np.random.default_rng(2).uniform([-10.0, -20.0], [10.0, 20.0], size=(150, 2))
TIME = np.arange(3.0)
SPIN = np.array([[0.0, -1.0], [1.0, 0.0]])
SLOPE = np.array([[-0.004, 0.003], [0.001, 0.012]])
POINTS = pytest.mark.parametrize("xy", [GRID, SCATTERED], ids=["grid", "scattered"])


def observation(xy: np.ndarray, slope: np.ndarray = SLOPE, sigma: float = 1e-3) -> FieldObservation:
    value = TIME[:, None, None] * (xy @ slope.T)
    return FieldObservation("u", TIME, xy, value, np.full(value.shape, sigma), np.ones(value.shape[:2], dtype=bool), "mm")


@POINTS
def test_gradients_of_a_linear_field_are_exact_and_blind_to_translation_and_rotation(xy: np.ndarray) -> None:
    stencil = differences(xy, ("xx", "yy", "xy"), gradient=True)
    counts = np.bincount(stencil.kind)
    assert counts.min() >= (60 if xy is GRID else 75), counts
    # What is straight within 2 % of the distance counts as straight: a field that is not that of a strain leaks by as much.
    found = -stencil.at((xy @ SLOPE.T)[None])[0]
    expected = np.array([SLOPE[0, 0], SLOPE[1, 1], 0.5 * (SLOPE[0, 1] + SLOPE[1, 0])])[stencil.kind]
    np.testing.assert_allclose(found, expected, atol=1e-12 if xy is GRID else 0.02 * np.abs(SLOPE).max())
    moved = stencil.at((1.0 + 0.01 * xy @ SPIN.T)[None])[0]
    assert np.abs(moved).max() < (1e-12 if xy is GRID else 0.02 * 0.01 + 1e-12)


def test_neighbours_lie_in_the_triangle_and_within_reach() -> None:
    for direction in (0, 1):
        found = neighbours(SCATTERED, direction, reach=6.0)
        away = SCATTERED[found.other] - SCATTERED[found.point][:, None]
        assert np.all(away[..., direction] > 0.0) and away[..., direction].max() <= 6.0
        assert np.all(np.abs(away[..., 1 - direction]) < 0.5 * away[..., direction])
        np.testing.assert_allclose((away * found.weight[..., None]).sum(axis=1)[:, direction], found.length)
        off = np.abs((away * found.weight[..., None]).sum(axis=1)[:, 1 - direction])
        assert np.all(off <= 0.02 * away[:, 0, direction] + 1e-12)
    assert len(neighbours(SCATTERED, 0, reach=1.0).point) < len(neighbours(SCATTERED, 0).point)
    wide = neighbours(GRID, 1, distance=8.0)
    assert np.allclose(wide.length[GRID[wide.point, 1] < 11.0], 8.0)


@POINTS
@pytest.mark.parametrize("measure", ["technical", "green-lagrange"])
def test_strains_of_a_linear_field_are_exact(xy: np.ndarray, measure: str) -> None:
    seen = observation(xy, np.zeros((2, 2)))
    compared = strains(seen, StrainScheme(measure), 1.0)
    h = TIME[:, None, None] * SLOPE
    exact = 0.5 * (h + h.transpose(0, 2, 1) + (h.transpose(0, 2, 1) @ h if measure == "green-lagrange" else 0.0))
    got = compared.residual(observation(xy).value)
    t = compared.rows[:, 0]
    n = compared.n // (3 * len(TIME))
    kind = np.tile(np.repeat([0, 1, 2], n), len(TIME))
    np.testing.assert_allclose(got, exact[t, [[0, 1, 0][k] for k in kind], [[0, 1, 1][k] for k in kind]], atol=1e-12)
    assert n > 0.95 * len(xy) and compared.unit == "1"


def test_green_lagrange_is_blind_to_any_rotation_and_technical_to_a_small_one() -> None:
    angle = 0.3
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    seen = observation(GRID)
    rotated = (GRID + seen.value) @ turn.T - GRID
    for measure, limit in (("technical", None), ("green-lagrange", 1e-12)):
        left = strains(seen, StrainScheme(measure), 1.0).residual(rotated - seen.value)
        assert (np.abs(left).max() > 0.04) if limit is None else (np.abs(left).max() < limit)
    small = strains(seen, StrainScheme(), 1.0).residual(np.broadcast_to(1e-4 * GRID @ SPIN.T, seen.value.shape))
    assert np.abs(small).max() < 1e-12


@pytest.mark.parametrize("measure", ["technical", "green-lagrange"])
def test_derivative_of_strains_is_that_of_differences(measure: str) -> None:
    seen, rng = observation(SCATTERED), np.random.default_rng(4)
    compared = strains(seen, StrainScheme(measure))
    error, slope = (0.05 * rng.normal(size=seen.value.shape) for _ in range(2))
    h = 1e-4
    expected = (compared.residual(error + h * slope) - compared.residual(error - h * slope)) / (2.0 * h)
    np.testing.assert_allclose(compared.slope(error, slope), expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())
    scaled = compared.scaled(4.0)
    np.testing.assert_allclose(scaled.slope(error, slope), 2.0 * compared.slope(error, slope))


@pytest.mark.parametrize("measure", ["technical", "green-lagrange", "gradient"])
def test_noise_of_strains_is_what_it_claims(measure: str) -> None:
    seen, rng = observation(SCATTERED[:40]), np.random.default_rng(6)
    if measure == "gradient":
        compared = neighbour_differences(seen, RelativeScheme("gradient", ("xx", "yy", "xy")))
    else:
        compared = strains(seen, StrainScheme(measure))
    drawn = np.stack([compared.residual(1e-3 * rng.normal(size=seen.value.shape)) for _ in range(4000)])
    assert compared.noise is not None
    assert np.abs(drawn.T @ drawn / 4000 - compared.noise(np.eye(compared.n))).max() < 0.12


def test_a_lost_point_takes_its_neighbours_with_it() -> None:
    seen = observation(GRID)
    whole = strains(seen, StrainScheme(components=("yy",)))
    seen.mask[1, 38] = False
    fewer = strains(seen, StrainScheme(components=("yy",)))
    assert 4 <= whole.n - fewer.n <= 12
    seen.mask[:] = False
    with pytest.raises(DataError, match="widen it"):
        strains(seen, StrainScheme())


def test_regions_hold_what_they_say() -> None:
    star = Region(polygon=((-5.0, -5.0), (5.0, -5.0), (0.0, 0.0), (5.0, 5.0), (-5.0, 5.0)))
    xy = np.array([[-4.0, 0.0], [3.0, 0.0], [3.0, 4.0], [3.0, -4.0], [6.0, 0.0], [0.0, 6.0]])
    assert inside(star, xy, TIME)[0].tolist() == [True, False, True, True, False, False]
    disc = Region(centre=(3.0, 0.0), radius=1.0, t=(1.0, 1.5))
    assert inside(disc, xy, TIME).sum() == 1 and inside(disc, xy, TIME)[1, 1]
    seen = masked(observation(GRID), (Region(y=(0.0, 30.0)),), "evaluation.mask")
    assert seen.mask.sum() == 3 * 5 * 7 and np.isnan(seen.value[~seen.mask]).all() and np.isnan(seen.sigma[~seen.mask]).all()
    with pytest.raises(DataError, match=r"evaluation\.mask: its regions leave out every observation"):
        masked(observation(GRID), (Region(y=(-30.0, 30.0)),), "evaluation.mask")
