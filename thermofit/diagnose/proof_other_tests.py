"""What held-out tests say of two optima, without and with an effect, and of an effect that has been accepted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermofit.core.parameters import param
from thermofit.diagnose.held_out import Proof, rms_with_error
from thermofit.diagnose.other_tests import UnseenColumns, both_predicted, proof_of_change, unseen_residual
from thermofit.diagnose.trace import Traced
from thermofit.effects.catalogue import effect
from thermofit.fit.linear_model import LinearModel


def predicted_unseen(here: Traced, beyond: Sequence[UnseenColumns] | None = None) -> np.ndarray:
    """Residual (m,) of the held-out tests of a trace, or of some of them."""
    tests = here.unseen if beyond is None else beyond
    return unseen_residual(here.problem.model, tests, [b.fitted for b in tests])


def proof_of_refit(here: Traced, there: Traced, name: str) -> Proof | None:
    """Proof of an effect by two optima, without and with it; None where the held-out tests cannot judge it."""
    if not any(name in test.judges for test in here.case.other_tests):
        return None
    before, after = both_predicted(here.unseen, there.unseen)
    return proof_of_change(predicted_unseen(here, before), predicted_unseen(there, after), before) if before else None


def proof_of_need(here: Traced, name: str, seen: LinearModel) -> Proof | None:
    """Proof of an accepted effect against the same model without it, `seen`; None as in `proof_of_refit`."""
    if not here.unseen or not any(name in test.judges for test in here.case.other_tests):
        return None
    own = [k for k, n in enumerate(here.case.parameters.free) if n in effect(name).names]
    back = np.array([0.0 if param(n).scan else param(n).neutral - here.case.parameters[n] for n in effect(name).names])
    back = back[[effect(name).names.index(here.case.parameters.free[k]) for k in own]]
    without = [replace(b, residual=b.residual + b.fitted[:, own] @ back) for b in here.unseen]
    before = unseen_residual(seen, without, [np.delete(b.fitted, own, axis=1) for b in here.unseen])
    return proof_of_change(before, predicted_unseen(here), here.unseen)


def unseen_rms(here: Traced, tests: Sequence[UnseenColumns]) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
    """Rms over the noise of every channel of these held-out tests with its standard error, and the noise in the unit of the channel, by
    <channel>@<test>."""
    residual, at = (predicted_unseen(here, tests) if tests else np.zeros(0)), 0
    rms, floors = {}, {}
    for b in tests:
        part = residual[at : at + len(b.residual)]
        at += len(b.residual)
        for k, (channel, floor) in enumerate(b.floors.items()):
            rms[f"{channel}@{b.name}"] = rms_with_error(part, b.rows, b.rows.channel == k)
            floors[f"{channel}@{b.name}"] = floor
    return rms, floors


def held_out_words(here: Traced) -> str:
    """What was held out, in words."""
    if not here.unseen:
        return here.split.by
    return f"{', '.join(b.name for b in here.unseen)}, which no fit has seen; for what only a fitted test can show: {here.split.by}"
