"""`validate`: predict experiments, or records of coupons, that no fit has seen, and judge the prediction by their noise."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any

from thermofit.core.errors import StudyError
from thermofit.core.jit import set_threads
from thermofit.core.parameters import AT, Parameters
from thermofit.diagnose.unseen import predicting
from thermofit.experiment.coupon_records import coupon_data
from thermofit.experiment.coupon_verification import verified_coupons
from thermofit.experiment.fields import with_identified
from thermofit.experiment.joint import joint_model, joint_settings
from thermofit.experiment.several import Part, interpolate_paths, part_of
from thermofit.experiment.verification import fitted_parameters, identified_stages
from thermofit.experiment.verification_record import checked, stages_remarks, together, with_remarks
from thermofit.identify.solve import discard_checkpoints, solve
from thermofit.identify.stage import data_of, data_paths, start_of
from thermofit.records.artefact import Dataset
from thermofit.records.key import SOLVED, read_of
from thermofit.records.staging import Job, Made, Outcome, job, produce
from thermofit.study.study import Study

NAME = "validate"
Prepare = Callable[[Study], None]
"""Makes the record of `interpolate` of the study of one experiment."""


def run(study: Study, *, force: bool = False, prepare: Prepare | None = None) -> Outcome:
    """Record with the prediction of every held-out experiment beside its data, judged as `verify` judges fitted data.

    `prepare` makes what is missing of a held-out experiment. StudyError where none is held out, or an identification is missing (names the
    command).
    """
    held_out_of(study)
    for name in study.held_out if prepare is not None else ():
        assert prepare is not None
        prepare(study.one_of(name))
    stages = identified_stages(study)
    parameters, identified = with_identified(study, start_of(study, data_of(study)), stages)
    inputs = {**data_paths(study), **interpolate_paths(study, study.held_out), **identified}
    task = job(study.run_dir, NAME, read_of(study, *SOLVED, "literature", "experiments", "shared"), inputs)
    if study.coupon is not None:
        unseen = coupon_data(study, held_out=True)
        return produce(task, lambda: verified_coupons(study, unseen, parameters, stages, "valid"), force=force)
    outcome = produce(task, lambda: _make(study, parameters, stages, task), force=force)
    for name in study.held_out:
        discard_checkpoints(_own_job(task, name))
    return outcome


def held_out_of(study: Study) -> tuple[str, ...]:
    """Names of what is held out; StudyError where that is nothing."""
    records = () if study.coupon is None else tuple(r.label for r in study.coupon.records if r.held_out)
    if found := (*study.held_out, *records):
        return found
    where = "coupon.records" if study.coupon is not None else "experiments"
    raise StudyError(
        f"{study.source.name}: nothing is held out; expected an entry with held_out: true under '{where}', or --experiment FOLDER"
    )


def _make(study: Study, parameters: Parameters, stages: tuple[str, ...], task: Job) -> Made:
    set_threads(study.numerics.threads)
    begin, results = time.perf_counter(), fitted_parameters(study, parameters, stages)
    summaries: dict[str, dict[str, Any]] = {}
    datasets: dict[str, Dataset] = {}
    for name in study.held_out:
        part = part_of(study, name)
        here, remarks = predicting(study, part, parameters, results)
        here, fitted = _own_fitted(study, part, here, task)
        found = checked(part.study, part.data, here, None, "valid")
        summaries[name] = {**found.summary, "remarks": [*found.summary["remarks"], *fitted]}
        summaries[name]["remarks"] += [text.removeprefix(f"{name}: ") for text in remarks]
        datasets |= {f"{name}/{key}": value for key, value in found.datasets.items()}
    summary = with_remarks(together(summaries, "valid"), stages_remarks(study, stages, results))
    counts = {"forward": len(summaries), "failed": 0, "wall_s": time.perf_counter() - begin}
    return Made(datasets, {**summary, "evaluations": counts}, results)


def _own_job(task: Job, name: str) -> Job:
    """The job under which evaluations of the fit of a held-out experiment's own parameters are kept."""
    return dataclasses.replace(task, stage=f"{NAME}{AT}{name}")


def _own_fitted(study: Study, part: Part, base: Parameters, task: Job) -> tuple[Parameters, list[str]]:
    """The held-out experiment's own parameters fitted on its own data, where the study says so; the material stays as it is."""
    names = study.experiments[part.name].fit_own
    if not names:
        return base, []
    settings = joint_settings(part.study, names, part.data)
    own = _own_job(task, part.name)
    solved = solve(part.study, settings, base, lambda size, _: joint_model(part.study, part.data, settings, size), own)
    values = ", ".join(f"{name} = {solved.parameters[name]:.4g}" for name in names)
    return solved.parameters, [f"{values} fitted on its own data, as fit_own says: these are no predictions"]
