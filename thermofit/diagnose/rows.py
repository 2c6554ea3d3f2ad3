"""Rows and phases of a joint fit of several experiments: one after the other in time, so that no block holds rows of two of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from thermofit.diagnose.case import rows_of
from thermofit.diagnose.held_out import Rows
from thermofit.experiment.model import StageModel
from thermofit.experiment.residuals import Span


def rows_of_tests(models: Mapping[str, StageModel], spans: Sequence[Span]) -> Rows:
    """Rows of a joint problem from the models of the tests in it by name; that of a test which is alone has none."""
    return rows_of(models[""], spans) if set(models) == {""} else joined_rows(models, spans)


def joined_rows(models: Mapping[str, StageModel], spans: Sequence[Span]) -> Rows:
    """Rows of a joined model from the models of its experiments: all data, then all priors; times follow one another."""
    data, channel, phase = [], 0, 0
    priors = 0
    for name, model in models.items():
        own = [s for s in spans if s.experiment == name]
        here = rows_of(model, own)
        used = here.channel >= 0
        data.append(Rows(here.channel[used] + channel, here.time[used], here.xy[used], here.phase[used] + phase))
        channel, phase, priors = channel + len(model.comparisons), phase + len(own), priors + int((~used).sum())
    rows = stacked(data)
    return Rows(
        np.append(rows.channel, np.full(priors, -1)),
        np.append(rows.time, np.full(priors, rows.time.min())),
        np.concatenate([rows.xy, np.zeros((priors, 2))]),
        np.append(rows.phase, np.full(priors, -1)),
    )


def stacked(rows: Sequence[Rows]) -> Rows:
    """Rows of several experiments, one after the other in time, so that their groups stay apart."""
    time, at = [], 0.0
    for one in rows:
        time.append(one.time - one.time.min() + at)
        at = float(time[-1].max()) + 1.0
    return Rows(
        np.concatenate([one.channel for one in rows]),
        np.concatenate(time),
        np.concatenate([one.xy for one in rows]),
        np.concatenate([one.phase for one in rows]),
    )
