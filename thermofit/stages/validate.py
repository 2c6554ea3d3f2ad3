"""`validate`: predict experiments, or records of coupons, that no fit has seen, and judge the prediction by their noise."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence

from thermofit.core.errors import StudyError
from thermofit.core.jit import set_threads
from thermofit.core.parameters import AT, Parameters
from thermofit.experiment.drive import carried
from thermofit.experiment.fields import with_identified
from thermofit.experiment.forms import experiment_of
from thermofit.experiment.protocol import Experiment, UnseenTest
from thermofit.experiment.verification import Checked, fitted_parameters, identified_stages, stages_remarks, together, with_remarks
from thermofit.identify.solve import discard_checkpoints, solve
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
    experiment = experiment_of(study)
    held_out_of(study, experiment)
    for name in study.held_out if prepare is not None else ():
        assert prepare is not None
        prepare(study.one_of(name))
    stages = identified_stages(study)
    parameters, identified = with_identified(study, experiment.start(), stages)
    inputs = {
        **experiment.inputs,
        **{name: path for test in experiment.unseen for name, path in test.experiment.inputs.items()},
        **identified,
    }
    task = job(study.run_dir, NAME, read_of(study, *SOLVED, "literature", "experiments", "shared", "stages", "diagnosis"), inputs)
    outcome = produce(task, lambda: _make(study, experiment, parameters, stages, task), force=force)
    for test in experiment.unseen:
        discard_checkpoints(_own_job(task, test.experiment.name))
    return outcome


def held_out_of(study: Study, experiment: Experiment) -> Sequence[UnseenTest]:
    """What is held out; StudyError where that is nothing."""
    if experiment.unseen:
        return experiment.unseen
    where = "experiments" if experiment.fields else "coupon.records"
    raise StudyError(
        f"{study.source.name}: nothing is held out; expected an entry with held_out: true under '{where}', or --experiment FOLDER"
    )


def _make(study: Study, experiment: Experiment, parameters: Parameters, stages: tuple[str, ...], task: Job) -> Made:
    set_threads(study.numerics.threads)
    begin, results = time.perf_counter(), fitted_parameters(study, parameters, stages)
    identified = [name for name, result in results.items() if result.free]
    found: dict[str, Checked] = {}
    datasets: dict[str, Dataset] = {}
    for test in experiment.unseen:
        name = test.experiment.name
        here, fitted = _own_fitted(test, test.predicted(parameters, identified), task)
        _, one, said = carried(test.experiment, lambda driven, here=here: driven.checked(here, None, "valid"))  # type: ignore[misc]
        remarks = [*([said] if said else []), *one.summary["remarks"], *fitted, *test.taken(parameters, identified)]
        found[name] = dataclasses.replace(one, summary={**one.summary, "remarks": remarks})
        datasets |= {f"{name}/{key}" if name else key: value for key, value in one.datasets.items()}
    summary = with_remarks(together(found, "valid").summary, stages_remarks(study, stages, results))
    return Made(datasets, {**summary, "evaluations": {**summary["evaluations"], "wall_s": time.perf_counter() - begin}}, results)


def _own_job(task: Job, name: str) -> Job:
    """The job under which evaluations of the fit of a held-out experiment's own parameters are kept."""
    return dataclasses.replace(task, stage=f"{NAME}{AT}{name}")


def _own_fitted(test: UnseenTest, base: Parameters, task: Job) -> tuple[Parameters, list[str]]:
    """The held-out experiment's own parameters fitted on its own data, where the study says so; the material stays as it is."""
    names, there = test.fit_own, test.experiment
    if not names:
        return base, []
    settings = there.joint_settings(names)
    own = _own_job(task, there.name)
    solved = solve(there.study, settings, base, lambda size, start: there.joint(settings, start, size).model, own, scalable=there.scalable)
    values = ", ".join(f"{name} = {solved.parameters[name]:.4g}" for name in names)
    return solved.parameters, [f"{values} fitted on its own data, as fit_own says: these are no predictions"]
