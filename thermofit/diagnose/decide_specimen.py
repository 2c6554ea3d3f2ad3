"""What a test programme tells of a family, and which change of the test that was made would part what it cannot tell apart.

Of the record of the force a few steps are kept, of the cameras a few points, whose noise is less by the root of how many they stand for. A
coarse mesh is run through every programme with the fitted parameters, lamp, air and jaws as they were, and the columns of all members are
taken from that one differentiated run. The force is taken as exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from thermofit.core.errors import DataError, NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import TINY, feels_rate
from thermofit.diagnose.score import CONVINCING, likeness
from thermofit.effects.catalogue import effect
from thermofit.experiment.fields import LoadSteps, Measured, TestPhase, force_observation
from thermofit.experiment.joint import Joint, JointParts, joint_settings
from thermofit.experiment.known_motion import acts_in_heat
from thermofit.fit.linear_model import LinearModel
from thermofit.observe.observation import FieldObservation
from thermofit.study.section import MeshSize


class CandidateProgramme(Protocol):
    """A test programme of a coupon or of a specimen."""

    @property
    def name(self) -> str:
        """Name among the programmes of a study."""
        ...

    @property
    def words(self) -> str:
        """What it does, in words."""
        ...


@dataclass(frozen=True)
class Family:
    """Effects that a test leaves undecided: the one that the loop has added (empty: none of them is in the model) and the values of
    exponents at which the others were scored."""

    members: tuple[str, ...]
    added: str = ""
    settings: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Discrimination:
    """What one programme tells of a family: largest |cos| between the members that are asked for (1 where it does not show one of them),
    smallest amplitudes."""

    programme: CandidateProgramme
    cosine: float
    detectable: dict[str, float]

    def apart(self, name: str) -> float:
        """Amplitude from which a member is told from the others, which take |cos| of its column: detectable / sqrt(1 - cos^2)."""
        left = 1.0 - self.cosine**2
        return self.detectable.get(name, np.inf) / float(np.sqrt(left)) if left > 0.0 else np.inf


def discrimination_of(programme: CandidateProgramme, own: Mapping[str, np.ndarray], members: Sequence[str]) -> Discrimination | None:
    """Told by columns (n, k) of effects beyond what the parameters can do; None where the programme shows none of the members."""
    there = {n: own[n] for n in members if n in own}
    if not there:
        return None
    alike = likeness(there)
    largest = max((cos for (a, b), cos in alike.items() if a != b), default=0.0)
    shown = {n: float(CONVINCING / np.linalg.norm(s[:, 0])) for n, s in there.items()}
    return Discrimination(programme, 1.0 if len(there) < len(members) else largest, shown)


STRIP = MeshSize(n_x=2, n_y=14, n_z=1)
"""Mesh of the programmes, where that of the study is not coarser."""
STEPS, POINTS = 32, 60
"""Most steps that are kept of a record, and points of a camera."""
REST, COOLING, STOP = 120.0, 300.0, 60.0
"""s before loading, without force at the end, and at constant force half way."""
_LEG = 6
"""Steps of a leg that is put in."""
_LOW = 0.1
"""Part of the force to which a cycle unloads."""


@dataclass(frozen=True)
class ForceCourse:
    """Force N (n,) over time s (n,); loading begins at step `begin`."""

    time: np.ndarray
    force: np.ndarray
    begin: int

    @property
    def peak(self) -> int:
        """Step of the largest force."""
        return int(np.argmax(self.force))

    @property
    def middle(self) -> int:
        """Step half way from the beginning of loading to the largest force."""
        return (self.begin + self.peak) // 2

    @property
    def rate(self) -> float:
        """Mean rate of loading in N/s."""
        return float((self.force[self.peak] - self.force[self.begin]) / (self.time[self.peak] - self.time[self.begin]))

    def with_legs(self, at: int, *legs: tuple[float, float]) -> ForceCourse:
        """The same with legs (duration in s, force at the end in N) put in after a step; what follows comes as much later."""
        time, force = list(self.time[: at + 1]), list(self.force[: at + 1])
        for seconds, to in legs:
            part = np.arange(1, _LEG + 1) / _LEG
            start, level = time[-1], force[-1]
            time += list(start + seconds * part)
            force += list(level + (to - level) * part)
        later = time[-1] - self.time[at]
        return ForceCourse(np.append(time, self.time[at + 1 :] + later), np.append(force, self.force[at + 1 :]), self.begin)

    def stretched(self, factor: float) -> ForceCourse:
        """The same with loading and all after it taking that many times as long."""
        start = self.time[self.begin]
        return replace(self, time=np.where(self.time > start, start + factor * (self.time - start), self.time))


@dataclass(frozen=True)
class OtherProgramme:
    """A programme by name: what it is in words, and what it makes of the course of the test."""

    name: str
    words: str
    course: Callable[[ForceCourse], ForceCourse]


def _cooled(c: ForceCourse) -> ForceCourse:
    last = len(c.time) - 1
    return c.with_legs(last, (max(abs(c.force[last]) / c.rate, 1.0), 0.0), (COOLING, 0.0))


def _unloaded(c: ForceCourse, at: int) -> ForceCourse:
    seconds = (1.0 - _LOW) * c.force[at] / c.rate
    return c.with_legs(at, (seconds, _LOW * float(c.force[at])), (seconds, float(c.force[at])))


OWN = OtherProgramme("own", "the test as it was", lambda c: c)
PROGRAMMES: tuple[OtherProgramme, ...] = (
    OtherProgramme("long-rest", f"rest {REST:g} s longer before loading, lamp and air as they are", lambda c: _rested(c)),
    OtherProgramme("long-cooling", f"cool {COOLING:g} s without load at the end", _cooled),
    OtherProgramme("half-rate", "load at half the rate", lambda c: c.stretched(2.0)),
    OtherProgramme("twice-rate", "load at twice the rate", lambda c: c.stretched(0.5)),
    OtherProgramme("stop", f"hold the force for {STOP:g} s half way", lambda c: c.with_legs(c.middle, (STOP, float(c.force[c.middle])))),
    OtherProgramme(
        "unloadings", "unload half way and at the largest force, and load again", lambda c: _unloaded(_unloaded(c, c.peak), c.middle)
    ),
)
"""All changes of the test, the simplest first."""


def _rested(c: ForceCourse) -> ForceCourse:
    return c.with_legs(c.begin, (REST, float(c.force[c.begin])))


def course_of(data: Measured) -> ForceCourse:
    """The force of a test at some of its steps: the first and last one, the begin of loading, the peak, and others by time and force."""
    steps = data.steps["all"]
    dt, df = np.diff(steps.time), np.abs(np.diff(steps.force))
    share = np.append(0.0, np.cumsum(0.5 * dt / dt.sum() + 0.5 * df / max(df.sum(), 1e-300)))
    start = int(np.clip(np.searchsorted(steps.time, data.load_start + 1e-9) - 1, 0, len(dt)))
    kept = np.searchsorted(share, np.linspace(0.0, share[-1], STEPS) - 1e-12)
    kept = np.unique([0, start, int(np.argmax(steps.force)), len(dt), *np.minimum(kept, len(dt)).tolist()])
    return ForceCourse(steps.time[kept], steps.force[kept], int(np.searchsorted(kept, start)))


def spread(xy: np.ndarray, count: int) -> np.ndarray:
    """Numbers of at most `count` points of xy (n, 2) that lie far from each other: each next one is the farthest from those before."""
    chosen = [int(np.argmin(np.linalg.norm(xy - xy.mean(axis=0), axis=1)))]
    away = np.linalg.norm(xy - xy[chosen[0]], axis=1)
    while len(chosen) < min(count, len(xy)):
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(xy - xy[chosen[-1]], axis=1))
    return np.sort(chosen)


def _blank(seen: FieldObservation, course: ForceCourse, own: ForceCourse) -> FieldObservation:
    """A camera that looks at some of its points (no means over patches) at all steps of a course; sigma is that of the mean of what it
    leaves out."""
    xy = seen.xy[spread(seen.xy, POINTS)]
    used = np.isfinite(seen.sigma) & seen.mask[:, :, None]
    kept = len(own.time) * len(xy) / max(float(np.any(used, axis=2).sum()), 1.0)
    sigma = [float(np.median(seen.sigma[:, :, k][used[:, :, k]])) * min(kept, 1.0) ** 0.5 for k in range(seen.value.shape[2])]
    shape = (len(course.time), len(xy))
    wide = np.broadcast_to(np.array(sigma), (*shape, len(sigma))).copy()
    whole = np.ones(shape, dtype=bool)
    return replace(seen, time=course.time, xy=xy, value=np.zeros_like(wide), sigma=wide, mask=whole, moments=None)


def planned(data: Measured, programme: OtherProgramme) -> Measured:
    """The test under a programme as the identification would see it, with nothing observed yet."""
    own = course_of(data)
    course = programme.course(own)
    steps = LoadSteps(course.time, course.force)
    noise = float(np.median(data.force.sigma))
    return replace(
        data,
        displacement=None if data.displacement is None else _blank(data.displacement, course, own),
        temperature=None if data.temperature is None else _blank(data.temperature, course, own),
        force=force_observation(course.time, steps, noise),
        steps=dict.fromkeys(data.steps, steps),
        phases=(TestPhase(float(course.time[0]), float(course.time[-1]), "loading"),),
    )


def drivable(parts: JointParts | None) -> Joint | None:
    """The joint problem of a specimen whose programmes are known: one that is alone, that its force drives, whose mesh is not one of a
    file, and whose test has a course. None where there is none: a single load step has no rest, no rate and no hold to change."""
    joint = None if parts is None else parts.each.get("")
    if joint is None or joint.study.force.drives != "force" or joint.study.mesh_file is not None:
        return None
    return joint if len(joint.data.steps["all"].time) > 2 else None


def columns(joint: Joint, programme: OtherProgramme, parameters: Parameters, family: Family) -> dict[str, np.ndarray] | None:
    """Whitened columns (n, k) of every member that the specimen feels in a programme, without what the other free parameters can do.

    A member that is on is asked at its value. None where the specimen cannot be driven so.
    """
    members = [effect(n) for n in family.members]
    felt = {e.name: tuple(p.name for p in e.amplitudes) for e in members}
    own = effect(family.added).names if family.added else ()
    free = tuple(n for n in parameters.free if n not in own)
    heated = [e for e in members if e.name != family.added and acts_in_heat(e)]
    coupled = [e for e in members if e not in heated]
    beside = [e.amplitude for e in coupled if e.name != family.added and feels_rate(e, parameters)]
    there = parameters.replace(**family.settings, **{p.name: p.neutral + TINY * float(p.probe or 0.0) for p in beside})
    names = (*free, *(n for e in coupled for n in felt[e.name]))
    directions = [(n, {p.name: there[p.name] for p in e.params if p.scan}) for e in heated for n in felt[e.name]]
    own_course = course_of(joint.data)
    if own_course.peak <= own_course.begin:  # a specimen that is never pulled
        return None
    try:
        strip = _strip(joint, programme, free)
        _, jacobian, along = strip.scored(there.with_free((*free, *own)), names, directions)
    except (NumericsError, DataError):
        return None
    at = {n: k for k, n in enumerate((*names, *(n for n, _ in directions)))}
    whole = np.concatenate([jacobian, along], axis=1)
    found = LinearModel(np.zeros(len(whole)), whole[:, : len(free)], n_priors=len(strip.model.priors))
    shown = {name: found.sensitive(whole[:, [at[n] for n in group]]) for name, group in felt.items()}
    return {name: block for name, block in shown.items() if block.shape[1] > 0}


def _strip(joint: Joint, programme: OtherProgramme, free: tuple[str, ...]) -> Joint:
    """The joint problem of a programme on the coarse mesh."""
    plan = planned(joint.data, programme)
    size = joint.size.with_counts({axis: min(getattr(STRIP, axis), n) for axis, n in joint.size.counts.items()})
    return Joint(joint.study, plan, joint_settings(joint.study, free, plan), size, beside=joint.beside)
