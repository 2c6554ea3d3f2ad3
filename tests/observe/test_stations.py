"""The measuring chain: gradients at scattered points, fields at other times, order of the stations, derivatives by complex step."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.core.errors import DataError
from thermofit.core.parameters import Parameters
from thermofit.effects.scene import Scene
from thermofit.observe.stations import CAMERA, INFRARED, chain, gradients, scene_of, seen, seen_along

RNG = np.random.default_rng(11)
XY = RNG.uniform([-10.0, -20.0], [10.0, 20.0], (40, 2))
TIME = np.array([0.0, 1.0, 2.5, 4.0, 7.0, 8.0])
U = 1e-3 * RNG.normal(size=(6, 40, 2)).cumsum(axis=0)
LOAD = np.array([0.0, 100.0, 300.0, 400.0, 400.0, 50.0])
THETA = 297.0 + RNG.normal(size=(6, 40)).cumsum(axis=0)
OFF = Parameters.of({})
ON = OFF.replace(
    **{
        **{"ir_drift.rate": 1e-3, "ir_gain.gain": 0.05, "ir_clock.offset": 0.31, "ir_lag.time": 0.7, "ir_emissivity.slope": 0.5},
        **{"ir_reflection.strength": 0.5, "ir_registration.rotation": 0.02},
    }
)


def scene(xy: np.ndarray = XY, u: np.ndarray = U) -> Scene:
    return scene_of(TIME, xy, u, LOAD, 297.5)


@pytest.mark.parametrize("n", [3, 5, 40])
def test_gradients_are_exact_for_linear_fields(n: int) -> None:
    xy = XY[:n]
    by_x, by_y = gradients(xy)
    field = 3.0 + 0.7 * xy[:, 0] - 0.2 * xy[:, 1]
    assert np.allclose(by_x @ field, 0.7, atol=1e-11)
    assert np.allclose(by_y @ field, -0.2, atol=1e-11)
    assert np.abs(by_x @ np.ones(n)).max() < 1e-13


def test_gradients_converge_for_smooth_fields() -> None:
    """First order at the rim of a grid, so that half the spacing halves the error."""
    errors = []
    for n in (11, 21):
        x, y = np.meshgrid(np.linspace(-1.0, 1.0, n), np.linspace(-1.0, 1.0, n))
        xy = np.stack([x.ravel(), y.ravel()], axis=1)
        errors.append(np.abs(gradients(xy)[1] @ np.sin(2.0 * xy[:, 1]) - 2.0 * np.cos(2.0 * xy[:, 1])).max())
    assert errors[1] < 0.6 * errors[0]


def test_one_point_has_no_gradient_and_a_line_is_refused() -> None:
    by_x, by_y = gradients(XY[:1])
    assert not by_x.toarray().any() and not by_y.toarray().any()
    with pytest.raises(DataError, match="lie on a line; widen the evaluation window"):
        gradients(np.array([[1.0, 1.0], [2.0, 2.0], [4.0, 4.0]]))


def test_scene_knows_position_strain_and_share_of_the_load() -> None:
    stretch = np.linspace(0.0, 0.1, 6)
    u = np.stack([np.zeros((6, 40)), stretch[:, None] * XY[:, 1]], axis=-1)
    s = scene(u=u)
    assert np.allclose(s.position, XY + u)
    assert np.allclose(s.strain, np.log1p(stretch)[:, None], atol=1e-12)
    assert np.allclose(s.load, LOAD / 400.0)
    assert not scene_of(TIME, XY, u, np.zeros(6), 297.0).load.any(), "a test without load has no share of it"


def test_later_is_exact_for_what_is_straight_between_the_times() -> None:
    field = np.stack([2.0 * TIME, np.interp(TIME, [0.0, 2.5, 8.0], [0.0, 5.0, -6.0])], axis=1)
    s = scene()
    assert np.array_equal(s.later(field, 0.0)[:-1], field[:-1])
    assert np.allclose(s.later(field, 0.0), field, rtol=1e-15)
    inside = s.later(field, 0.6)
    for k, t in enumerate(np.minimum(TIME + 0.6, 8.0)):
        assert inside[k] == pytest.approx([2.0 * t, np.interp(t, [0.0, 2.5, 8.0], [0.0, 5.0, -6.0])])
    assert np.allclose(s.later(field, -100.0), field[0]) and np.allclose(s.later(field, 100.0), field[-1]), "at rest before and after"


@pytest.mark.parametrize("tau", [0.05, 0.9, 30.0])
def test_lagged_is_the_response_to_a_ramp(tau: float) -> None:
    """field = a t: the sensor is behind by a tau (1 - exp(-t / tau)); a field at rest is seen as it is."""
    field = np.stack([3.0 * TIME, np.full(6, 300.0)], axis=1)
    found = scene().lagged(field, tau)
    assert np.allclose(found[:, 0], 3.0 * TIME - 3.0 * tau * (1.0 - np.exp(-TIME / tau)), rtol=1e-12)
    assert np.array_equal(found[:, 1], field[:, 1])
    assert np.array_equal(scene().lagged(field, 0.0), field)


def test_lagged_satisfies_its_equation_for_any_field() -> None:
    """Against fine steps of the backward Euler rule."""
    fine = np.linspace(0.0, 8.0, 80001)
    field = np.interp(fine, TIME, THETA[:, 0])
    s, dt = field[0], fine[1]
    out = [s]
    for value in field[1:]:
        s = (s + dt / 0.7 * value) / (1.0 + dt / 0.7)
        out.append(s)
    assert np.interp(TIME, fine, out) == pytest.approx(scene().lagged(THETA[:, :1], 0.7)[:, 0], abs=2e-4)


def test_chain_holds_what_is_on_or_free_in_the_order_of_the_stations() -> None:
    assert chain(INFRARED, OFF) == () and chain(CAMERA, ON) == ()
    assert [e.name for e in chain(INFRARED, ON)] == [
        *("ir_emissivity", "ir_reflection", "ir_registration"),
        *("ir_clock", "ir_drift", "ir_gain", "ir_lag"),
    ]
    assert [e.name for e in chain(INFRARED, OFF.with_free(["ir_gain.gain"]))] == ["ir_gain"]
    assert [e.name for e in chain(CAMERA, OFF.replace(**{"dic_scale.error": 0.1}))] == ["dic_scale"]
    assert chain(INFRARED, OFF.replace(**{"ir_registration.shift_x": 0.1})), "any shift, not the first alone"
    assert seen(THETA, scene(), (), OFF) is THETA


def test_chain_acts_in_its_order() -> None:
    """A drift of the sensor is magnified by no gain of the optics before it, a reflection is by the gain after it."""
    both = OFF.replace(**{"ir_reflection.strength": 1.0, "ir_gain.gain": 0.5})
    found = seen(THETA, scene(), chain(INFRARED, both), both)
    seen_at_last = THETA[-1] + 1.0
    assert np.allclose(found[-1], seen_at_last + 0.5 * (seen_at_last - 297.5))


@pytest.mark.parametrize("name", ["", "ir_drift.rate", "ir_gain.gain", "ir_clock.offset", "ir_lag.time", "ir_registration.rotation"])
def test_derivative_of_a_chain_is_that_of_differences(name: str) -> None:
    """Along a field that changes, along a Param, and along both."""
    links, s, slope = chain(INFRARED, ON), scene(), RNG.normal(size=THETA.shape)
    found, h = seen_along(THETA, slope, s, links, ON, name), 1e-5
    moved = [ON if not name else ON.replace(**{name: ON[name] + x}) for x in (h, -h)]
    there, back = (seen(THETA + x * slope, s, links, p) for x, p in zip((h, -h), moved, strict=True))
    assert np.allclose(found, (there - back) / (2.0 * h), atol=1e-6)
    alone = seen_along(THETA, np.zeros_like(THETA), s, links, ON, name) if name else 0.0
    assert np.allclose(found, seen_along(THETA, slope, s, links, ON) + alone, atol=1e-12), "linear in both"
