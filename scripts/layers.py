"""What one layer of elements over half the thickness misses beside two in the joint model of a study, whose stages have run, and saves.

    python scripts/layers.py study.yaml               # the coarse mesh, whose counts in the plane the joint model has
    python scripts/layers.py study.yaml --finest 16 108 4
    python scripts/layers.py study.yaml --thickness 8     # as if the specimen were so thick, under a force as many times as large

Rows are meshes: CPU seconds of one run, and how far displacements and temperatures lie from those of the finest mesh, rms in units of the
noise, as they are and with the error of the mesh that half as many elements again tell taken off. Below them stand CPU seconds of the run
along all modes of the error of the smoothed force, on two layers and on one, and how far apart what these make is.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters, load_modes
from thermofit.experiment.discretisation import left_by, telling_mesh
from thermofit.experiment.fields import LoadSteps, with_identified
from thermofit.experiment.forms import experiment_after
from thermofit.experiment.joint import Joint, coarse_mesh
from thermofit.experiment.verification import IDENTIFY, identified_stages
from thermofit.study.section import MeshSize
from thermofit.study.study import load_study

Fields = Mapping[str, np.ndarray]


def joint_of(path: Path) -> tuple[Joint, Parameters]:
    """The joint problem of a study and the parameters that its stages have identified."""
    os.chdir(path.parent)
    study = load_study(path.name)
    set_threads(1)
    stages = tuple(name for name in identified_stages(study) if name in IDENTIFY)
    experiment = experiment_after(study, stages)
    base, _ = with_identified(study, experiment.start(), stages)
    problem = experiment.diagnosed(base, ())
    assert isinstance(problem.parts, Joint), "a study of one test"
    return replace(problem.parts, size=coarse_mesh(study)), problem.base


def thickened(joint: Joint, thickness: float) -> Joint:
    """The same test on a specimen of another thickness in mm, under the same nominal stress."""
    own = joint.data.specimen
    by = thickness / own.thickness

    def pulled(steps: LoadSteps) -> LoadSteps:
        course = None if steps.course is None else (steps.course[0], by * steps.course[1])
        return replace(steps, force=by * steps.force, error=None if steps.error is None else by * steps.error, course=course)

    every = {name: pulled(steps) for name, steps in joint.data.steps.items()}
    return replace(joint, data=replace(joint.data, specimen=replace(own, thickness=thickness), steps=every))


def timed(run: Callable[[], Fields]) -> tuple[Fields, float]:
    """What a run gives, and its CPU seconds."""
    begin = time.process_time()
    return run(), time.process_time() - begin


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", type=Path)
    parser.add_argument("--finest", nargs=3, type=int, default=(16, 108, 4), metavar=("N_X", "N_Y", "N_Z"))
    parser.add_argument("--thickness", type=float, help="mm; that of the study")
    chosen = parser.parse_args()
    joint, parameters = joint_of(chosen.study.absolute())
    joint = joint if chosen.thickness is None else thickened(joint, chosen.thickness)

    def shown(size: MeshSize) -> tuple[Fields, float]:
        return timed(lambda: replace(joint, size=size).prediction.errors(parameters))

    two, one = joint.size, joint.size.with_counts({"n_z": 1})
    finest, _ = shown(MeshSize(**dict(zip(("n_x", "n_y", "n_z"), chosen.finest, strict=True))))
    noise = {name: np.sqrt(np.nanmean(joint.model.observations[name].sigma ** 2)) for name in finest}

    def far(fields: Fields) -> str:
        return ", ".join(f"{name} {np.sqrt(np.nanmean((fields[name] - finest[name]) ** 2)) / noise[name]:.3f}" for name in finest)

    for size in (two, one):
        finer = telling_mesh(joint.study, joint.data.specimen, size)
        (here, cpu), (fine, cpu_finer) = shown(size), shown(finer)
        told = {name: here[name] - (here[name] - fine[name]) / (1.0 - left_by(size, finer)) for name in finest}
        print(f"{size.words}: {cpu:.1f} s, off by {far(here)}; with the error that {finer.words} tells in {cpu_finer:.1f} s: {far(told)}")
    error = joint.steps.error
    if error is None:
        print("the error of the force is not known")
        return
    modes = load_modes(error.shape[1])
    made = {size.n_z: timed(lambda size=size: replace(joint, size=size).prediction.linearise(parameters, modes)[1]) for size in (two, one)}
    for layers, (_, cpu) in made.items():
        print(f"along {len(modes)} modes of the force on {layers} layer{'s' if layers > 1 else ''}: {cpu:.1f} s")
    (on_two, _), (on_one, _) = made[two.n_z], made[one.n_z]
    print(", ".join(f"{name} {np.linalg.norm(on_one[name] - on_two[name]) / np.linalg.norm(on_two[name]):.1e} apart" for name in on_two))


if __name__ == "__main__":
    main()
