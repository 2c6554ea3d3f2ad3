"""Knees of the force that a record cuts off: where it goes straight from one slope to another on a chord, in less time than the fields see.

A law bends in its own way where a specimen yields. A record that was averaged, filtered, or made in coarse steps shows a chord there, of
force, displacements and temperatures alike. A stage or frame on the chord belongs to no law: its force is too small at its elongation, by
the height of the corner. It is one value among many, and the law would be bent to it.
"""

from __future__ import annotations

import numpy as np

from thermofit.observe.force import SmoothForce
from thermofit.observe.observation import FieldObservation

Chord = tuple[float, float]
"""Times (s) between which the force is a chord."""
_MOST = 1
"""Stages or frames on a chord, at most: what two of them see is a course, and it is for the law to follow it."""


def cut_knees(force: SmoothForce) -> tuple[Chord, ...]:
    """Chords of a force: between two knees that follow each other in one phase, where the rate falls at either and keeps its sign. In
    serrated flow it rises at every second one."""
    found = []
    for phase in force.phases.items:
        knees = force.phases.knees[(force.phases.knees > phase.t0) & (force.phases.knees < phase.t1)]
        edges = [phase.t0, *np.sort(knees).tolist(), phase.t1]
        for t0, a, b, t1 in zip(edges, edges[1:], edges[2:], edges[3:], strict=False):
            ahead, behind = 0.5 * min(a - t0, b - a), 0.5 * min(t1 - b, b - a)
            rates = force.rate(np.array([a - ahead, 0.5 * (a + b), b + behind]))
            before, within, after = (float(rate) for rate in rates * np.sign(rates[0]))
            if before > within > after > 0.0:
                found.append((a, b))
    return tuple(found)


def off_chords(field: FieldObservation, chords: tuple[Chord, ...]) -> FieldObservation:
    """The field without its time on every chord that holds no more than one."""
    keep = np.ones(len(field.time), dtype=bool)
    for a, b in chords:
        here = (field.time > a) & (field.time < b)
        if here.sum() <= _MOST:
            keep &= ~here
    return field if keep.all() else field.at_times(keep)
