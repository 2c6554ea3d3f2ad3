"""`compare`: models side by side on the same data: error, held-out error, AIC and BIC with the number of independent values, a verdict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.jit import set_threads
from thermofit.diagnose.comparing import Contender, fitted, judged, parameter_table, table, verdict
from thermofit.diagnose.prepared import SECTIONS, inputs_of
from thermofit.diagnose.refit import failed_in_words
from thermofit.experiment.verification import identified_stages
from thermofit.identify.solve import discard_checkpoints, merged_counts
from thermofit.records.artefact import Dataset
from thermofit.records.key import read_of
from thermofit.records.staging import Made, Outcome, artefact_path, job, produce
from thermofit.study.literature import Candidate
from thermofit.study.study import Study

NAME = "compare"


def run(study: Study, *, force: bool = False, others: Sequence[Study] = ()) -> Outcome:
    """Record with a table of models: that of the study, the candidates of its section `compare`, and those of other studies of the same
    data; each is fitted to all channels at once, from where its stages ended.

    StudyError where there is nothing to compare with, where other studies have other data, or a record is missing (names the command).
    """
    if not study.compare and not others:
        raise StudyError(
            f"{study.source.name}: key 'compare' is missing: add candidates, compare: {{model-1: {{model: 1}}}}, or name further studies"
        )
    names = [study.name, *study.compare, *(other.name for other in others)]
    if repeated := {name for name in names if names.count(name) > 1}:
        raise StudyError(f"{study.source.name}: key 'compare': {', '.join(sorted(repeated))} is there twice; give every model its own name")
    inputs = inputs_of(study)
    for one in (study, *others):
        inputs |= {f"{stage} of {one.name}": artefact_path(one.run_dir, stage) for stage in identified_stages(one)}
    config = {**read_of(study, *SECTIONS, "experiments", "shared", "compare"), "others": {o.name: read_of(o, *SECTIONS) for o in others}}
    task = job(study.run_dir, NAME, config, inputs)

    def make() -> Made:
        set_threads(study.numerics.threads)
        found = [fitted(study, study.name, Candidate(), task)]
        found += [fitted(study, name, candidate, task) for name, candidate in study.compare.items()]
        for other in others:
            found.append(fitted(other, other.name, Candidate(), task))
            _same_data(found[0], found[-1])
        return _made(study, found)

    outcome = produce(task, make, force=force)
    discard_checkpoints(task)
    return outcome


def _same_data(first: Contender, other: Contender) -> None:
    """StudyError where two studies do not compare the same values."""
    mine, theirs = first.model.observations, other.model.observations
    channels = [tuple((c.channel, c.n) for c in one.model.comparisons) for one in (first, other)]
    same = channels[0] == channels[1] and all(np.array_equal(mine[k].value, theirs[k].value, equal_nan=True) for k in mine)
    if not same:
        raise StudyError(
            f"{other.study.source.name}: its data are not those of {first.study.source.name} (experiment, evaluation, noise, channels); "
            "criteria of different data cannot be compared, use one experiment and one evaluation"
        )


def _made(study: Study, contenders: list[Contender]) -> Made:
    found = judged(study, contenders)
    line, sure = verdict(found)
    bounds = [f"{c.name}: {n} at its bound" for c in contenders for n, hit in zip(c.fit.names, c.fit.at_bound, strict=True) if hit]
    summary = {
        "verdict": line,
        "trustworthy": sure,
        "models": table(found),
        "fitted": parameter_table(found),
        "held_out": found.by,
        "evaluations": merged_counts(*(c.fit for c in contenders)),
        "remarks": [f"held out: {found.by}", *bounds, *(f"{c.name}: {text}" for c in contenders for text in failed_in_words(c.failures))],
    }
    datasets = {}
    for c, r in zip(contenders, found.held_out, strict=True):
        datasets[f"models/{c.name}/residual"] = Dataset(c.residual, "1", ("row",))
        datasets[f"models/{c.name}/held_out"] = Dataset(r, "1", ("row",))
    return Made(datasets, summary)
