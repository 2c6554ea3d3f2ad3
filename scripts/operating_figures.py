"""Operating figures of the diagnosis: plant effects in virtual data, run the loop without telling it, count what it says.

Virtual coupon records come from the point driver with steps four times finer than the fit uses, noise added; amplitudes are 1, 3 and 10
times the smallest that the programme can detect. Every run is kept in a file of JSON lines, so that the study resumes where it was
stopped; seeds are in it. `python scripts/operating_figures.py --write` writes docs/operating_figures.md from it.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from thermofit.core.errors import ThermofitError
from thermofit.core.parameters import Parameters, param
from thermofit.core.staging import job
from thermofit.core.study import Study, load_study
from thermofit.diagnose.case import Case, slots_of
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.prepared import coupon_joint_settings, coupon_spans
from thermofit.diagnose.refit import JointFit
from thermofit.diagnose.trace import traced
from thermofit.effects.catalogue import effect
from thermofit.identify.coupon_inputs import CouponData, CouponTest
from thermofit.identify.coupon_model import coupon_model
from thermofit.identify.coupon_sensor import SENSOR, shown
from thermofit.identify.inputs import TestPhase
from thermofit.identify.joint import station_names
from thermofit.point.driver import PointSettings, Programme, simulate

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "runs" / "operating_figures.jsonl"
PAGE = ROOT / "docs" / "operating_figures.md"
TRUTH = {
    **{"E": 200000.0, "nu": 0.3, "M_y0": 350.0, "M_yinf": 480.0, "H_exp": 25.0, "alpha_exp": 12e-6, "beta": 0.9, "c0": 3.65},
    **{"tau": 60.0, "lag": 0.6},
}
FREE = ("E", "M_y0", "M_yinf", "H_exp", "alpha_exp", "beta", "tau", "lag")
NOISE = {"strain": 1e-7, "stress": 0.8, "theta": 0.015}
FINER = 4
AMPLITUDES = (1.0, 3.0, 10.0)
SEEDS = tuple(range(4))
NULLS = tuple(range(100, 140))
EFFECTS = (
    *("second_hardening", "rate_logarithmic", "thermal_softening", "yield_plateau", "stored_energy", "backstress"),
    *("elastic_degradation", "ir_drift", "ir_gain", "ir_clock"),
)
PAIRS = (("backstress", "stored_energy"), ("rate_logarithmic", "ir_clock"), ("yield_plateau", "ir_drift"))
STUDY = """
name: operating-figures
model: 1
coupon: {control: strain, records: [{file: none.csv, time: t, strain: e, stress: s, initial_temperature_degC: 23}]}
parameters:
  nu: 0.3
  c0: 3.65
  E: {start: 195000, bounds: [100000, 300000]}
  M_y0: {start: 340, bounds: [50, 1500], scale: 100}
  M_yinf: {start: 470, bounds: [100, 3000], scale: 100}
  H_exp: {start: 22, bounds: [0.1, 500], scale: 10}
  alpha_exp: {start: 11.0e-6, bounds: [0, 5.0e-5]}
  beta: {start: 0.8, bounds: [0, 5]}
  tau: {start: 50, bounds: [1, 1.0e+5], scale: 50}
  lag: {start: 0.5, bounds: [0, 20], scale: 0.5}
stages:
  elastic: {free: [E]}
  plastic: {free: [M_y0, M_yinf, H_exp]}
  thermal: {free: [alpha_exp, beta, tau, lag], channels: {dtheta: {}}}
diagnosis: {max_effects: 2}
"""


def programme() -> tuple[np.ndarray, np.ndarray, tuple[TestPhase, ...]]:
    """Time s and strain of a test that moves everything once: rest, loading, change of rate, hold, unloading, reverse flow, cooling."""
    legs = [
        (0.0, 3.0, "rest"),
        (0.015, 30.0, "loading 5e-4/s"),
        (0.030, 3.0, "loading 5e-3/s"),
        (0.030, 30.0, "hold"),
        (0.022, 8.0, "unloading"),
        (0.010, 12.0, "reverse"),
        (0.045, 35.0, "loading 1e-3/s"),
        (0.0435, 3.0, "unloading"),
        (0.0435, 80.0, "hold"),
    ]
    time_, strain, phases = [0.0], [0.0], []
    for target, duration, label in legs:
        n = max(4, int(duration / 0.4))
        start, t0 = strain[-1], time_[-1]
        part = np.linspace(0.0, 1.0, n + 1)[1:]
        strain += list(start + (target - start) * part)
        time_ += list(t0 + duration * part)
        phases.append(TestPhase(t0, time_[-1], label))
    return np.array(time_), np.array(strain), tuple(phases)


def record(planted: dict[str, float], seed: int) -> CouponData:
    """A virtual record of the truth with planted Params, from steps FINER times finer, with noise."""
    t, strain, phases = programme()
    index = np.arange((len(t) - 1) * FINER + 1) / FINER
    fine = np.interp(index, np.arange(len(t)), t), np.interp(index, np.arange(len(t)), strain)
    parameters = Parameters.of({**TRUTH, "theta_air": 296.15, "theta_ref": 296.15, **planted})
    history = simulate(parameters, Programme.by_strain(*fine, 296.15), PointSettings(model=1)).every(FINER)
    random = np.random.default_rng(seed)
    bare = CouponTest("virtual", t, strain, history.stress, None, 296.15, 296.15, NOISE, phases)
    theta = shown(history.theta_sensor, bare, parameters) + NOISE["theta"] * random.normal(size=len(t))
    stress = history.stress + NOISE["stress"] * random.normal(size=len(t))
    return CouponData((replace(bare, stress=stress, theta=theta),), "strain")


def closed(study: Study, data: CouponData, folder: Path) -> Closed:
    """The loop on a record, from the fit of the base model on."""
    settings = coupon_joint_settings(study, data)
    base = study.start_parameters(data).with_free(settings.free)  # type: ignore[arg-type]
    model = coupon_model(study, data, settings, base)
    refit = JointFit(study, settings, model, job(Path(tempfile.mkdtemp(dir=folder)), "operating", {}, {}))
    parameters, fit = refit(base, "joint")
    case = Case(model, parameters, slots_of("point", SENSOR), coupon_spans(data), station_names(), cheap=True)
    fine = study.model_copy(update={"numerics": study.numerics.model_copy(update={"steps_per_interval": 2})})
    numerical = (model.residual(parameters) - coupon_model(fine, data, settings, base).residual(parameters)) / 0.5
    return close_loop(case, fit, refit, study.diagnosis.max_effects, numerical)


def detectable(study: Study, folder: Path) -> dict[str, float]:
    """Smallest amplitude of every effect that passes the threshold, from a record with nothing planted."""
    data = record({}, 1)
    settings = coupon_joint_settings(study, data)
    base = Parameters.of({**TRUTH, "theta_air": 296.15, "theta_ref": 296.15, "theta_clamp": 296.15}, settings.free)
    case = Case(coupon_model(study, data, settings, base), base, slots_of("point", SENSOR), coupon_spans(data), station_names())
    return {s.effect: s.detectable for s in traced(case).ranking.scores}


def run_one(study: Study, folder: Path, planted: dict[str, float], seed: int) -> dict[str, Any]:
    """What the loop said of one record."""
    begin = time.perf_counter()
    try:
        found = closed(study, record(planted, seed), folder)
    except ThermofitError as error:
        return {"failed": str(error), "wall_s": time.perf_counter() - begin}
    families = {s.effect: s.family for s in found.first.ranking.scores}
    for r in found.rounds:
        families |= {t.score.effect: t.score.family for t in r.trials}
    last = found.last.case.parameters
    held = found.last.case
    residual = found.last.columns.residual
    return {
        "first": found.first.promising()[0].effect if found.first.promising() else None,
        "accepted": list(found.accepted),
        "families": {name: list(families.get(name, (name,))) for name in found.accepted},
        "estimates": {name: {p.name: last[p.name] for p in effect(name).params} for name in found.accepted},
        "chi2": float(np.mean(residual**2)),
        "channels": list(held.channels),
        "wall_s": time.perf_counter() - begin,
    }


def plan(smallest: dict[str, float]) -> list[dict[str, Any]]:
    """All runs: nothing planted, every effect at every amplitude, pairs."""
    runs: list[dict[str, Any]] = [{"kind": "none", "planted": {}, "times": 0.0, "seed": seed} for seed in NULLS]
    for name in EFFECTS:
        if name in smallest:
            amplitude = effect(name).amplitude
            sign = 1.0 if (amplitude.probe or 1.0) > 0.0 else -1.0
            for times in AMPLITUDES:
                value = amplitude.neutral + sign * times * smallest[name]
                if amplitude.lower <= value <= amplitude.upper:
                    runs += [{"kind": name, "planted": {amplitude.name: value}, "times": times, "seed": seed} for seed in SEEDS]
    for pair in PAIRS:
        if all(name in smallest for name in pair):
            planted = {effect(n).amplitude.name: effect(n).amplitude.neutral + 6.0 * smallest[n] for n in pair}
            runs += [{"kind": "+".join(pair), "planted": planted, "times": 6.0, "seed": seed} for seed in SEEDS]
    return runs


def key(run: dict[str, Any]) -> str:
    return json.dumps([run["kind"], run["times"], run["seed"]])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write the page from the kept runs")
    parser.add_argument("--kept", type=Path, default=KEPT)
    parser.add_argument("--only", default="", help="kind of run")
    chosen = parser.parse_args()
    chosen.kept.parent.mkdir(parents=True, exist_ok=True)
    done = {} if not chosen.kept.exists() else {key(r): r for r in map(json.loads, chosen.kept.read_text().splitlines())}
    if not chosen.write:
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "study.yaml"
            source.write_text(STUDY, encoding="utf-8")
            study = load_study(source)
            smallest = detectable(study, Path(folder))
            for run in plan(smallest):
                if key(run) in done or (chosen.only and run["kind"] != chosen.only):
                    continue
                run |= run_one(study, Path(folder), run["planted"], run["seed"])
                done[key(run)] = run
                with chosen.kept.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(run) + "\n")
                print(f"{run['kind']} x {run['times']:g}, seed {run['seed']}: {run.get('accepted', run.get('failed'))}", file=sys.stderr)
    PAGE.write_text(page(list(done.values())), encoding="utf-8")


def named(run: dict[str, Any], name: str) -> bool:
    """Whether an accepted effect is the planted one or of one family with it."""
    return any(name == a or name in run["families"][a] for a in run.get("accepted", ()))


def page(runs: list[dict[str, Any]]) -> str:
    """docs/operating_figures.md."""
    nulls = [r for r in runs if r["kind"] == "none" and "failed" not in r]
    false = sum(bool(r["accepted"]) for r in nulls)
    lines = [
        "# Operating figures of the diagnosis",
        "",
        "Written by `scripts/operating_figures.py` from runs on virtual coupon records; programme and noise stand in that file.",
        "An effect counts as named where it, or an effect of its family, was accepted on held-out data after a refit.",
        "",
        f"Nothing planted: {len(nulls)} runs, an effect accepted in {false} ({100 * false / max(len(nulls), 1):.1f} %).",
        "",
        "| planted | amplitude / smallest detectable | runs | named | something else besides or instead | bias of the amplitude |",
        "|---|---|---|---|---|---|",
    ]
    for kind in dict.fromkeys(r["kind"] for r in runs if r["kind"] != "none"):
        for times in sorted({r["times"] for r in runs if r["kind"] == kind}):
            here = [r for r in runs if r["kind"] == kind and r["times"] == times and "failed" not in r]
            names = kind.split("+")
            right = sum(all(named(r, n) for n in names) for r in here)
            other = sum(any(not any(n == a or n in r["families"][a] for n in names) for a in r["accepted"]) for r in here)
            lines.append(f"| {' and '.join(names)} | {times:g} | {len(here)} | {right} | {other} | {_bias(here, names)} |")
    lines += ["", "## What was named", "", "| planted | named first |", "|---|---|"]
    for kind in dict.fromkeys(r["kind"] for r in runs):
        counts = Counter(str(r.get("first")) for r in runs if r["kind"] == kind and r["times"] != 1.0)
        if counts:
            lines.append(f"| {kind} | {', '.join(f'{name} {n}' for name, n in counts.most_common())} |")
    return "\n".join(lines) + "\n"


def _bias(runs: list[dict[str, Any]], names: list[str]) -> str:
    values = []
    for r in runs:
        for n in names:
            amplitude = effect(n).amplitude
            if n in r.get("estimates", {}):
                planted = r["planted"][amplitude.name] - param(amplitude.name).neutral
                values.append((r["estimates"][n][amplitude.name] - amplitude.neutral) / planted - 1.0)
    return f"{100 * float(np.median(values)):+.0f} %" if values else "-"


if __name__ == "__main__":
    main()
