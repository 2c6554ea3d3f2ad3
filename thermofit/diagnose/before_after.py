"""Error before and after, of fit and held-out data, with its standard error, beside the floors of noise and discretisation."""

from __future__ import annotations

import numpy as np

from thermofit.diagnose.backward import held_out_of
from thermofit.diagnose.held_out import rms_with_error
from thermofit.diagnose.other_tests import both_predicted
from thermofit.diagnose.proof_other_tests import unseen_rms
from thermofit.diagnose.trace import Traced
from thermofit.records.artefact import Dataset

WORDS = ("before", "after")
ERRORS = ("fit", "fit_sigma", "held_out", "held_out_sigma", "numerical")
Table = dict[str, dict[str, dict[str, float]]]
"""Numbers by before or after, by what they are, by channel."""


def channel_rms(here: Traced, residual: np.ndarray) -> dict[str, tuple[float, float]]:
    """Rms of whitened rows per channel with its standard error, in units of the noise; nan rows (never held out) are left aside."""
    seen = np.isfinite(residual)
    return {c: rms_with_error(residual, here.rows, (here.rows.channel == k) & seen) for k, c in enumerate(here.case.channels)}


def numerical_rms(here: Traced) -> dict[str, float]:
    """Rms per channel of the error of mesh and steps that may be left in the residual, in units of the noise; empty: it is not known."""
    error = here.problem.may_be_left
    if error is None:
        return {}
    return {c: float(np.sqrt(np.mean(error[here.rows.channel == k] ** 2))) for k, c in enumerate(here.case.channels)}


def before_after(first: Traced, last: Traced) -> Table:
    """Error of fit and held-out data per channel before and after, in the unit of the channel: rms = (rms / noise) x noise floor.

    Of held-out tests those that both predict. Beside them their standard errors and both floors: that of the noise, and what the error of
    mesh and steps alone would give.
    """
    floors = {c.channel: float(np.sqrt(np.mean(c.sigma**2))) for c in first.case.model.comparisons}
    table: Table = {}
    predicted = both_predicted(first.unseen, last.unseen)
    for word, here, tests in zip(WORDS, (first, last), predicted, strict=True):
        unseen, noise = unseen_rms(here, tests)
        fit, held = channel_rms(here, here.columns.residual), channel_rms(here, held_out_of(here)) | unseen
        floor = floors | noise
        table[word] = {
            "fit": {c: rms * floor[c] for c, (rms, _) in fit.items()},
            "fit_sigma": {c: sigma * floor[c] for c, (_, sigma) in fit.items()},
            "held_out": {c: rms * floor[c] for c, (rms, _) in held.items()},
            "held_out_sigma": {c: sigma * floor[c] for c, (_, sigma) in held.items()},
            "floor": floor,
            "numerical": {c: rms * floor[c] for c, rms in numerical_rms(here).items()},
        }
    return table


def error_datasets(table: Table) -> dict[str, Dataset]:
    """The table in units of the noise, one value per channel (nan: there is none), beside the names of the channels."""
    floors = table["after"]["floor"]
    out = {"error/channel": Dataset(np.array(list(floors)), "1", ("channel",))}
    for word in WORDS:
        for kind in ERRORS:
            value = np.array([table[word][kind].get(c, np.nan) / floor for c, floor in floors.items()])
            out[f"error/{word}/{kind}"] = Dataset(value, "1", ("channel",))
    return out
