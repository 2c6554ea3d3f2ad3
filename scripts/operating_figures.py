"""Operating figures of the diagnosis: plant effects in virtual data, run the loop without telling it, count what it says.

Coupon records (`operating_point`), full fields on a small body, and a handful of full fields of the full mesh (`operating_body`); data
come from another discretisation than the fit uses. Amplitudes are 1, 3 and 10 times the smallest that the test can detect; all other values
of an effect are drawn off the grid that the loop scans (`operating_draw`). Every run is a row of docs/operating_figures.jsonl with its seed
and the digest of the source, so that the study resumes where it was stopped, and anybody can count again: `--write` only writes the page.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import operating_page
from operating_draw import directions, secondary, smallest
from operating_page import OF_TIMES
from operating_run import TESTS, run_one, sources

from thermofit.effects.catalogue import effect, effects
from thermofit.records.executor import Executor, Task, run_all

ROOT = Path(__file__).resolve().parent.parent
ROWS = "operating_figures.jsonl"
PAIRED = 6.0
"""Amplitude of both effects of a pair."""
ORDER = (0.0, 3.0, PAIRED, 10.0, 1.0)
"""Amplitudes in the order in which they are run: what is hardly detectable comes last."""
KNOCKED = "knocked"
"""Runs whose planted effect is not in the catalogue, nor is what is like it."""
OF_KIND = 1000
"""Between the seeds of two kinds of runs; `OF_TIMES` between those of two amplitudes of a kind."""


@dataclass(frozen=True)
class Driver:
    """One driver: first seed, runs with nothing planted, runs of an effect by the multiple of the smallest amplitude, effects, pairs,
    runs of each pair, and runs of an effect whose family is not in the catalogue, by the same multiple."""

    seed: int
    nulls: int
    runs: Mapping[float, int]
    effects: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...] = ()
    of_pair: int = 4
    knocked: Mapping[float, int] = field(default_factory=dict)


DRIVERS = {
    "point": Driver(
        1_600_000,
        300,
        {3.0: 16, 10.0: 24, 1.0: 6},
        (
            *("second_hardening", "rate_logarithmic", "rate_power", "thermal_softening", "softening_power", "yield_plateau"),
            *("stored_energy", "backstress_first", "backstress_second", "elastic_degradation", "linear_hardening", "tension_compression"),
            *("air_drift", "ir_drift", "ir_gain", "ir_clock", "ir_lag"),
        ),
        (
            ("backstress_first", "stored_energy"),
            ("rate_logarithmic", "ir_clock"),
            ("elastic_degradation", "ir_drift"),
            ("yield_plateau", "ir_drift"),
        ),
        8,
        {10.0: 6, 3.0: 6},
    ),
    "body": Driver(
        200_000,
        100,
        {3.0: 2, 10.0: 2, 1.0: 2},
        (
            *("rate_logarithmic", "thermal_softening", "lamp", "air_drift", "clamp_drift", "initial_gradient", "latent_heat"),
            *("ir_drift", "ir_clock", "ir_lag", "ir_emissivity", "ir_reflection", "dic_out_of_plane", "bending", "local_source"),
            "clamp_step",
        ),
        (("rate_logarithmic", "lamp"), ("lamp", "ir_clock"), ("rate_logarithmic", "ir_lag")),
        knocked={10.0: 3, 3.0: 3},
    ),
    "full": Driver(300_000, 2, {3.0: 1}, ("rate_logarithmic", "lamp", "latent_heat")),
}

FITTED = "fitted with the base model wherever a test knows it, so never dormant"
CROSSHEAD = "acts where the crosshead drives; the strain drives the coupon records, the force the bodies"
BEYOND = "detectable on the small body only beyond its bounds, because fitted parameters do nearly the same: "
UNPLANTED = {
    **dict.fromkeys(("thermal_expansion", "air_convection", "clamp_conductance"), FITTED),
    **dict.fromkeys(("jaw_slip", "machine_compliance"), CROSSHEAD),
    "force_scale": f"{BEYOND}a gain of 7.9, bound 0.5; coupon records do not know it",
    "force_offset": "detectable on the small body from 1560 N on, and three times that is nearly the load; coupon records do not know it",
    "radiation": f"{BEYOND}emissivity 17, bound 1",
    "free_convection": f"{BEYOND}17 W/(m^2 K) at 1 K, bound 10",
    "film_by_height": "detectable on the small body from 0.2 W/(m^2 K mm) on; three times that is a film below nothing at one end",
    "capacity_by_temperature": f"{BEYOND}0.09 1/K, bound 0.02 1/K",
    "conductivity_by_temperature": f"{BEYOND}0.27 1/K, bound 0.02 1/K",
    "dic_scale": f"{BEYOND}1.04, bound 0.2",
    "ir_registration": "fitted within the error of the landmarks of every body, so never dormant",
    "clamp_difference": "detectable on the small body from 2.3 K on; three times that is refused, 14 standard errors off what is declared",
    "modulus_by_temperature": "asked only of coupon records with elastic ranges more than 50 K apart; figures in docs/real-coupons.md",
    "rate_by_temperature": "asked only of coupon records that flow at several rates and at temperatures 50 K apart",
    "dic_tilt": "found on the measured plate (docs/real-s235.md) and on a made-up one (tests/stages/test_static.py); not planted for time",
    "hardening_curve": "names nothing: asked for where no other effect takes what displacements hold (tests/diagnose/test_any_form.py)",
    "heating_profile": "asked only of rows of sections; planted in tests/stages/test_rows.py",
    "hill_anisotropy": "could be planted in a body (detectable from 0.54 on); left out for time",
}
"""Effects of the catalogue that no driver plants, and why; smallest amplitudes are those that `--driver body --seed 200777 --smallest`
prints, the least of its tests."""


def unplanted() -> dict[str, str]:
    """Reason for every effect of the catalogue that no driver plants. KeyError where one has none."""
    planted = {name for d in DRIVERS.values() for name in (*d.effects, *(e for pair in d.pairs for e in pair))}
    return {e.name: UNPLANTED[e.name] for e in effects() if e.name not in planted and not e.of_user}


def plan(name: str, driver: Driver, nulls: int | None = None) -> list[dict[str, Any]]:
    """All runs of a driver: nothing planted (`nulls` of them, where given), every effect at every amplitude, pairs, effects whose family is
    not in the catalogue. Each run has a seed of its own, so that what one noise resembles by chance is not counted twice."""
    count = driver.nulls if nulls is None else nulls
    runs: list[dict[str, Any]] = [{"driver": name, "kind": "none", "times": 0.0, "seed": driver.seed + j} for j in range(count)]
    for k, kind in enumerate((*driver.effects, *driver.pairs)):
        counts = {PAIRED: driver.of_pair} if isinstance(kind, tuple) else driver.runs
        for at, (times, n) in enumerate(counts.items()):
            first = driver.seed + OF_KIND * (k + 1) + OF_TIMES * at
            one = {"driver": name, "kind": "+".join(kind) if isinstance(kind, tuple) else kind, "times": times}
            runs += [{**one, "seed": first + j} for j in range(n)]
        for at, (times, n) in enumerate({} if isinstance(kind, tuple) else driver.knocked.items()):
            first = driver.seed + OF_KIND * (k + 1) + OF_TIMES * (at + len(driver.runs))
            runs += [{"driver": name, "kind": kind, "times": times, KNOCKED: True, "seed": first + j} for j in range(n)]
    order = list(ORDER)
    # Kinds take turns, so that a study which is stopped holds some of each.
    return sorted(runs, key=lambda run: (order.index(run["times"]), run["seed"] % OF_TIMES if run["times"] else 0))


def key(run: Mapping[str, Any]) -> str:
    """What tells a row from others: rows of another source are other rows."""
    told = [run[name] for name in ("source", "scripts", "driver", "kind", "times", "seed")]
    return json.dumps([*told, *([KNOCKED] if run.get(KNOCKED) else [])])


def kinds_of(run: Mapping[str, Any]) -> tuple[str, ...]:
    """Words by which `--only` takes a run."""
    return (KNOCKED,) if run.get(KNOCKED) else (run["kind"],)


def kept_rows(path: Path) -> dict[str, dict[str, Any]]:
    """The rows of a file, the later one where a run was made twice; none where there is no file."""
    return {} if not path.exists() else {key(r): r for r in map(json.loads, path.read_text(encoding="utf-8").splitlines())}


def make(runs: list[dict[str, Any]], done: dict[str, dict[str, Any]], kept: Path, jobs: int) -> None:
    """Make the runs, `jobs` side by side, and keep each row as soon as it is there. RuntimeError where the source changes meanwhile."""

    def keep(index: int, row: dict[str, Any]) -> None:
        if any(row[name] != digest for name, digest in sources().items()):
            raise RuntimeError("the source was edited while the runs were made: a worker has loaded another one; start again")
        done[key(row)] = row
        with kept.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row, separators=(",", ":")) + "\n")
        said = row.get("accepted", row.get("failed", row.get("left_out")))
        known = ", family not known" if row.get(KNOCKED) else ""
        more = f", {row['unlisted']} unlisted" if row.get("unlisted") else ""
        print(
            f"{row['driver']}: {row['kind']} x {row['times']:g}{known}, seed {row['seed']}: {said}{more}, {row['cpu_s']:.0f} s",
            file=sys.stderr,
        )

    tasks = [Task(f"{r['driver']} {r['kind']} seed {r['seed']}", run_one, (r["driver"], r)) for r in runs]
    run_all(tasks, Executor(jobs), keep)


def smallest_amplitudes(driver: str, names: Sequence[str], seed: int) -> Iterator[str]:
    """For every test of a seed and every effect that it knows, a line: the smallest amplitude that it can detect, and the bounds."""
    for world in TESTS[driver].candidates(seed):
        here = TESTS[driver].at_truth(world)
        for name in names:
            if name not in here.problem.dormant:
                yield f"{world.programme}: {name} is not known to this test"
                continue
            one = effect(name)
            (block,) = directions(here, one, [secondary(one, here.case, world.random("secondary"))])
            p = one.amplitude
            yield f"{world.programme}: {p.name} from {smallest(here, name, block):.3g} {p.unit} on, bounds {p.lower:g} to {p.upper:g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="only write the page from the kept rows")
    parser.add_argument("--docs", type=Path, default=ROOT / "docs", help="folder of the rows, the page and its plots")
    parser.add_argument("--driver", choices=tuple(DRIVERS), help="one driver only")
    parser.add_argument("--only", default="", help="kind of run: none, an effect, a pair as a+b, or knocked")
    parser.add_argument("--nulls", type=int, help=f"coupon records with nothing planted ({DRIVERS['point'].nulls})")
    parser.add_argument("--seed", type=int, help="first seed of the runs, for fresh ones beside those that are kept; needs --driver")
    parser.add_argument("--jobs", type=int, default=2, help="processes side by side (2)")
    parser.add_argument("--at-most", type=int, help="make no more than so many runs in this call")
    parser.add_argument(
        "--smallest", nargs="+", metavar="EFFECT", help="only print the smallest amplitudes that its tests detect; needs --driver"
    )
    chosen = parser.parse_args()
    if chosen.smallest:
        if chosen.driver is None or set(chosen.smallest) - {e.name for e in effects()}:
            parser.error("--smallest needs --driver and effects of the catalogue")
        for line in smallest_amplitudes(
            chosen.driver, chosen.smallest, DRIVERS[chosen.driver].seed if chosen.seed is None else chosen.seed
        ):
            print(line, flush=True)
        return
    if chosen.seed is not None and chosen.driver is None:
        parser.error("--seed needs --driver: seeds of drivers must not overlap")
    chosen.docs.mkdir(parents=True, exist_ok=True)
    kept = chosen.docs / ROWS
    done = kept_rows(kept)
    if not chosen.write:
        drivers = DRIVERS if chosen.driver is None else {chosen.driver: DRIVERS[chosen.driver]}
        if chosen.seed is not None:
            drivers = {name: replace(driver, seed=chosen.seed) for name, driver in drivers.items()}
        runs = [r for name, d in drivers.items() for r in plan(name, d, chosen.nulls if name == "point" else None)]
        runs = [r for r in runs if key({**sources(), **r}) not in done and chosen.only in ("", *kinds_of(r))][: chosen.at_most]
        begin = time.perf_counter()
        make(runs, done, kept, chosen.jobs)
        print(f"{len(runs)} runs in {(time.perf_counter() - begin) / 3600.0:.2f} h", file=sys.stderr)
    operating_page.write(list(done.values()), chosen.docs, unplanted())


if __name__ == "__main__":
    main()
