"""`close-loop`: find, trace, add, prove until nothing is accepted; error before and after, and a study with the effects switched on."""

from __future__ import annotations

from thermofit.core.jit import set_threads
from thermofit.diagnose.decide import added_families, decided
from thermofit.diagnose.known_fit import known_fit
from thermofit.diagnose.prepared import DIAGNOSE, diagnosis_job, prepared
from thermofit.diagnose.refit import JointFit
from thermofit.diagnose.study_with_effects import write_study
from thermofit.diagnose.whole_loop import looped
from thermofit.identify.budget import budget_datasets, budget_summary
from thermofit.identify.solve import discard_checkpoints
from thermofit.records.staging import Made, Outcome, produce
from thermofit.report.balances import local_findings
from thermofit.report.findings import diagnosis_parameters, loop_datasets, loop_summary
from thermofit.report.unlisted import described, unlisted_datasets, with_any_form, with_unlisted
from thermofit.study.study import Study

NAME = "close-loop"
STUDY = "with-effects.yaml"


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record of all rounds; `<run_dir>/with-effects.yaml` is the study with the accepted effects.

    Begins with the joint fit of `diagnose` where its record is fresh (with `force` that is made anew), and ends the same without it.
    Needs `interpolate` and the identification stages. UntrustworthyError where a fit has not converged.
    """
    task, stages = diagnosis_job(study, NAME)

    def make() -> Made:
        """All rounds, what remains unlisted, and the study with what was added."""
        set_threads(study.numerics.threads)
        known = None if force else known_fit(diagnosis_job(study, DIAGNOSE)[0])
        end = looped(study, prepared(study, task, stages, known))
        found, closed, missing, beside = end.found, end.closed, end.missing, end.beside
        write_study(study, closed, study.run_dir / STUDY)
        told = decided(loop_summary(found, closed, study.run_dir / STUDY), closed.last, added_families(closed), found.refit.parts)
        parts = closed.refit.parts if isinstance(closed.refit, JointFit) else None
        local = local_findings(study, closed.last, parts or found.refit.parts)
        parameters = diagnosis_parameters(study, closed.last.case, closed.fit, closed.by_noise, beside)
        said = described(study, closed.last, missing, beside, local.entries["local_balances"])
        summary = {**with_any_form(with_unlisted(told, said), closed), "drive": found.drive, **local.entries}
        summary |= {} if closed.budget is None else budget_summary(closed.budget)
        datasets = {**loop_datasets(closed), **unlisted_datasets(missing), **local.datasets, **budget_datasets(closed.budget)}
        return Made(datasets, summary, parameters)

    outcome = produce(task, make, force=force)
    discard_checkpoints(task)
    return outcome
