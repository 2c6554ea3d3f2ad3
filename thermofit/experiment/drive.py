"""What drives a specimen, and when the motion of its sections drives it instead of the force.

A forward model that cannot carry the measured force has no equilibrium under it; near the load maximum, and beyond it, the force says next
to nothing about the strain. The elongation between two sections that DIC sees drives any model, and the force is then a channel that is
fitted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.experiment.fields import Measured, Stretched
from thermofit.study.stages import ChannelSettings, StageSettings

if TYPE_CHECKING:
    from thermofit.experiment.protocol import Experiment

FORCE, SECTIONS = "force", "sections"
"""The drives of a test as records and results name them, besides `crosshead` and `dic` where the study says so."""
FLAT = 0.3
"""Growth g = d ln F / d ln l of the force at the end of loading below which it is near its maximum.

A law that is too weak by a share m has an equilibrium under the measured force only while m is below what the specimen could still carry
more, its headroom h = max ln F - ln F = g^2 / (2 |d^2 ln F / d ln l^2|) near the maximum (Considere: for Voce's curve the curvature is
(1 + g)(1 + g + H_exp), for Swift's (1 + g)^2 / n). The same ratio m / h says whether a step of the linearised problem means anything. Of
random materials of four kinds of curves h is 0.04 % at g = 0.1 (median), 0.3 % at 0.3 (0.15 to 0.7 % in eight of ten) and 0.7 % at 0.5; a
Voce curve fitted to such materials with steps of the rate, self-heating or a curve of another form misses the stress at the end of loading
by 0.3 to 1.4 % (quartiles), 0.7 % in the median. At 0.3 the headroom is thus what only one in four of the laws that lack something keeps
within, and at 0.5 what half of them do: both ends could be defended, and above the lower one, which is taken, a run that fails tells by
itself (`carried`). No measured test was used; `test_drive` draws these materials again. It was moved from 0.1 to 0.3 when a test that ends
a little below 0.3 had been seen, before these were made."""
_LAST = 0.9
"""Share of the largest elongation from which on the end of loading is looked at."""
_FLOWS = 0.9
"""Share of the largest force so far above which the specimen flows."""
_LEAST = 4
"""Stages from which a growth is told: where they are rare, those before that share as well."""
_EARLIEST = 0.5
"""Share of the largest elongation before which a stage says nothing of the end."""

_T = TypeVar("_T")


def last_growth(data: Measured) -> float | None:
    """d ln F / d ln(l + e) at the end of loading, l + e the distance of the sections; None where the stages do not tell it."""
    if data.stretched is None or data.gauge is None:
        return None
    steps, e = data.steps["displacement"], data.stretched.elongation
    force = np.interp(data.stretched.time, steps.time, steps.force)
    low, high = data.gauge.sections
    end = int(np.argmax(e))
    pulled = np.zeros(len(e), dtype=bool)
    for phase in data.phases:
        if phase.label in ("elastic", "loading"):
            pulled |= (data.stretched.time > phase.t0) & (data.stretched.time <= phase.t1)
    flows = force >= _FLOWS * np.maximum.accumulate(np.maximum(force, 1e-300))
    flowing = np.flatnonzero(pulled & flows & (np.arange(len(e)) <= end))
    late = flowing[e[flowing] >= _LAST * e[end]]
    here = late if len(late) >= _LEAST else flowing[-_LEAST:]
    if len(here) < _LEAST or e[here[0]] < _EARLIEST * e[end]:
        return None
    return float(np.polyfit(np.log(high - low + e[here]), np.log(force[here]), 1)[0])


def near_maximum(data: Measured) -> str:
    """Why the force should not drive a test, in words; empty where it may."""
    growth = last_growth(data)
    if growth is None or growth >= FLAT:
        return ""
    where = "falls" if growth < 0.0 else "hardly grows"
    return f"the measured force {where} at the end of loading ({100.0 * growth:.2g} % per 100 % of strain)"


def with_driven_force(data: Measured) -> Measured:
    """Measured values for a model that the elongation drives: the error of the elongation is one of the force that answers to it, and is
    counted there once; what drives has the modes of that error."""
    if data.stretched is None or data.stretched.counted is not None:
        return data
    seen = data.stretched
    own = np.interp(data.force.time, seen.time, seen.force_error)
    known = replace(seen, force_error=np.zeros_like(seen.force_error), counted=own)
    modes = {name: elongation_modes(seen, one.time, data.load_start) if seen.noise > 0.0 else None for name, one in data.steps.items()}
    steps = {name: replace(one, error=modes[name]) for name, one in data.steps.items()}
    return replace(data, force=replace(data.force, sigma=np.hypot(data.force.sigma, own[:, None, None])), steps=steps, stretched=known)


def elongation_modes(seen: Stretched, time: np.ndarray, load_start: float) -> np.ndarray:
    """Modes (n, k) mm of the error of the elongation at times s (n,): the noise of every stage after loading has begun, on its own, which
    grows from the stage before and dies away to the next. What is wrong where a specimen turns stays wrong until it flows again."""
    late = seen.time > load_start + 1e-6
    return seen.noise * np.stack([np.interp(time, seen.time, row) for row in np.eye(len(seen.time))[late]], axis=1)


def with_force_channel(settings: StageSettings) -> StageSettings:
    """Settings of a stage that compares displacements, with the force among its channels."""
    if not {"u", "du", "strain"} & set(settings.channels) or {"force", "stress"} & set(settings.channels):
        return settings
    return settings.model_copy(update={"channels": {**settings.channels, "force": ChannelSettings()}})


def driven_remark(experiment: Experiment, why: str) -> str:
    """One sentence on a turn to the sections."""
    return f"driven by the motion of {experiment.sections} (DIC), with the force as a channel that is fitted, because {why}"


def carried(experiment: Experiment, attempt: Callable[[Experiment], _T]) -> tuple[Experiment, _T, str]:
    """What `attempt` makes of an experiment; where its model cannot carry the measured force, of the same one driven by its sections, and a
    remark. NumericsError where it fails in either drive, or sections are not known."""
    try:
        return experiment, attempt(experiment), ""
    except NumericsError as error:
        other = experiment.by_sections
        if other is None:
            raise
        return other, attempt(other), driven_remark(other, f"the model finds no equilibrium at the measured force ({error})")
