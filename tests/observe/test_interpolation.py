"""Algorithms 2 and 3: linear fields in the moving frame, lost points, ends of the record, noise through the weights."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField, InfraredSequence, Specimen
from thermofit.observe.camera import make_pose, specimen_to_pixel
from thermofit.observe.interpolation import (
    PixelMap,
    cell_weights,
    displacements_at,
    edge_distance,
    interpolate_displacements,
    interpolate_temperatures,
    pixel_map,
    time_weights,
)

GRADIENT = np.array([[-0.06, 0.01, 0.0], [0.02, 0.14, 0.03]])
SHIFT = np.array([0.3, -0.8, 0.1])
TIMES = np.array([0.0, 2.0, 3.5, 7.0, 8.0])
TARGETS = np.stack(np.meshgrid(np.linspace(-4.0, 4.0, 9), np.linspace(-6.0, 6.0, 13)), axis=-1).reshape(-1, 2)
SHAPE = (90, 64)
# Back view: x to the left, y up, rolled by 2 degrees, 0.25 mm per pixel.
PLACE = pixel_map(make_pose(0.25, np.array([45.0, 31.0]), np.array([-np.cos(0.035), np.sin(0.035)]), "back"))


def motion(xy: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Displacement (n_t, n, 3), linear in X and in time."""
    return 0.1 * t[:, None, None] * (xy @ GRADIENT + SHIFT)


def dic_field(lost: float = 0.0, regular: bool = False) -> DicField:
    x, y = np.meshgrid(np.arange(-5.0, 5.5), np.arange(-7.0, 7.5))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    rng = np.random.default_rng(7)
    points = points if regular else points + rng.uniform(-0.2, 0.2, points.shape)
    u = motion(points, TIMES)
    u[rng.random(u.shape[:2]) < lost] = np.nan
    return DicField(TIMES, np.arange(len(points)), np.column_stack([points, np.full(len(points), 0.6)]), u)


def thermal(xy: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Temperature linear in the CURRENT position and in time."""
    return 297.0 + 0.5 * t + (0.03 + 0.01 * t) * xy[..., 0] - 0.2 * xy[..., 1]


def camera(times: np.ndarray) -> InfraredSequence:
    row, col = np.meshgrid(np.arange(SHAPE[0]), np.arange(SHAPE[1]), indexing="ij")
    xy = (np.stack([row, col], axis=-1) - PLACE.offset) @ np.linalg.inv(PLACE.matrix).T
    return InfraredSequence(times, np.stack([thermal(xy, t) for t in times]))


@pytest.mark.parametrize("regular", [False, True])
def test_linear_displacement_field_with_lost_points(regular: bool) -> None:
    """Targets on the points and lines of a regular grid as well as in an irregular one; other triangles where points are lost."""
    nodal = interpolate_displacements(dic_field(0.03, regular), TARGETS)
    assert nodal.counts.retriangulated > 10
    assert nodal.mask.mean() > 0.98
    np.testing.assert_allclose(nodal.value[nodal.mask], motion(TARGETS, TIMES)[nodal.mask], atol=1e-12)
    assert np.isnan(nodal.value[~nodal.mask]).all() and np.isnan(nodal.sigma_factor[~nodal.mask]).all()


def test_counts_of_lost_points_and_nodes_outside() -> None:
    dic = dic_field()
    dic.displacement[2, :10] = np.nan
    dic.displacement[:, 20] = np.nan
    targets = np.concatenate([TARGETS, [[9.0, 0.0], [0.0, 30.0]]])
    nodal = interpolate_displacements(dic, targets)
    assert nodal.counts.points_lost.tolist() == [0, 0, 10, 0, 0], "a point that was never measured is not lost at a stage"
    assert nodal.counts.nodes_outside == 2
    assert not nodal.mask[:, -2:].any() and nodal.mask[[0, 1, 3, 4], :-2].all()
    assert nodal.counts.masked == (~nodal.mask).sum()


def test_only_targets_that_lost_a_point_get_another_triangle() -> None:
    whole, part = dic_field(regular=True), dic_field(regular=True)
    whole.displacement[1] += np.random.default_rng(1).normal(size=whole.displacement[1].shape)
    part.displacement[1] = whole.displacement[1]
    lost = int(np.argmin(np.linalg.norm(part.reference[:, :2], axis=1)))
    part.displacement[1, lost] = np.nan
    a, b = interpolate_displacements(whole, TARGETS + 0.3), interpolate_displacements(part, TARGETS + 0.3)
    changed = np.flatnonzero((a.value[1] != b.value[1]).any(axis=1))
    assert b.counts.retriangulated == len(changed) > 0
    assert np.abs(TARGETS[changed] + 0.3).max() < 1.0
    assert b.mask.all()


def test_sigma_factor_is_that_of_the_scatter() -> None:
    """400 stages of unit noise: the scatter of nodal values, in space and between stages, is sigma_factor."""
    dic = dic_field()
    time = np.arange(400.0)
    dic = dataclasses.replace(dic, time=time, displacement=np.random.default_rng(2).normal(size=(400, len(dic.reference), 3)))
    nodal = interpolate_displacements(dic, TARGETS)
    assert nodal.sigma_factor.min() >= 1.0 / np.sqrt(3.0) - 1e-12 and nodal.sigma_factor.max() <= 1.0
    np.testing.assert_allclose(np.std(nodal.value / nodal.sigma_factor[:, :, None]), 1.0, rtol=0.02)
    between = displacements_at(nodal, time[:-1] + 0.3)
    np.testing.assert_allclose(np.std(between.value / between.sigma_factor[:, :, None]), 1.0, rtol=0.02)
    assert between.sigma_factor.max() <= np.hypot(0.7, 0.3)


def test_two_dimensional_correlation_has_no_z() -> None:
    dic = dic_field()
    dic.displacement[:, :, 2] = np.nan
    nodal = interpolate_displacements(dic, TARGETS)
    assert nodal.mask.all() and np.isfinite(nodal.value[:, :, :2]).all()


def test_time_weights() -> None:
    w = time_weights(TIMES, np.array([-0.1, 0.0, 1.0, 2.0, 3.0, 8.0, 8.1]))
    assert w.inside.tolist() == [False, True, True, True, True, True, False]
    np.testing.assert_allclose(w.share[1:6], [0.0, 0.5, 0.0, 2.0 / 3.0, 1.0])
    np.testing.assert_allclose(((1 - w.share) * TIMES[w.left] + w.share * TIMES[w.right])[1:6], [0.0, 1.0, 2.0, 3.0, 8.0])
    single = time_weights(np.array([2.0]), np.array([1.0, 2.0, 3.0]))
    assert single.inside.tolist() == [False, True, False] and single.share.tolist() == [0.0, 0.0, 0.0]


def test_displacements_in_time_need_both_neighbours_but_none_at_a_stage() -> None:
    dic = dic_field()
    near = np.linalg.norm(dic.reference[:, :2], axis=1) < 2.5
    dic.displacement[2, near] = np.nan
    centre = np.array([[0.0, 0.0]])
    times = np.array([-1.0, 0.0, 1.0, 2.0, 3.0, 3.5, 5.0, 7.0, 8.0, 9.0])
    nodal = displacements_at(interpolate_displacements(dic, centre), times)
    assert nodal.mask[:, 0].tolist() == [False, True, True, True, False, False, False, True, True, False]
    np.testing.assert_allclose(nodal.value[nodal.mask], motion(centre, times)[nodal.mask], atol=1e-12)
    assert nodal.counts.times_outside == 2 and nodal.counts.masked == 5
    dic.displacement[3, near] = np.nan
    last = displacements_at(interpolate_displacements(dic, centre), np.array([7.9, 8.0]))
    assert last.mask[:, 0].tolist() == [False, True]
    np.testing.assert_allclose(last.value[1], motion(centre, np.array([8.0]))[0], atol=1e-12)


def test_no_target_in_the_field() -> None:
    with pytest.raises(DataError, match=r"none of the 117 nodes .* y -7"):
        interpolate_displacements(dic_field(regular=True), TARGETS + 100.0)
    dic = dic_field()
    dic.displacement[:] = np.nan
    with pytest.raises(DataError, match="0 points are measured"):
        interpolate_displacements(dic, TARGETS)


@pytest.mark.parametrize("times", [TIMES, np.array([0.1, 1.3, 2.9, 6.6, 7.9])])
def test_linear_temperature_in_the_moving_frame(times: np.ndarray) -> None:
    """Temperature linear in the current position, displacement linear in the reference position: exact to 1e-9, in time too.

    The gradient itself changes with time, so that only frames interpolated at fixed pixels give the exact value between them.
    """
    displacement = displacements_at(interpolate_displacements(dic_field(), TARGETS), times)
    nodal = interpolate_temperatures(camera(TIMES), PLACE, TARGETS, displacement)
    assert nodal.mask.all() and nodal.counts.masked == 0
    expected = np.stack([thermal(TARGETS + motion(TARGETS, times)[k, :, :2], t) for k, t in enumerate(times)])
    np.testing.assert_allclose(nodal.value, expected, atol=1e-9)
    at_rest = np.stack([thermal(TARGETS, t) for t in times])
    assert np.abs(expected - at_rest).max() > 0.1, "the motion must matter in this test"


def test_temperature_at_pixel_centres_lines_and_the_last_row() -> None:
    frame = np.random.default_rng(3).normal(size=(6, 5))
    pixel = np.array([[0.0, 0.0], [5.0, 4.0], [2.0, 3.0], [2.5, 3.0], [2.0, 3.5], [5.0, 1.25], [0.5, 0.5]])
    w = cell_weights(pixel, (6, 5))
    assert w.weight.min() >= 0.0
    np.testing.assert_allclose(w.weight.sum(axis=1), 1.0)
    value = (frame.ravel()[w.index] * w.weight).sum(axis=1)
    expected = [
        frame[0, 0],
        frame[5, 4],
        frame[2, 3],
        0.5 * (frame[2, 3] + frame[3, 3]),
        0.5 * (frame[2, 3] + frame[2, 4]),
        0.75 * frame[5, 1] + 0.25 * frame[5, 2],
        0.5 * (frame[0, 1] + frame[1, 0]),
    ]
    np.testing.assert_allclose(value, expected, atol=1e-14)


def test_noise_of_temperatures_goes_through_the_weights() -> None:
    time = np.arange(300.0)
    infrared = InfraredSequence(time, np.random.default_rng(4).normal(size=(300, *SHAPE)))
    dic = dataclasses.replace(dic_field(), time=np.array([0.0, 300.0]))
    still = dataclasses.replace(dic, displacement=np.zeros((2, len(dic.reference), 3)))
    nodal = interpolate_temperatures(infrared, PLACE, TARGETS, displacements_at(interpolate_displacements(still, TARGETS), time[:-1] + 0.4))
    np.testing.assert_allclose(np.std(nodal.value / nodal.sigma_factor), 1.0, rtol=0.02)


def test_masked_temperatures_are_counted_by_cause() -> None:
    times = np.array([-1.0, 1.0, 3.0, 7.5])
    infrared = camera(TIMES)
    infrared.frames[2:, 45, 31] = np.nan
    dic = dic_field()
    targets = np.concatenate([[[0.0, 0.0]], TARGETS[TARGETS[:, 0] > 1.0], [[8.0, 0.0]]])
    usable = np.ones(len(targets), dtype=bool)
    usable[[5, 6]] = False
    still = dataclasses.replace(dic, displacement=np.zeros_like(dic.displacement))
    displacement = displacements_at(interpolate_displacements(still, targets), times)
    nodal = interpolate_temperatures(infrared, PLACE, targets, displacement, usable)
    counts = nodal.counts
    assert (counts.nodes_at_edge, counts.times_outside, counts.dead_pixel) == (2, 1, 2)
    assert counts.no_position == 3, "the node outside the field has no position at three times"
    assert not nodal.mask[:, [5, 6]].any() and not nodal.mask[0].any() and not nodal.mask[2:, 0].any() and nodal.mask[1, 0]
    assert counts.masked == (~nodal.mask).sum() == len(targets) + 3 * 2 + 3 + 2
    np.testing.assert_array_equal(np.isfinite(nodal.value), nodal.mask)


@pytest.mark.parametrize("shift", [(-30.0, 0.0), (37.3, 0.0), (0.0, -20.0), (0.0, 25.4)])
def test_nodes_that_leave_the_image_are_masked(shift: tuple[float, float]) -> None:
    far = PixelMap(PLACE.matrix, PLACE.offset + np.array(shift))
    displacement = interpolate_displacements(dic_field(), TARGETS)
    nodal = interpolate_temperatures(camera(TIMES), far, TARGETS, displacement)
    pixel = (TARGETS + displacement.value[:, :, :2]) @ far.matrix.T + far.offset
    np.testing.assert_array_equal(nodal.mask, ((pixel >= 0.0) & (pixel <= np.array(SHAPE) - 1.0)).all(axis=2))
    assert (pixel[:, :, 0] > SHAPE[0] - 1.0).any() or shift != (37.3, 0.0)
    assert nodal.counts.outside_image == (~nodal.mask).sum() > 0
    with pytest.raises(DataError, match="outside the image"):
        interpolate_temperatures(camera(TIMES), PixelMap(PLACE.matrix, PLACE.offset + 1e3), TARGETS, displacement)


def test_other_nodes_than_those_of_the_displacement() -> None:
    with pytest.raises(ValueError, match="same nodes"):
        interpolate_temperatures(camera(TIMES), PLACE, TARGETS[:-1], interpolate_displacements(dic_field(), TARGETS))


def test_pixel_map_is_the_pose() -> None:
    pose = make_pose(0.4, np.array([109.0, 44.0]), np.array([-1.0, 0.03]), "back")
    place = pixel_map(pose)
    np.testing.assert_allclose(TARGETS @ place.matrix.T + place.offset, specimen_to_pixel(pose, TARGETS), atol=1e-12)


def test_edge_distance_of_a_dogbone() -> None:
    specimen = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
    xy = np.array([[0.0, 0.0], [-12.0, 40.0], [13.0, 0.0], [0.0, 65.0], [17.5, 70.0], [12.5, 51.0]])
    arc = np.hypot(25.0, 1.0) - 25.0
    np.testing.assert_allclose(edge_distance(specimen, xy), [12.5, 0.5, -0.5, np.hypot(37.5, 15.0) - 25.0, 0.0, arc], atol=1e-12)
