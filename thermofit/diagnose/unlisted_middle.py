"""Where an offset of the infrared camera that grows along the load is nothing: its middle y_0.

    theta_camera = theta + g(t) (y - y_0)

A camera that tilts, or whose housing warms up from one side, does so about a height of its own image, which need not be the middle of the
specimen. Were it held there, what is left, -g(t) y_0 in all of the image, would be taken by films, capacity and heat of plastic flow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from thermofit.diagnose.held_out import Rows, Split
from thermofit.diagnose.unlisted_field import Basis, MissingField, field_of
from thermofit.experiment.missing import KINDS, Grid
from thermofit.fit.linear_model import LinearModel

Hats = Callable[[Grid], Basis]
"""The hats of a grid, whose one knot in y is the middle."""


def found_middle(known: LinearModel, hats: Hats, grid: Grid, rows: Rows, split: Split) -> Grid:
    """The grid with y_0 in mm of the offset along the load that goes best with one h(t) that is the same everywhere.

    It is the slope of -h over g, for what is constant of either is taken by parameters. It lies no farther beyond what is observed than
    that is high: a camera sees little more than the specimen.
    """
    along, m = hats(grid), grid.size
    even = _lower(hats, along)
    unit = float(np.linalg.norm(along.columns) / np.linalg.norm(even))  # either is as rough in units of what it does to the image
    both = replace(along, columns=np.hstack([along.columns, unit * even]), rough=block_diag(along.rough, along.rough))
    q = field_of(known, both, rows, split).q
    g, h = q[:m] - np.mean(q[:m]), unit * (q[m:] - np.mean(q[m:]))
    y = rows.xy[along.rows, 1]
    low, high = float(y.min()), float(y.max())
    middle = grid.y - float(h @ g) / max(float(g @ g), 1e-300)
    return replace(grid, y=np.clip(middle, low - (high - low), high + (high - low)))


def with_middle(hats: Hats, term: MissingField) -> Basis:
    """The hats of a term about its middle as it was found last and, behind them, what the term does where that lies 1 mm lower."""
    along = hats(about(term))
    lower = _lower(hats, along) @ term.q[: len(along.chosen)]
    return replace(along, columns=np.column_stack([along.columns, lower]), rough=block_diag(along.rough, np.zeros((1, 1))))


def about(term: MissingField) -> Grid:
    """The grid of a term, of one about a middle with that which it has found: as far lower as its last coefficient says. That of a film
    says which changes are there, for what it lets out goes with the temperatures that these leave."""
    grid = term.basis.grid
    if term.basis.kind == "film":
        return replace(grid, level=term.values[:, 0, 0, 0])
    if not KINDS[term.basis.kind].about:
        return grid
    return replace(grid, y=grid.y - np.sum(term.q[len(term.basis.chosen) :]))


def _lower(hats: Hats, along: Basis) -> np.ndarray:
    """What unit hats (n_rows, m) add where their middle lies 1 mm lower."""
    return np.asarray(hats(replace(along.grid, y=along.grid.y - 1.0)).columns - along.columns)
