"""Effects between the specimen and what is seen of it, and its motion: closed forms, exactly off at neutral, all in the stated unit."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.core.parameters import Parameters
from thermofit.effects.catalogue import KINEMATICS, MEASUREMENT, Effect, effect, effects
from thermofit.effects.scene import Scene
from thermofit.observe.stations import scene_of, seen_along

X, Y = np.meshgrid(np.linspace(-10.0, 10.0, 6), np.linspace(-20.0, 20.0, 9))
XY = np.stack([X.ravel(), Y.ravel()], axis=1)
TIME = np.array([2.0, 3.0, 5.0, 9.0, 10.0])
STRETCH = np.array([0.0, 0.01, 0.03, 0.08, 0.07])
U = np.stack([-0.4 * STRETCH[:, None] * XY[:, 0], STRETCH[:, None] * XY[:, 1]], axis=-1)
AIR = 297.0
THETA = 300.0 + 0.1 * XY[:, 0] - 0.2 * XY[:, 1] + np.linspace(0.0, 2.0, 5)[:, None]
SCENE: Scene = scene_of(TIME, XY, U, np.array([0.0, 1000.0, 3000.0, 4000.0, 0.0]), AIR)
MEASURING = effects((*KINEMATICS, *MEASUREMENT))
OF_DISPLACEMENT = ("kinematics", "camera")


def acted(name: str, *values: float) -> np.ndarray:
    e = effect(name)
    out: np.ndarray = e.act(U if e.slot in OF_DISPLACEMENT else THETA, SCENE, *values)
    return out


@pytest.mark.parametrize("e", MEASURING, ids=lambda e: e.name)
def test_neutral_is_exactly_off_and_the_probe_is_plainly_visible(e: Effect) -> None:
    one = e
    field = U if one.slot in OF_DISPLACEMENT else THETA
    neutral = [p.neutral for p in one.params]
    off = one.act(field, SCENE, *neutral)
    # Straight lines between times give the last one by way of the last but one: to the last digit.
    assert np.array_equal(off, field) if one.name != "ir_clock" else np.allclose(off, field, rtol=1e-15, atol=0.0)
    assert one.amplitude.probe is not None
    seen = one.act(field, SCENE, one.amplitude.probe, *neutral[1:])
    noise = 2e-3 if one.slot in OF_DISPLACEMENT else 2e-2
    assert np.abs(seen - field).max() > 0.25 * noise
    assert one.amplitude.lower <= one.amplitude.probe <= one.amplitude.upper


@pytest.mark.parametrize("e", MEASURING, ids=lambda e: e.name)
def test_derivative_by_complex_step_is_that_of_differences(e: Effect) -> None:
    one = e
    field = U if one.slot in OF_DISPLACEMENT else THETA
    at = Parameters.of({p.name: 0.3 * p.probe if p.probe is not None else p.neutral for p in one.params})
    for p in one.params:
        h = 1e-4 * (p.probe or p.scale)
        there, back = (one.act(field, SCENE, *(at[n] + x * (n == p.name) for n in one.names)) for x in (h, -h))
        found = seen_along(field, np.zeros_like(field), SCENE, (one,), at, p.name)
        expected = (there - back) / (2.0 * h)
        assert np.abs(found - expected).max() < 1e-5 * np.abs(expected).max() + 1e-12 * np.abs(field).max() / h, p.name


def test_drift_gain_and_offset_of_the_sensor() -> None:
    assert np.allclose(acted("ir_drift", 0.01), THETA + 0.01 * np.array([0.0, 1.0, 3.0, 7.0, 8.0])[:, None])
    assert np.allclose(acted("ir_gain", 0.1), THETA + 0.1 * (THETA - AIR))


def test_clock_and_lag_of_the_sensor() -> None:
    between = acted("ir_clock", 0.5)
    assert np.allclose(between[1], THETA[1] + 0.25 * (THETA[2] - THETA[1]))
    assert np.allclose(between[-1], THETA[-1])
    lag = acted("ir_lag", 0.5)
    assert np.array_equal(lag[0], THETA[0])
    rate = (THETA[1] - THETA[0]) / 1.0
    assert np.allclose(lag[1], THETA[1] - 0.5 * rate * (1.0 - np.exp(-2.0)))


def test_emissivity_grows_with_the_strain_along_the_load() -> None:
    assert np.allclose(acted("ir_emissivity", 0.5), THETA + 0.5 * np.log1p(STRETCH)[:, None] * (THETA - AIR), atol=1e-10)


def test_reflection_grows_in_time_and_towards_one_end() -> None:
    share = np.array([0.0, 1.0, 3.0, 7.0, 8.0])[:, None] / 8.0
    y = XY[:, 1] * (1.0 + STRETCH[:, None])
    assert np.allclose(acted("ir_reflection", 0.6, 0.02), THETA + 0.6 * (1.0 + 0.02 * y) * share)
    # Its tilt, without which it is a drift of the camera, is fitted once its strength is known.
    assert [p.name for p in effect("ir_reflection").exponents] == ["ir_reflection.tilt"]


def test_registration_shifts_rotates_and_scales_the_picture() -> None:
    """theta = 300 + 0.1 x - 0.2 y + ...: its gradient is (0.1, -0.2) 1/mm."""
    x, y = XY[:, 0] * (1.0 - 0.4 * STRETCH[:, None]), XY[:, 1] * (1.0 + STRETCH[:, None])
    assert np.allclose(acted("ir_registration", 0.5, 0.0, 0.0, 0.0), THETA - 0.2 * 0.5)
    assert np.allclose(acted("ir_registration", 0.0, 0.5, 0.0, 0.0), THETA + 0.1 * 0.5)
    assert np.allclose(acted("ir_registration", 0.0, 0.0, 0.02, 0.0), THETA + 0.02 * (-0.1 * y - 0.2 * x))
    assert np.allclose(acted("ir_registration", 0.0, 0.0, 0.0, 0.03), THETA + 0.03 * (0.1 * x - 0.2 * y))


def test_displacements_are_scaled_by_calibration_and_by_motion_towards_the_camera() -> None:
    assert np.allclose(acted("dic_scale", 0.02), 1.02 * U)
    share = np.array([0.0, 0.25, 0.75, 1.0, 0.0])[:, None, None]
    assert np.allclose(acted("dic_out_of_plane", 1e-3), U + 1e-3 * share * (XY + U))


def test_bending_is_a_field_without_shear_whose_strain_grows_across() -> None:
    k, nu = 1e-5, 0.3
    still = scene_of(TIME, XY, 0.0 * U, np.array([0.0, 1000.0, 3000.0, 4000.0, 0.0]), AIR)
    bent = effect("bending").act(0.0 * U, still, k, nu)
    x, y = XY[:, 0], XY[:, 1]
    assert np.allclose(bent[3], np.stack([-0.5 * k * (y**2 + nu * x**2), k * x * y], axis=1), atol=1e-18)
    assert np.allclose(bent[1], 0.25 * bent[3]) and not bent[[0, 4]].any(), "in proportion to the load"
    grid = bent[3].reshape(*X.shape, 2)
    strain_y = (grid[2:, :, 1] - grid[:-2, :, 1]) / (Y[2:] - Y[:-2])
    strain_x = (grid[:, 2:, 0] - grid[:, :-2, 0]) / (X[:, 2:] - X[:, :-2])
    shear = (grid[2:, 1:-1, 0] - grid[:-2, 1:-1, 0]) / (Y[2:] - Y[:-2])[:, 1:-1] + (grid[1:-1, 2:, 1] - grid[1:-1, :-2, 1]) / (
        X[:, 2:] - X[:, :-2]
    )[1:-1]
    assert np.allclose(strain_y, k * X[1:-1]) and np.allclose(strain_x, -nu * k * X[:, 1:-1]) and np.abs(shear).max() < 1e-18


def test_bending_is_odd_across_the_load_which_the_quarter_model_is_not() -> None:
    still = scene_of(TIME, XY, 0.0 * U, np.full(5, 1.0), AIR)
    u_y = effect("bending").act(0.0 * U, still, 1e-5, 0.33)[0, :, 1].reshape(X.shape)
    assert np.allclose(u_y, -u_y[:, ::-1])
