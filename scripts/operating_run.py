"""One run of the operating figures: draw a test, plant effects, let the loop say what it finds, and the row that is kept of it."""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
import operating_body
import operating_point
from operating_draw import World, alike_to, directions, secondary, shown_in, smallest
from operating_page import names_of

from thermofit.core.digest import file_digest, source_digest
from thermofit.core.errors import ThermofitError
from thermofit.diagnose.backward import held_out_of
from thermofit.diagnose.before_after import channel_rms
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.trace import Traced
from thermofit.diagnose.unlisted import Unlisted
from thermofit.effects.catalogue import effect
from thermofit.experiment.channels import field_of

HERE = Path(__file__).resolve().parent
MOST = 10.0
"""Largest amplitude that is planted, in units of the probe, at which an effect is plainly visible, or of the scale, whichever is larger:
beyond, it is another material."""
DIGITS = 4
"""Of the figures in a row."""


class NotPlanted(Exception):
    """Why an effect cannot be planted in a test."""


class Tests(Protocol):
    """Virtual tests of one kind."""

    def candidates(self, seed: int) -> tuple[World, ...]:
        """The tests of a seed, in the order in which they are asked."""

    def at_truth(self, world: World) -> Traced:
        """The trace of a test with nothing planted at its truth."""

    def measured(self, world: World, planted: Mapping[str, float]) -> Any:
        """What is measured of a test with planted Params."""

    def closed(self, world: World, data: Any, folder: Path, without: Collection[str] = ()) -> tuple[Closed, Unlisted | None]:
        """The loop on it, and what it leaves unlisted; with a catalogue that lacks the effects `without`."""


TESTS: Mapping[str, Tests] = {"point": cast(Tests, operating_point), "body": operating_body.SMALL, "full": operating_body.FULL}


@lru_cache(maxsize=1)
def sources() -> dict[str, str]:
    """Digests of thermofit and of the scripts that make the tests, as they stand in every row. As soon as they are known they stay: a run
    is one of the code that was loaded."""
    own = "".join(file_digest(HERE / f"operating_{name}.py") for name in ("draw", "point", "body", "run"))
    return {"source": source_digest()[:16], "scripts": hashlib.sha256(own.encode()).hexdigest()[:8]}


@dataclass(frozen=True)
class Planted:
    """What is planted in a test: values of all Params of the effects, the smallest detectable amplitude of each at these values, for each
    the effects that the test cannot tell from it (itself first), and the share of each channel in what it shows beyond parameters."""

    values: dict[str, float] = field(default_factory=dict)
    units: dict[str, float] = field(default_factory=dict)
    alike: dict[str, list[str]] = field(default_factory=dict)
    shows: dict[str, dict[str, float]] = field(default_factory=dict)


def planted_in(here: Traced, names: Sequence[str], times: float, random: np.random.Generator, knocked: bool) -> Planted:
    """What is planted in a test, `times` the smallest detectable amplitude; `knocked`: it will be taken out of the catalogue with all
    that is like it. NotPlanted where an amplitude would lie beyond its bounds, or beyond what is still an effect."""
    found = Planted()
    for name in names:
        if name not in here.problem.dormant:
            raise NotPlanted(f"it does not know {name}")
        p = effect(name).amplitude
        others = secondary(effect(name), here.case, random)
        (block,) = directions(here, effect(name), [others])
        found.units[name] = smallest(here, name, block)
        probe = float(p.probe or p.scale) - p.neutral
        value = p.neutral + np.sign(probe) * times * found.units[name]
        if not p.lower <= value <= p.upper or abs(value - p.neutral) > MOST * max(abs(probe), p.scale):
            raise NotPlanted(f"{p.name} = {value:.3g} {p.unit}")
        found.values.update({p.name: float(value), **others})
        if knocked:
            found.alike[name] = list(alike_to(here, name, block))
            found.shows[name] = shown_in(here, block)
    return found


def run_one(driver: str, run: Mapping[str, Any]) -> dict[str, Any]:
    """The row of a run: what the loop said of the first test of its seed in which what is planted lies within its bounds."""
    begin = time.process_time()
    row = {**sources(), **run, **_said(TESTS[driver], run)}
    return {**_short(row), "cpu_s": round(time.process_time() - begin, 1)}


def _said(tests: Tests, run: Mapping[str, Any]) -> dict[str, Any]:
    names, knocked = names_of(run), bool(run.get("knocked", False))
    planted = Planted()
    why: list[str] = []
    for world in tests.candidates(run["seed"]):
        try:
            if names:
                planted = planted_in(tests.at_truth(world), names, run["times"], world.random("secondary"), knocked)
            data = tests.measured(world, planted.values)
        except (NotPlanted, ThermofitError) as error:
            why.append(f"{world.programme}: {error}")
            continue
        wrong = {q: f for q, f in world.declared.items() if f != 1.0}
        drawn = {
            "programme": world.programme,
            "noise": world.noise,
            "declared": wrong,
            "memory": world.memory,
            "planted": planted.values,
            "unit": planted.units,
        }
        without = {n for alike in planted.alike.values() for n in alike}
        if knocked:
            drawn |= {"without": sorted(without), "shows": planted.shows}
        with tempfile.TemporaryDirectory() as folder:
            try:
                return {**drawn, **_found(world, *tests.closed(world, data, Path(folder), without))}
            except ThermofitError as error:
                return {**drawn, "failed": str(error)}
    return {"left_out": "; ".join(why)}


def _found(world: World, found: Closed, missing: Unlisted | None) -> dict[str, Any]:
    families = {s.effect: s.family for s in found.first.ranking.scores}
    for r in found.rounds:
        families |= {s.effect: s.family for t in r.trials if t.effects == r.accepted for s in t.scores}
    promising = found.first.promising()
    last = found.last.case.parameters
    return {
        "first": promising[0].effect if promising else None,
        "first_family": list(promising[0].family) if promising else [],
        "accepted": list(found.accepted),
        "families": {name: list(families.get(name, (name,))) for name in found.accepted},
        "estimates": {name: {p.name: last[p.name] for p in effect(name).params} for name in found.accepted},
        "sigma": {name: sigma for name in found.accepted if (sigma := _error_of(found, name)) is not None},
        "dropped": list(found.dropped),
        "unjudged": list(found.unjudged),
        "unlisted": None if missing is None else missing.channel,
        "where": _where(missing),
        "before": held_out(world, found.first),
        "after": held_out(world, found.last),
        "settled": found.fit.converged,
    }


def _error_of(found: Closed, name: str) -> float | None:
    """Standard error of the amplitude of an accepted effect; None where the fit has none."""
    own, fit = effect(name).amplitude.name, found.fit
    if fit.sigma is None or own not in fit.names:
        return None
    sigma = float(fit.sigma[fit.names.index(own)])
    return sigma if np.isfinite(sigma) else None


def _where(missing: Unlisted | None) -> dict[str, Any]:
    """Kind, place and window of a reconstructed term."""
    if missing is None or missing.field is None or missing.place is None:
        return {}
    place = missing.place
    return {"kind": missing.field.basis.kind, "when": list(place.when), "at": list(place.centroid), "size": place.size}


def held_out(world: World, here: Traced) -> dict[str, float]:
    """Held-out error per channel in units of the true noise: the loop's own is in those of the declared one."""
    found = channel_rms(here, held_out_of(here))
    return {c: rms * world.declared.get(field_of(c), 1.0) for c, (rms, _) in found.items()}


def _short(value: Any) -> Any:
    """The same with figures of a few digits, so that rows stay small."""
    if isinstance(value, Mapping):
        return {k: _short(v) for k, v in value.items()}
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    return [_short(v) for v in value] if isinstance(value, list | tuple) else value
