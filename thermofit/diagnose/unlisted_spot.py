"""An unlisted heat that has a place as one spot: where its middle y_0 is and how far it reaches.

    q(y, t) = q(t) exp(-((y - y_0 - v (t - t_0)) / s)^2 / 2) / (sqrt(2 pi) s),   q(t) of hats

Hats over the face tell where a heat is, but not the parameters: too few are not all of it, and beside many the data hardly tell anything.
Conduction levels out how a compact source is spread, across a sheet within seconds. What is left of it is its power over time, its middle
and its spread, which are fitted together with a step of the parameters. A band of localised flow travels along the specimen: where that is
asked for, its velocity v is fitted as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import lsq_linear

from thermofit.diagnose.unlisted_field import Basis, MissingField, with_parameters
from thermofit.diagnose.unlisted_place import Place
from thermofit.experiment.missing import Grid
from thermofit.fit.linear_model import LinearModel, Room

NEARBY = 0.05
"""Part of the spread by which it and the middle are moved for a difference quotient."""
FARTHEST = 1.0
"""Spreads by which the middle moves at most in one step, and the logarithm of the factor by which the spread changes."""
HALVED = (1.0, 0.5, 0.25, 0.125)
"""Parts of a step that are tried in turn."""
MOST = 12
"""Most steps."""
OF_ITS_ERROR = 0.1
"""Part of its standard error beside the other to which a step of middle or spread has come down where they are found."""


Shown = Callable[[Grid, np.ndarray], np.ndarray]
"""What coefficients (m,) of the hats of a grid make of the residual (n,)."""


def nearest(residual: np.ndarray, hats: Callable[[Grid], Basis], shown: Shown, hat: Basis, *, weight: float, least: float) -> Basis:
    """The spot whose middle and spread, from those of hats at hand, fit best with lambda beside parameters that stay where they left the
    residual r (n,), by Gauss-Newton steps that are taken as far as

        min_q |r + B q|^2 + lambda q^T R q

    falls. Beside parameters that are free it would be the best one for where a whole step takes them, and a step may be cut or damped.

    No step goes farther than FARTHEST, nor the spread below the least. Where it is held up there the middle goes where it fits best
    beside it: of a spread that the mesh hardly shows a free step is no direction. Behind its hats stand columns of a middle that is 1 mm
    lower, of a velocity that is 1 mm/s less where it travels, and of ln s, which the uncertainty of all others knows of; of ln s none where
    it would go below the least. `weight`: lambda; `least`: the least spread in mm."""
    stay = LinearModel(residual, np.zeros((len(residual), 0)))
    q, _, square = with_parameters(stay, hat, weight)
    for turn in range(MOST + 1):
        ways = _ways(hat.grid, q)
        both = _with_place(shown, hat, q, ways)
        moved, posterior, _ = with_parameters(stay, both, weight)
        m = len(hat.chosen)
        if not np.diag(posterior)[m:].all():
            break  # what has no power has no place
        step, near = _within(moved[m:], posterior[m:, m:], _room(hat.grid, ways, least))
        if near or turn == MOST:
            break
        tried = (hats(_moved(hat.grid, ways, part * step)) for part in HALVED)
        ends = ((one, with_parameters(stay, one, weight)) for one in tried)
        found = next(((one, end) for one, end in ends if end[2] < square), None)
        if found is None:
            break
        hat, (q, _, square) = found
    narrower = hat.grid.spread * np.exp(moved[-1]) < least
    return _without_spread(both) if narrower else both


def travels(term: MissingField, place: Place) -> np.ndarray | None:
    """Middle y_0 in mm, velocity v in mm/s and time t_0 in s, (3,), of what the hats of a term (n_k, n_y, n_x, 1) show within its window:
    of its power of one sign, the straight line through its middle over time. None where the way is shorter than it reaches along the
    load: then nothing says that it travels."""
    grid, power = term.basis.grid, term.values.sum(axis=(2, 3))
    inside = (grid.time >= place.when[0]) & (grid.time <= place.when[1])
    power = np.where(inside[:, None], np.maximum(np.sign(power.sum()) * power, 0.0), 0.0)
    weight = power.sum(axis=1)
    if np.count_nonzero(weight) < 2:
        return None
    y = power @ grid.y / np.maximum(weight, 1e-300)
    mean, since = (float(weight @ v / weight.sum()) for v in (y, grid.time))
    velocity = float(weight @ ((y - mean) * (grid.time - since)) / (weight @ (grid.time - since) ** 2))
    way = abs(velocity) * (place.when[1] - place.when[0])
    return np.array([mean, velocity, since]) if way > place.extent[1] else None


def _ways(grid: Grid, q: np.ndarray) -> np.ndarray:
    """What (n_k, k) lowers the place at every knot in time by a unit of each of its variables but the spread: 1 everywhere for its middle,
    and t - t_0 for the velocity of one that travels, t_0 the middle of its power in time, about which either says nothing of the other."""
    every = np.ones((len(grid.time), 1))
    if grid.along is None:
        return every
    return np.column_stack([every, grid.time - middle_of_power(grid, q)])


def middle_of_power(grid: Grid, q: np.ndarray) -> float:
    """Middle t_0 in s, by the squares, of the power of hats in time (m,)."""
    power = q[: len(grid.time)] ** 2
    return float(power @ grid.time) / max(float(power.sum()), 1e-300)


def _with_place(shown: Shown, hat: Basis, q: np.ndarray, ways: np.ndarray) -> Basis:
    """The hats of a spot and, behind them, what their coefficients q (m,) do by its `ways` (n_k, k) and its spread, to first order. Asked
    for these coefficients alone a place that has moved costs one answer, for all hats as many as there are."""
    grid, n = hat.grid, ways.shape[1]
    by = np.append(NEARBY * grid.spread / np.sqrt(np.mean(ways**2, axis=0)), NEARBY)
    moved = [_moved(grid, ways, np.append(h * np.eye(n)[k], 0.0)) for k, h in enumerate(by[:n])]
    moved.append(_moved(grid, ways, np.append(np.zeros(n), by[n])))
    own = [(shown(way, q)[hat.rows] - hat.columns @ q) / h for way, h in zip(moved, by, strict=True)]
    return replace(hat, columns=np.column_stack([hat.columns, *own]), rough=block_diag(hat.rough, np.zeros((n + 1, n + 1))))


def _without_spread(both: Basis) -> Basis:
    """The same without what the spread does."""
    return replace(both, columns=both.columns[:, :-1], rough=both.rough[:-1, :-1])


def _room(grid: Grid, ways: np.ndarray, least: float) -> Room:
    """How far (k + 1,) the place of a spot goes in a step at most, on the average over the knots, in mm, and ln s, either way."""
    farthest = FARTHEST * np.append(grid.spread / np.sqrt(np.mean(ways**2, axis=0)), 1.0)
    return np.append(-farthest[:-1], max(-farthest[-1], float(np.log(least / grid.spread)))), farthest


def _within(step: np.ndarray, covariance: np.ndarray, room: Room) -> tuple[np.ndarray, bool]:
    """The step (k,) within a room that is nearest to a free one, by its covariance (k, k), and whether it is a small part of the standard
    error that each variable has beside the others."""
    size = np.sqrt(np.diag(covariance))
    known = np.linalg.inv(covariance / np.outer(size, size))
    root = np.linalg.cholesky(known).T
    out = lsq_linear(root, root @ (step / size), (room[0] / size, room[1] / size)).x
    return out * size, bool(np.all(np.abs(out) * np.sqrt(np.diag(known)) <= OF_ITS_ERROR))


def _moved(grid: Grid, ways: np.ndarray, step: np.ndarray) -> Grid:
    """The grid with its place lower by a step (k + 1,) along its ways, in mm, and ln s larger by the last number."""
    spread = grid.spread * float(np.exp(step[-1]))
    along = None if grid.along is None else grid.along - ways[:, 1:] @ step[1:-1]
    return replace(grid, y=grid.y - float(step[0]), spread=spread, along=along)
