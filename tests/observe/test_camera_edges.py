"""Refinement of the pose from the edges: synthetic frames with blur and noise of known pose."""

import dataclasses

import numpy as np
import pytest
from scipy.special import ndtr

from thermofit.core.experiment import Specimen
from thermofit.observe.camera import CameraPose, make_pose, pixel_coordinates
from thermofit.observe.camera_edges import pixel_noise, refine_pose

SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
SHAPE = (218, 90)
NETD = 0.025


def pose_of(origin: tuple[float, float], roll: float, side: str = "back") -> CameraPose:
    return make_pose(0.4, np.array(origin), np.array([-np.cos(roll), np.sin(roll)]), side)


TRUE = pose_of((118.0, 44.3), np.deg2rad(1.1))


def frame_of(
    pose: CameraPose, contrast: float | np.ndarray, seed: int = 0, blur_px: float = 0.8, background_slope: float = 0.0
) -> np.ndarray:
    """Frame K of a straight strip: both edges are normal distribution functions of width `blur_px`; white noise on top."""
    rng = np.random.default_rng(seed)
    x = pixel_coordinates(pose, SHAPE)[..., 0]
    share = ndtr((12.5 - np.abs(x)) / (blur_px * pose.scale))
    background = 297.0 + background_slope * (np.arange(SHAPE[1]) - 45.0)
    return background + share * contrast + NETD * rng.standard_normal(SHAPE)


def error(found: CameraPose, true: CameraPose) -> tuple[float, float]:
    """Error of the origin across the specimen in px and of the roll in deg."""
    across = np.array([true.axis_y[1], -true.axis_y[0]])
    return abs(float((found.origin - true.origin) @ across)), abs(np.degrees(found.roll - true.roll))


@pytest.mark.parametrize("side", ["front", "back"])
@pytest.mark.parametrize("contrast", [0.3, -0.3, 5.0])
def test_recovers_offset_and_roll(side: str, contrast: float) -> None:
    true = pose_of((118.0, 44.3), np.deg2rad(1.1), side)
    for seed, (offset, turn) in enumerate([(0.5, 0.2), (-0.8, -0.15), (0.1, 0.0)]):
        start = pose_of((118.0, 44.3 + offset), np.deg2rad(1.1 + turn), side)
        found = refine_pose(start, frame_of(true, contrast, seed), SPECIMEN, NETD)
        assert found.pose is not None and found.reason == ""
        assert found.pose.side == side and found.pose.scale == start.scale
        shift, roll = error(found.pose, true)
        assert shift < 0.1 and roll < 0.05
        assert found.shift_px == pytest.approx(-offset, abs=0.1)
        assert np.degrees(found.roll_change) == pytest.approx(-turn, abs=0.05)
        assert found.width_mm == pytest.approx(25.0, abs=0.08)


def test_reported_scatter_is_the_true_error() -> None:
    """Over many noise seeds: the root mean square error is what the refinement says of itself."""
    errors, told = [], []
    for seed in range(40):
        found = refine_pose(TRUE, frame_of(TRUE, 0.4, seed), SPECIMEN, NETD)
        assert found.pose is not None
        errors.append([found.shift_px, found.roll_change])
        told.append([found.sigma_shift_px, found.sigma_roll])
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / np.mean(told, axis=0)
    assert (ratio > 0.7).all() and (ratio < 1.4).all()
    assert np.sqrt(np.mean(np.square(errors), axis=0))[0] < 0.03


def test_scale_error_of_the_landmarks_does_not_move_the_middle() -> None:
    start = dataclasses.replace(TRUE, scale=0.4 * 1.01)
    found = refine_pose(start, frame_of(TRUE, 0.5), SPECIMEN, NETD)
    assert found.pose is not None
    assert error(found.pose, TRUE)[0] < 0.1
    assert found.width_mm == pytest.approx(25.25, abs=0.08)


def test_slope_of_the_background_does_not_move_the_middle() -> None:
    frame = np.mean([frame_of(TRUE, 0.4, seed, background_slope=0.004) for seed in range(10)], axis=0)
    found = refine_pose(TRUE, frame, SPECIMEN)
    assert found.pose is not None
    assert error(found.pose, TRUE)[0] < 0.05


def test_contrast_that_changes_sign_along_the_specimen() -> None:
    """Rows without contrast are left out, the others still fix the line."""
    contrast = np.linspace(-1.5, 1.5, SHAPE[0])[:, None]
    start = pose_of((118.0, 44.8), np.deg2rad(1.3))
    found = refine_pose(start, frame_of(TRUE, contrast), SPECIMEN, NETD)
    assert found.pose is not None and found.n_used[0] < 26
    shift, roll = error(found.pose, TRUE)
    assert shift < 0.1 and roll < 0.05


@pytest.mark.parametrize("contrast", [0.0, 0.1, -0.2])
def test_refuses_weak_contrast(contrast: float) -> None:
    for seed in range(5):
        found = refine_pose(TRUE, frame_of(TRUE, contrast, seed), SPECIMEN, NETD)
        assert found.pose is None and "contrast" in found.reason and "noise" in found.reason


def test_refuses_a_strip_of_another_width() -> None:
    wide = dataclasses.replace(SPECIMEN, gauge_width=26.6)
    found = refine_pose(TRUE, frame_of(TRUE, 1.0), wide, NETD)
    assert found.pose is None and "mm apart" in found.reason


def test_refuses_an_edge_that_is_not_straight() -> None:
    """Waves of 2 px along one edge (a wrapped thermocouple, a neck) are no edge to calibrate with."""
    x = pixel_coordinates(TRUE, SHAPE)
    wave = 0.8 * np.sin(0.35 * x[..., 1])
    frame = 297.0 + ndtr((12.5 + wave - np.abs(x[..., 0])) / 0.32)
    found = refine_pose(TRUE, frame, SPECIMEN, NETD)
    assert found.pose is None and "scatter" in found.reason


def test_refuses_edges_outside_the_frame() -> None:
    found = refine_pose(pose_of((118.0, 20.0), 0.0), np.full(SHAPE, 297.0), SPECIMEN, NETD)
    assert found.pose is None and "seen over 0 px" in found.reason


def test_pixel_noise_is_not_fooled_by_a_gradient() -> None:
    frame = 290.0 + 0.3 * np.arange(SHAPE[0])[:, None] + NETD * np.random.default_rng(1).standard_normal(SHAPE)
    assert pixel_noise(frame) == pytest.approx(NETD, rel=0.05)
