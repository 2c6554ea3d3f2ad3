"""The loop from a prepared case to its end: rounds, what stays unlisted, and what the data do not tell from what was added."""

from __future__ import annotations

from dataclasses import dataclass, replace

from thermofit.diagnose.beside_source import BesideSource, beside_source
from thermofit.diagnose.combined import with_combined
from thermofit.diagnose.exchanged import with_exchanged
from thermofit.diagnose.heat_of_flow import with_form_of_heat
from thermofit.diagnose.held_exponents import with_held_exponents
from thermofit.diagnose.held_law import with_held_law
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.other_form import with_other_forms, with_stand_ins
from thermofit.diagnose.prepared import Prepared
from thermofit.diagnose.pulled import with_pulled
from thermofit.diagnose.quiet import with_quiet
from thermofit.diagnose.slowest_rate import with_slowest_rate
from thermofit.diagnose.small_term import moves_nothing
from thermofit.diagnose.unlisted import Unlisted, not_told
from thermofit.diagnose.unlisted_loop import ended
from thermofit.study.study import Study


@dataclass(frozen=True)
class Looped:
    """A case at the end of the loop: as it was prepared, with the error of the discretisation that is left at the end, the rounds, what is
    unlisted (None: nothing), and the parameters beside that."""

    found: Prepared
    closed: Closed
    missing: Unlisted | None
    beside: BesideSource | None


def looped(study: Study, found: Prepared) -> Looped:
    """The loop of a study on a prepared case. UntrustworthyError where the data do not suffice, NumericsError where a run fails that has to
    be made."""
    how = study.diagnosis.held_out
    closed = close_loop(found.case, found.fit, found.refit, study.diagnosis.max_effects, found.numerical, how)
    if closed.numerical is not None:
        found = replace(found, numerical=closed.numerical)
    return Looped(found, *finished(closed, how))


def finished(closed: Closed, how: str) -> tuple[Closed, Unlisted | None, BesideSource | None]:
    """What the loop leaves of what it has accepted, with all errors, what is unlisted, and the parameters beside that. A small unlisted
    term that moves nothing once all errors are known (`small_term`) is not told; errors are then told anew without it."""
    closed, missing = ended(closed, closed.refit, closed.numerical, how)
    known = with_all_errors(closed, missing, how)
    beside = beside_source(known.last, missing, known.budget)
    if missing is None or not moves_nothing(known, missing, beside):
        return known, missing, beside
    words = not_told(closed.last, missing, "with all errors known no parameter of the material moves by it")
    return with_all_errors(replace(closed, remarks=(*closed.remarks, words)), None, how), None, None


def with_all_errors(closed: Closed, missing: Unlisted | None, how: str) -> Closed:
    """The end of the loop with standard errors that hold, beside the noise, what the test prescribes and what the data do not tell."""
    for knowing in (with_stand_ins, with_combined, with_held_exponents):
        closed = knowing(closed)
    closed = with_other_forms(with_held_law(closed, missing), how)
    for knowing in (with_form_of_heat, with_pulled, with_slowest_rate, with_exchanged):
        closed = knowing(closed)
    return with_quiet(closed, missing)
