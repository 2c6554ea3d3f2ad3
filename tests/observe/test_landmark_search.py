"""Landmarks found without a click: the pose of synthetic frames is met, given ones are compared, a hand may pick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from seen_test import SHAPE, SPECIMEN, frame_of, landmarks_of, pose_at

from thermofit.core.errors import StudyError
from thermofit.observe.camera import landmark_checks, make_pose, pose_from_landmarks
from thermofit.observe.landmark_search import disagreement, landmarks_from, propose
from thermofit.observe.picking import POINTS, pick


@pytest.mark.parametrize("side", ["front", "back"])
@pytest.mark.parametrize(("warm", "roll"), [(2.0, 1.1), (-0.6, -2.5), (0.4, 0.0)])
def test_edges_and_shoulders_give_the_pose(side: str, warm: float, roll: float) -> None:
    """To a tenth of a pixel, by frames whose specimen is warmer or colder than the background."""
    true = pose_at(side, roll)
    found = propose(frame_of(true, SPECIMEN, warm=warm), SPECIMEN, side)
    assert found.pose is not None and found.shoulders and found.pose.side == side
    assert np.abs(found.pose.origin - true.origin).max() < 0.3
    assert abs(np.degrees(found.pose.roll - true.roll)) < 0.02 and abs(found.pose.scale / true.scale - 1.0) < 2e-3
    across, along = disagreement(true, found, SPECIMEN)
    assert across < 0.1 and along < 0.3


def test_landmarks_from_a_pose_give_it_back() -> None:
    true = pose_at()
    marks = landmarks_from(true, SPECIMEN, 0, SHAPE)
    again = pose_from_landmarks(marks, "back", SHAPE)
    np.testing.assert_allclose(again.origin, true.origin, atol=1e-9)
    assert again.scale == pytest.approx(true.scale) and again.roll == pytest.approx(true.roll)
    assert landmark_checks(marks, again, SPECIMEN).width_error == pytest.approx(0.0, abs=1e-9)


def test_without_a_shoulder_only_the_edges_are_known() -> None:
    """A longer specimen fills the frame: scale, roll and mid-line are found, and it is said that nothing tells the middle."""
    long, true = replace(SPECIMEN, parallel_length=130.0, total_length=200.0), pose_at()
    found = propose(frame_of(true, long), long, "back")
    assert found.pose is not None and not found.shoulders
    across, along = disagreement(true, found, long)
    assert across < 0.1 and np.isnan(along)


@pytest.mark.parametrize("frame", [np.full(SHAPE, 296.0), 296.0 + 0.03 * np.random.default_rng(1).normal(size=SHAPE)])
def test_nothing_is_found_in_an_empty_frame(frame: np.ndarray) -> None:
    found = propose(frame, SPECIMEN, "back")
    assert found.pose is None and "edges" in found.reason


def test_a_shifted_hand_is_noticed() -> None:
    true = pose_at()
    found = propose(frame_of(true, SPECIMEN), SPECIMEN, "back")
    off = make_pose(true.scale, true.origin + np.array([3.0, 4.0]), true.axis_y, "back")
    across, along = disagreement(off, found, SPECIMEN)
    assert across == pytest.approx(4.0, abs=0.3) and along == pytest.approx(3.0, abs=0.3)


def test_a_hand_picks_eight_points() -> None:
    """What is clicked as (column, row) are landmarks [row, col]; a window closed early, or none at all, is one sentence."""
    true = pose_at()
    marks = landmarks_of(true, SPECIMEN)
    px = [*marks.length, *marks.edge_left, marks.edge_right, *marks.circle]

    def clicks(frame: np.ndarray, texts: Sequence[str]) -> list[tuple[float, float]]:
        assert frame.shape == SHAPE and frame.max() < 100.0 and len(texts) == len(POINTS) == 8
        return [(float(p[1]), float(p[0])) for p in px]

    frame = frame_of(true, SPECIMEN)
    section = pick(frame, 60.0, clicks)
    assert section["length"] == {"length_mm": 60.0, "p1": [round(v, 2) for v in px[0]], "p2": [round(v, 2) for v in px[1]]}
    assert set(section["circle"]) == {"p1", "p2", "p3"} and section["edge_right"]["p1"] == [round(v, 2) for v in px[4]]
    with pytest.raises(StudyError, match="2 of 8 points"):
        pick(frame, 60.0, lambda frame, texts: [(1.0, 1.0), (2.0, 2.0)])


def test_without_a_display_there_is_no_window(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(StudyError, match="no display"):
        pick(frame_of(pose_at(), SPECIMEN), 60.0)
