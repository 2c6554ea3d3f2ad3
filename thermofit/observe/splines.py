"""Least-squares splines on pieces that are joined continuously, with knots put where the noise asks for them.

Each piece between two breaks has its own clamped B-spline basis (degree 1 or 3, free slope at the breaks); the last
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
from scipy.sparse import csr_array

from thermofit.core.errors import NumericsError

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
class _Block:
    """What one piece has of a fit: index of its first sample, dense design, covariance for unit noise, residual."""

    first: int
    design: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray


def _block(fit: Fit, piece: int, samples: tuple[int, int]) -> _Block:
    starts = fit.curve.starts
    columns = slice(int(starts[piece]), int(starts[piece + 1]) + 1)
    unit = np.eye(fit.curve.coefficients.size)[:, columns]
    rows = slice(*samples)
    return _Block(samples[0], fit.design[rows].toarray()[:, columns], fit.solve(unit)[columns], fit.residual[rows])


def _score(block: _Block, old: np.ndarray, knot: float, time: np.ndarray) -> float:
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
