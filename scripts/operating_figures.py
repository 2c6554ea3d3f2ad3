"""Operating figures of the diagnosis: plant effects in virtual data, run the loop without telling it, count what it says.

Coupon records (`operating_point`), full fields on a small body, and a handful of full fields of the full mesh (`operating_body`); data come
from another discretisation than the fit uses. Amplitudes are 1, 3 and 10 times the smallest that the programme can detect. Every run is
kept in a file of JSON lines, so that the study resumes where it was stopped; seeds are in it. `--write` only writes
docs/operating_figures.md from what is kept.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
import operating_body
import operating_page
import operating_point

from thermofit.core.errors import ThermofitError
from thermofit.core.study import Study, load_study
from thermofit.diagnose.backward import held_out_of
from thermofit.diagnose.before_after import channel_rms
from thermofit.diagnose.loop import Closed
from thermofit.effects.catalogue import effect, effects

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "runs" / "operating_figures.jsonl"
AMPLITUDES = (3.0, 10.0, 1.0)
PAIRED = 6.0
APART = 100
"""Between the seeds of two kinds of runs."""


class Tests(Protocol):
    """Virtual tests of one kind."""

    @property
    def STUDY(self) -> str:
        """The study of the fit."""

    def detectable(self, study: Study) -> dict[str, float]:
        """Smallest amplitude of every effect that can be detected."""

    def measured(self, study: Study, planted: dict[str, float], seed: int) -> Any:
        """A test with planted Params."""

    def closed(self, study: Study, data: Any, folder: Path) -> Closed:
        """The loop on a test."""


@dataclass(frozen=True)
class Driver:
    """One driver: its tests, seeds of runs with nothing planted, seeds of the others, effects, pairs, and multiples of the smallest
    amplitude.

    Effects that came `later` are planted with the first two seeds, at the first two multiples. Their seeds follow those of the pairs,
    so that no run that is kept gets another one.
    """

    module: Tests
    nulls: tuple[int, ...]
    seeds: tuple[int, ...]
    effects: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    amplitudes: tuple[float, ...] = AMPLITUDES
    later: tuple[str, ...] = ()


DRIVERS = {
    "point": Driver(
        cast(Tests, operating_point),
        tuple(range(600, 640)),
        tuple(range(1000, 1004)),
        (
            *("second_hardening", "rate_logarithmic", "thermal_softening", "yield_plateau", "stored_energy", "backstress_first"),
            *("elastic_degradation", "linear_hardening", "ir_drift", "ir_gain", "ir_clock", "ir_lag"),
        ),
        (("backstress_first", "stored_energy"), ("rate_logarithmic", "ir_clock"), ("elastic_degradation", "ir_drift")),
        later=("rate_power", "backstress_second"),
    ),
    "body": Driver(
        operating_body.SMALL,
        tuple(range(640, 660)),
        tuple(range(1000, 1002)),
        (
            *("rate_logarithmic", "thermal_softening", "lamp", "air_drift", "clamp_drift", "initial_gradient", "latent_heat"),
            *("ir_drift", "ir_clock", "ir_lag", "ir_emissivity", "ir_reflection", "dic_out_of_plane", "bending"),
        ),
        (("rate_logarithmic", "lamp"), ("lamp", "ir_clock"), ("rate_logarithmic", "ir_lag")),
    ),
    "full": Driver(operating_body.FULL, (500, 501), (20,), ("rate_logarithmic", "lamp", "latent_heat"), (), (3.0,)),
}

FITTED = "fitted with the base model wherever a test knows it, so never dormant"
CROSSHEAD = "acts where the crosshead drives; the strain drives the coupon records, the force the bodies"
BEYOND = "detectable on the small body only beyond its bounds, because fitted parameters do nearly the same: "
UNPLANTED = {
    **dict.fromkeys(("thermal_expansion", "air_convection", "clamp_conductance"), FITTED),
    **dict.fromkeys(("jaw_slip", "machine_compliance"), CROSSHEAD),
    "force_scale": f"{BEYOND}a gain of 12, bound 0.5; coupon records do not know it",
    "force_offset": "detectable on the small body from 1000 N on, and three times that is half of the load; coupon records do not know it",
    "radiation": f"{BEYOND}emissivity 12, bound 1",
    "capacity_by_temperature": f"{BEYOND}0.07 1/K, bound 0.02 1/K",
    "conductivity_by_temperature": f"{BEYOND}0.18 1/K, bound 0.02 1/K",
    "dic_scale": f"{BEYOND}0.55, bound 0.2",
    "ir_registration": "detectable on the small body from 3.7 mm on; three times that is beyond its bound of 10 mm",
    "clamp_difference": "detectable on the small body from 2.4 K on; three times that is refused, 14 standard errors off what is declared",
    **dict.fromkeys(("softening_power", "rate_by_temperature"), "asked only of coupon records that flow at temperatures 50 K apart"),
    "tension_compression": "could be planted in coupon records; left out for time",
    "hill_anisotropy": "could be planted in a body (detectable from 0.32 on); left out for time",
}
"""Effects of the catalogue that no driver plants, and why; smallest amplitudes are those at the truth of `operating_body.SMALL`."""


def unplanted() -> dict[str, str]:
    """Reason for every effect of the catalogue that no driver plants. KeyError where one has none."""
    planted = {name for d in DRIVERS.values() for name in (*d.effects, *d.later, *(e for pair in d.pairs for e in pair))}
    return {e.name: UNPLANTED[e.name] for e in effects() if e.name not in planted and not e.of_user}


def run_one(driver: Driver, study: Study, folder: Path, planted: dict[str, float], seed: int) -> dict[str, Any]:
    """What the loop said of one virtual test."""
    begin = time.perf_counter()
    try:
        found: Closed = driver.module.closed(study, driver.module.measured(study, planted, seed), folder)
    except ThermofitError as error:
        return {"failed": str(error), "wall_s": time.perf_counter() - begin}
    families = {s.effect: s.family for s in found.first.ranking.scores}
    for r in found.rounds:
        families |= {t.score.effect: t.score.family for t in r.trials}
    promising = found.first.promising()
    last = found.last.case.parameters
    ends = (("before", found.first), ("after", found.last))
    held = {word: {c: rms for c, (rms, _) in channel_rms(here, held_out_of(here)).items()} for word, here in ends}
    return {
        "first": promising[0].effect if promising else None,
        "first_family": list(promising[0].family) if promising else [],
        "accepted": list(found.accepted),
        "families": {name: list(families.get(name, (name,))) for name in found.accepted},
        "estimates": {name: {p.name: last[p.name] for p in effect(name).params} for name in found.accepted},
        "chi2": float(np.mean(found.last.columns.residual**2)),
        "held_out": held,
        "settled": found.fit.converged,
        "wall_s": time.perf_counter() - begin,
    }


def plan(name: str, driver: Driver, smallest: dict[str, float]) -> list[dict[str, Any]]:
    """All runs of a driver: nothing planted, every effect at every amplitude, pairs. Each kind has noise of its own, so that what one noise
    resembles by chance is not counted for all of them."""
    runs: list[dict[str, Any]] = [{"driver": name, "kind": "none", "planted": {}, "times": 0.0, "seed": seed} for seed in driver.nulls]
    kinds = (*driver.effects, *driver.pairs, *driver.later)
    singles = [(e, t, driver.seeds) for t in driver.amplitudes for e in driver.effects]
    singles += [(e, t, driver.seeds[:2]) for t in driver.amplitudes[:2] for e in driver.later]
    for planted, times, own in singles:
        seeds = [seed + APART * kinds.index(planted) for seed in own]
        if planted in smallest:
            p = effect(planted).amplitude
            value = p.neutral + np.sign(p.probe or 1.0) * times * smallest[planted]
            if p.lower <= value <= p.upper:
                one = {"driver": name, "kind": planted, "planted": {p.name: value}, "times": times}
                runs += [{**one, "seed": seed} for seed in seeds]
    for pair in driver.pairs:
        if all(e in smallest for e in pair):
            values = {effect(e).amplitude.name: effect(e).amplitude.neutral + PAIRED * smallest[e] for e in pair}
            one = {"driver": name, "kind": "+".join(pair), "planted": values, "times": PAIRED}
            runs += [{**one, "seed": driver.seeds[0] + APART * kinds.index(pair) + j} for j in range(4)]
    return sorted(runs, key=lambda run: run["times"] == 1.0)  # what is hardly detectable comes last


def key(run: dict[str, Any]) -> str:
    return json.dumps([run["driver"], run["kind"], run["times"], run["seed"]])


def run_all(name: str, done: dict[str, dict[str, Any]], kept: Path, only: str) -> None:
    """All runs of a driver that are not kept yet."""
    driver = DRIVERS[name]
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "study.yaml"
        source.write_text(driver.module.STUDY, encoding="utf-8")
        study = load_study(source)
        for run in plan(name, driver, driver.module.detectable(study)):
            if key(run) in done or (only and run["kind"] != only):
                continue
            run |= run_one(driver, study, Path(folder), run["planted"], run["seed"])
            done[key(run)] = run
            with kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps(run) + "\n")
            said = run.get("accepted", run.get("failed"))
            print(f"{name}: {run['kind']} x {run['times']:g}, seed {run['seed']}: {said}, {run['wall_s']:.0f} s", file=sys.stderr)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="only write the page from the kept runs")
    parser.add_argument("--kept", type=Path, default=KEPT)
    parser.add_argument("--driver", choices=tuple(DRIVERS), help="one driver only")
    parser.add_argument("--only", default="", help="kind of run")
    chosen = parser.parse_args()
    chosen.kept.parent.mkdir(parents=True, exist_ok=True)
    done = {} if not chosen.kept.exists() else {key(r): r for r in map(json.loads, chosen.kept.read_text().splitlines())}
    if not chosen.write:
        for name in DRIVERS if chosen.driver is None else (chosen.driver,):
            run_all(name, done, chosen.kept, chosen.only)
    operating_page.write(list(done.values()), ROOT / "docs", unplanted())


if __name__ == "__main__":
    main()
