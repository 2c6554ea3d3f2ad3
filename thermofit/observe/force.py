"""The measured force as an input of the model: smoothed phase by phase to its noise level, kinks kept.

The force is prescribed as a load. Near the end of loading dF/d(strain) is only some kN, and plasticity rectifies raw
noise: each upward spike yields, no downward one takes it back (thesis, figure 5.20, shows the jumps of dissipation).
So the record is replaced by a piecewise cubic spline that differs from it by nothing but noise; its breaks are the
kinks of the programme and the sharp knees of the force.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from thermofit.core.errors import DataError, StudyError
from thermofit.core.experiment import ForceRecord
from thermofit.observe.phases import Phases, check_record, find_phases, force_noise, working_sigma
from thermofit.observe.splines import GAIN, Curve, Fit, adaptive_fit, fit_curve, halved, monotone

__all__ = ["Phases", "SmoothForce", "find_phases", "force_noise", "programme_times", "smooth_force", "step_times"]

SMOOTHINGS = ("phases", "none")
_FINE = 12
_SHIFT = 3.0
_NEAR = 40
_HALVINGS = 2
_MANY = 60
_MOST_BREAKS = 200


@dataclass(frozen=True)
class SmoothForce:
    """The force that the model is loaded with.

    `time` s (n,) and `force` N (n,) at the times of the record; `knots` s: all breaks and knots; `phases` of the
    programme; `noise` N: sigma of the raw force; `residual_rms` N, `residual_autocorrelation` at lag one and
    `residual_max` (largest |raw - smooth| / noise) of what was taken away; `n` samples; `spurious_reversals`: how often
    dF/dt has the wrong sign within a loading or unloading phase. `curve` is for `evaluate`; `finer`, a curve with more
    knots that was fitted to the same record, and its `covariance` N^2, (n_c, n_c) or its diagonal (n_c,), tell the error.
    """

    time: np.ndarray
    force: np.ndarray
    knots: np.ndarray
    phases: Phases
    noise: float
    residual_rms: float
    residual_autocorrelation: float
    residual_max: float
    n: int
    spurious_reversals: int
    curve: Curve
    finer: Curve
    covariance: np.ndarray

    def evaluate(self, t: np.ndarray | float) -> np.ndarray:
        """Force in N at times t in s, shape of t; DataError outside the record."""
        return _shaped(self.curve.evaluate(_within(self, t)), t)

    def rate(self, t: np.ndarray | float) -> np.ndarray:
        """dF/dt in N/s at times t in s, shape of t; at a break that of the following piece; DataError outside the record."""
        return _shaped(self.curve.evaluate(_within(self, t), 1), t)

    def sigma(self, t: np.ndarray | float) -> np.ndarray:
        """Standard error of the smoothed force in N at times t in s, see `error_modes`; DataError outside the record."""
        times = _within(self, t)
        design = self.finer.design(times)
        if self.covariance.ndim == 1:
            variance = np.asarray(design.multiply(design) @ self.covariance)
        else:
            variance = np.asarray(design.multiply(design @ self.covariance).sum(axis=1)).ravel()
        return _shaped(np.sqrt(np.maximum(variance, 0.0) + self._left_out(times) ** 2), t)

    def error_modes(self, t: np.ndarray | float) -> np.ndarray:
        """Modes of the error of the smoothed force in N at times t s (n,), (n, k): its covariance is modes modes^T; those of less than a
        thousandth of the largest are left out. DataError outside the record.

        smooth - truth = (smooth - finer) + (finer - truth): a knot has to be worth much, so that a bend which is not worth one is left out
        of the smoothed force. What a finer curve shows of such bends is one mode, its own standard errors are the others.
        """
        times = _within(self, t)
        design = self.finer.design(times)
        if self.covariance.ndim == 1:
            root = np.diag(np.sqrt(self.covariance))
        else:
            # A record without noise, such as a computed one, has no covariance to take a root of.
            root = np.linalg.cholesky(self.covariance) if self.covariance.any() else self.covariance
        u, s, _ = np.linalg.svd(np.column_stack([design @ root, self._left_out(times)]), full_matrices=False)
        return np.asarray((u * s)[:, s > 1e-3 * s[0]])

    def _left_out(self, times: np.ndarray) -> np.ndarray:
        """What the finer curve shows and the smoothed force does not, N (n,)."""
        return self.finer.evaluate(times) - self.curve.evaluate(times)


def _within(smooth: SmoothForce, t: np.ndarray | float) -> np.ndarray:
    """Times as a flat array, checked to be within the record (a rounding error beyond it is moved onto its end)."""
    times = np.asarray(t, dtype=float).ravel()
    first, last = float(smooth.time[0]), float(smooth.time[-1])
    slack = 1e-9 * (last - first)
    bad = ~((times >= first - slack) & (times <= last + slack))
    if bad.any():
        raise DataError(
            f"force record: covers {first:g} s to {last:g} s, asked for {int(bad.sum())} times outside such as "
            f"{times[bad][0]:g} s; expected times within the record, shorten the window or export more of the force"
        )
    return np.asarray(np.clip(times, first, last))


def _shaped(values: np.ndarray, like: np.ndarray | float) -> np.ndarray:
    return np.asarray(values).reshape(np.shape(like))


def smooth_force(record: ForceRecord, noise: float | None = None, smoothing: str = "phases") -> SmoothForce:
    """Smooth a force record to its noise level; `noise` in N if it is known better than from second differences.

    `smoothing` "phases" is the spline of this module, "none" joins the raw samples by straight lines.
    Errors: DataError for a bad record, StudyError for a noise that is not positive or an unknown smoothing.
    """
    check_record(record)
    if smoothing not in SMOOTHINGS:
        raise StudyError(f"force smoothing: found '{smoothing}', expected one of {', '.join(SMOOTHINGS)}")
    if noise is not None and not (np.isfinite(noise) and noise > 0.0):
        raise StudyError(f"force noise: found {noise}, expected a positive number of N or nothing (then it is measured)")
    level = force_noise(record) if noise is None else float(noise)
    if level > np.ptp(record.force):
        raise StudyError(
            f"force noise: found {level:.3g} N, more than the force changes in the record ({np.ptp(record.force):.3g} N); expected "
            "the noise of single samples in N, leave it out to have it measured"
        )
    phases = find_phases(record, level)
    if smoothing == "none":
        inner = record.time[1:-1]
        curve = Curve(record.time[[0, -1]], (inner,), (1,), record.force)
        return _summary(record, phases, level, (curve, curve, np.full(record.time.size, level**2)))
    if phases.kinks.size + phases.knees.size > _MOST_BREAKS:
        raise DataError(
            f"force record: found {phases.kinks.size} kinks and {phases.knees.size} knees at a noise of {level:.3g} N, "
            f"expected at most {_MOST_BREAKS}; the noise is not white: give its level (noise), leave out a rough "
            "crosshead, or take smoothing none"
        )
    sigma = working_sigma(level, record.force)
    edges = _settle_knees(record, phases, sigma)
    phases = replace(phases, knees=np.setdiff1d(edges[1:-1], phases.kinks))
    fit = adaptive_fit(edges, record.time, record.force, sigma)
    curve = _moved_breaks(fit.curve, record, phases, sigma)
    phases = _renamed(phases, edges, curve.edges)
    fit = fit_curve(curve, record.time, record.force)
    fit = _without_reversals(fit, record, phases, sigma)
    finer = _finer(fit, record)
    return _summary(record, phases, level, (fit.curve, finer.curve, level**2 * finer.solve(np.eye(finer.curve.coefficients.size))))


def _settle_knees(record: ForceRecord, phases: Phases, sigma: float) -> np.ndarray:
    """Edges of the pieces: ends, kinks, and each knee where it pays most, or not at all; (n_p + 1,) s.

    A knee can be rounded, and lines that meet are then no guide to the best break. Places up to `_SHIFT` samples away,
    half a sample apart, and no break at all compete by chi-square plus `GAIN` for each coefficient and each reversal.
    Not where there are more than `_MANY` knees: that is serrated flow, each tooth is a knee and stays where it was found.
    """
    edges = np.concatenate([record.time[:1], np.sort(np.concatenate([phases.kinks, phases.knees])), record.time[-1:]])
    for knee in phases.knees if phases.knees.size <= _MANY else ():
        others = edges[edges != knee]
        i = int(np.searchsorted(record.time, knee))
        step = float(np.median(np.diff(record.time[max(0, i - 4) : i + 5])))
        places = knee + step * np.arange(-_SHIFT, _SHIFT + 0.5, 0.5)
        trials = [np.sort(np.append(others, place)) for place in places if _room(others, float(place), record.time)]
        costs = [_local_cost(record, phases, trial, (float(knee), sigma)) for trial in [others, *trials]]
        edges = [others, *trials][int(np.argmin(costs))]
    return edges


def _room(edges: np.ndarray, place: float, time: np.ndarray) -> bool:
    """True if a break at `place` leaves two samples at least in the pieces before and after it."""
    if not edges[0] < place < edges[-1]:
        return False
    j = int(np.searchsorted(edges, place))
    marks = np.searchsorted(time, [edges[j - 1], place, edges[j]])
    return bool(marks[1] - marks[0] >= 2 and marks[2] - marks[1] >= 2)


def _local_cost(record: ForceRecord, phases: Phases, edges: np.ndarray, about: tuple[float, float]) -> float:
    """Chi-square of a fit near a knee plus `GAIN` per coefficient and per reversal; about = (time of the knee s, sigma N)."""
    knee, sigma = about
    i = int(np.searchsorted(record.time, knee))
    low, high = record.time[max(0, i - _NEAR)], record.time[min(record.time.size - 1, i + _NEAR)]
    pinned = np.concatenate([phases.kinks, record.time[[0, -1]]])
    before, after = pinned[pinned < knee - _SHIFT * _step(record)], pinned[pinned > knee + _SHIFT * _step(record)]
    low, high = max(low, before.max(initial=low)), min(high, after.min(initial=high))
    part = (record.time >= low) & (record.time <= high)
    local = np.concatenate([[low], edges[(edges > low) & (edges < high)], [high]])
    held = np.diff(np.searchsorted(record.time[part], local))
    local = np.delete(local, 1 + np.flatnonzero(held[:-1] < 2)) if held.size > 1 else local
    fit = adaptive_fit(local, record.time[part], record.force[part], sigma)
    reversals = int(_reversals(fit.curve, _senses(fit.curve, phases)).sum())
    return _chi_square(fit, sigma) + GAIN * (fit.curve.coefficients.size + reversals)


def _moved_breaks(curve: Curve, record: ForceRecord, phases: Phases, sigma: float) -> Curve:
    """Each break moved by up to a quarter of a sample to the least chi-square of the two pieces that meet there.

    Kinks keep what the crosshead knows of them: (shift / kink_sigma)^2 is added to chi-square.
    """
    edges = curve.edges.copy()
    known = dict(zip(phases.kinks.tolist(), phases.kink_sigma.tolist(), strict=True))
    for j in range(1, edges.size - 1):
        low, high = np.searchsorted(record.time, [edges[j - 1], edges[j + 1]])
        time, force = record.time[low:high], record.force[low:high]
        prior = known.get(float(curve.edges[j]), np.inf)
        pair = replace(curve, edges=edges[j - 1 : j + 2], knots=curve.knots[j - 1 : j + 1], degrees=curve.degrees[j - 1 : j + 1])
        shifts = 0.25 * float(np.median(np.diff(time))) * np.linspace(-1.0, 1.0, 5)
        costs = np.full(5, np.inf)
        for k, shift in enumerate(shifts):
            trial = _shifted(pair, float(shift))
            if _clear(trial, time):
                costs[k] = _chi_square(fit_curve(trial, time, force), sigma) + (shift / prior) ** 2
        k = int(np.argmin(costs))
        if not np.isfinite(costs[k]):
            continue
        shift = float(shifts[k])
        if 0 < k < 4 and np.all(np.isfinite(costs[k - 1 : k + 2])) and costs[k - 1] - 2.0 * costs[k] + costs[k + 1] > 0.0:
            bend = costs[k - 1] - 2.0 * costs[k] + costs[k + 1]
            between = shift + 0.5 * float(shifts[1] - shifts[0]) * float((costs[k - 1] - costs[k + 1]) / bend)
            shift = between if _clear(_shifted(pair, between), time) else shift
        edges[j] += shift
    return replace(curve, edges=edges)


def _shifted(pair: Curve, shift: float) -> Curve:
    """Two pieces with the break between them shifted."""
    return replace(pair, edges=pair.edges + np.array([0.0, shift, 0.0]))


def _clear(pair: Curve, time: np.ndarray) -> bool:
    """True if the knots of two pieces are inside their piece and each piece holds as many samples as it needs."""
    sizes = [k.size + d for k, d in zip(pair.knots, pair.degrees, strict=True)]
    held = np.diff(np.searchsorted(time, [*pair.edges[:2], np.inf]))
    first, second = pair.knots
    return bool(np.all(held > sizes) and np.all(first < pair.edges[1]) and np.all(second > pair.edges[1]))


def _renamed(phases: Phases, old: np.ndarray, new: np.ndarray) -> Phases:
    """Phases with their times moved as the edges were."""
    to = dict(zip(old.tolist(), new.tolist(), strict=True))
    items = tuple(replace(phase, t0=to[phase.t0], t1=to[phase.t1]) for phase in phases.items)
    kinks, knees = (np.array([to[t] for t in times.tolist()]) for times in (phases.kinks, phases.knees))
    return replace(phases, items=items, kinks=kinks, knees=knees)


def _step(record: ForceRecord) -> float:
    return float(np.median(np.diff(record.time)))


def _senses(curve: Curve, phases: Phases) -> np.ndarray:
    """Sign that dF/dt should have in each piece of the curve: of its phase, 0 in holds; (n_p,)."""
    middle = 0.5 * (curve.edges[1:] + curve.edges[:-1])
    starts = np.array([phase.t0 for phase in phases.items])
    owner = np.clip(np.searchsorted(starts, middle, side="right") - 1, 0, starts.size - 1)
    signs = np.array([0.0 if phase.kind == "hold" else np.sign(phase.force_rate) for phase in phases.items])
    return np.asarray(signs[owner])


def _fine_times(curve: Curve, piece: int) -> np.ndarray:
    """Times within each knot interval of a piece, dense enough to see its shape, the knots among them."""
    marks = np.concatenate([curve.edges[piece : piece + 1], curve.knots[piece], curve.edges[piece + 1 : piece + 2]])
    share = np.arange(_FINE) / _FINE
    return np.append((marks[:-1, None] + np.diff(marks)[:, None] * share).ravel(), marks[-1])


def _reversals(curve: Curve, senses: np.ndarray) -> np.ndarray:
    """How often the curve begins to go against the sense of each piece, (n_p,)."""
    counts = np.zeros(senses.size, dtype=int)
    scale = 1e-9 * max(float(np.ptp(curve.coefficients)), np.finfo(float).tiny)
    for piece in np.flatnonzero(senses):
        wrong = senses[piece] * np.diff(curve.evaluate(_fine_times(curve, int(piece)))) < -scale
        counts[piece] = int(wrong[0]) + int(np.count_nonzero(wrong[1:] & ~wrong[:-1]))
    return counts


def _without_reversals(fit: Fit, record: ForceRecord, phases: Phases, sigma: float) -> Fit:
    """Force pieces to be monotone where the noise permits: chi-square may rise by `GAIN` per reversal that goes.

    Increasing coefficients are more than an increasing curve needs; the surplus vanishes as knots are halved, so that is
    tried before a reversal is believed. A real drop (upper yield point, change of rate, necking) is significant and stays.
    """
    senses = _senses(fit.curve, phases)
    active = np.zeros(senses.size)
    bound = fit
    for piece in np.flatnonzero(_reversals(fit.curve, senses)):
        count = int(_reversals(fit.curve, senses)[piece])
        trial, curve = fit, fit.curve
        wanted = np.where(np.arange(senses.size) == piece, senses, active)
        for _ in range(_HALVINGS + 1):
            candidate = monotone(trial, wanted, record.force)
            if _chi_square(candidate, sigma) - _chi_square(bound, sigma) <= GAIN * count:
                fit, bound, active = trial, candidate, wanted
                break
            curve = halved(curve, int(piece), record.time)
            trial = fit_curve(curve, record.time, record.force)
    return bound


def _finer(fit: Fit, record: ForceRecord) -> Fit:
    """The fit with every interval between knots of its cubic pieces cut into four, where it holds samples enough.

    A piece that a straight line fits, such as an elastic unloading, stays one: its bends are in no error.
    """
    for _ in range(_HALVINGS):
        curve = fit.curve
        for piece in range(len(curve.knots)):
            curve = halved(curve, piece, record.time)
        fit = fit_curve(curve, record.time, record.force)
    return fit


def _chi_square(fit: Fit, sigma: float) -> float:
    return float(fit.residual @ fit.residual) / sigma**2


def _summary(record: ForceRecord, phases: Phases, noise: float, result: tuple[Curve, Curve, np.ndarray]) -> SmoothForce:
    """The smoothed force with what was taken away, in numbers."""
    curve, finer, covariance = result
    force = curve.evaluate(record.time)
    residual = record.force - force
    power = float(residual @ residual)
    knots = np.sort(np.concatenate([curve.edges, *curve.knots]))
    return SmoothForce(
        time=record.time,
        force=force,
        knots=knots,
        phases=phases,
        noise=noise,
        residual_rms=float(np.sqrt(power / residual.size)),
        residual_autocorrelation=float(residual[1:] @ residual[:-1]) / power if power > 0.0 else 0.0,
        residual_max=float(np.abs(residual).max()) / noise if noise > 0.0 else 0.0,
        n=residual.size,
        spurious_reversals=int(_reversals(curve, _senses(curve, phases)).sum()),
        curve=curve,
        finer=finer,
        covariance=covariance,
    )


def programme_times(smooth: SmoothForce) -> np.ndarray:
    """Times (s) that a solver must step onto: kinks of the programme and sharp knees of the force, sorted."""
    return np.sort(np.concatenate([smooth.phases.kinks, smooth.phases.knees]))


def step_times(smooth: SmoothForce, required: np.ndarray, tolerance: float, max_dt: float) -> np.ndarray:
    """Few times between which the force is straight within `tolerance` N and which are at most `max_dt` s apart.

    From the start of the record to the last required time (its end if none is required): all required times within
    the record, all programme times on the way, and in each gap as many more as needed. A chord over dt misses
    |F''| dt^2 / 8, so that steps of equal share of the integral of sqrt(|F''|) make equal errors.
    StudyError for a tolerance or step that is not positive.
    """
    if not (tolerance > 0.0 and max_dt > 0.0):
        raise StudyError(f"step times: found tolerance {tolerance} N and largest step {max_dt} s, expected positive numbers")
    first, last = float(smooth.time[0]), float(smooth.time[-1])
    wanted = np.asarray(required, dtype=float).ravel()
    wanted = wanted[(wanted >= first) & (wanted <= last)]
    end = float(wanted.max()) if wanted.size else last
    forced = programme_times(smooth)
    fixed = np.unique(np.concatenate([[first], wanted, forced[(forced > first) & (forced < end)], [end]]))
    parts = [_subdivide(smooth, a, b, (tolerance, max_dt)) for a, b in pairwise(fixed)]
    return np.concatenate([*parts, fixed[-1:]])


def _subdivide(smooth: SmoothForce, a: float, b: float, limits: tuple[float, float]) -> np.ndarray:
    """Step times in [a, b), a among them, for a gap without break; limits = (tolerance N, largest step s)."""
    tolerance, max_dt = limits
    inner = smooth.knots[(smooth.knots > a) & (smooth.knots < b)]
    marks = np.concatenate([[a], inner, [b]])
    fine = np.unique((marks[:-1, None] + np.diff(marks)[:, None] * np.linspace(0.0, 1.0, _FINE + 1)).ravel())
    middle = 0.5 * (fine[1:] + fine[:-1])
    force = smooth.curve.evaluate(fine)
    density = np.sqrt(np.abs(smooth.curve.evaluate(middle, 2)) / (8.0 * tolerance))
    share = np.concatenate([[0.0], np.cumsum(np.maximum(density, 1.0 / max_dt) * np.diff(fine))])
    n = max(1, int(np.ceil(share[-1] - 1e-6)))
    while True:
        times = np.interp(np.linspace(0.0, share[-1], n + 1), share, fine)
        times[0], times[-1] = a, b
        chord = np.interp(fine, times, smooth.curve.evaluate(times))
        if np.max(np.abs(force - chord)) <= tolerance or n >= 4 * fine.size:
            return times[:-1]
        n += 1
