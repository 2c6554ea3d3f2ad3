"""`verify`: everything identified so far in one coupled run, against all observations and their noise."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.experiment.coupon_records import CouponData
from thermofit.experiment.coupon_verification import verified_coupons
from thermofit.experiment.fields import Measured, with_identified
from thermofit.experiment.several import Part, Several, interpolate_paths, seen_by
from thermofit.experiment.verification import fitted_parameters, identified_stages, made_otherwise
from thermofit.experiment.verification_record import checked, results_in, stages_remarks, thermal_record, together, with_remarks
from thermofit.identify.stage import data_of, data_paths, start_of
from thermofit.records.artefact import open_record
from thermofit.records.key import key_of
from thermofit.records.staging import Job, Made, Outcome, artefact_path, job, produce
from thermofit.study.study import Study

NAME = "verify"


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record with predicted fields, residuals per channel and phase, maps, curves, coupling error and energy balance.

    Stages that have not run are absent: their parameters keep the start of the study. StudyError where `interpolate` or
    `identify-elastic` is missing, or any artefact stale (names the command); NumericsError where the coupled run fails. Of coupons: every
    record by the point driver. Of several experiments: a record for each in its folder, and one that joins them.
    """
    data, stages = data_of(study), identified_stages(study)
    parameters, identified = with_identified(study, start_of(study, data), stages)
    inputs: dict[str, Path] = {**data_paths(study), **identified}
    others = made_otherwise(study, stages)
    task = job(study.run_dir, NAME, {**key_of(study, NAME), "made_otherwise": others}, inputs)

    def make() -> Made:
        if isinstance(data, CouponData):
            made = verified_coupons(study, data, parameters, stages)
        elif isinstance(data, Several):
            made = _several(study, data, parameters, stages, task)
        else:
            made = _one(study, data, parameters, stages)
        return replace(made, summary=with_remarks(dict(made.summary), {"remarks": others}))

    return produce(task, make, force=force)


def _one(study: Study, data: Measured, parameters: Parameters, stages: tuple[str, ...]) -> Made:
    set_threads(study.numerics.threads)
    begin = time.perf_counter()
    found = checked(study, data, parameters, thermal_record(study, stages))
    seconds = time.perf_counter() - begin
    results = fitted_parameters(study, parameters, stages)
    summary = with_remarks(found.summary, stages_remarks(study, stages, results))
    return Made(found.datasets, {**summary, "evaluations": {"forward": 1, "failed": 0, "wall_s": seconds}}, results)


def _several(study: Study, data: Several, parameters: Parameters, stages: tuple[str, ...], task: Job) -> Made:
    """Every experiment leaves `<run_dir>/<name>/verify.h5`; here are their channels and phases together."""
    results, begin = fitted_parameters(study, parameters, stages), time.perf_counter()
    shared = {name: path for name, path in task.inputs.items() if not name.startswith("interpolate")}

    def of(part: Part) -> Made:
        set_threads(study.numerics.threads)
        found = checked(part.study, part.data, seen_by(parameters, part.name), None)
        return Made(found.datasets, {**found.summary, "stages": list(stages)}, results_in(results, part.name))

    summaries = {}
    for part in data.parts:
        own = replace(task, path=artefact_path(part.study.run_dir, NAME), inputs={**interpolate_paths(study, [part.name]), **shared})
        produce(own, lambda part=part: of(part), force=True)  # type: ignore[misc]
        summaries[part.name] = open_record(own.path).summary
    summary = with_remarks(together(summaries, "verified"), stages_remarks(study, stages, results))
    counts = {"forward": len(data.parts), "failed": 0, "wall_s": time.perf_counter() - begin}
    return Made({}, {**summary, "evaluations": counts}, results)
