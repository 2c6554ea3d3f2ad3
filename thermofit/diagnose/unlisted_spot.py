"""An unlisted heat that has a place as one spot: where its middle y_0 is and how far it reaches.

    q(y, t) = q(t) exp(-((y - y_0) / s)^2 / 2) / (sqrt(2 pi) s),   q(t) of hats

Hats over the face tell where a heat is, but not the parameters: too few are not all of it, and beside many the data hardly tell anything.
Conduction levels out how a compact source is spread, across a sheet within seconds. What is left of it is its power over time, its middle
and its spread, which are fitted together with a step of the parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from thermofit.diagnose.held_out import Rows, Split
from thermofit.diagnose.unlisted_field import Basis, MissingField, field_of, with_parameters
from thermofit.experiment.missing import Grid
from thermofit.fit.linear_model import LinearModel

NEARBY = 0.05
"""Part of the spread by which it and the middle are moved for a difference quotient."""
FARTHEST = 1.0
"""Spreads by which the middle moves at most in one step, and the logarithm of the factor by which the spread changes."""
HALVED = (1.0, 0.5, 0.25, 0.125)
"""Parts of a step that are tried in turn."""
MOST = 8
"""Most steps: each costs four answers to unit heats."""
OF_ITS_ERROR = 0.1
"""Part of their standard errors to which a step of middle and spread has come down where they are found."""


def nearest(
    known: LinearModel, hats: Callable[[Grid], Basis], grid: Grid, rows: Rows, split: Split, *, weight: float, least: float
) -> MissingField:
    """The spot whose middle and spread, from those of a grid, fit best with lambda, by Gauss-Newton steps that are taken as far as

        |r + J x + B q|^2 + lambda q^T R q

    falls. Behind its hats stand columns of a middle that is 1 mm lower and of ln s, which the uncertainty of all others knows of; of ln s
    none where the spread is the least. `weight`: lambda; `least`: the least spread in mm."""

    hat = hats(grid)
    q, _, square = with_parameters(known, hat, weight)
    for turn in range(MOST + 1):
        both = _with_place(hats, hat, q, least)
        moved, posterior, _ = with_parameters(known, both, weight)
        step = moved[len(hat.chosen) :]
        near = np.abs(step) <= OF_ITS_ERROR * np.sqrt(np.diag(posterior)[-len(step) :])
        if near.all() or turn == MOST:
            break
        tried = (hats(_moved(hat.grid, part * step, least)) for part in HALVED)
        ends = ((one, with_parameters(known, one, weight)) for one in tried)
        found = next(((one, end) for one, end in ends if end[2] < square), None)
        if found is None:
            break
        hat, (q, _, square) = found
    return field_of(known, both, rows, split, weight)


def _with_place(hats: Callable[[Grid], Basis], hat: Basis, q: np.ndarray, least: float) -> Basis:
    """The hats of a spot and, behind them, what their coefficients q (m,) do by its middle and its spread, to first order."""
    grid = hat.grid
    by = NEARBY * np.array([grid.spread, 1.0])
    ways = (replace(grid, y=grid.y - by[0]), replace(grid, spread=grid.spread * float(np.exp(by[1]))))
    ends = ways if grid.spread > least else ways[:1]
    own = [(hats(way).columns @ q - hat.columns @ q) / h for way, h in zip(ends, by, strict=False)]
    free = np.zeros((len(own), len(own)))
    return replace(hat, columns=np.column_stack([hat.columns, *own]), rough=block_diag(hat.rough, free))


def _moved(grid: Grid, step: np.ndarray, least: float) -> Grid:
    """The grid with its middle lower by the first number of a step, in mm, and ln s larger by the second, where there is one."""
    lower = float(np.clip(step[0], -FARTHEST * grid.spread, FARTHEST * grid.spread))
    wider = float(np.exp(np.clip(step[1], -FARTHEST, FARTHEST))) if len(step) > 1 else 1.0
    return replace(grid, y=grid.y - lower, spread=max(grid.spread * wider, least))
