"""Check picture: the outline is the dogbone of the specimen, and the file holds what was drawn."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from thermofit.body.mesh.dogbone import half_width
from thermofit.core.experiment import Landmarks, Specimen
from thermofit.observe.camera import make_pose
from thermofit.observe.check_picture import draw_check_picture, specimen_outline

SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
POSE = make_pose(0.4, np.array([118.0, 44.0]), np.array([-1.0, 0.02]), "back")


def test_outline_is_the_dogbone() -> None:
    outline = specimen_outline(SPECIMEN)
    np.testing.assert_array_equal(outline[0], outline[-1])
    np.testing.assert_allclose(np.abs(outline).max(axis=0), [17.5, 75.0])
    side = np.abs(outline[:, 0]) > 0.0
    np.testing.assert_allclose(np.abs(outline[side, 0]), half_width(SPECIMEN, outline[side, 1]), atol=1e-9)
    # The area says that the polygon goes round once and does not cross itself.
    x, y = outline.T
    area = 0.5 * abs(float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum()))
    wanted = float(np.trapezoid(2.0 * half_width(SPECIMEN, np.linspace(-75, 75, 20001)), dx=150.0 / 20000))
    assert area == pytest.approx(wanted, rel=1e-3)


def test_outline_without_shoulders_is_a_strip() -> None:
    strip = Specimen(20.0, 1.0, 80.0, 25.0, 20.0, 100.0, 10.0)
    np.testing.assert_allclose(np.abs(specimen_outline(strip)[:, 0]), 10.0)


@pytest.mark.parametrize("shape", [(218, 90), (60, 120)])
@pytest.mark.parametrize("contrast", [0.0, 1.0])
def test_writes_a_picture(tmp_path: Path, shape: tuple[int, int], contrast: float) -> None:
    frame = np.full(shape, 297.0)
    frame[:, 15:75] += contrast
    marks = np.array([[10.0, 20.0], [50.0, 21.0], [30.0, 40.0]])
    path = tmp_path / "figures" / "check.png"
    assert draw_check_picture(path, frame, POSE, SPECIMEN, Landmarks(0, marks[:2], 16.0, marks[:2], marks[2], marks)) == path
    drawn = imread(path)
    assert drawn.shape[0] > 500 and np.ptp(drawn[..., :3]) > 0.9
    # Cyan of the outline and red of the length marks are there; nothing else is left in the folder.
    assert (np.abs(drawn[..., :3] - [0.0, 1.0, 1.0]).max(axis=-1) < 0.05).sum() > 50
    assert (np.abs(drawn[..., :3] - [1.0, 0.0, 0.0]).max(axis=-1) < 0.05).sum() > 10
    assert [p.name for p in path.parent.iterdir()] == ["check.png"]


def test_landmarks_are_optional(tmp_path: Path) -> None:
    assert draw_check_picture(tmp_path / "check.png", np.full((50, 40), 300.0), POSE, SPECIMEN).stat().st_size > 1000
