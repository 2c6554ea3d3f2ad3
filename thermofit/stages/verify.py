"""`verify`: everything identified so far in one coupled run, against all observations and their noise."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from thermofit.core.jit import set_threads
from thermofit.experiment.drive import carried
from thermofit.experiment.fields import with_identified
from thermofit.experiment.forms import experiment_after
from thermofit.experiment.protocol import Experiment
from thermofit.experiment.refinement import Refinement, refinement
from thermofit.experiment.verification import (
    Checked,
    fitted_parameters,
    identified_stages,
    known_errors,
    made_otherwise,
    refined_record,
    results_in,
    stages_remarks,
    thermal_record,
    together,
    with_remarks,
)
from thermofit.records.key import key_of, read_of
from thermofit.records.staging import Made, Outcome, artefact_path, job, produce
from thermofit.study.reading import reading
from thermofit.study.study import Study

NAME = "verify"
REFINEMENT = "refinement"
_LARGE = 0.5
"""Errors of a parameter over its standard error from which they are named."""


def run(study: Study, *, force: bool = False, refine: bool = False) -> Outcome:
    """Record with predicted fields, residuals per channel and phase, maps, curves, coupling error and energy balance.

    Stages that have not run are absent: their parameters keep the start of the study. StudyError where `interpolate` or
    `identify-elastic` is missing, or any artefact stale (names the command); NumericsError where a run fails. Of several experiments: a
    record for each in its folder, and one that joins them.

    `refine`: the record `refinement` besides, with the errors of mesh and steps of every channel and parameter, which is the one returned.
    """
    stages = identified_stages(study)
    key = key_of(study, NAME)
    with reading(key):
        experiment = experiment_after(study, stages)
        parameters, identified = with_identified(study, experiment.start(), stages)
        inputs: dict[str, Path] = {**experiment.inputs, **identified}
    others = made_otherwise(study, stages)
    task = job(study.run_dir, NAME, {**key, "made_otherwise": others}, inputs)

    def make() -> Made:
        """The check of every test with the identified parameters; of several, a record of each besides."""
        set_threads(study.numerics.threads)
        results, begin = fitted_parameters(study, parameters, stages), time.perf_counter()
        found: dict[str, Checked] = {}
        for test in experiment.tests:
            thermal = None if test.name else thermal_record(study, stages)
            here = experiment.seen_by(parameters, test.name)
            errors = known_errors(refined_record(study, stages), test.name)
            driven, one, said = carried(
                test,
                lambda one, here=here, thermal=thermal, errors=errors: one.checked(here, thermal, known=errors),  # type: ignore[misc]
            )
            own_remarks = {"drive": driven.drive, "remarks": [said] if said else []}
            found[test.name] = one = replace(one, summary=with_remarks(one.summary, own_remarks))
            if test.name:
                own = Made(one.datasets, {**one.summary, "stages": list(stages)}, results_in(results, test.name))
                inputs_there = {**test.inputs, **identified}
                produce(replace(task, path=_path(test), inputs=inputs_there), lambda own=own: own, force=True)  # type: ignore[misc]
        whole = together(found, "verified")
        summary = with_remarks(with_remarks(whole.summary, stages_remarks(study, stages, results)), {"remarks": others})
        counts = {**summary["evaluations"], "wall_s": time.perf_counter() - begin}
        return Made(whole.datasets, {**summary, "evaluations": counts}, results)

    done = produce(task, make, force=force)
    if not refine:
        return done
    fitted = read_of(study, "diagnosis", "stages.elastic", "stages.plastic", "stages.thermal", free=())
    finer = job(study.run_dir, REFINEMENT, {**task.config, **fitted}, {**inputs, NAME: task.path})

    def make_refinement() -> Made:
        """Errors by refinement, and what is large among them, in words."""
        set_threads(study.numerics.threads)
        begin = time.perf_counter()
        sigmas = {name: result.sigma for name, result in done.record.parameters.items() if result.free}
        found = refinement(experiment, parameters, study.mesh_size, sigmas)
        summary = {
            "verdict": _said(found),
            "trustworthy": True,
            "refined": found.channels,
            "drawn_off": found.parameters,
            "remarks": _large(found),
            "evaluations": {"forward": found.forward, "failed": 0, "wall_s": time.perf_counter() - begin},
        }
        return Made({}, summary)

    return produce(finer, make_refinement, force=force)


def _said(found: Refinement) -> str:
    """Errors of the channels over their noise, in one line."""
    kinds = [kind for kind in ("mesh", "steps", "sheet") if f"{kind}_over_noise" in found.channels[0]]
    rows = [f"{row['channel']} " + " + ".join(f"{row[f'{kind}_over_noise']:.2g}" for kind in kinds) for row in found.channels]
    return f"error of {' + '.join(kinds)}: {', '.join(rows)} times the noise"


def _large(found: Refinement) -> list[str]:
    """Parameters that mesh and steps draw off by more than half of their standard error, and a missing mesh."""
    large = [f"{row['parameter']} by {row['over_sigma']:.2g}" for row in found.parameters if (row["over_sigma"] or 0.0) > _LARGE]
    out = [f"mesh and steps may draw parameters off, in their standard errors: {', '.join(large)}; take a finer mesh"] if large else []
    if any(row.get("sheet_over_noise", 0.0) > row["mesh_over_noise"] for row in found.channels):
        out.append("the error of the one layer of the sheet is larger than that of its mesh in the plane; take the mesh of a body")
    if "mesh_error" not in found.channels[0]:
        out.append("no error of a mesh: there is none, or it is that of a file, which is not refined")
    return out


def _path(test: Experiment) -> Path:
    """Where the record of one of several experiments lies."""
    return artefact_path(test.study.run_dir, NAME)
