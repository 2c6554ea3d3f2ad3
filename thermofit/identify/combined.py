"""Combined uncertainty of a stage: its own noise, and everything that it takes for exact, passed on from stage to stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.experiment.protocol import Experiment
from thermofit.fit.budget import combined
from thermofit.fit.linear_model import LinearModel
from thermofit.identify.blocks import residual_blocks
from thermofit.identify.budget import earlier_moves
from thermofit.identify.outcome import channel_table
from thermofit.identify.solve import Solved, noise_of
from thermofit.records.artefact import Record
from thermofit.study.stages import StageSettings

ABOVE_NOISE = 1.05
"""Error of a channel over its noise, which is itself known to a few percent, from which on the residual tells of more than noise."""


def with_budget(settings: StageSettings, experiment: Experiment, solved: Solved, earlier: Mapping[str, Record]) -> Solved:
    """The same answer with the combined uncertainty of its parameters; `earlier`: records of the stages whose parameters it took.

    Where a run that tells a cause fails, the answer keeps the noise alone, and says so.
    """
    if solved.covariance is None or solved.fit.jacobian is None:
        return solved
    model, parameters = solved.model, solved.parameters
    names, passed = earlier_moves({stage: record for stage, record in earlier.items() if record.parameters})
    used = tuple(n for n in names if n not in solved.fit.names)
    try:
        told = experiment.stage_errors(settings, parameters, used)
    except NumericsError as error:
        remark = f"the uncertainty holds the noise of the data alone: a run that tells the rest failed ({error})"
        return replace(solved, remarks=(*solved.remarks, remark))
    causes = dict(told.causes)
    rows = [names.index(n) for n in used]
    for cause, moves in passed.items():
        through = told.slopes @ moves[rows]
        if not through.any():
            continue
        own = causes.get(cause)
        causes[cause] = through if own is None else _added(own, through)
    linear = LinearModel(solved.fit.residual, solved.fit.jacobian, noise_of(model, solved.fit.residual))
    budget = combined(
        linear,
        solved.covariance,
        causes,
        noise_scale=None if model.segments is not None else float(np.mean(model.spread**2)),
        groups=groups_above_noise(solved),
        channels=model.places if model.segments is None else None,
    )
    return replace(solved, budget=budget)


def groups_above_noise(solved: Solved) -> np.ndarray | None:
    """Numbers (n,) of blocks of time and space that a misfit has in common; None where every channel is at its noise."""
    model = solved.model
    channels = channel_table(model, model.errors(solved.parameters))
    above = max((float(c["chi2_reduced"]) for c in channels.values()), default=0.0) > ABOVE_NOISE**2
    return residual_blocks(model, solved.fit.residual).label if above and model.segments is None else None


def _added(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sum of columns of the same errors; one may lack the last ones."""
    width = max(a.shape[1], b.shape[1])
    return np.pad(a, ((0, 0), (0, width - a.shape[1]))) + np.pad(b, ((0, 0), (0, width - b.shape[1])))
