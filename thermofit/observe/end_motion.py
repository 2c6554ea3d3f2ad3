"""Elongation of a specimen between two sections, from the DIC points near them: the ends of a model, or sections inside the field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField
from thermofit.observe.force import SmoothForce
from thermofit.observe.phases import Phase

_LEAST = 6
"""Points of an end section at least: its plane has three coefficients."""
_FLOWS = 0.9
"""Share of the largest force so far above which a specimen that is loaded may flow; below, it answers elastically."""
_LEAST_STAGES = 3
"""Stages of one unloading that tell its stiffness."""


@dataclass(frozen=True)
class Gauge:
    """What makes the elongation of the displacements along y: points (n, 2) mm of both sections with their weights (n,)."""

    xy: np.ndarray
    weight: np.ndarray

    @property
    def sections(self) -> tuple[float, float]:
        """Mean y of the points of either section, mm."""
        y = self.xy[:, 1]
        lower = y < y.mean()
        return float(y[lower].mean()), float(y[~lower].mean())


@dataclass(frozen=True)
class EndMotion:
    """`elongation` mm (n_t,) at `time` s (n_t,), zero at rest; `noise` mm of one value; `points`, the least number at a section; `gauge`,
    what makes it of the displacements."""

    time: np.ndarray
    elongation: np.ndarray
    noise: float
    points: int
    gauge: Gauge

    def at(self, times: np.ndarray, load_start: float, force: SmoothForce | None = None) -> np.ndarray:
        """Elongation (n,) at times s between the stages, zero before loading. DataError where loading begins before the first stage, or
        a time lies after the last.

        Between two stages the force tells how far the specimen was strained before it turned: what is elastic of the elongation follows
        the force, and the rest grows while the specimen is loaded and may flow, from the knee of the force on. Without a force it is
        straight from stage to stage.
        """
        if self.time[0] > load_start + 1e-6:
            raise DataError(
                f"force.drives is 'dic', but loading begins at {load_start:g} s, before the first DIC stage at {self.time[0]:g} s: the "
                "elongation until then is not known; let the force drive, or take a stage at rest"
            )
        if times[-1] > self.time[-1] + 1e-6:
            raise DataError(
                f"force.drives is 'dic', but the last DIC stage is at {self.time[-1]:g} s and {times[-1]:g} s is asked for; end the "
                "evaluation times at the last stage"
            )
        times = np.asarray(times, dtype=float)
        moved = np.interp(times, self.time, self.elongation) if force is None else _turned(self, times, force)
        return np.where(times <= load_start, 0.0, moved)

    def stiffness(self, force: SmoothForce) -> float:
        """Elastic stiffness dF/de in N/mm: the median of those of the unloadings, else that of the first loading; inf where the stages
        tell none."""
        found = list(_unloadings(self, force).values())
        if found:
            return float(np.median(found))
        first = next((p for p in force.phases.items if p.kind == "loading"), None)
        if first is None:
            return float("inf")
        knee = min([t for t in force.phases.knees if t > first.t0], default=first.t1)
        here = (self.time >= first.t0 - 1e-9) & (self.time <= knee)
        f = _force_at(force, self.time[here])
        e = self.elongation[here]
        return float(f @ f / (f @ e)) if len(f) and float(f @ e) > 0.0 else float("inf")

    def force_error(self, force: SmoothForce) -> np.ndarray:
        """What the noise of the elongation makes of the force at the stages, N (n_t,): by the steeper slope to a neighbouring stage, no
        more than the elastic one."""
        stiff, f = self.stiffness(force), _force_at(force, self.time)
        if not np.isfinite(stiff):
            return np.zeros_like(f)
        moved, pulled = np.abs(np.diff(self.elongation)), np.abs(np.diff(f))
        slope = np.where(moved > 3.0 * self.noise, np.minimum(pulled / np.maximum(moved, 1e-300), stiff), stiff)
        steeper = np.maximum(np.append(slope, 0.0), np.append(0.0, slope))
        return np.asarray(steeper * self.noise)


def _force_at(force: SmoothForce, time: np.ndarray) -> np.ndarray:
    """Force N at times s; before and after its record that of the ends, where a stage lies a moment outside it."""
    return np.asarray(force.evaluate(np.clip(time, force.time[0], force.time[-1])))


def _unloadings(motion: EndMotion, force: SmoothForce) -> dict[int, float]:
    """Stiffness N/mm of every unloading, by its number among the phases, that has stages enough."""
    found = {}
    for k, phase in enumerate(force.phases.items):
        here = (motion.time >= phase.t0 - 1e-9) & (motion.time <= phase.t1 + 1e-9)
        if phase.kind != "unloading" or here.sum() < _LEAST_STAGES:
            continue
        f, e = _force_at(force, motion.time[here]), motion.elongation[here]
        f, e = f - f.mean(), e - e.mean()
        if float(f @ e) > 0.0:
            found[k] = float(f @ f / (f @ e))
    return found


def _turned(motion: EndMotion, times: np.ndarray, force: SmoothForce) -> np.ndarray:
    """Elongation (n,) at times between the stages: elastic part by the force, the rest while the specimen may flow."""
    usual, own = motion.stiffness(force), _unloadings(motion, force)
    if not np.isfinite(usual):
        return np.interp(times, motion.time, motion.elongation)
    edges = np.concatenate([*([p.t0, p.t1] for p in force.phases.items), force.phases.knees])
    grid = np.union1d(np.union1d(times, motion.time), edges)
    grid = grid[(grid >= motion.time[0]) & (grid <= motion.time[-1])]
    f = _force_at(force, grid)
    middle = 0.5 * (grid[1:] + grid[:-1])
    loaded = np.zeros(len(middle), dtype=bool)
    largest = np.maximum.accumulate(np.abs(f))
    may_flow, flowed = np.abs(f) >= _FLOWS * largest, False
    for phase in force.phases.items:
        if phase.kind == "loading":
            goes_on = flowed and bool(may_flow[min(np.searchsorted(grid, phase.t0), len(grid) - 1)])
            begins = phase.t0 if goes_on else _yields_at(phase, force.phases.knees, grid[may_flow])
            loaded |= (middle > begins) & (middle < phase.t1)
            flowed = True
    flows = loaded & may_flow[1:]
    clock = np.append(0.0, np.cumsum(np.where(flows, np.diff(grid), 0.0)))
    stage = np.minimum(np.searchsorted(motion.time, times, side="right") - 1, len(motion.time) - 2)
    stage = np.maximum(stage, 0)
    stiff = np.full(len(motion.time) - 1, usual)
    for k, value in own.items():
        phase = force.phases.items[k]
        stiff[(motion.time[1:] > phase.t0) & (motion.time[:-1] < phase.t1)] = value
    ends = _force_at(force, motion.time)
    before = motion.elongation[:-1] - ends[:-1] / stiff
    after = motion.elongation[1:] - ends[1:] / stiff
    at, tick = np.interp(times, grid, clock), np.interp(motion.time, grid, clock)
    length = np.diff(tick)[stage]
    in_time = (times - motion.time[stage]) / np.diff(motion.time)[stage]
    share = np.where(length > 0.0, (at - tick[stage]) / np.where(length > 0.0, length, 1.0), in_time)
    rest = before[stage] + (after - before)[stage] * np.clip(share, 0.0, 1.0)
    return np.asarray(rest + np.interp(times, grid, f) / stiff[stage])


def _yields_at(phase: Phase, knees: np.ndarray, may_flow: np.ndarray) -> float:
    """When a specimen yields in a phase of loading that begins elastic: at the first knee of the force among the times (n,) at which it
    `may_flow`; where there is none, as soon as it may."""
    own = knees[(knees > phase.t0) & (knees < phase.t1) & np.isin(knees, may_flow)]
    return float(own.min()) if len(own) else phase.t0


def end_motion(dic: DicField, ends: tuple[float, float], band: float, load_start: float | None = None) -> EndMotion:
    """Elongation between the sections y = ends[0] and y = ends[1] (mm) at the DIC stages.

    At each end u_y = a + b x + c (y - y_end) is fitted by least squares to the points within `band` mm: a is the displacement of the
    centre, free of rotation and of the strain within the band, and averages the noise of its points. It counts from the mean of the stages
    up to `load_start` s (None: from the first). DataError where an end has fewer than six measured points at a stage.
    """
    motion, variance, least, gauges = [], [], len(dic.point_id), []
    for y_end in ends:
        centre, factor, count = _centre(dic, y_end, band)
        motion.append(centre)
        variance.append(factor)
        least = min(least, count)
        gauges.append(_gauge(dic, y_end, band))
    elongation = motion[1] - motion[0]
    noise = float(np.sqrt(np.median(variance[0] + variance[1])))
    time = np.asarray(dic.time, dtype=float)
    rest = time <= (time[0] if load_start is None else max(load_start, float(time[0]))) + 1e-9
    gauge = Gauge(np.concatenate([g.xy for g in gauges]), np.concatenate([-gauges[0].weight, gauges[1].weight]))
    return EndMotion(time, elongation - elongation[rest].mean(), noise, least, gauge)


def sections_inside(dic: DicField, ends: tuple[float, float], band: float) -> tuple[float, float]:
    """The outermost sections y (mm) of a field near which enough points are measured at every stage: the ends of the model itself, where
    the field reaches them. DataError where there are none."""
    y = dic.reference[:, 1]
    always = np.isfinite(dic.displacement[:, :, 1]).all(axis=0)
    if not always.any():
        raise DataError("dic: no point is measured at every stage; the motion of sections is not known")
    low, high = float(y[always].min()), float(y[always].max())
    found = []
    for end, edge, inwards in ((ends[0], low, 1.0), (ends[1], high, -1.0)):
        outside = (edge - end) * inwards > band
        section = edge + inwards * band if outside else end
        while ((np.abs(y - section) <= band) & always).sum() < _LEAST:
            section += inwards * band
            if not low < section < high:
                raise DataError(f"dic: fewer than {_LEAST} points near any section are measured at every stage; widen force.band")
        found.append(section)
    if found[1] - found[0] < 4.0 * band:
        raise DataError(f"dic: sections y = {found[0]:.3g} and {found[1]:.3g} mm are too near to each other; take a smaller force.band")
    return found[0], found[1]


def _gauge(dic: DicField, y_end: float, band: float) -> Gauge:
    """Weights of the points near a section in the displacement of its centre."""
    x, y = dic.reference[:, 0], dic.reference[:, 1] - y_end
    here = np.flatnonzero((np.abs(y) <= band) & np.isfinite(dic.displacement[:, :, 1]).any(axis=0))
    a = np.stack([np.ones(len(here)), x[here], y[here]], axis=1)
    return Gauge(np.asarray(dic.reference[here, :2]), np.linalg.pinv(a)[0])


def _centre(dic: DicField, y_end: float, band: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Displacement of the centre of a section (n_t,), its variance (n_t,) mm^2, and the least number of points."""
    x, y = dic.reference[:, 0], dic.reference[:, 1] - y_end
    near = np.flatnonzero(np.abs(y) <= band)
    value, variance, least = np.empty(len(dic.time)), np.empty(len(dic.time)), len(near)
    for n in range(len(dic.time)):
        here = near[np.isfinite(dic.displacement[n, near, 1])]
        if len(here) < _LEAST:
            raise DataError(
                f"force.drives is 'dic', but {len(here)} DIC points are measured within {band:g} mm of the model's end y = {y_end:g} mm at "
                f"{dic.time[n]:g} s, at least {_LEAST} are needed; let the model end inside the field (geometry.shape bar with a shorter "
                "specimen.total_length) or widen force.band"
            )
        a = np.stack([np.ones(len(here)), x[here], y[here]], axis=1)
        u = dic.displacement[n, here, 1]
        inverse = np.linalg.pinv(a)
        coefficient = inverse @ u
        left = u - a @ coefficient
        value[n] = coefficient[0]
        variance[n] = float(left @ left) / (len(here) - 3) * float(inverse[0] @ inverse[0])
        least = min(least, len(here))
    return value, variance, least
