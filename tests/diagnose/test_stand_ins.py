"""Which effects could stand in for one that was accepted: what an angle calls alike, a large amplitude tells apart."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from refits import fitted, refitting
from seen_field import case_of

from thermofit.core.errors import NumericsError
from thermofit.diagnose import stand_ins as module
from thermofit.diagnose.backward import held_out_of
from thermofit.diagnose.loop import Closed, close_loop, like_of
from thermofit.diagnose.other_form import with_stand_ins
from thermofit.diagnose.stand_ins import stand_ins
from thermofit.diagnose.trace import Traced

ON = {"ir_drift.rate": 0.02}
ALIKE, OTHER = "ir_gain", "ir_emissivity"


def closed() -> Closed:
    """A loop that has added a drift of many standard errors."""
    case, fit = fitted(case_of(5, **ON))
    found = close_loop(case, fit, refitting(case.model), 3, None)
    assert found.accepted == ("ir_drift",)
    return found


def beside(here: Traced, cosine: float) -> Traced:
    """A trace whose dormant gain acts as the drift does, at that |cos|."""
    k = here.case.parameters.free.index("ir_drift.rate")
    amplitude, column = here.case.parameters["ir_drift.rate"], here.columns.fitted[:, k]
    rest = here.problem.model.only([i for i in range(here.columns.fitted.shape[1]) if i != k])
    own = rest.sensitive(column[:, None])[:, 0]
    noise = np.random.default_rng(3).normal(size=len(own))
    other = here.problem.model.projected(noise)
    mixed = cosine * own + np.sqrt(1.0 - cosine**2) * np.linalg.norm(own) / np.linalg.norm(other) * other
    block = (mixed * amplitude / 0.01)[:, None]
    problem = replace(here.problem, dormant={**here.problem.dormant, ALIKE: (("ir_gain.gain",), block)})
    return replace(here, problem=problem, scanned={})


def test_a_stand_in_predicts_held_out_data_as_well() -> None:
    """At |cos| 0.95 a drift of many standard errors is told from what is like it, by whatever name the round called them one family."""
    found = closed()
    here = found.last
    assert stand_ins(beside(here, 1.0), "ir_drift") == (ALIKE,)
    assert stand_ins(beside(here, 0.95), "ir_drift", (ALIKE, OTHER)) == ()
    assert stand_ins(beside(here, 0.0), "ir_drift", (ALIKE,)) == ()


def test_the_end_tells_what_the_round_could_not() -> None:
    found = closed()
    family = ("ir_drift", ALIKE, OTHER)
    turns = tuple(
        replace(r, trials=tuple(replace(t, scores=tuple(replace(s, family=family) for s in t.scores)) for t in r.trials))
        for r in found.rounds
    )
    found = replace(found, rounds=turns)
    assert like_of(found) == {"ir_drift": (ALIKE, OTHER)}
    assert like_of(with_stand_ins(found)) == {"ir_drift": ()}
    same = replace(found, last=beside(found.last, 1.0))
    assert like_of(with_stand_ins(same)) == {"ir_drift": (ALIKE,)}
    cheap = replace(same, last=replace(same.last, case=replace(same.last.case, cheap=True)))
    assert with_stand_ins(cheap).stand_ins is None, "of coupons the refits have told"


def test_without_the_effect_the_model_is_run_and_where_that_fails_taken_to_first_order() -> None:
    here = beside(closed().last, 1.0)

    def fails(_: object) -> dict[str, np.ndarray]:
        raise NumericsError("no equilibrium")

    assert stand_ins(replace(here, case=replace(here.case, model=replace(here.case.model, errors=fails))), "ir_drift") == (ALIKE,)


@pytest.mark.parametrize(
    ("worse", "motion", "told"),
    [(1.5, False, True), (1.0, False, False), (1.5, True, False), (None, False, False)],
    ids=["worse", "as well", "acts on the motion", "no start runs"],
)
def test_a_refit_on_the_known_motion_tells_what_one_step_could_not(
    worse: float | None, motion: bool, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alike to first order; the refit begins without what was accepted."""
    here = beside(closed().last, 1.0)
    begun: list[Any] = []

    def refitted(there: Traced, scores: Any, fit: Any, settings: Any, freed: bool) -> Any:
        begun.append((there.case.parameters["ir_drift.rate"], "ir_drift.rate" in there.case.parameters.free, scores[0].effect, freed))
        return None if worse is None else SimpleNamespace(held_out=worse * held_out_of(here))

    monkeypatch.setattr(module, "refitted", refitted)
    if motion:
        monkeypatch.setattr(module, "acting_on_temperatures", lambda names: tuple(n for n in names if not n.startswith(ALIKE)))
    warm = replace(here, case=replace(here.case, heated=lambda parameters: SimpleNamespace()))
    assert stand_ins(warm, "ir_drift") == (() if told else (ALIKE,))
    assert begun == ([] if motion else [(0.0, False, ALIKE, True)])
