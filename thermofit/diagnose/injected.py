"""The loop on data into which an effect was planted, and what it answered."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from thermofit.core.errors import DataError, NumericsError, UntrustworthyError
from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.diagnose.loop import like_of
from thermofit.diagnose.prepared import prepared
from thermofit.diagnose.whole_loop import Looped, looped
from thermofit.effects.catalogue import effect
from thermofit.experiment.forms import experiment_after
from thermofit.records.staging import Job
from thermofit.study.study import Study

ITSELF, LIKE, UNLISTED, OTHER, NOTHING, FAILED = "the effect", "its like", "unlisted", "another", "nothing", "failed"
ANSWERS: Mapping[str, str] = {
    ITSELF: "named as it was planted",
    LIKE: "named as an effect that this test does not tell from it",
    UNLISTED: "unlisted, in the channel in which it shows most",
    OTHER: "something else is named instead",
    NOTHING: "nothing is named",
    FAILED: "the loop ended with an error",
}
FOUND = (ITSELF, LIKE, UNLISTED)
"""Answers that count as found."""


@dataclass(frozen=True)
class Injection:
    """One run of the loop on planted data, in a form that any process can be sent.

    `stages`: identification stages that it rests on; `turned`: the sections drive it, although the study says that the force should;
    `before`, `after`: parameters without and with the effect, of which the predictions differ by what is planted; `job`: where evaluations
    are kept. Equal parameters plant nothing.
    """

    study: Study
    stages: tuple[str, ...]
    turned: bool
    before: Parameters
    after: Parameters
    effect: str
    job: Job


def answered(one: Injection) -> dict[str, Any]:
    """What the loop says of it, as plain types; an error of the numerics or the data becomes the text `failed`."""
    begin = time.perf_counter()
    set_threads(one.study.numerics.threads)
    try:
        experiment = experiment_after(one.study, one.stages)
        experiment = (experiment.by_sections or experiment) if one.turned else experiment
        if one.after.values != one.before.values:
            experiment = experiment.planted(one.before, one.after)
        said = said_by(looped(one.study, prepared(one.study, one.job, one.stages, of=experiment)), one.effect)
    except (NumericsError, UntrustworthyError, DataError) as error:
        said = {"failed": str(error)}
    return {**said, "wall_s": round(time.perf_counter() - begin, 2)}


def said_by(end: Looped, name: str) -> dict[str, Any]:
    """What was accepted, each with the effects that the data do not tell from it, what is unlisted, and Params of the effect of that name
    with their standard errors where it was accepted."""
    closed, missing = end.closed, end.missing
    fitted = {} if closed.fit.sigma is None else dict(zip(closed.fit.names, closed.fit.sigma.tolist(), strict=True))
    at = closed.last.case.parameters
    estimate = {p.name: [at[p.name], fitted.get(p.name)] for p in effect(name).params} if name in closed.accepted else {}
    unlisted: dict[str, Any] | None = None
    if missing is not None:
        unlisted = {"channel": missing.channel, "y_mm": None, "when_s": None}
        if missing.place is not None:
            unlisted |= {"y_mm": missing.place.centroid[1], "when_s": list(missing.place.when)}
    return {
        "accepted": list(closed.accepted),
        "like": {n: list(others) for n, others in like_of(closed).items()},
        "unlisted": unlisted,
        "estimate": estimate,
        "settled": bool(closed.fit.converged),
    }


def answer_of(row: Mapping[str, Any], name: str, plain: Mapping[str, Any], channel: str) -> str:
    """Which of ANSWERS a run gave on data with an effect of that name, `plain` being what is said of the data as they are: that is none of
    it. `channel`: the one in which the effect shows most."""
    if "failed" in row:
        return FAILED
    new = besides(row, plain)
    if name in new:
        return ITSELF
    if any(name in row["like"].get(n, ()) for n in new):
        return LIKE
    here, there = (None if r.get("unlisted") is None else r["unlisted"]["channel"] for r in (row, plain))
    if here == channel and there != channel:
        return UNLISTED
    return OTHER if new else NOTHING


def besides(row: Mapping[str, Any], plain: Mapping[str, Any]) -> list[str]:
    """Accepted effects that are not accepted in the data as they are."""
    return [n for n in row.get("accepted", ()) if n not in plain.get("accepted", ())]


def off_planted(row: Mapping[str, Any], name: str, values: Mapping[str, float]) -> tuple[float, float] | None:
    """Estimated over planted distance of the amplitude from neutral, and by how many standard errors they differ; None where the effect
    itself was not named, or one of its planted Params was held: amplitudes of two forms of an effect cannot be compared."""
    p, found = effect(name).amplitude, row.get("estimate", {})
    if not found or any(found[n][1] is None for n in values):
        return None
    value, sigma = found[p.name]
    off = values[p.name] - p.neutral
    return (value - p.neutral) / off, (value - values[p.name]) / sigma


def impostors(row: Mapping[str, Any], name: str, plain: Mapping[str, Any]) -> list[str]:
    """Newly accepted effects that are neither the planted one nor one that the data do not tell from it."""
    return [n for n in besides(row, plain) if n != name and name not in row["like"].get(n, ())]
