"""Nodal values from all points and pixels: exact for quadratic fields in the moving frame, white noise stays white, all is counted."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from thermofit.body.mesh.shapes import plate_with_hole_mesh
from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField, InfraredSequence, Specimen
from thermofit.observe import projection
from thermofit.observe.camera import make_pose
from thermofit.observe.fixed_pattern import FixedPattern, fixed_pattern
from thermofit.observe.interpolation import PixelMap, pixel_map
from thermofit.observe.noise import temperature_noise
from thermofit.observe.observation import FieldObservation
from thermofit.observe.observation_points import observation_points
from thermofit.observe.projection import (
    Patches,
    Projected,
    Sight,
    face_patches,
    in_line,
    motion_of,
    project_displacements,
    project_temperatures,
    rests,
    sight_of,
)
from thermofit.study.section import MeshSize

TIMES = np.array([0.0, 2.0, 3.5, 7.0, 8.0])
SIGMA = np.array([0.002, 0.002])
SHAPE = (90, 64)
PLACE = pixel_map(make_pose(0.25, np.array([45.0, 31.0]), np.array([-np.cos(0.035), np.sin(0.035)]), "back"))
"""Back view: x to the left, y up, rolled by 2 degrees, 0.25 mm per pixel."""


def nodes(x_max: float = 3.0, y_max: float = 4.5) -> Patches:
    """Nodes 1 mm by 1.5 mm apart, compared within |x| <= x_max, |y| <= y_max."""
    every = np.stack(np.meshgrid(np.linspace(-6.0, 6.0, 13), np.linspace(-9.0, 9.0, 13)), axis=-1).reshape(-1, 2)
    inside = (np.abs(every) <= np.array([x_max, y_max]) + 1e-9).all(axis=1)
    return Patches(every[inside], every[~inside])


PATCHES = nodes()


GRADIENT, SHIFT = np.array([[-0.06, 0.01, 0.0], [0.02, 0.14, 0.03]]), np.array([0.3, -0.8, 0.1])
"""Of the motion at time 10 s."""


def motion(xy: np.ndarray, t: np.ndarray, bent: float = 0.0) -> np.ndarray:
    """Displacement (n_t, n, 3), linear in time, linear or quadratic in X."""
    curved = bent * np.stack([xy[:, 0] * xy[:, 1], xy[:, 1] ** 2, 0.0 * xy[:, 0]], axis=1)
    return 0.1 * t[:, None, None] * (xy @ GRADIENT + SHIFT + curved)


def dic_field(lost: float = 0.0, bent: float = 0.0, noise: float = 0.0, seed: int = 7, times: np.ndarray = TIMES) -> DicField:
    x, y = np.meshgrid(np.arange(-6.0, 6.1, 0.6), np.arange(-9.0, 9.1, 0.6))
    rng = np.random.default_rng(seed)
    points = np.stack([x.ravel(), y.ravel()], axis=1) + rng.uniform(-0.15, 0.15, (x.size, 2))
    u = motion(points, times, bent) + noise * rng.normal(size=(len(times), len(points), 3))
    u[rng.random(u.shape[:2]) < lost] = np.nan
    return DicField(times, np.arange(len(points)), np.column_stack([points, np.full(len(points), 0.6)]), u)


def pixels(times: np.ndarray, field: object) -> InfraredSequence:
    """Frames of a temperature that is a function of place in space and time."""
    row, col = np.meshgrid(np.arange(SHAPE[0]), np.arange(SHAPE[1]), indexing="ij")
    xy = (np.stack([row, col], axis=-1) - PLACE.offset) @ np.linalg.inv(PLACE.matrix).T
    return InfraredSequence(times, np.stack([field(xy, t) for t in times]))  # type: ignore[operator]


def nowhere(patches: Patches) -> np.ndarray:
    return np.zeros(len(patches.raster().places), dtype=bool)


def sight(dic: DicField, times: np.ndarray, at_edge: np.ndarray | None = None, place: PixelMap = PLACE) -> Sight:
    return sight_of(place, dic, PATCHES, in_line(dic, SIGMA), nowhere(PATCHES) if at_edge is None else at_edge, times)


def shown(at: Projected, field: np.ndarray) -> np.ndarray:
    """Means over the patches of a nodal field (n_t, m, n_c)."""
    like = FieldObservation("u", at.time, PATCHES.xy, at.value, np.ones_like(at.value), at.mask, "mm", at.moments)
    return like.averaged(field)


@pytest.mark.parametrize("times", [None, np.array([0.0, 1.3, 2.9, 6.6, 8.0])])
@pytest.mark.parametrize("bent", [0.0, 0.01])
def test_displacements_come_back_through_the_means(bent: float, times: np.ndarray | None) -> None:
    """Linear and quadratic fields on scattered points, some of them lost, at the stages and between them."""
    dic = dic_field(0.03, bent)
    at = project_displacements(dic, PATCHES, in_line(dic, SIGMA), times)
    nodal = motion(PATCHES.xy, at.time, bent)[:, :, :2]
    assert at.mask.all() and at.counts["points_out_of_line"] == 0
    assert np.abs(at.value - shown(at, nodal)).max() < (1e-12 if bent == 0.0 else 1e-10)
    assert np.abs(at.value - nodal).max() > 0.01, "the means must not be the nodal values"


def curved(xy: np.ndarray, t: float) -> np.ndarray:
    return 297.0 + 0.5 * t + (0.03 + 0.01 * t) * xy[..., 0] - 0.2 * xy[..., 1] + 0.004 * xy[..., 0] * xy[..., 1] - 0.003 * xy[..., 1] ** 2


@pytest.mark.parametrize("times", [TIMES, np.array([0.1, 1.3, 2.9, 6.6, 7.9])])
def test_quadratic_temperature_in_the_moving_frame(times: np.ndarray) -> None:
    """Quadratic in the current place, under a linear motion: quadratic in the material place, whatever the gradient does over time."""
    at = project_temperatures(pixels(TIMES, curved), sight(dic_field(0.02), times), PATCHES)
    assert at.mask.all() and at.counts["pixels_used"] == at.counts["pixels_in_window"]
    moved = PATCHES.xy + motion(PATCHES.xy, times)[:, :, :2]
    nodal = np.stack([curved(moved[k], t) for k, t in enumerate(times)])[:, :, None]
    assert np.abs(at.value - shown(at, nodal)).max() < 1e-5, "the place of a pixel is known to 1e-5 mm"
    resting = np.stack([curved(PATCHES.xy, t) for t in times])[:, :, None]
    assert np.abs(at.value - shown(at, resting)).max() > 0.1, "the motion must matter in this test"


def test_a_point_spread_is_in_the_prediction() -> None:
    """Frames blurred by 0.6 mm: a quadratic field is then 0.6^2 / 2 of its curvature more."""
    still = dataclasses.replace(dic_field(), displacement=np.zeros_like(dic_field().displacement))
    seen = pixels(TIMES, lambda xy, t: curved(xy, t) - 0.003 * 0.6**2)
    nodal = np.stack([curved(PATCHES.xy, t) for t in TIMES])[:, :, None]
    sharp, blurred = (project_temperatures(seen, sight(still, TIMES), PATCHES, blur=blur) for blur in (0.0, 0.6))
    assert np.abs(blurred.value - shown(blurred, nodal)).max() < 1e-10 < 5e-4 < np.abs(sharp.value - shown(sharp, nodal)).min()


def test_a_curved_motion_is_followed() -> None:
    dic = dic_field(bent=0.01)
    at = project_temperatures(pixels(TIMES, lambda xy, t: 300.0 + xy[..., 1]), sight(dic, TIMES), PATCHES)
    nodal = PATCHES.xy[:, 1] + motion(PATCHES.xy, TIMES, 0.01)[:, :, 1]
    assert np.abs(at.value - 300.0 - shown(at, nodal[:, :, None])).max() < 4e-3


def test_at_rest_a_linear_temperature_comes_back_to_1e_12() -> None:
    still = dataclasses.replace(dic_field(), displacement=np.zeros_like(dic_field().displacement))
    at = project_temperatures(pixels(TIMES, lambda xy, t: 0.3 * xy[..., 0] - 0.2 * xy[..., 1]), sight(still, TIMES), PATCHES)
    nodal = np.broadcast_to(0.3 * PATCHES.xy[:, 0] - 0.2 * PATCHES.xy[:, 1], at.mask.shape)[:, :, None]
    assert np.abs(at.value - shown(at, nodal)).max() < 1e-12


def test_white_noise_stays_white_with_the_stated_size() -> None:
    """2000 draws: the sum of squares over sigma is a chi-square of as many degrees of freedom, neighbours have no correlation."""
    time = np.arange(2000.0)
    dic = dic_field(0.02, times=time)
    draws = dataclasses.replace(
        dic, displacement=np.where(np.isnan(dic.displacement), np.nan, np.random.default_rng(2).normal(size=dic.displacement.shape))
    )
    at = project_displacements(draws, PATCHES, np.isfinite(draws.displacement[:, :, 0]))
    z = (at.value / at.sigma_factor[:, :, None])[:, :, 0]
    assert at.mask.all()
    total = (z**2).sum(axis=0)
    low, high = chi2.ppf([1e-4 / z.shape[1], 1.0 - 1e-4 / z.shape[1]], len(time))
    assert low < total.min() and total.max() < high
    correlation = z.T @ z / len(time) - np.diag(np.mean(z**2, axis=0))
    assert np.abs(correlation).max() < 5.0 / np.sqrt(len(time))
    assert np.abs(correlation.sum()) / z.shape[1] < 5.0 * np.sqrt(2.0 * z.shape[1] / len(time)) / np.sqrt(z.shape[1]) * 2.0


def test_noise_of_temperatures() -> None:
    """80 frames of white noise under a moving specimen, at and between the frames."""
    time = np.linspace(0.0, 8.0, 80)
    infrared = InfraredSequence(time, np.random.default_rng(4).normal(size=(80, *SHAPE)))
    for times in (time, time[:-1] + 0.4 * np.diff(time)):
        at = project_temperatures(infrared, sight(dic_field(), times), PATCHES)
        z = at.value / at.sigma_factor[:, :, None]
        assert np.std(z) == pytest.approx(1.0, abs=0.02)
        neighbour = np.mean(z[:, :-1] * z[:, 1:])
        assert abs(neighbour) < 5.0 / np.sqrt(z.size)
        assert np.median(at.points) == pytest.approx(1.5 / 0.25**2, rel=0.1), "all pixels of a patch of 1.5 mm^2"


def test_points_out_of_line_are_left_out_and_counted() -> None:
    """A blotch of three points, a single one and one that is 5 mm off, in single stages; their neighbours stay."""
    dic = dic_field(0.02, 0.01, noise=0.002)
    middle = np.argsort(np.linalg.norm(dic.reference[:, :2], axis=1))
    blotch, single = middle[:3], middle[60]
    dic.displacement[2, blotch] += np.array([0.05, -0.04, 0.0])
    dic.displacement[4, single] += np.array([0.0, 0.1, 0.0])
    dic.displacement[1, middle[10]] += 5.0
    good = in_line(dic, SIGMA)
    measured = np.isfinite(dic.displacement[:, :, 0])
    wrong = np.argwhere(measured & ~good).tolist()
    assert wrong == [[1, middle[10]], *([2, k] for k in np.sort(blotch)), [4, single]]
    at = project_displacements(dic, PATCHES, good)
    assert at.counts["points_out_of_line"] == len(wrong)
    error = at.value - shown(at, motion(PATCHES.xy, TIMES, 0.01)[:, :, :2])
    assert np.nanmax(np.abs(error)) < 0.008
    spoilt = project_displacements(dic, PATCHES, measured)
    assert np.nanmax(np.abs(spoilt.value - shown(spoilt, motion(PATCHES.xy, TIMES, 0.01)[:, :, :2]))[2]) > 0.012


def test_stages_in_many_blocks_are_those_in_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is bounded by working on some stages at a time: values lost, out of line and between two blocks are the same."""
    dic, times = dic_field(0.02, 0.01, noise=0.002), np.linspace(-1.0, 9.0, 23)
    dic.displacement[3, 100:103] += 0.1

    def found() -> tuple[np.ndarray, Projected, np.ndarray]:
        good = in_line(dic, SIGMA)
        return good, project_displacements(dic, PATCHES, good, times), motion_of(dic, PATCHES, good, times).u

    (good, at, u), _ = found(), monkeypatch.setattr(projection, "AT_ONCE", 2 * len(dic.reference))
    parts, at_parts, u_parts = found()
    assert np.array_equal(good, parts) and at.counts == at_parts.counts
    for name in ("value", "points", "there", "sigma_factor", "mask", "moments"):
        assert np.array_equal(getattr(at, name), getattr(at_parts, name), equal_nan=True), name
    np.testing.assert_allclose(u, u_parts, rtol=0.0, atol=1e-12)


def test_a_crowd_of_points_in_one_place_makes_no_fine_grid_of_the_motion_everywhere() -> None:
    """Points 1 um apart over half a millimetre, several for each of the field: a grid as fine everywhere would have 10^8 places."""
    dic = dic_field(times=np.array([0.0, 5.0]))
    x, y = np.meshgrid(np.linspace(0.0, 0.06, 60), np.linspace(0.0, 0.06, 60))
    crowd = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.6)])
    points = np.concatenate([dic.reference, crowd])
    seen = DicField(dic.time, np.arange(len(points)), points, motion(points[:, :2], dic.time))
    found = motion_of(seen, PATCHES, np.ones(seen.displacement.shape[:2], dtype=bool), dic.time)
    assert found.u[0, :, :, 0].size < 300_000
    places = np.array([[1.0, 2.0], [-2.5, -4.0], [0.03, 0.03]])
    np.testing.assert_allclose(found.at(1, places), motion(places, dic.time)[1, :, :2], atol=1e-6)


def test_a_neck_is_signal() -> None:
    """A kink of the displacement along a line, as a band of localised strain has it: no point is taken for an outlier."""
    dic = dic_field(noise=0.0002)
    dic.displacement[3:, :, 1] += 0.2 * np.tanh(dic.reference[:, 1] / 0.4)
    assert in_line(dic, SIGMA)[np.isfinite(dic.displacement[:, :, 0])].all()


def test_nodes_without_points_are_masked_and_counted() -> None:
    dic = dic_field()
    lost = np.linalg.norm(dic.reference[:, :2] - np.array([1.0, 1.5]), axis=1) < 1.2
    dic.displacement[2, lost] = np.nan
    at = project_displacements(dic, PATCHES, in_line(dic, SIGMA))
    empty = (np.abs(PATCHES.xy - np.array([1.0, 1.5])) < 1e-9).all(axis=1)
    assert at.mask[2].tolist() == (~empty).tolist() and at.mask[[0, 1, 3, 4]].all()
    assert at.counts["points_lost"] == lost.sum() and at.counts["masked"] == 1 and at.counts["nodes_outside"] == 0
    assert np.isnan(at.value[2, empty]).all() and np.isnan(at.sigma_factor[2, empty]).all()
    assert (at.moments[2, empty] == 0.0).all(), "the prediction there is the nodal value"
    with pytest.raises(DataError, match=r"none of the 49 nodes lies in the measured field"):
        project_displacements(dic, Patches(PATCHES.xy + 100.0, PATCHES.others + 100.0), in_line(dic, SIGMA))


def test_pixels_that_are_left_out_are_counted_by_cause() -> None:
    infrared = pixels(TIMES, curved)
    infrared.frames[1, 40:44, 30:34] = np.nan
    edge = PATCHES.raster().places[:, 0] > 2.0
    at = project_temperatures(infrared, sight(dic_field(), TIMES, edge), PATCHES)
    counts = at.counts
    assert counts["pixels_dead"] == 16 and counts["pixels_at_edge"] > 1000
    assert counts["pixels_used"] + 16 + counts["pixels_at_edge"] == counts["pixels_in_window"]
    assert counts["pixels_in_window"] == pytest.approx(5 * 49 * 24, rel=0.2)
    assert not at.mask[:, PATCHES.xy[:, 0] > 2.6].any() and at.mask[:, PATCHES.xy[:, 0] < 1.9].all()
    assert counts["masked"] == (~at.mask).sum() > 0
    late = project_temperatures(pixels(TIMES, curved), sight(dic_field(), np.array([1.0, 8.5])), PATCHES)
    assert late.counts["times_outside"] == 1 and late.mask[0].all() and not late.mask[1].any()


def test_far_from_all_points_there_is_no_motion() -> None:
    dic = dic_field()
    dic.displacement[:, dic.reference[:, 0] > 1.0] = np.nan
    at = project_temperatures(pixels(TIMES, curved), sight(dic, TIMES), PATCHES)
    assert at.counts["pixels_without_motion"] > 0
    assert not at.mask[:, PATCHES.xy[:, 0] > 2.9].any() and at.mask[:, PATCHES.xy[:, 0] < 1.1].all()


@pytest.mark.parametrize("shift", [(-40.0, 0.0), (40.0, 0.0), (0.0, 45.0)])
def test_patches_that_leave_the_image_are_masked(shift: tuple[float, float]) -> None:
    far = PixelMap(PLACE.matrix, PLACE.offset + np.array(shift))
    at = project_temperatures(pixels(TIMES, curved), sight(dic_field(), TIMES, place=far), PATCHES)
    pixel = (PATCHES.xy + motion(PATCHES.xy, TIMES)[:, :, :2]) @ far.matrix.T + far.offset
    well_in = ((pixel > 4.0) & (pixel < np.array(SHAPE) - 5.0)).all(axis=2)
    well_out = ((pixel < -5.0) | (pixel > np.array(SHAPE) + 4.0)).any(axis=2)
    assert at.mask[well_in].all() and not at.mask[well_out].any() and well_out.any()
    with pytest.raises(DataError, match="no node has a temperature"):
        project_temperatures(pixels(TIMES, curved), sight(dic_field(), TIMES, place=PixelMap(PLACE.matrix, PLACE.offset + 1e3)), PATCHES)


def patterned(size: float, seed: int = 6) -> tuple[InfraredSequence, np.ndarray, DicField]:
    """Frames of 25 mK of a specimen that rests, moves and rests again, with a fixed pattern of `size` K."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 160.0, 161)
    stages = np.array([0.0, 40.0, 80.0, 160.0])
    moved = dic_field(times=np.array([0.0, 0.0, 8.0, 8.0]))
    pattern = size * rng.normal(size=SHAPE)
    clean = pixels(time, curved_slowly)
    frames = clean.frames + pattern + 0.025 * rng.normal(size=clean.frames.shape)
    return InfraredSequence(time, frames), pattern, dataclasses.replace(moved, time=stages)


def curved_slowly(xy: np.ndarray, t: float) -> np.ndarray:
    return curved(xy, 4.0) + 0.002 * t


def found_pattern(infrared: InfraredSequence, dic: DicField) -> FixedPattern:
    seen = sight(dic, infrared.time)
    return fixed_pattern(infrared, rests(infrared, seen), temperature_noise(infrared))


def test_fixed_pattern_is_taken_off() -> None:
    """8 mK under 25 mK of noise and a moving specimen: what is left of it in a nodal value is below 2 mK, in a pixel what is said."""
    infrared, pattern, dic = patterned(0.008)
    found = found_pattern(infrared, dic)
    assert found.size == pytest.approx(0.008, rel=0.15) and found.frames == 41 + 81
    seen = found.value != 0.0
    left = (pattern - found.value)[seen]
    assert np.std(left) == pytest.approx(found.left, rel=0.2) and np.std(left) < 0.0035
    view = sight(dic, infrared.time)
    only = InfraredSequence(infrared.time, np.broadcast_to(pattern, infrared.frames.shape))
    with_it, without = (project_temperatures(only, view, PATCHES, p).value for p in (None, found.value))
    assert np.std(without) < 0.0012 < 0.0015 < np.std(with_it)


def test_a_pattern_that_stays_is_the_cameras() -> None:
    infrared, _, dic = patterned(0.008)
    found = found_pattern(infrared, dic)
    assert found.stays is not None and abs(found.stays[0] - 1.0) < 4.0 * found.stays[1] < 1.0 and not found.moves


def test_a_pattern_of_the_specimen_is_left_to_it() -> None:
    """Paint of 12 mK at a wavelength of 0.7 mm goes with the specimen: nothing of it is taken off."""
    infrared, _, dic = patterned(0.0)
    gradient, shift = GRADIENT[:, :2], SHIFT[:2]

    def painted(xy: np.ndarray, t: float) -> np.ndarray:
        k = 0.8 * float(np.clip((t - 40.0) / 40.0, 0.0, 1.0))
        place = (xy - k * shift) @ np.linalg.inv(np.eye(2) + k * gradient)
        return np.asarray(curved_slowly(xy, t) + 0.024 * np.sin(9.0 * place[..., 0]) * np.sin(9.0 * place[..., 1]))

    painted_frames = pixels(infrared.time, painted).frames
    noise = 0.025 * np.random.default_rng(8).normal(size=painted_frames.shape)
    found = found_pattern(InfraredSequence(infrared.time, painted_frames + noise), dic)
    assert found.size == pytest.approx(0.012, rel=0.4)
    assert found.stays is not None and found.stays[0] < 0.2 and found.moves
    assert not found.value.any() and found.left == found.size


def test_one_rest_tells_no_camera_from_a_specimen() -> None:
    infrared, _, dic = patterned(0.008)
    short = infrared.time <= 60.0
    found = found_pattern(InfraredSequence(infrared.time[short], infrared.frames[short]), dic)
    assert found.stays is None and not found.moves and found.value.any()


def test_no_pattern_is_taken_off_where_there_is_none() -> None:
    infrared, _, dic = patterned(0.0)
    found = found_pattern(infrared, dic)
    assert found.size < 0.002 and np.abs(found.value).max() < 0.004 and np.std(found.value) < 0.0007


def test_bad_pixels_go() -> None:
    infrared, _, dic = patterned(0.004)
    infrared.frames[:, 40, 30] += 0.2
    found = found_pattern(infrared, dic)
    assert found.bad == 1 and np.isnan(found.value[40, 30])
    at = project_temperatures(infrared, sight(dic, infrared.time), PATCHES, found.value)
    assert at.counts["pixels_dead"] >= 100 and at.mask.all()


def test_areas_of_patches() -> None:
    np.testing.assert_allclose(PATCHES.areas(), 1.5, rtol=0.1)


def beside_a_hole(xy: np.ndarray, strain: float = 1e-3, nu: float = 0.33, radius: float = 4.0) -> np.ndarray:
    """Displacement (n, 2) of Kirsch's plate with a hole, pulled along y to the strain far away (plane stress)."""
    r, angle = np.hypot(*xy.T), np.arctan2(-xy[:, 0], xy[:, 1])
    k, a = (3.0 - nu) / (1.0 + nu), radius / r
    size = 2.0 * strain * (1.0 + nu) * radius / 8.0
    along = (k + 1.0) / a * np.cos(angle) + 2.0 * a * ((1.0 + k) * np.cos(angle) + np.cos(3.0 * angle)) - 2.0 * a**3 * np.cos(3.0 * angle)
    across = (k - 3.0) / a * np.sin(angle) + 2.0 * a * ((1.0 - k) * np.sin(angle) + np.sin(3.0 * angle)) - 2.0 * a**3 * np.sin(3.0 * angle)
    return size * np.stack([-across, along], axis=1)


def test_smoothing_is_no_bias_beside_a_hole() -> None:
    """At the rim of a hole, where strains are three times those far away, on nodes as far apart as the radius is divided into six."""
    specimen = Specimen(20.0, 3.0, 80.0, 0.0, 20.0, 80.0, 0.0)
    mesh = plate_with_hole_mesh(specimen, 4.0, MeshSize(n_x=8, n_y=48, n_z=1))
    patches = face_patches(mesh, observation_points(mesh.nodes, mesh.node_sets["face"], 9.0, 9.0))
    points = np.random.default_rng(8).uniform([-9.9, -12.0], [9.9, 12.0], (4000, 2))
    points = points[np.hypot(*points.T) > 4.0]
    u = np.column_stack([beside_a_hole(points), np.zeros(len(points))])
    dic = DicField(np.zeros(1), np.arange(len(points)), np.column_stack([points, np.zeros(len(points))]), u[None])
    at = project_displacements(dic, patches, np.ones((1, len(points)), dtype=bool))
    seen = FieldObservation("u", at.time, patches.xy, at.value, at.value, at.mask, "mm", at.moments)
    nodal = beside_a_hole(patches.xy)[None]
    rim = at.mask & (np.hypot(*patches.xy.T) < 6.0)[None]
    bias = [np.sqrt(np.mean((at.value - field)[rim] ** 2)) for field in (nodal, seen.averaged(nodal))]
    assert bias[0] > 1e-4 and bias[1] < 0.05 * bias[0], bias
