"""Do the intervals hold the truth? Virtual experiments are drawn, each goes through the chain, and the intervals are counted.

    python scripts/interval_coverage.py --draws 40            # goes on where it stopped; rows in docs/coverage.jsonl
    python scripts/interval_coverage.py --interpolation three-point --draws 12    # with the data that the thesis used
    python scripts/interval_coverage.py --page                # docs/coverage.md and its figure from the rows

The material of exp1 and exp3 is computed once on a mesh of its own. Every draw then has its own noise of both cameras and of the load cell,
readings of the thermocouples (0.1 K), calibration of the force (class 0.5: within 0.5 %), thickness (0.005 mm) and width (0.02 mm) as read,
scale of the displacements (2e-4), pose of the infrared camera and rigid motion of the specimen. The study states what is known of these
errors, and nothing of what was drawn.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import yaml
from scipy.stats import binom

from thermofit.core.errors import ThermofitError
from thermofit.experiment.forms import experiment_of
from thermofit.experiment.priors import is_of_pose
from thermofit.identify.refine import refined
from thermofit.records.artefact import open_record
from thermofit.records.staging import artefact_path, job
from thermofit.stages import stage_function
from thermofit.stages.simulate import virtual_fields
from thermofit.study.section import MeshSize
from thermofit.study.study import Study, load_study
from thermofit.study.virtual import Simulate
from thermofit.virtual.laboratory import write_raw
from thermofit.virtual.setup import VirtualFields

ROOT = Path(__file__).resolve().parents[1]
ROWS, PAGE, FIGURE = (ROOT / "docs" / name for name in ("coverage.jsonl", "coverage.md", "coverage.png"))
READING, IDENTIFYING = ("calibrate-ir", "interpolate"), ("identify-elastic", "identify-plastic", "identify-thermal")
INSTRUMENTS = {"coarse": {"dic": 40, "ir": 40}, "full": {"dic": 160, "ir": 130}}
"""Stages and frames by mesh: fewer where many draws are wanted."""
THERMOCOUPLE, CLASS, THICKNESS, WIDTH, SCALE = 0.1, 0.5, 0.005, 0.02, 2e-4
STATED = {"force_class": CLASS, "thickness": THICKNESS, "width": WIDTH, "camera_scale": SCALE}
LEVEL, NORMAL = 0.95, 1.96
TRUTH_MESH, FINER_STEPS = MeshSize(n_x=18, n_y=144, n_z=5), 16
COUNT, FIRST_SEED = 3, 201
"""Number of the count that rows belong to: one more, with fresh seeds, where what is counted has changed. Rows without it are of the first,
which began at 1. `again` of a row says why this draw alone was made anew."""


PROJECTION, THREE_POINT = "projection", "three-point"
"""`evaluation.interpolation`: the default, and that of the thesis. Rows without the key are of the default."""


def study_of(name: str, mesh: str, folder: Path, raw: Path | None = None, interpolation: str = PROJECTION) -> Study:
    """The study of an experiment; `raw`: what was drawn of it."""
    counts = INSTRUMENTS[mesh]
    keys = [f"mesh={mesh}", f"run_dir={folder}", f"simulate.dic.stages={counts['dic']}", f"simulate.ir.frames={counts['ir']}"]
    keys += [f"uncertainty={json.dumps(STATED)}", f"evaluation.interpolation={interpolation}"]
    keys += [] if raw is None else [f"experiment={raw}"]
    return load_study(ROOT / "configs" / f"{name}.yaml", keys)


def truth_of(study: Study) -> tuple[VirtualFields, Simulate]:
    """What the instruments look at, computed far finer than any identification: what the truth misses itself would be counted as an error
    of the intervals."""
    assert study.simulate is not None
    fine = study.simulate.model_copy(update={"mesh": TRUTH_MESH})
    numerics = study.numerics.model_copy(update={"max_time_step": study.numerics.max_time_step / FINER_STEPS})
    return virtual_fields(study.model_copy(update={"numerics": numerics}), fine)[0], study.simulate


def drawn(fields: VirtualFields, settings: Simulate, seed: int, raw: Path) -> dict[str, float]:
    """Write the raw folder of one draw; what was drawn."""
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(99,)))
    gain = 0.01 * CLASS * random.uniform(-1.0, 1.0)
    thickness, width, scale, rotation, drift = random.normal(size=5) * (THICKNESS, WIDTH, SCALE, 1.0, 1.0)
    machine = settings.machine.model_copy(
        update={"rotation_deg": rotation * settings.machine.rotation_deg, "drift": drift * settings.machine.drift}
    )
    camera = settings.ir.model_copy(update={"roll_deg": float(random.uniform(-2.0, 2.0))})
    own = settings.model_copy(update={"machine": machine, "ir": camera, "thermocouple_error": THERMOCOUPLE})
    seen = replace(fields, load=replace(fields.load, force=fields.load.force * (1.0 + gain)), dic_u=fields.dic_u * (1.0 + scale))
    write_raw(raw, seen, own, seed)
    path = raw / "experiment.yaml"
    told = yaml.safe_load(path.read_text(encoding="ascii"))
    told["specimen"]["thickness_mm"] += float(thickness)
    told["specimen"]["gauge_width_mm"] += float(width)
    path.write_text(yaml.safe_dump(told, sort_keys=False), encoding="ascii")
    return {"gain": gain, "thickness_mm": thickness, "width_mm": width, "scale": scale, "roll_deg": camera.roll_deg}


def row_of(name: str, mesh: str, seed: int, truth: tuple[VirtualFields, Simulate], interpolation: str = PROJECTION) -> dict[str, Any]:
    """One experiment through the chain."""
    begin = time.process_time()
    folder = Path(tempfile.mkdtemp(prefix="coverage-"))
    try:
        errors = drawn(*truth, seed, folder / "raw")
        study = study_of(name, mesh, folder / "run", folder / "raw", interpolation)
        head = {"experiment": name, "mesh": mesh, "seed": seed, "count": COUNT, "drawn": errors}
        head |= {} if interpolation == PROJECTION else {"interpolation": interpolation}
        try:
            for stage in (*READING, *IDENTIFYING):
                stage_function(stage)(study)
            found = {stage: open_record(artefact_path(study.run_dir, stage)) for stage in IDENTIFYING}
            experiment = experiment_of(study)
            told = {key: p.value for record in found.values() for key, p in record.parameters.items() if p.free}
            task = job(study.run_dir, "refine", {}, {})
            made = refined(study, experiment, experiment.start().replace(**told), task, found)
        except ThermofitError as error:
            return {**head, "failed": str(error)}
        staged = made.summary["staged"]
        parameters = {
            key: {"true": study.truth_of(key), "value": p.value, "sigma": p.sigma, "sigma_noise": p.sigma_noise, "staged": staged.get(key)}
            for key, p in made.parameters.items()
            if p.free
        }
        over = {c: float(np.sqrt(v["chi2_reduced"])) for c, v in made.summary["channels"].items()}
        result = {"verdict": made.summary["verdict"], "refined": made.summary["refined"], "parameters": parameters, "over_noise": over}
        return {**head, **result, "cpu_s": round(time.process_time() - begin, 1)}
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def rows_there() -> list[dict[str, Any]]:
    """What was drawn before."""
    return [json.loads(line) for line in ROWS.read_text(encoding="ascii").splitlines()] if ROWS.exists() else []


def run(names: Sequence[str], mesh: str, draws: int, interpolation: str = PROJECTION) -> None:
    """Draw what is missing, the experiments in turn."""
    there = [r for r in rows_there() if r.get("count") == COUNT and r.get("interpolation", PROJECTION) == interpolation]
    done = {(r["experiment"], r["mesh"], r["seed"]) for r in there}
    truth: dict[str, tuple[VirtualFields, Simulate]] = {}
    for seed, name in ((seed, name) for seed in range(FIRST_SEED, FIRST_SEED + draws) for name in names):
        if (name, mesh, seed) in done:
            continue
        if name not in truth:
            truth[name] = truth_of(study_of(name, mesh, Path(tempfile.gettempdir()) / "coverage-truth"))
        row = row_of(name, mesh, seed, truth[name], interpolation)
        with ROWS.open("a", encoding="ascii") as out:
            out.write(json.dumps(row) + "\n")
        print(name, mesh, seed, row.get("failed") or row["verdict"], row.get("cpu_s"), flush=True)


def departures(rows: Sequence[Mapping[str, Any]], key: str) -> np.ndarray:
    """(value - true) / sigma of a parameter in every row."""
    found = [r["parameters"][key] for r in rows]
    return np.array([(p["value"] - p["true"]) / p["sigma"] for p in found])


def statistics(rows: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Per parameter: share of intervals that hold the truth, its binomial range, widths."""
    for key in rows[0]["parameters"]:
        if key.startswith("theta_") or is_of_pose(key):
            continue
        found, z = [r["parameters"][key] for r in rows], departures(rows, key)
        size, n = abs(found[0]["true"]), len(rows)
        held = int(np.count_nonzero(np.abs(z) <= NORMAL))
        before = np.array([p["staged"]["value"] - p["true"] for p in found]) / size
        now = np.array([p["value"] - p["true"] for p in found]) / size
        yield {
            "parameter": key,
            "held": held,
            "n": n,
            "chance": tuple(int(v) for v in binom.interval(LEVEL, n, LEVEL)),
            "rms_z": float(np.sqrt(np.mean(z**2))),
            "sigma": float(np.median([p["sigma"] for p in found])) / size,
            "sigma_noise": float(np.median([p["sigma_noise"] for p in found])) / size,
            "scatter": float(np.sqrt(np.mean(now**2))),
            "before": float(np.sqrt(np.mean(before**2))),
            "sigma_before": float(np.median([p["staged"]["sigma"] for p in found])) / size,
        }


def page() -> None:
    """docs/coverage.md and its figure."""
    whole = [r for r in rows_there() if "failed" not in r]
    every = [r for r in whole if "interpolation" not in r]
    failed = [r for r in rows_there() if "failed" in r]
    groups: dict[tuple[str, str, int], list[dict[str, Any]]] = {}
    for r in every:
        groups.setdefault((r["experiment"], r["mesh"], r.get("count", 1)), []).append(r)
    lines = ["# Do the intervals hold the truth?", "", *_words(), ""]
    matplotlib.use("Agg")
    figure, axes = plt.subplots(1, max(len(groups), 1), figsize=(5.5 * max(len(groups), 1), 4.5), squeeze=False)
    for axis, ((name, mesh, count), rows) in zip(axes[0], sorted(groups.items()), strict=False):
        earlier = "" if count == COUNT else ", an earlier count"
        lines += [f"## {name}, {mesh} mesh: {len(rows)} experiments{earlier}", "", *_table(rows), ""]
        if staged := sum(not r["refined"] for r in rows):
            lines += [f"{staged} of them were not refined: their parameters and intervals are those of the stages.", ""]
        if again := [r for r in rows if "again" in r]:
            seeds = ", ".join(str(r["seed"]) for r in again)
            lines += [f"Made anew, the others as they were: {seeds}. {again[0]['again']}", ""]
        _draw(axis, rows, f"{name}, {mesh} mesh, {len(rows)} draws{earlier}")
    figure.tight_layout()
    figure.savefig(FIGURE, dpi=110)
    lines += [
        f"{len(failed)} draws ended with an error." if failed else "No draw ended with an error.",
        "",
        f"![Departures]({FIGURE.name})",
    ]
    lines += ["", "*Departure from the truth in combined standard uncertainties, every draw; the band is the 95 % interval*"]
    lines += _beside_three_points([r for r in whole if r.get("count") == COUNT])
    PAGE.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _words() -> list[str]:
    return [
        "Written by `make coverage`. Virtual experiments of the materials of exp1 and exp3 are computed once on 18 x 144 x 5 elements and "
        "identified on another mesh. Every draw has its own noise of cameras and load cell. Readings of the thermocouples (0.1 K), "
        f"calibration of the force (class {CLASS:g}), thickness ({1e3 * THICKNESS:g} um) and width ({1e3 * WIDTH:g} um) are drawn. So are "
        f"the scale of the displacements ({SCALE:g}), the pose of the infrared camera and the rigid motion. The study states these "
        "uncertainties, not what was drawn.",
        "",
        "* *Held*: intervals of 1.96 combined standard uncertainties that hold the true value. *By chance*: the range in which that number "
        "lies in 95 of 100 cases where the intervals are right.",
        "* *rms z*: departure in standard uncertainties, 1 where these are right.",
        "* *+-*: median combined standard uncertainty. *Noise*: the part of it that comes from the noise of cameras and load cell.",
        "* *Error*: rms departure from the truth over all draws after the joint fit. *Stages*: the same before it, with the combined "
        "uncertainty of the stages.",
        "",
        "Draws of the same number share what was drawn of thickness, width and calibrations. These decide E, the yield stresses and c0.",
        "",
        "Earlier counts came before the share of the mesh's error in the data was known by its parts, and before halved steps knew the "
        "force between the steps ([uncertainty](uncertainty.md)). They also came before the error of the force held the times of its "
        "breaks, and before the pose of the infrared camera was fitted.",
    ]


def _table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    out = [
        "| parameter | held | by chance | rms z | +- | noise | error | error of the stages | +- of the stages |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for s in statistics(rows):
        sizes = (f"{100.0 * s[key]:.2g} %" for key in ("sigma", "sigma_noise", "scatter", "before", "sigma_before"))
        low, high = s["chance"]
        out.append(f"| {s['parameter']} | {s['held']} of {s['n']} | {low} to {high} | {s['rms_z']:.2f} | {' | '.join(sizes)} |")
    return out


def _beside_three_points(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """How wide intervals are beside honest ones of the stages with three points, at the mesh for which there are such."""
    lines = []
    for name, mesh in sorted({(r["experiment"], r["mesh"]) for r in rows if "interpolation" in r}):
        of = [r for r in rows if (r["experiment"], r["mesh"]) == (name, mesh)]
        now = {s["parameter"]: s for s in statistics([r for r in of if "interpolation" not in r])}
        then = list(statistics([r for r in of if "interpolation" in r]))
        ratios = [now[s["parameter"]]["sigma"] / s["before"] for s in then]
        lines += ["", f"## {name}, {mesh} mesh, beside three points a node: {then[0]['n']} experiments", ""]
        lines += [
            "A node had the three nearest points or pixels, and parameters were those of the stages. An honest uncertainty of these is "
            "their rms departure from the truth. *Ratio*: the combined uncertainty of now over it.",
            "",
        ]
        lines += ["| parameter | +- now | honest +- with three points | ratio |", "|---|---:|---:|---:|"]
        for s, ratio in zip(then, ratios, strict=True):
            lines.append(f"| {s['parameter']} | {100.0 * now[s['parameter']]['sigma']:.2g} % | {100.0 * s['before']:.2g} % | {ratio:.2f} |")
        lines += ["", f"The median of the ratios is {np.median(ratios):.2f}."]
    return lines


def _draw(axis: Any, rows: Sequence[Mapping[str, Any]], title: str) -> None:
    names = [s["parameter"] for s in statistics(rows)]
    for k, key in enumerate(names):
        z = departures(rows, key)
        axis.plot(z, k + np.linspace(-0.3, 0.3, len(z)), ".", ms=4, color="#1f5a99" if np.mean(np.abs(z) <= NORMAL) >= 0.9 else "#b3261e")
    axis.axvspan(-NORMAL, NORMAL, color="0.92", zorder=0)
    axis.set(yticks=range(len(names)), yticklabels=names, xlim=(-5, 5), title=title, xlabel="(identified - true) / combined uncertainty")
    axis.invert_yaxis()


def main() -> None:
    """Parse, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--experiments", nargs="+", default=["exp3", "exp1"])
    parser.add_argument("--mesh", default="coarse", choices=tuple(INSTRUMENTS))
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--interpolation", default=PROJECTION, choices=(PROJECTION, THREE_POINT))
    parser.add_argument("--page", action="store_true", help="write the page from the rows that are there, draw nothing")
    options = parser.parse_args()
    if not options.page:
        run(options.experiments, options.mesh, options.draws, options.interpolation)
    page()


if __name__ == "__main__":
    main()
