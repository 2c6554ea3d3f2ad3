"""What an error of measured displacements does to temperatures: a pixel is given to the point that is said to be there."""

from __future__ import annotations

import numpy as np
import pytest
from virtual_pulls import TRUTH, model, study

from thermofit.core.parameters import Parameters
from thermofit.experiment.instruments import carried
from thermofit.observe.stations import scene_of

XY = np.stack(np.meshgrid(np.linspace(-6.0, 6.0, 7), np.linspace(-20.0, 20.0, 21)), axis=-1).reshape(-1, 2)
STRETCH = np.array([1.0, 1.05, 1.18])


def image(x: np.ndarray) -> np.ndarray:
    """Temperature in K at places x (..., 2) mm before the camera."""
    return np.asarray(300.0 + 0.04 * x[..., 0] + 0.3 * x[..., 1])


@pytest.mark.parametrize("error", [4e-3, -1e-2])
def test_a_pixel_is_given_to_the_point_that_is_said_to_be_there(error: float) -> None:
    """An image that is read at X + (1 + e) u in the stead of X + u: exact where it is linear and the bar keeps its volume."""
    u = np.stack([np.outer(STRETCH**-0.5 - 1.0, XY[:, 0]), np.outer(STRETCH - 1.0, XY[:, 1])], axis=-1)
    scene = scene_of(np.arange(3.0), XY, u, np.arange(3.0), 297.0)
    read = image(XY + (1.0 + error) * u)
    assert np.allclose(image(XY + u) + carried(image(XY + u), scene, error * u), read, rtol=0.0, atol=1e-9)
    assert np.abs(read - image(XY + u)).max() > 4e-3


@pytest.mark.parametrize("name", ["dic_scale.error", "dic_out_of_plane.strain", "dic_tilt.along"])
def test_temperatures_feel_the_cameras_of_displacements(name: str) -> None:
    """Slopes of all channels by a Param of these against differences of the whole run, at neutral and away from it, with a camera that lies
    beside besides; and those by a parameter of the material there."""
    joint = model(study())
    for value, shift in ((0.0, 0.0), (2e-3 if "tilt" not in name else 2e-5, 0.4)):
        at = Parameters.of({**TRUTH, name: value, "ir_registration.shift_y": shift}).with_free((name, "kappa"))
        _, slopes = joint.linearised(at, at.free)
        for k, (free, step) in enumerate(((name, 1e-5 if "tilt" not in name else 1e-7), ("kappa", 0.5))):
            ahead, behind = (joint.residual(at.replace(**{free: at[free] + s * step})) for s in (1.0, -1.0))
            found = (ahead - behind) / (2.0 * step)
            assert np.abs(slopes[:, k] - found).max() < 2e-3 * np.abs(found).max()
            heat = [c.channel for c in joint.comparisons].index("dtheta")
            ends = np.cumsum([c.n for c in joint.comparisons])
            own = slice(ends[heat] - joint.comparisons[heat].n, ends[heat])
            assert np.abs(slopes[own, k] - found[own]).max() < 5e-3 * np.abs(found[own]).max() and np.abs(found[own]).max() > 0.0
