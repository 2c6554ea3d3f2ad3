"""A missing stress as a law: smooth steps of the yield stress over one state variable.

What is missing over the time of a cyclic record turns with every reversal, so that no neighbouring block of time tells the next. Over the
state it may be one curve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.diagnose.trace import Traced
from thermofit.diagnose.unlisted_effect import VARIABLES
from thermofit.diagnose.unlisted_field import Basis, MissingField, field_of
from thermofit.diagnose.unlisted_structure import Structure
from thermofit.experiment.channels import field_of as observed_field
from thermofit.experiment.missing import Grid

STEPS = 10
"""Steps of a table of the yield stress."""


@dataclass(frozen=True)
class StateLaw:
    """The name of a state variable, `edges` (m,) of steps over it, all of one `width`, and the field whose q (m,) are their heights MPa."""

    variable: str
    edges: np.ndarray
    width: float
    field: MissingField

    @property
    def size(self) -> float:
        """Largest height of the curve over its mean, MPa: its level is one with the yield stress of the base law."""
        curve = np.cumsum(self.field.q)
        return float(np.abs(curve - curve.mean()).max())


def state_law(here: Traced, structure: Structure) -> StateLaw | None:
    """The missing stress of a channel over the state variable that predicts held-out data best; None where the driver knows no missing
    yield stress, or where no variable moves."""
    missing = here.case.model.missing
    terms = None if missing is None else missing.of_yield
    if terms is None:
        return None
    best: StateLaw | None = None
    for variable in VARIABLES:
        values = terms.yield_variables(here.case.parameters, variable)
        if len(values) < STEPS or float(np.ptp(values)) <= 1e-9 * max(1.0, float(np.abs(values).max())):
            continue
        edges = np.linspace(values.min(), values.max(), STEPS + 1)[:-1]
        width = 0.5 * float(edges[1] - edges[0])
        found = _stepped(here, structure, terms.yielding(here.case.parameters, variable, edges, width), edges)
        if best is None or found.proof.gain > best.field.proof.gain:
            best = StateLaw(variable, edges, width, found)
    return best


def _stepped(here: Traced, structure: Structure, answers: np.ndarray, edges: np.ndarray) -> MissingField:
    """Field of steps of the yield stress at edges (m,) of a state variable; `answers` (n_t, 1, 1, m) are theirs."""
    grid = Grid(edges, np.zeros(len(edges), dtype=int), np.zeros(1), np.zeros(1))
    channel, model = structure.blocks.channel, here.case.model
    columns = model.columns({observed_field(channel): answers})[here.case.channels.index(channel)]
    # Steps of the table are independent of each other: only their size is held down.
    hat = Basis("stress", "MPa", grid, np.arange(len(edges)), structure.blocks.rows, columns, np.eye(len(edges)))
    return field_of(here.problem.model, hat, here.rows, here.split)
