"""Phases in words: the elastic phase ends where the force bends, not where the crosshead merely changes its rate."""

from itertools import pairwise

import numpy as np

from thermofit.core.experiment import ForceRecord
from thermofit.experiment.interpolated import label_phases
from thermofit.observe.force import smooth_force


def record() -> ForceRecord:
    """Rest to 3 s, elastic to 10 s with a slightly slower crosshead from 7 s, yield, unloading at 60 s, zero force from 70 s."""
    time = np.arange(0.0, 120.0, 0.1)
    force = np.interp(time, [0.0, 3.0, 7.0, 10.0, 60.0, 70.0, 120.0], [0.0, 0.0, 2400.0, 4000.0, 6000.0, 0.0, 0.0])
    crosshead = np.interp(time, [0.0, 3.0, 7.0, 60.0, 70.0, 120.0], [0.0, 0.0, 0.56, 7.2, 5.9, 5.9])
    rng = np.random.default_rng(4)
    return ForceRecord(time, force + 4.0 * rng.normal(size=time.size), crosshead + 0.0007 * rng.normal(size=time.size))


def test_labels_and_the_end_of_the_elastic_phase() -> None:
    phases = label_phases(smooth_force(record()))
    assert [p.label for p in phases] == ["rest", "elastic", "loading", "unloading", "cooling"]
    ends = [p.t1 for p in phases]
    assert np.allclose(ends, [3.0, 10.0, 60.0, 70.0, 119.9], atol=0.15)
    assert all(a.t1 == b.t0 for a, b in pairwise(phases))
