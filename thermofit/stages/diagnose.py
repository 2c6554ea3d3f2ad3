"""`diagnose`: find what the residual still holds, and trace it to effects that the model lacks (design section 8, steps 1 and 2)."""

from __future__ import annotations

from thermofit.core.jit import set_threads
from thermofit.diagnose.beside_source import beside_source
from thermofit.diagnose.decide import decided
from thermofit.diagnose.known_fit import KnownFit, known_fit_datasets
from thermofit.diagnose.prepared import DIAGNOSE, diagnosis_job, prepared
from thermofit.diagnose.rescored import rescored
from thermofit.diagnose.trace import traced
from thermofit.diagnose.unlisted import structured, unlisted
from thermofit.identify.solve import discard_checkpoints
from thermofit.records.staging import Made, Outcome, produce
from thermofit.report.balances import local_findings
from thermofit.report.findings import diagnosis_datasets, diagnosis_parameters, diagnosis_summary
from thermofit.report.unlisted import described, unlisted_datasets, with_unlisted
from thermofit.study.study import Study

NAME = DIAGNOSE


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record with the lack of fit per channel and phase, the ranked effects with held-out proof, and what could not be decided.

    Needs `interpolate` and the identification stages. UntrustworthyError where a fit has not converged.
    """
    task, stages = diagnosis_job(study, NAME)

    def make() -> Made:
        """The joint fit, the ranking of its residual, what remains unlisted."""
        set_threads(study.numerics.threads)
        found = prepared(study, task, stages)
        failures = tuple(found.refit.failures)
        here = rescored(traced(found.case, found.numerical, study.diagnosis.held_out, fit=found.fit))
        untold: list[str] = []
        missing = unlisted(here, structured(here, found.numerical), [s.effect for s in here.promising()], remark=untold.append)
        told = decided(diagnosis_summary(found, here), here, parts=found.refit.parts)
        local = local_findings(study, here, found.refit.parts)
        beside = beside_source(here, missing)
        said = described(study, here, missing, beside, local.entries["local_balances"])
        summary = {**with_unlisted(told, said), "remarks": [*told["remarks"], *untold], "drive": found.drive, **local.entries}
        fitted = known_fit_datasets(KnownFit(found.case.parameters, found.fit, failures, found.refit.ends))
        datasets = {**diagnosis_datasets(here), **unlisted_datasets(missing), **local.datasets, **fitted}
        return Made(datasets, summary, diagnosis_parameters(study, found.case, found.fit, beside=beside))

    outcome = produce(task, make, force=force)
    discard_checkpoints(task)
    return outcome
