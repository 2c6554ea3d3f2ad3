"""Observation points: face nodes in the window and their mirror images, axis nodes once."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from thermofit.core.errors import StudyError
from thermofit.core.experiment import DicField, Specimen
from thermofit.observe.observation_points import observation_points, observed_window, reach_of
from thermofit.study.models import EvaluationWindow


def face() -> tuple[np.ndarray, np.ndarray]:
    """Quarter face 5 x 7 nodes, x 0 to 12 mm, y -30 to 30 mm, as every second node of a body."""
    x, y = np.meshgrid(np.linspace(0.0, 12.0, 5), np.linspace(-30.0, 30.0, 7))
    nodes = np.zeros((70, 3))
    nodes[::2, 0], nodes[::2, 1], nodes[::2, 2] = x.ravel(), y.ravel(), 0.75
    return nodes, np.arange(0, 70, 2)


def test_window_and_mirror_images() -> None:
    nodes, ids = face()
    points = observation_points(nodes, ids, 9.0, 20.0)
    # x in {0, 3, 6, 9}, y in {-20, ..., 20}: 20 nodes, 15 of them off the axis.
    assert len(points.node) == 35
    assert (points.mirror == -1.0).sum() == 15
    np.testing.assert_array_equal(nodes[points.node, 1], points.xy[:, 1])
    np.testing.assert_array_equal(nodes[points.node, 0] * points.mirror, points.xy[:, 0])
    assert len(np.unique(points.xy, axis=0)) == 35
    assert np.abs(points.xy).max(axis=0).tolist() == [9.0, 20.0]
    np.testing.assert_allclose(points.xy[:, 0].sum(), 0.0)


def test_axis_node_with_rounding_error_counts_once() -> None:
    nodes = np.array([[1e-15, 0.0, 0.5], [5.0, 0.0, 0.5]])
    assert observation_points(nodes, np.array([0, 1]), 6.0, 1.0).mirror.tolist() == [1.0, 1.0, -1.0]


def test_empty_window_names_the_window() -> None:
    nodes, ids = face()
    with pytest.raises(StudyError, match="none of the 35 nodes"):
        observation_points(nodes[:, :] + np.array([0.0, 3.0, 0.0]), ids, 9.0, 1.0)


def test_full_model_is_refused() -> None:
    nodes, ids = face()
    with pytest.raises(StudyError, match="quarter model"):
        observation_points(nodes - np.array([6.0, 0.0, 0.0]), ids, 9.0, 20.0)


def field_of(x: float, y: float, lost: float = 0.0) -> DicField:
    """Points over |x| <= x, |y| <= y mm; those beyond `lost` of y are there in one stage of four."""
    place = np.stack([g.ravel() for g in np.meshgrid(np.linspace(-x, x, 9), np.linspace(-y, y, 21), [0.0])], axis=1)
    moved = np.zeros((4, len(place), 3))
    if lost:
        moved[1:, np.abs(place[:, 1]) > lost] = np.nan
    return DicField(np.arange(4.0), np.arange(len(place)), place, moved)


THESIS = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)


@pytest.mark.parametrize(
    ("specimen", "field", "straight", "window"),
    [
        (THESIS, field_of(11.5, 25.0), True, (11.0, 20.0)),
        (dataclasses.replace(THESIS, gauge_width=12.5, parallel_length=50.0), field_of(5.9, 24.0), True, (5.5, 10.0)),
        (THESIS, field_of(8.0, 12.0), True, (8.0, 12.0)),
        (THESIS, field_of(8.0, 12.0, lost=7.3), True, (8.0, 7.2)),
        (THESIS, field_of(24.0, 60.0), False, (24.0, 60.0)),
    ],
)
def test_the_window_follows_from_specimen_and_data(
    specimen: Specimen, field: DicField, straight: bool, window: tuple[float, float]
) -> None:
    assert observed_window(EvaluationWindow(), specimen, straight, reach_of(field)) == pytest.approx(window)
    given = EvaluationWindow(abs_y_max=3.0)
    assert observed_window(given, specimen, straight, reach_of(field)) == pytest.approx((window[0], 3.0))
