"""`refine`: all parameters and all channels in one residual, from where the stages ended."""

from __future__ import annotations

from thermofit.core.jit import set_threads
from thermofit.experiment.fields import with_identified
from thermofit.experiment.forms import experiment_after
from thermofit.experiment.verification import IDENTIFY, identified_stages
from thermofit.identify.refine import refined
from thermofit.identify.solve import discard_checkpoints
from thermofit.records.artefact import open_record
from thermofit.records.key import key_of
from thermofit.records.staging import Made, Outcome, artefact_path, job, produce
from thermofit.study.reading import reading
from thermofit.study.study import Study

NAME = "refine"


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record of the joint fit with the combined uncertainty of every parameter. StudyError where `identify-elastic` has not run, or any
    record is stale (names the command)."""
    stages = tuple(name for name in identified_stages(study) if name in IDENTIFY)
    key = key_of(study, NAME)
    with reading(key):
        experiment = experiment_after(study, stages)
        base, identified = with_identified(study, experiment.start(), stages)
        inputs = {**experiment.inputs, **identified}
    task = job(study.run_dir, NAME, key, inputs)

    def make() -> Made:
        """The joint fit."""
        set_threads(study.numerics.threads)
        records = {name: open_record(artefact_path(study.run_dir, name)) for name in stages}
        return refined(study, experiment, base, task, records)

    outcome = produce(task, make, force=force)
    discard_checkpoints(task)
    return outcome
