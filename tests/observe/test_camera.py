"""Algorithm 1 against known camera poses, its checks, its uncertainty, and the mirrored back view."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thermofit.core.errors import DataError
from thermofit.core.experiment import Landmarks, Specimen
from thermofit.observe.camera import (
    CameraPose,
    circle_centre,
    landmark_checks,
    pixel_coordinates,
    pixel_to_specimen,
    pose_from_landmarks,
    pose_uncertainty,
    specimen_to_pixel,
)

SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
SHAPE = (218, 90)


def known_pixel(xy: np.ndarray, side: str, scale: float, origin: tuple[float, float], roll: float) -> np.ndarray:
    """Projection written out once more: columns to the right, rows downwards, specimen turned clockwise by roll."""
    x, y = np.asarray(xy, dtype=float).T
    x = -x if side == "back" else x
    right = x * np.cos(roll) + y * np.sin(roll)
    up = -x * np.sin(roll) + y * np.cos(roll)
    return np.column_stack([origin[0] - up / scale, origin[1] + right / scale])


def known_landmarks(side: str, scale: float = 0.4, origin: tuple[float, float] = (118.3, 44.6), roll: float = 0.02) -> Landmarks:
    """Exact landmarks; the edge at +x is on the right of a front view and on the left of a back view."""
    left = 12.5 if side == "back" else -12.5
    angle = np.deg2rad([80.0, 200.0, 320.0])
    points = [[0.0, -30.0], [0.0, 30.0], [left, -31.0], [left, 33.0], [-left, 2.0]]
    xy = np.array([*points, *np.column_stack([9 * np.cos(angle), 9 * np.sin(angle)])])
    pixel = known_pixel(xy, side, scale, origin, roll)
    return Landmarks(0, pixel[:2], 60.0, pixel[2:4], pixel[4], pixel[5:])


def pose_of(side: str = "back") -> CameraPose:
    return pose_from_landmarks(known_landmarks(side), side, SHAPE)


@settings(max_examples=60, deadline=None)
@given(
    side=st.sampled_from(["front", "back"]),
    scale=st.floats(0.38, 0.6),
    origin=st.tuples(st.floats(100.0, 118.0), st.floats(42.0, 46.0)),
    roll=st.floats(-0.1, 0.1),
)
def test_exact_landmarks_give_the_pose(side: str, scale: float, origin: tuple[float, float], roll: float) -> None:
    landmarks = known_landmarks(side, scale, origin, roll)
    pose = pose_from_landmarks(landmarks, side, SHAPE)
    assert pose.scale == pytest.approx(scale, abs=1e-11)
    assert pose.roll == pytest.approx(roll, abs=1e-11)
    np.testing.assert_allclose(pose.origin, origin, atol=1e-9)
    xy = np.array([[0.0, 0.0], [7.0, -20.0], [-12.5, 40.0], [11.0, 3.0]])
    pixel = known_pixel(xy, side, scale, origin, roll)
    np.testing.assert_allclose(specimen_to_pixel(pose, xy), pixel, atol=1e-9)
    np.testing.assert_allclose(pixel_to_specimen(pose, pixel), xy, atol=1e-9)
    checks = landmark_checks(landmarks, pose, SPECIMEN)
    assert checks.width_mm == pytest.approx(25.0, abs=1e-9) and checks.centre_offset_mm == pytest.approx(0.0, abs=1e-9)


def test_back_view_is_mirrored_and_crosshead_is_on_top() -> None:
    right = {side: specimen_to_pixel(pose_of(side), np.array([10.0, 0.0]))[1] - 44.6 for side in ("front", "back")}
    assert right["front"] == pytest.approx(25.0, abs=0.1) and right["back"] == pytest.approx(-25.0, abs=0.1)
    for side in ("front", "back"):
        pose = pose_of(side)
        assert specimen_to_pixel(pose, np.array([0.0, 20.0]))[0] < pose.origin[0] - 49.0
        handed = pose.axis_x[1] * -pose.axis_y[0] - -pose.axis_x[0] * pose.axis_y[1]
        assert handed == pytest.approx(1.0 if side == "front" else -1.0)


def test_order_of_the_edge_points_does_not_matter() -> None:
    landmarks = known_landmarks("back")
    turned = dataclasses.replace(
        landmarks, edge_left=landmarks.edge_left[::-1], length=landmarks.length[::-1], circle=landmarks.circle[::-1]
    )
    a, b = (pose_from_landmarks(marks, "back", SHAPE) for marks in (landmarks, turned))
    np.testing.assert_allclose(a.axis_x, b.axis_x)
    np.testing.assert_allclose(a.origin, b.origin)


def test_pixel_coordinates_are_those_of_the_pixel_centres() -> None:
    pose = pose_of()
    coordinates = pixel_coordinates(pose, SHAPE)
    assert coordinates.shape == (*SHAPE, 2)
    np.testing.assert_allclose(coordinates[100, 17], pixel_to_specimen(pose, np.array([100.0, 17.0])), atol=1e-12)
    # Neighbouring columns are one scale apart, and x falls to the right in the back view.
    step = coordinates[100, 18] - coordinates[100, 17]
    assert np.hypot(*step) == pytest.approx(0.4) and step[0] < 0.0


def test_circle_through_three_points() -> None:
    points = np.array([3.0, -2.0]) + 5.0 * np.array([[1.0, 0.0], [0.0, 1.0], [-0.6, 0.8]])
    np.testing.assert_allclose(circle_centre(points), [3.0, -2.0], atol=1e-12)


def test_reported_uncertainty_is_the_scatter_of_noisy_picks() -> None:
    landmarks, rng, sigma = known_landmarks("back"), np.random.default_rng(5), 0.15
    found = []
    for _ in range(1500):
        noisy = {
            name: getattr(landmarks, name) + sigma * rng.standard_normal(getattr(landmarks, name).shape)
            for name in ("length", "edge_left", "edge_right", "circle")
        }
        pose = pose_from_landmarks(dataclasses.replace(landmarks, **noisy), "back", SHAPE)
        found.append([*pose.origin, pose.roll, pose.scale])
    told = pose_uncertainty(landmarks, sigma)
    scatter = np.std(found, axis=0)
    np.testing.assert_allclose([*told.origin, told.roll, told.scale], scatter, rtol=0.08)
    # By hand: two points 160 px apart for the roll, 150 px for the scale, both with sigma sqrt(2).
    assert told.roll == pytest.approx(sigma * np.sqrt(2.0) / 160.0, rel=1e-3)
    assert told.scale == pytest.approx(0.4 * sigma * np.sqrt(2.0) / 150.0, rel=1e-3)
    assert told.origin.max() < 0.2


def test_checks_see_what_the_pose_does_not_use() -> None:
    landmarks = known_landmarks("back")
    shifted = dataclasses.replace(landmarks, edge_right=landmarks.edge_right + np.array([0.0, 1.0]))
    checks = landmark_checks(shifted, pose_from_landmarks(shifted, "back", SHAPE), SPECIMEN)
    across = 0.4 * np.cos(0.02)
    assert checks.width_mm == pytest.approx(25.0 + across, abs=1e-9)
    assert checks.width_error == pytest.approx(across / 25.0, abs=1e-9)
    assert checks.centre_offset_mm == pytest.approx(-0.5 * across, abs=1e-9)


def test_wrong_length_contradicts_the_width() -> None:
    landmarks = dataclasses.replace(known_landmarks("back"), length_mm=64.0)
    with pytest.raises(DataError, match=r"26.67 mm apart.*gauge_width_mm is 25"):
        landmark_checks(landmarks, pose_from_landmarks(landmarks, "back", SHAPE), SPECIMEN)


L = known_landmarks("back")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"circle": np.array([[99.0, 37.0], [119.0, 47.0], [139.0, 57.1]])}, r"circle': the three points lie on a line"),
        ({"circle": np.array([[99.0, 37.0], [99.2, 37.3], [139.0, 57.0]])}, r"circle': points p1 and p2 coincide"),
        ({"length": np.array([[50.0, 40.0], [50.3, 40.3]])}, r"length': points p1 and p2 coincide"),
        ({"edge_left": np.array([[50.0, 12.0], [50.0, 12.9]])}, r"edge_left': points p1 and p2 coincide"),
        ({"edge_left": np.array([[50.0, 12.0], [218.0, 11.0]])}, r"edge_left.p2' is \[218, 11\], outside the frame of 218 rows x 90"),
        ({"edge_right": np.array([-1.0, 74.0])}, r"edge_right.p1' is \[-1, 74\], outside"),
        ({"edge_right": np.array([np.nan, 74.0])}, r"edge_right.p1' is \[nan, 74\], outside"),
        ({"edge_left": np.array([[50.0, 12.0], [54.0, 80.0]])}, r"edge_left' makes an angle of -?8\d deg"),
        ({"edge_right": L.edge_left[0] - [3.0, 5.0]}, r"left of edge_left, which contradicts the declared side 'back'"),
        ({"edge_left": L.edge_left + np.array([0.0, 63.0]), "edge_right": L.edge_right - [0.0, 60.0]}, r"contradicts the declared side"),
    ],
)
def test_contradictory_landmarks_are_refused(change: dict[str, np.ndarray], match: str) -> None:
    with pytest.raises(DataError, match=match) as caught:
        pose_from_landmarks(dataclasses.replace(L, **change), "back", SHAPE)
    assert "\n" not in str(caught.value)


def test_unknown_side_is_refused() -> None:
    with pytest.raises(DataError, match=r"ir.side' is 'top'"):
        pose_from_landmarks(L, "top", SHAPE)


def test_agrees_with_the_virtual_camera() -> None:
    """The virtual laboratory has a projection of its own: picked without error its pose comes back to the rounding of the picks."""
    from thermofit.study.virtual import VirtualIr
    from thermofit.virtual.infrared import camera_pose, pick_landmarks, to_pixel

    settings_ = VirtualIr(landmark_noise_px=0.0, roll_deg=-1.7)
    true = camera_pose(settings_, 3)
    pose = pose_from_landmarks(pick_landmarks(true, SPECIMEN, settings_, 3), "back", settings_.image_shape)
    xy = np.array([[0.0, 0.0], [12.0, 40.0], [-12.0, -40.0], [12.0, -30.0]])
    assert np.abs(specimen_to_pixel(pose, xy) - to_pixel(true, xy)).max() < 0.2
