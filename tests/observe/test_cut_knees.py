"""Knees of the force that a record cuts off."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.core.experiment import ForceRecord
from thermofit.observe.cut_knees import cut_knees, off_chords
from thermofit.observe.force import SmoothForce, smooth_force
from thermofit.observe.observation import FieldObservation

RNG = np.random.default_rng(14)
TIME = np.arange(0.0, 60.0, 0.1)


def smoothed(*corners: tuple[float, float], turns: bool = True) -> SmoothForce:
    """A record of straight lines between corners (s, N), with 4 N of noise, and a crosshead that turns where the force does or goes on."""
    t, f = np.array(corners).T
    senses = np.sign(np.diff(f)) if turns else np.append(0.0, np.ones(len(f) - 2))
    moved = np.cumsum(np.append(0.0, senses * np.diff(t)))
    crosshead = np.interp(TIME, t, moved) + 1e-4 * RNG.normal(size=len(TIME))
    return smooth_force(ForceRecord(TIME, np.interp(TIME, t, f) + 4.0 * RNG.normal(size=len(TIME)), crosshead, ()))


YIELDS = ((0.0, 0.0), (3.0, 0.0), (10.0, 7000.0), (10.6, 7240.0))
CUT = (*YIELDS, (40.0, 7900.0), (44.0, 3900.0), (48.0, 7900.0), (48.7, 8200.0), (60.0, 8450.0))
"""Loaded, unloaded and loaded again; a chord of 0.6 s and one of 0.7 s where it yields."""


def field(*times: float) -> FieldObservation:
    time = np.array(times)
    value = np.broadcast_to(time[:, None, None], (len(time), 2, 1))
    return FieldObservation("u", time, np.zeros((2, 2)), value, np.ones_like(value), np.ones((len(time), 2), dtype=bool), "mm")


def test_a_chord_lies_between_two_near_knees() -> None:
    first, second = cut_knees(smoothed(*CUT))
    assert first == pytest.approx((10.0, 10.6), abs=0.05)
    assert second == pytest.approx((48.0, 48.7), abs=0.05)


def test_a_sharp_knee_has_no_chord() -> None:
    assert cut_knees(smoothed((0.0, 0.0), (3.0, 0.0), (10.0, 7000.0), (60.0, 8200.0))) == ()


def test_serrated_flow_has_no_chord() -> None:
    """The force rises faster after a tooth than on its top."""
    tops = [(10.0 + 5.0 * k + 2.5 * s, 7000.0 + 500.0 * k + 100.0 * s) for k in range(8) for s in (0, 1)]
    force = smoothed((0.0, 0.0), (3.0, 0.0), *tops, turns=False)
    assert len(force.phases.knees) > 12
    assert cut_knees(force) == ()


def test_knees_of_two_loadings_have_no_chord() -> None:
    """The specimen was unloaded between them."""
    force = smoothed((0.0, 0.0), (3.0, 0.0), (10.0, 7000.0), (40.0, 8200.0), (44.0, 4200.0), (48.0, 8200.0), (60.0, 8300.0))
    assert force.phases.knees == pytest.approx([10.0, 48.0], abs=0.1)
    assert cut_knees(force) == ()


def test_hardening_that_sets_in_has_no_chord() -> None:
    """A plateau between two knees, after which the force rises faster: the rate does not fall at the second one."""
    force = smoothed((0.0, 0.0), (3.0, 0.0), (10.0, 7000.0), (14.0, 7100.0), (20.0, 9000.0), (60.0, 9500.0))
    assert len(force.phases.knees) == 3
    assert cut_knees(force) == ()


def test_one_stage_on_a_chord_is_left_out_and_two_are_a_course() -> None:
    chords = ((10.0, 10.6), (48.0, 48.7))
    assert off_chords(field(8.0, 10.3, 12.0, 48.2, 48.5, 50.0), chords).time.tolist() == [8.0, 12.0, 48.2, 48.5, 50.0]
    whole = field(8.0, 10.0, 10.6, 12.0)
    assert off_chords(whole, chords) is whole
    left = off_chords(field(8.0, 10.3, 12.0), chords)
    assert left.value[:, 0, 0].tolist() == [8.0, 12.0] and left.mask.shape == (2, 2) and left.sigma.shape == left.value.shape
