"""The budget of a stage: what its record keeps of it, what later stages read of it, and which measurement would help most."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from thermofit.core.parameters import AT, THERMOCOUPLES, units_of
from thermofit.experiment.channels import field_of
from thermofit.experiment.discretisation import MESH, OF_TERM, SHEET, STEPS, THEIRS, WITHIN
from thermofit.experiment.joint import FORCE_NOISE
from thermofit.experiment.prescribed import AREA_THICKNESS, AREA_WIDTH, CALIBRATION, INFRARED, SCALE
from thermofit.experiment.priors import LANDMARKS, is_of_pose
from thermofit.fit.budget import (
    EXCHANGED,
    EXPONENTS,
    FORM_OF_HEAT,
    HELD_LAW,
    MISFIT,
    NOISE,
    OTHER_FORM,
    PULLED,
    QUIET,
    QUIET_EFFECT,
    SLOWER_RATES,
    Budget,
)
from thermofit.records.artefact import Dataset, Record, of_parameters

ROOM = "uncertainty"
"""Group of the moves in a record: uncertainty/<cause>."""
EARLIER = "noise of "
"""Before the stage of which the noise reaches a later one through its parameters."""
_HELP = {
    NOISE: "more stages and frames, or cameras with less noise",
    MISFIT: "what the law or the measurement lacks: `thermofit diagnose`",
    FORCE_NOISE: "a load cell with less noise, or a slower test",
    CALIBRATION: "a load cell of a better class",
    AREA_THICKNESS: "the thickness measured to less",
    AREA_WIDTH: "the width measured to less",
    SCALE: "the cameras' scale calibrated to less",
    INFRARED: "the gain of the infrared camera calibrated to less",
    LANDMARKS: "landmarks of the infrared camera that are found to less, or more of them",
    **dict.fromkeys((MESH, WITHIN, THEIRS, OF_TERM), "a finer mesh"),
    STEPS: "smaller time steps",
    SHEET: "the mesh of a body in place of the sheet",
    EXPONENTS: "a test over a wider range of what these exponents act on",
    HELD_LAW: "a hardening law that has the form of this material's",
    OTHER_FORM: "a test that tells the two effects apart, as the verdict names it",
    EXCHANGED: "a reading of one of the two, or bounds that tell them apart",
    FORM_OF_HEAT: "a measurement of the stored energy by itself, or capacity and expansion from another one",
    PULLED: "displacements with less noise, or a heat effect that has the form of this material's",
    QUIET: "temperatures of air and of both jaws recorded throughout the test, and a rest that shows what of the cameras drifts",
    QUIET_EFFECT: "a test that shows more of the effects which may be there, as an unloading does of a modulus",
    SLOWER_RATES: "a phase of the test in which the material flows more slowly",
    **dict.fromkeys(THERMOCOUPLES, "temperatures of air and jaws read to less than 0.1 K, or a longer cooling in the record"),
}

_LESS_NOISE = {
    "u": "more DIC stages or points, or DIC cameras with less noise",
    "theta": "more infrared frames, or an infrared camera with less noise",
    "force": "a load cell with less noise",
}
"""What helps against the noise of an observed field."""


def budget_datasets(budget: Budget | None) -> dict[str, Dataset]:
    """Moves of the parameters by every cause."""
    if budget is None:
        return {}
    units, dims = units_of(budget.names), ("parameter", "error")
    return {place_of(cause): of_parameters(moves, dims, units) for cause, moves in budget.parts.items() if moves.size}


def place_of(cause: str) -> str:
    """Name of the dataset of a cause."""
    return f"{ROOM}/{cause.replace(' ', '.')}"


def cause_at(place: str) -> str:
    """The cause of a dataset."""
    return place.removeprefix(f"{ROOM}/").replace(".", " ")


def budget_summary(budget: Budget) -> dict[str, Any]:
    """`budget`: per parameter its causes, largest first, each with its standard uncertainty and share of the variance; `helps_most`: what
    would lower the uncertainties most, in words."""
    rows = {}
    for name, sigma in zip(budget.names, budget.sigma, strict=True):
        found = budget.largest_first(name)
        rows[name] = [{"cause": cause, "sigma": own, "share": float(own / sigma) ** 2} for cause, own in found if np.isfinite(sigma)]
    return {"budget": rows, "helps_most": helps_most(budget)}


def helps_most(budget: Budget) -> str:
    """Which measurement would lower the uncertainties most: that against the cause with the largest share of the variances. That of a
    camera's pose does not count: it is no result that a test is made for."""
    shares = budget.shares([name for name in budget.names if not is_of_pose(name)])
    cause = next(iter(shares), "")
    if not shares.get(cause):
        return ""
    bare = cause.partition(AT)[0]
    channel, share = budget.largest_noise() if cause == NOISE else ("", 0.0)
    stage = bare.removeprefix(EARLIER)
    words = _HELP.get(bare, "") if stage == bare else f"the parameters of {stage} told better, or all fitted at once (`thermofit refine`)"
    told = f"{cause} makes {100.0 * shares[cause]:.0f} % of the variances, on average"
    less = _LESS_NOISE.get(field_of(channel.partition(AT)[0])) if channel else None
    if less is not None:
        return f"{told}, and {100.0 * share:.0f} % of it is that of {channel}: what helps most is {less}"
    return f"{told}: what helps most is {words}" if words else told


def earlier_moves(records: Mapping[str, Record]) -> tuple[tuple[str, ...], dict[str, np.ndarray]]:
    """Parameters that earlier stages, by name, have identified, and their moves (n_p, m) by cause. The noise of a stage becomes that of its
    name; causes that several stages share move the parameters of all of them together."""
    names: list[str] = []
    parts: dict[str, list[tuple[int, np.ndarray]]] = {}
    for stage, record in records.items():
        own = [name for name, p in record.parameters.items() if p.free]
        at = len(names)
        listed = [str(n) for n in record["evaluations/names"].value] if own else []
        names += listed
        for key in (key for key in record.names if key.startswith(f"{ROOM}/")):
            cause = cause_at(key)
            told = f"{EARLIER}{stage}" if cause in (NOISE, MISFIT) else cause
            parts.setdefault(told, []).append((at, record[key].value))
    out = {}
    for cause, blocks in parts.items():
        apart = cause.startswith(EARLIER)
        width = sum(b.shape[1] for _, b in blocks) if apart else max(b.shape[1] for _, b in blocks)
        out[cause] = np.zeros((len(names), width))
        begin = 0
        for at, block in blocks:
            out[cause][at : at + len(block), begin : begin + block.shape[1]] += block
            begin += block.shape[1] if apart else 0
    return tuple(names), out
