"""The measured force as an input of the model: smoothed phase by phase to its noise level, kinks kept.

The force is prescribed as a load. Near the end of loading dF/d(strain) is only some kN, and plasticity rectifies raw
noise: each upward spike yields, no downward one takes it back (thesis, figure 5.20, shows the jumps of dissipation).
So the record is replaced by a piecewise cubic spline that differs from it by nothing but noise; its breaks are the
kinks of the programme and the sharp knees of the force.

Splines: each piece between two breaks has its own clamped B-spline basis (degree 1 or 3, free slope at the breaks); the last
coefficient of a piece is the first of the next, so that the curve is continuous. Knots are inserted where the score
test says that chi-square falls by more than `GAIN`, and taken out where the Wald test says that it rises by less.
Basis: C. de Boor, A Practical Guide to Splines (1978), chapters IX and XIV; scipy's make_lsq_spline and
generate_knots know one smooth piece and no test of a knot against noise, so that only the basis is scipy's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.optimize import lsq_linear
from scipy.sparse import csr_array, hstack

from thermofit.core.errors import DataError, NumericsError, StudyError
from thermofit.core.experiment import ForceRecord
from thermofit.observe.phases import Phases, check_record, find_phases, force_noise, working_sigma

GAIN = 12.0
"""Drop of chi-square that one knot must be worth: one place in 2000 gains that much from noise alone."""
_GAIN_CUBIC = 15.1
"""The same level of significance for the two coefficients that a cubic has more than a line."""
_PASSES = 40
_MOST = 400


@dataclass(frozen=True)
class Curve:
    """Piecewise spline: `edges` (n_p + 1,) s, per piece the interior knots and the degree, and the coefficients (n_c,)."""

    edges: np.ndarray
    knots: tuple[np.ndarray, ...]
    degrees: tuple[int, ...]
    coefficients: np.ndarray

    @property
    def starts(self) -> np.ndarray:
        """Column of the first coefficient of each piece, and that of the last coefficient of all, (n_p + 1,)."""
        sizes = [k.size + d for k, d in zip(self.knots, self.degrees, strict=True)]
        return np.concatenate([[0], np.cumsum(sizes)])

    def vector(self, piece: int) -> np.ndarray:
        """Clamped knot vector of a piece in s."""
        d = self.degrees[piece]
        ends = self.edges[piece], self.edges[piece + 1]
        return np.concatenate([np.full(d + 1, ends[0]), self.knots[piece], np.full(d + 1, ends[1])])

    def piece_of(self, time: np.ndarray) -> np.ndarray:
        """Index of the piece that holds each time, (n,)."""
        return np.clip(np.searchsorted(self.edges, time, side="right") - 1, 0, len(self.knots) - 1)

    def evaluate(self, time: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Value or derivative (per s) at times within the edges, (n,); at a break that of the piece that begins."""
        result = np.empty(time.size)
        owner, starts = self.piece_of(time), self.starts
        for piece in np.unique(owner):
            inside = owner == piece
            local = self.coefficients[starts[piece] : starts[piece + 1] + 1]
            spline = BSpline(self.vector(piece), local, self.degrees[piece])
            result[inside] = spline(time[inside], nu=derivative)
        return result

    def design(self, time: np.ndarray) -> csr_array:
        """Matrix (n, n_c) that takes coefficients to values at increasing or unordered times within the edges."""
        owner, starts = self.piece_of(time), self.starts
        rows, columns, values = [], [], []
        for piece in np.unique(owner):
            inside = np.flatnonzero(owner == piece)
            local = BSpline.design_matrix(time[inside], self.vector(piece), self.degrees[piece]).tocoo()
            rows.append(inside[local.row])
            columns.append(local.col + starts[piece])
            values.append(local.data)
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        return csr_array(entries, shape=(time.size, int(starts[-1]) + 1))


@dataclass(frozen=True)
class Fit:
    """A curve with the data it was fitted to: residual (n,), design (n, n_c) and the Cholesky factor of design^T design."""

    curve: Curve
    design: csr_array
    factor: tuple[np.ndarray, bool]
    residual: np.ndarray

    def solve(self, right: np.ndarray) -> np.ndarray:
        """(design^T design)^-1 right."""
        return np.asarray(cho_solve(self.factor, right))


def fit_curve(curve: Curve, time: np.ndarray, value: np.ndarray) -> Fit:
    """Least-squares coefficients for given breaks, knots and degrees; NumericsError where a piece lacks samples."""
    design = curve.design(time)
    try:
        factor = cho_factor((design.T @ design).toarray(), lower=True)
    except LinAlgError:
        raise NumericsError(
            "force smoothing: a spline piece holds too few samples to be determined, expected two or more in each; "
            "give smoothing: none or a record with a higher rate"
        ) from None
    coefficients = cho_solve(factor, design.T @ value)
    fitted = replace(curve, coefficients=coefficients)
    return Fit(fitted, design, factor, value - design @ coefficients)


def adaptive_fit(edges: np.ndarray, time: np.ndarray, value: np.ndarray, sigma: float) -> Fit:
    """Curve with the fewest knots that leaves nothing but noise of `sigma`: insert, then prune; edges (n_p + 1,) s."""
    held = np.bincount(np.clip(np.searchsorted(edges, time, side="right") - 1, 0, edges.size - 2), minlength=edges.size - 1)
    degrees = tuple(int(np.clip(n - 1, 1, 3)) for n in held)
    empty = np.zeros(0)
    fit = fit_curve(Curve(edges, tuple(empty for _ in degrees), degrees, empty), time, value)
    for _ in range(_PASSES):
        added = [_worthwhile(fit, piece, time, sigma) for piece in range(len(degrees))]
        if not any(a.size for a in added) or fit.curve.coefficients.size > _MOST:
            break
        knots = tuple(np.sort(np.concatenate([k, a])) for k, a in zip(fit.curve.knots, added, strict=True))
        fit = fit_curve(replace(fit.curve, knots=knots), time, value)
    return _prune(fit, time, value, sigma)


def _candidates(low: int, high: int) -> np.ndarray:
    """Sample indices after which a knot may go in an interval of samples low .. high - 1: 2, 4, 8, ... from either end
    and the middle, so that a bend near the end of a long interval is reached at once; at least two samples each side."""
    n = high - low
    steps = 2 ** np.arange(1, 20)
    steps = steps[steps <= n // 2]
    return np.unique(np.concatenate([low + steps, high - steps, [low + n // 2]])) if n >= 4 else np.zeros(0, dtype=int)


def _worthwhile(fit: Fit, piece: int, time: np.ndarray, sigma: float) -> np.ndarray:
    """New knots of a piece (s): the best of each interval, if worth it and better than those of both neighbours.

    None where the piece would have more coefficients than samples.
    """
    curve = fit.curve
    if curve.degrees[piece] < 3:
        return np.zeros(0)
    marks = np.concatenate([[curve.edges[piece]], curve.knots[piece], [curve.edges[piece + 1]]])
    bounds = np.searchsorted(time, marks)
    block = _block(fit, piece, (int(bounds[0]), int(bounds[-1])))
    best = np.zeros((marks.size - 1, 2))
    for j in range(marks.size - 1):
        for i in _candidates(int(bounds[j]), int(bounds[j + 1])):
            knot = 0.5 * (time[i - 1] + time[i])
            gain = _score(block, curve.vector(piece), knot, time) / sigma**2
            if gain > best[j, 0]:
                best[j] = gain, knot
    gains = best[:, 0]
    beside = np.maximum(np.concatenate([[0.0], gains[:-1]]), np.concatenate([gains[1:], [0.0]]))
    order = np.flatnonzero((gains > GAIN) & (gains >= beside))
    spare = int(bounds[-1] - bounds[0]) - (marks.size + 2)
    return np.asarray(best[order[np.argsort(-gains[order])][: max(0, spare)], 1])


@dataclass(frozen=True)
class _PieceFit:
    """What one piece has of a fit: index of its first sample, dense design, covariance for unit noise, residual."""

    first: int
    design: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray


def _block(fit: Fit, piece: int, samples: tuple[int, int]) -> _PieceFit:
    starts = fit.curve.starts
    columns = slice(int(starts[piece]), int(starts[piece + 1]) + 1)
    unit = np.eye(fit.curve.coefficients.size)[:, columns]
    rows = slice(*samples)
    return _PieceFit(samples[0], fit.design[rows].toarray()[:, columns], fit.solve(unit)[columns], fit.residual[rows])


def _score(block: _PieceFit, old: np.ndarray, knot: float, time: np.ndarray) -> float:
    """Drop of the sum of squares if `knot` were added to the knot vector `old` of a piece: (g.r)^2 / |g_perp|^2 for the
    new B-spline g around the knot, g_perp being what the present functions cannot say of g."""
    refined = np.insert(old, int(np.searchsorted(old, knot)), knot)
    # The first and last function are not zero at the breaks; they belong to the neighbours too.
    j = int(np.clip(np.searchsorted(old, knot) - 2, 1, refined.size - 6))
    low, high = np.searchsorted(time, [refined[j], refined[j + 4]])
    high = min(int(high), block.first + block.residual.size)
    g = BSpline.basis_element(refined[j : j + 5])(time[low:high])
    part = slice(low - block.first, high - block.first)
    inner = g @ block.design[part]
    left = float(g @ g - inner @ block.covariance @ inner)
    if left <= 1e-9 * float(g @ g):
        return 0.0
    return float(g @ block.residual[part]) ** 2 / left


def _prune(fit: Fit, time: np.ndarray, value: np.ndarray, sigma: float) -> Fit:
    """Take out knots, and cubics that could be lines, while chi-square rises by less than they must be worth; each time
    the least of every other piece, because neighbours share a coefficient."""
    while True:
        worth = [(_wald(fit, row, sigma) / GAIN, piece, j) for piece, j, row in _jumps(fit.curve)]
        worth += [(_wald(fit, rows, sigma) / (_GAIN_CUBIC if len(rows) > 1 else GAIN), piece, -1) for piece, rows in _bends(fit.curve)]
        knots, degrees = list(fit.curve.knots), list(fit.curve.degrees)
        touched: set[int] = set()
        for share, piece, j in sorted(worth):
            if share >= 1.0:
                break
            if touched & {piece - 1, piece, piece + 1}:
                continue
            touched.add(piece)
            if j < 0:
                degrees[piece] = 1
            else:
                knots[piece] = np.delete(knots[piece], j)
        if not touched:
            return fit
        fit = fit_curve(replace(fit.curve, knots=tuple(knots), degrees=tuple(degrees)), time, value)


def _wald(fit: Fit, rows: np.ndarray, sigma: float) -> float:
    """Rise of chi-square if rows @ coefficients (m,) is forced to zero; exact, because the model is linear."""
    held = rows @ fit.curve.coefficients
    spread = rows @ fit.solve(rows.T)
    return float(held @ np.linalg.solve(spread, held)) / sigma**2


def _jumps(curve: Curve) -> list[tuple[int, int, np.ndarray]]:
    """Per interior knot: piece, index, and the row (1, n_c) that gives the jump of the third derivative, scaled to one."""
    found = []
    starts = curve.starts
    for piece, interior in enumerate(curve.knots):
        if not interior.size:
            continue
        vector = curve.vector(piece)
        marks = np.concatenate([[vector[0]], interior, [vector[-1]]])
        middle = 0.5 * (marks[1:] + marks[:-1])
        basis = BSpline(vector, np.eye(vector.size - 4), 3)
        steps = np.diff(basis(middle, nu=3), axis=0)
        for j, step in enumerate(steps):
            row = np.zeros((1, int(starts[-1]) + 1))
            row[0, starts[piece] : starts[piece + 1] + 1] = step / np.abs(step).max()
            found.append((piece, j, row))
    return found


def _bends(curve: Curve) -> list[tuple[int, np.ndarray]]:
    """Per curved piece without knots: piece, and the rows (1 or 2, n_c) that vanish where it is a straight line."""
    found = []
    for piece, (interior, degree, start) in enumerate(zip(curve.knots, curve.degrees, curve.starts[:-1], strict=True)):
        if degree == 2:
            row = np.zeros((1, int(curve.starts[-1]) + 1))
            row[0, start : start + 3] = -0.5, 1.0, -0.5
            found.append((piece, row))
        elif degree == 3 and not interior.size:
            rows = np.zeros((2, int(curve.starts[-1]) + 1))
            rows[0, start : start + 4] = -2.0 / 3.0, 1.0, 0.0, -1.0 / 3.0
            rows[1, start : start + 4] = -1.0 / 3.0, 0.0, 1.0, -2.0 / 3.0
            found.append((piece, rows))
    return found


def monotone(fit: Fit, senses: np.ndarray, value: np.ndarray) -> Fit:
    """The nearest curve that rises (sense +1), falls (-1) or is free (0) in each piece, senses (n_p,).

    Coefficients of a B-spline that increase give a curve that increases; in c = T y with y the steps between
    coefficients that is a bound on y. Minimises |L^T (c - c_free)|, that is the same chi-square.
    """
    n = fit.curve.coefficients.size
    sense = np.zeros(n)
    for piece, s in enumerate(senses):
        sense[fit.curve.starts[piece] + 1 : fit.curve.starts[piece + 1] + 1] = s
    signs = np.where(sense < 0.0, -1.0, 1.0)
    total = np.tril(np.ones((n, n))) * signs[None, :]
    root = np.tril(fit.factor[0]).T
    low = np.where(sense == 0.0, -np.inf, 0.0)
    solved = lsq_linear(root @ total, root @ fit.curve.coefficients, bounds=(low, np.full(n, np.inf)), method="bvls")
    curve = replace(fit.curve, coefficients=total @ solved.x)
    return replace(fit, curve=curve, residual=value - fit.design @ curve.coefficients)


def halved(curve: Curve, piece: int, time: np.ndarray) -> Curve:
    """The curve with a knot more in the middle of each interval of a cubic piece that holds four samples or more."""
    marks = np.concatenate([[curve.edges[piece]], curve.knots[piece], [curve.edges[piece + 1]]])
    held = np.diff(np.searchsorted(time, marks))
    if curve.degrees[piece] < 3 or held.sum() < 2 * marks.size + 2:
        return curve
    middle = [float(np.median(time[(time >= a) & (time < b)])) for a, b in pairwise(marks)]
    knots = list(curve.knots)
    knots[piece] = np.sort(np.concatenate([knots[piece], np.array(middle)[held >= 4]]))
    return replace(curve, knots=tuple(knots))


SMOOTHINGS = ("phases", "none")
_FINE = 12
_SHIFT = 3.0
_NEAR = 40
_HALVINGS = 2
_FINER = 3
"""How often the intervals between knots are halved for the curve that tells the error: its own error of approximation, which falls by
sixteen with every halving, is in no covariance, and near the largest force a hundredth of the noise moves the points by more than theirs.
"""
_NUDGE = 1e-3
"""Part of the shorter of two pieces by which the break between them is moved for a derivative."""
_TOLD = 1e-12
"""Part of the largest square of the influence on the record, of columns of one size, below which a change of the curve has none."""
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
    spread: np.ndarray

    def evaluate(self, t: np.ndarray | float) -> np.ndarray:
        """Force in N at times t in s, shape of t; DataError outside the record."""
        return _shaped(self.curve.evaluate(_within(self, t)), t)

    def rate(self, t: np.ndarray | float) -> np.ndarray:
        """dF/dt in N/s at times t in s, shape of t; at a break that of the following piece; DataError outside the record."""
        return _shaped(self.curve.evaluate(_within(self, t), 1), t)

    def sigma(self, t: np.ndarray | float) -> np.ndarray:
        """Standard error of the smoothed force in N at times t in s, see `error_modes`; DataError outside the record."""
        times = _within(self, t)
        own = self._own_error(times)
        return _shaped(np.sqrt(np.asarray((own * own).sum(axis=1)).ravel() + self._left_out(times) ** 2), t)

    def error_modes(self, t: np.ndarray | float) -> np.ndarray:
        """Modes of the error of the smoothed force in N at times t s (n,), (n, k): its covariance is modes modes^T; those of less than a
        thousandth of the largest are left out. DataError outside the record.

        smooth - truth = (smooth - finer) + (finer - truth): a knot has to be worth much, so that a bend which is not worth one is left out
        of the smoothed force. What a finer curve shows of such bends is one mode, its own standard errors are the others.
        """
        times = _within(self, t)
        own = self._own_error(times).toarray()
        u, s, _ = np.linalg.svd(np.column_stack([own, self._left_out(times)]), full_matrices=False)
        return np.asarray((u * s)[:, s > 1e-3 * s[0]])

    def _own_error(self, times: np.ndarray) -> csr_array:
        """What the errors of the finer curve make (n, k) of the force at times (n,)."""
        if self.spread.ndim == 1:
            return csr_array(self.finer.design(times).multiply(self.spread))
        return csr_array(_by_breaks_too(self.finer, times) @ self.spread)

    def _left_out(self, times: np.ndarray) -> np.ndarray:
        """What the finer curve shows and the smoothed force does not, N (n,)."""
        return self.finer.evaluate(times) - self.curve.evaluate(times)


def _by_breaks_too(curve: Curve, time: np.ndarray) -> csr_array:
    """Derivatives (n, n_c + n_b) of a curve at times (n,) by its coefficients and by the times of its breaks, these in N/s.

    Where an elastic load ends in flow a break that is a millisecond off is worth a newton or two. Only moved breaks tell such an error:
    the coefficients of either side hold the curve to the other one at the time at which the break happens to stand.
    """
    moved = []
    for j in range(1, curve.edges.size - 1):
        by = _NUDGE * float(np.min(np.diff(curve.edges)[j - 1 : j + 1]))
        off = by * (np.arange(curve.edges.size) == j)
        ahead, behind = (replace(curve, edges=curve.edges + way * off).evaluate(time) for way in (1.0, -1.0))
        moved.append(csr_array(((ahead - behind) / (2.0 * by))[:, None]))
    return csr_array(hstack([curve.design(time), *moved]))


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
    # Differences of a few samples with a spike may be larger than all that the force changes.
    level = min(force_noise(record), float(np.ptp(record.force))) if noise is None else float(noise)
    if level > np.ptp(record.force):
        raise StudyError(
            f"force noise: found {level:.3g} N, more than the force changes in the record ({np.ptp(record.force):.3g} N); expected "
            "the noise of single samples in N, leave it out to have it measured"
        )
    phases = find_phases(record, level)
    if smoothing == "none":
        inner = record.time[1:-1]
        curve = Curve(record.time[[0, -1]], (inner,), (1,), record.force)
        return _summary(record, phases, level, curve, curve, np.full(record.time.size, level))
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
    return _summary(record, phases, level, fit.curve, finer.curve, _spread(finer.curve, record.time, level))


def _spread(curve: Curve, time: np.ndarray, level: float) -> np.ndarray:
    """Errors (n_c + n_b, k) of coefficients and breaks for a noise of `level` N at the times of the record (n,). What changes nothing of
    the force that was measured is no error of it."""
    columns = _by_breaks_too(curve, time)
    normal = (columns.T @ columns).toarray()
    size = np.sqrt(np.diag(normal))
    size[size == 0.0] = 1.0
    square, turned = np.linalg.eigh(normal / np.outer(size, size))
    told = square > _TOLD * square[-1]
    return np.asarray(level * turned[:, told] / np.sqrt(square[told]) / size[:, None])


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
    """The fit with every interval between knots of its cubic pieces cut into eight, and with parabolas for its lines, where they hold
    samples enough.

    A line is a piece whose bend is not worth its coefficients. In an elastic unloading it has none; where a short piece flows, what is left
    out moves the specimen by more than the line is told to be off.
    """
    for _ in range(_FINER):
        curve = fit.curve
        for piece in range(len(curve.knots)):
            curve = halved(curve, piece, record.time)
        fit = fit_curve(curve, record.time, record.force)
    return fit_curve(_bent(fit.curve, record.time), record.time, record.force)


def _bent(curve: Curve, time: np.ndarray) -> Curve:
    """The curve with a parabola in place of every line that holds twice the samples that this needs."""
    held = np.diff(np.searchsorted(time, [*curve.edges[:-1], np.inf]))
    degrees = tuple(2 if d == 1 and n >= 6 else d for d, n in zip(curve.degrees, held, strict=True))
    return replace(curve, degrees=degrees)


def _chi_square(fit: Fit, sigma: float) -> float:
    return float(fit.residual @ fit.residual) / sigma**2


def _summary(record: ForceRecord, phases: Phases, noise: float, curve: Curve, finer: Curve, spread: np.ndarray) -> SmoothForce:
    """The smoothed force with what was taken away, in numbers."""
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
        spread=spread,
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
    parts = [_subdivide(smooth, a, b, tolerance, max_dt) for a, b in pairwise(fixed)]
    return np.concatenate([*parts, fixed[-1:]])


def _subdivide(smooth: SmoothForce, a: float, b: float, tolerance: float, max_dt: float) -> np.ndarray:
    """Step times in [a, b), a among them, for a gap without break; tolerance N, largest step s."""
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
