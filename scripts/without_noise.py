"""By how much a whole chain is off on a virtual test without noise, which lacks nothing: what is left is mesh and steps, on either side.

    python scripts/without_noise.py                # both specimens of scripts/other_causes.py, steps of a fit and short ones
    python scripts/without_noise.py --specimen steel --steps 0.5 --mesh-of-truth 4 28 1
    python scripts/without_noise.py --left         # what the joint fit leaves in the residual, and what mesh and steps may leave there
    python scripts/without_noise.py --left --steps 0.5 --mesh 6 40 2
    python scripts/without_noise.py --specimen aluminium --seed 1 3 5 10 11 12     # with the usual noise, by these seeds

Instruments have a hundredth of their usual noise. The study is told the usual one of displacements and temperatures, so that these weigh
against each other as always. With `--seed` they have all of their noise, drawn by it. Printed is what `refine` is off by, in per cent and
in combined standard errors. With `--left` it is the rms by channel, in units of the noise: of the residual of the joint
fit, of what mesh and steps may leave in it, and of the same with the part that the fitted parameters have taken up.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from itertools import product
from pathlib import Path

import numpy as np
import yaml
from other_causes import BASE, SPECIMENS, command

import thermofit
from thermofit.diagnose.prepared import DIAGNOSE, diagnosis_job, prepared
from thermofit.diagnose.trace import traced
from thermofit.study.study import Study, load_study

STEPS = (5.0, 0.5)
"""Longest steps of the laboratory while the force changes, s."""
QUIET = {
    "dic": {"stages": 60, "noise_in_plane": 2e-5, "noise_out_of_plane": 5e-5, "lost_fraction": 0.0},
    "ir": {"frames": 70, "netd": 2.5e-4, "landmark_noise_px": 0.0},
    "force": {"noise": 0.04, "crosshead_noise": 7e-6},
    "thermocouple_error": 0.0,
}
USUAL = {"displacement": 0.002, "temperature": 0.025}
"""Noise of a point in mm and of a pixel in K that the study is told."""


def told(
    specimen: str, steps: float, mesh_of_truth: dict[str, int], mesh: dict[str, int], seed: int | None = None, left: bool = False
) -> dict[str, tuple[float, ...]]:
    """By how much each parameter of `refine` is off, in per cent and in combined standard errors, fitted on `mesh`; `left`: what is left
    instead, by channel. `seed`: with the usual noise. RuntimeError where a command fails."""
    made = SPECIMENS[specimen]
    seen = QUIET if seed is None else {"seed": seed, **{name: {n: QUIET[name][n]} for name, n in (("dic", "stages"), ("ir", "frames"))}}
    simulated = {
        **{"mesh": mesh_of_truth, "truth": made["truth"], "programme": made["programme"], "max_time_step": steps, **seen},
        **({"specimen": made["specimen"]} if made["specimen"] else {}),
    }
    with tempfile.TemporaryDirectory() as passing:
        folder = Path(passing)
        (folder / "lab.yaml").write_text(yaml.safe_dump({"name": "lab", "mesh": made["mesh"], "simulate": simulated}), encoding="utf-8")
        noise = ("--set", f"noise={json.dumps(USUAL)}") if seed is None else ()  # else it is measured from the files
        settings = ("--set", f"mesh={json.dumps(mesh)}", *noise, "--run-dir", "runs")
        for words in (
            ("simulate", "lab.yaml", "--run-dir", "lab"),
            ("new", "study.yaml", "--experiment", "lab/raw"),
            ("run", "study.yaml", *settings),
        ):
            done = command(folder, *words)
            if done.returncode not in (0, 5):
                raise RuntimeError(f"{specimen}: {' '.join(words)} ended with exit {done.returncode}: {done.stderr[-300:]}")
        if left:
            chosen = [setting for setting in settings if setting.startswith(("mesh=", "noise="))]
            return what_is_left(load_study(folder / "study.yaml", [*chosen, f"run_dir={folder / 'runs'}"]))
        found = thermofit.open_run(folder / "runs").record("refine").parameters
    truth = made["truth"]
    return {n: (100.0 * (found[n].value / truth[n] - 1.0), (found[n].value - truth[n]) / (found[n].sigma or float("inf"))) for n in BASE}


def what_is_left(study: Study) -> dict[str, tuple[float, ...]]:
    """By channel, in units of the noise, the rms of the residual of the joint fit, of what mesh and steps may leave in it, and of the same
    with what the fitted parameters have taken up; the stages of the study have run."""
    found = prepared(study, *diagnosis_job(study, DIAGNOSE))
    here = traced(found.case, found.numerical, study.diagnosis.held_out, fit=found.fit)
    may_be = here.problem.may_be_left
    assert may_be is not None
    errors = (here.columns.residual, may_be, found.numerical)
    return {
        channel: tuple(float(np.sqrt(np.mean(error[here.rows.channel == k] ** 2))) for error in errors)
        for k, channel in enumerate(here.case.channels)
    }


def main() -> None:
    """A line for each specimen and step."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--specimen", nargs="+", choices=list(SPECIMENS), default=list(SPECIMENS))
    parser.add_argument("--steps", nargs="+", type=float, default=STEPS)
    parser.add_argument("--mesh", nargs=3, type=int, metavar=("N_X", "N_Y", "N_Z"), help="elements of the study")
    parser.add_argument("--mesh-of-truth", nargs=3, type=int, metavar=("N_X", "N_Y", "N_Z"), help="elements of the laboratory")
    parser.add_argument("--seed", nargs="+", type=int, default=[None], help="with the usual noise, by these seeds")
    parser.add_argument("--left", action="store_true", help="what is left in the residual of the joint fit, for what parameters are off by")
    options = parser.parse_args()
    for specimen in options.specimen:
        mesh, truth = (
            dict(zip(("n_x", "n_y", "n_z"), given, strict=True)) if given else SPECIMENS[specimen][own]
            for given, own in ((options.mesh, "mesh"), (options.mesh_of_truth, "of_truth"))
        )
        for steps, seed in product(options.steps, options.seed):
            numbers = told(specimen, steps, truth, mesh, seed, options.left).items()
            form = "{} {:.3f} of its noise is left, {:.3f} may be, {:.3f} with parameters" if options.left else "{} {:+.3f} % ({:+.1f})"
            words = ", ".join(form.format(name, *pair) for name, pair in numbers)
            print(f"{specimen}, steps of {steps:g} s{'' if seed is None else f', seed {seed}'}: {words}", flush=True)


if __name__ == "__main__":
    main()
