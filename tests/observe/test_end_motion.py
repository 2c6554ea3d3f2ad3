"""Elongation of sections inside the field of DIC, and between its stages."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField, ForceRecord
from thermofit.observe.end_motion import EndMotion, Gauge, end_motion, sections_inside
from thermofit.observe.force import SmoothForce, smooth_force

RNG = np.random.default_rng(6)
STIFF = 40000.0
"""N/mm"""
TURN = 51.0
"""s; between two stages, which come every four seconds."""


def field() -> DicField:
    """Uniform strain on scattered points within 25 mm of the centre."""
    points = RNG.uniform([-10.0, -25.0, 0.0], [10.0, 25.0, 0.0], (2000, 3))
    u = np.zeros((5, 2000, 3))
    u[:, :, 1] = np.linspace(0.0, 0.01, 5)[:, None] * points[:, 1]
    return DicField(np.arange(5.0), np.arange(2000), points, u)


def test_sections_lie_inside_the_field_where_the_model_is_longer() -> None:
    low, high = sections_inside(field(), (-75.0, 75.0), 2.0)
    assert low == pytest.approx(-23.0, abs=0.1) and high == pytest.approx(23.0, abs=0.1)
    assert sections_inside(field(), (-20.0, 20.0), 2.0) == (-20.0, 20.0)
    motion = end_motion(field(), (low, high), 2.0)
    assert motion.elongation == pytest.approx(np.linspace(0.0, 0.01, 5) * (high - low), abs=1e-9)
    assert motion.gauge.weight @ field().displacement[0, :1, 1].repeat(len(motion.gauge.weight)) == pytest.approx(0.0)
    assert motion.gauge.weight @ motion.gauge.xy[:, 1] == pytest.approx(high - low)
    assert motion.gauge.sections == pytest.approx((low, high), abs=0.3)


def test_points_that_are_lost_move_a_section_inwards() -> None:
    lost = field()
    lost.displacement[2, lost.reference[:, 1] > 15.0] = np.nan
    assert sections_inside(lost, (-75.0, 75.0), 2.0)[1] == pytest.approx(13.0, abs=0.2)
    lost.displacement[:] = np.nan
    with pytest.raises(DataError, match="no point is measured at every stage"):
        sections_inside(lost, (-75.0, 75.0), 2.0)


def course(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force N and elongation mm of an elastic-plastic bar: loading to TURN, elastic unloading at 200 N/s."""
    t = np.clip(time - 3.0, 0.0, TURN - 3.0)
    force = np.minimum(400.0 * t, 4000.0 + 20.0 * (t - 10.0))
    plastic = 0.08 * np.clip(t - 10.0, 0.0, None)
    force = force - 200.0 * np.clip(time - TURN, 0.0, None)
    return force, force / STIFF + plastic


@pytest.fixture(scope="module")
def smooth() -> SmoothForce:
    time = np.arange(0.0, 70.0, 0.1)
    return smooth_force(ForceRecord(time, course(time)[0] + 2.0 * RNG.normal(size=len(time)), None, ()))


def seen() -> EndMotion:
    time = np.arange(0.0, 69.0, 4.0)
    return EndMotion(time, course(time)[1], 3e-4, 90, Gauge(np.zeros((2, 2)), np.array([-1.0, 1.0])))


def test_the_force_tells_how_far_it_went_before_it_turned(smooth: SmoothForce) -> None:
    """Straight between the stages the peak is missed by 0.1 mm, a tenth of which would already be 400 N."""
    times = np.linspace(0.0, 68.0, 400)
    found, true = seen().at(times, 3.0, smooth), course(times)[1]
    straight = seen().at(times, 3.0)
    assert np.abs(straight - true).max() > 0.05
    assert np.abs(found - true)[times > 16.0].max() < 0.003
    assert found[np.isin(times, seen().time)] == pytest.approx(true[np.isin(times, seen().time)], abs=1e-9)


AGAIN, YIELDS = 60.0, 64.3
"""s; loaded again from there at 400 N/s, and yielding there."""


def reloaded(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same bar loaded again: it yields, as softly as a bar with a backstress does, below the force that it was unloaded from."""
    force, elongation = course(np.minimum(time, AGAIN))
    force = force + 400.0 * (np.clip(time, AGAIN, YIELDS) - AGAIN) + 20.0 * np.clip(time - YIELDS, 0.0, None)
    return force, force / STIFF + (elongation - course(np.minimum(time, AGAIN))[0] / STIFF) + 0.08 * np.clip(time - YIELDS, 0.0, None)


def test_flow_begins_at_the_knee_of_the_force() -> None:
    time = np.arange(0.0, 80.0, 0.1)
    record = ForceRecord(time, reloaded(time)[0] + 2.0 * RNG.normal(size=len(time)), None, ())
    largest = course(np.array([TURN]))[0][0]
    assert 0.9 * largest + 200.0 < reloaded(np.array([YIELDS]))[0][0] < largest, "it may flow for more than half a second before"
    stages = np.arange(0.0, 79.0, 4.0) + 0.5
    motion = EndMotion(stages, reloaded(stages)[1], 3e-4, 90, Gauge(np.zeros((2, 2)), np.array([-1.0, 1.0])))
    times = np.linspace(0.5, 76.5, 400)
    found = motion.at(times, 3.0, smooth_force(record))
    assert np.abs(found - reloaded(times)[1])[times > 3.0].max() < 0.003, "a tenth of the flow of half a second"


def test_what_flows_already_goes_on_though_a_knee_follows() -> None:
    """Pulled at half the rate from 30 s on, and hardening less from 41.5 s on: both bend the force, and neither begins to flow."""
    time = np.arange(0.0, 60.0, 0.1)

    def both(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        own = t - 0.5 * np.clip(t - 30.0, 0.0, None)
        force, elongation = course(np.minimum(own, 45.0))
        more = 60.0 * np.clip(own - 13.0, 0.0, 22.75)
        return force + more, elongation + more / STIFF

    crosshead = 0.1 * np.clip(time - 3.0 - 0.5 * np.clip(time - 30.0, 0.0, None), 0.0, None) + 3e-4 * RNG.normal(size=len(time))
    smooth = smooth_force(ForceRecord(time, both(time)[0] + 2.0 * RNG.normal(size=len(time)), crosshead, ()))
    loading = [p.t0 for p in smooth.phases.items if p.kind == "loading"]
    assert loading[-1] == pytest.approx(30.0, abs=0.2) and smooth.phases.knees[-1] == pytest.approx(41.5, abs=0.2)
    stages = np.append(np.arange(0.0, 56.0, 4.0) + 0.5, 56.0)
    motion = EndMotion(stages, both(stages)[1], 3e-4, 90, Gauge(np.zeros((2, 2)), np.array([-1.0, 1.0])))
    times = np.linspace(0.5, 55.0, 300)
    assert np.abs(motion.at(times, 3.0, smooth) - both(times)[1])[times > 34.5].max() < 0.01


def test_noise_of_the_elongation_is_force_by_the_stiffness_of_the_moment(smooth: SmoothForce) -> None:
    assert seen().stiffness(smooth) == pytest.approx(STIFF, rel=0.01)
    error = seen().force_error(smooth)
    flows = (seen().time > 20.0) & (seen().time < 45.0)
    assert error[flows] == pytest.approx(20.0 / (0.08 + 20.0 / STIFF) * 3e-4, rel=0.2)
    assert error[-3:] == pytest.approx(STIFF * 3e-4, rel=0.02)
