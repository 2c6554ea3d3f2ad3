"""The end of the loop: what it leaves, and which of the effects that it accepted only resembled an unlisted one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.diagnose.backward import held_out_of, neutral, without_effects
from thermofit.diagnose.case import Refit
from thermofit.diagnose.held_out import Rows, compared
from thermofit.diagnose.loop import Closed, against_base, whole
from thermofit.diagnose.rescored import on_its_motion
from thermofit.diagnose.trace import Traced, at_end
from thermofit.diagnose.unlisted import (
    Unlisted,
    as_spot,
    believed_law,
    beside_spot,
    broad_basis,
    camera_bases,
    over_time,
    structured,
    unlisted,
)
from thermofit.diagnose.unlisted_field import BEHIND, PRACTICAL, SURE, Basis, MissingField, field_of
from thermofit.diagnose.unlisted_structure import Structure
from thermofit.effects.catalogue import effect
from thermofit.experiment.missing_body import OF_CAMERAS
from thermofit.experiment.priors import contradicted
from thermofit.fit.linear_model import LinearModel


def ended(closed: Closed, refit: Refit, numerical: np.ndarray | None, how: str) -> tuple[Closed, Unlisted | None]:
    """The loop's result without effects that only resembled what is missing, and what is missing.

    An accepted effect is taken back where more than a tenth of the excess stays, a field of the missing term explains that, and held-out
    data no longer ask for the effect beside the field. Where several that resemble it have taken so much together that what stays asks for
    no field, a field in their stead is asked for, and what the infrared camera adds in any case. One that leaves less is taken back where
    one spot of heat is all that is missing without it; that spot is what is told then. At an optimum that what is missing has driven off
    another kind of term may predict better. A refit that fails leaves effects where they are, and so does one that does not converge where
    others stay. A run that fails is said.
    """
    hold = structured(closed.last, numerical)
    said: list[str] = []
    found = unlisted(closed.last, hold, closed.open_ones, _base(closed), said.append)
    resembles: list[str] = []
    while closed.accepted:
        names: tuple[str, ...] = ()
        spot: Unlisted | None = None
        if found is not None:
            names, spot, failed = resembling(closed, found)
            closed = replace(closed, remarks=tuple(dict.fromkeys((*closed.remarks, *failed))))
        if not names and not resembles:
            names = in_their_stead(closed, hold, by_cameras_alone=found is not None and found.field is not None)
        if not names:
            break
        resembles += names
        taken = _taken_back(closed, names, refit)
        if isinstance(taken, str):
            closed = replace(closed, remarks=(*closed.remarks, taken))
            break
        closed = whole(against_base(taken, how).as_base(), how)
        hold = structured(closed.last, numerical)
        beside: Unlisted | None = None
        try:
            beside = None if found is None or spot is None else beside_spot(closed.last, hold, found, spot)
        except NumericsError as error:
            words = f"what is unlisted was sought anew: the run beside one spot failed ({error})"
            closed = replace(closed, remarks=(*closed.remarks, words))
        found = unlisted(closed.last, hold, (), _base(closed), said.append) if beside is None else beside
    closed = replace(closed, remarks=(*closed.remarks, *dict.fromkeys(said)))
    if found is None:
        return closed, None
    remarks = (*closed.remarks, *([found.remark] if found.remark else []))
    spot = None if found.spot is None else replace(found.spot, beside=closed.accepted)
    return replace(closed, remarks=remarks), replace(found, resembles=tuple(resembles), beside=closed.accepted, spot=spot)


def _base(closed: Closed) -> np.ndarray | None:
    """The residual (n,) of the base model, where effects were accepted since."""
    return closed.first.columns.residual if closed.accepted else None


def terms_of(found: Unlisted) -> list[MissingField]:
    """The terms of what is missing beside which effects may not be needed: the field, and on coupons the law over the state."""
    law = found.law.field if found.law is not None and believed_law(found.law) is not None else None
    return [term for term in (found.field, law) if term is not None]


def resembling(closed: Closed, found: Unlisted) -> tuple[tuple[str, ...], Unlisted | None, tuple[str, ...]]:
    """The first accepted effect that only resembles what is missing, and the one spot that decided, if one did; then, in words, which
    effects were not judged because a run failed."""
    failed: list[str] = []
    for term in terms_of(found):
        for name in closed.accepted:
            try:
                taken_for, spot = resembled_by(closed, (name,), found, term)
            except NumericsError as error:
                failed.append(f"whether {name} only resembles what is unlisted was not judged: a run failed ({error})")
                continue
            if taken_for:
                return (name,), spot, tuple(failed)
    return (), None, tuple(failed)


def resembled_by(closed: Closed, names: tuple[str, ...], found: Unlisted, field: MissingField) -> tuple[bool, Unlisted | None]:
    """True where the effects left too much behind or have driven declared readings beyond their errors, or one spot is all that is missing
    without them, and they are not needed beside the field; then that spot, where it decided.

    A stress over the time of each record follows whatever is smooth: beside it no law is needed, and none is taken back for it, but for a
    law over the state. That takes back no effect of which it is another form (`imitates`). Nor is a curve of any form taken back for a
    displacement (`says_more`). NumericsError where a run fails."""
    blocks, end = found.structure.blocks, closed.last.case
    over_state = found.law is not None and field is found.law.field
    if (field.basis.kind == "stress" and not over_state) or says_more(names, field.basis.kind):
        return False, None
    answers = found.structure.excess <= BEHIND * blocks.excess(closed.first.columns.residual)
    answers = answers and not contradicted(end.model.priors, end.parameters)
    if answers and field.basis.kind != "heat":
        return False, None
    here, known = closed.last, without_effects(closed.last, names)
    if over_state and imitates(here.problem.model, known, field.basis):
        return False, None
    alone = over_time(known, field.basis, here) if field.steps else field_of(known, field.basis, here.rows, here.split)
    if compared(alone.after, field.after, here.rows, len(here.split.held_out)).convinces:
        return False, None
    spot = one_spot_instead(closed, names, found) if answers else None
    return not answers or spot is not None, spot


def one_spot_instead(closed: Closed, names: Sequence[str], found: Unlisted) -> Unlisted | None:
    """The one spot of heat that is all that is missing where effects are not there: parameters settle beside it, and it leaves no
    structure. None where there is no such spot. NumericsError where a run fails.

    Beside a field over place and time no heat is needed, for it follows any. A spot does not: beside a second cause it is not all."""
    return as_spot(on_its_motion(trace_without(closed, names)), found)[0]


def trace_without(closed: Closed, names: Sequence[str]) -> Traced:
    """The trace without effects: at the optimum of the base model where nothing else was accepted, else where they alone are back at
    neutral. NumericsError where the run there fails."""
    if closed.base is not None and set(names) == set(closed.accepted):
        return closed.first
    last = closed.last
    return at_end(replace(last.case, parameters=neutral(last.case.parameters, names)), None, last.split, last)


def imitates(model: LinearModel, known: LinearModel, law: Basis) -> bool:
    """Whether a law over the state leaves less than BEHIND of what effects do beside the other fitted parameters: it goes over the state
    that they go over. A logarithm of the rate is a curve over that, whatever form the data ask for. `known`: the linear model without the
    effects."""
    done = replace(known, residual=known.residual - model.residual, bounds=None)
    left = done.left
    columns = np.zeros((len(left), law.columns.shape[1]))
    columns[law.rows] = law.columns
    return bool(np.sum(done.with_columns(columns).left ** 2) <= BEHIND * (left @ left))


def says_more(names: Sequence[str], kind: str) -> bool:
    """Whether a curve of any form is among effects and the field is a displacement, or what displacement cameras add to it.

    Over time either follows whatever the flow under a force does; the curve is no name either, and says at which strain it is.
    """
    return kind in ("displacement", *OF_CAMERAS["u"]) and any(effect(n).last for n in names)


def in_their_stead(closed: Closed, hold: Sequence[Structure], by_cameras_alone: bool = False) -> tuple[str, ...]:
    """Accepted effects in whose stead a field of a missing term predicts held-out data better by three standard errors, and that they do
    not need beside it; none where what they leave is no more than noise, or less than a tenth of the excess, and none on coupons: a stress
    over the time of each record follows whatever is smooth, and no law predicts the next block as well.

    What the infrared camera adds is asked for however little they leave: jaws that drift apart take nearly all of an
    offset that grows along the load. Where it leaves no structure in their stead they are not needed, but where other channels need them.
    `hold`: the channels that hold structure (`structured`); `by_cameras_alone`: nothing else is asked for."""
    here = closed.last
    if here.case.cheap:
        return ()
    best: tuple[float, tuple[str, ...]] = (0.0, ())
    for structure in hold:
        little = structure.excess <= BEHIND * structure.blocks.excess(closed.first.columns.residual)
        broad = None if little or by_cameras_alone else broad_basis(here.case, structure)
        for hat in (*([] if broad is None else [broad]), *camera_bases(here, structure)):
            with_both, rows = field_of(here.problem.model, hat, here.rows, here.split), rows_of(here, hat.rows)
            now = held_out_of(here)
            for size in range(1, len(closed.accepted) + 1):
                for names in combinations(closed.accepted, size):
                    if says_more(names, hat.kind):
                        continue
                    alone = field_of(without_effects(here, names), hat, here.rows, here.split)
                    better = compared(now[hat.rows], alone.after[hat.rows], rows, len(here.split.held_out))
                    needed = compared(alone.after, with_both.after, here.rows, len(here.split.held_out)).convinces
                    if hat is not broad and not replace(structure, excess=structure.blocks.excess(alone.residual)).stands_out:
                        # What is the same all over an image and leaves nothing is the answer to its channel.
                        needed = needed_elsewhere(here, hat, alone, with_both)
                    if better.gain > max(SURE * better.sigma, PRACTICAL, best[0]) and not needed:
                        best = (better.gain, names)
    return best[1]


def needed_elsewhere(here: Traced, hat: Basis, alone: MissingField, with_both: MissingField) -> bool:
    """Whether held-out data of other channels than those that show a term need the effects beside it."""
    others = np.setdiff1d(np.arange(len(alone.after)), hat.rows)
    if not len(others):
        return False
    return compared(alone.after[others], with_both.after[others], rows_of(here, others), len(here.split.held_out)).convinces


def rows_of(here: Traced, own: np.ndarray) -> Rows:
    """Where the rows of some numbers are from."""
    return Rows(*(of[own] for of in (here.rows.channel, here.rows.time, here.rows.xy, here.rows.phase)))


def _taken_back(closed: Closed, names: Sequence[str], refit: Refit) -> Closed | str:
    """The result with the effects at neutral and everything else refitted, or in words why they could not be taken back.

    Where nothing else was accepted it is the base model, at its optimum where that is known. What is missing may keep a refit of it from
    settling, as it kept the first fit: then it is where the loop began."""
    last: Traced = closed.last
    every = set(names) == set(closed.accepted)
    accepted = tuple(n for n in closed.accepted if n not in names)
    without = replace(closed, accepted=accepted, dropped=(*closed.dropped, *names))
    if every and closed.base is not None:
        return replace(without, last=closed.first, fit=closed.base)
    begin = closed.first.case.parameters if every else neutral(last.case.parameters, names)
    kept = f"{' and '.join(names)} only resembles what is unlisted, but stays: the fit without it"
    try:
        parameters, fit = refit(begin, f"without {' '.join(names)}")
    except NumericsError as error:
        return f"{kept} failed ({error})"
    if not fit.converged:
        if not every:
            return f"{kept} did not converge ({fit.message})"
        parameters = begin
        words = f"the fit without {' and '.join(names)} has not settled ({fit.message}): traced from where the loop began"
        without = replace(without, remarks=(*without.remarks, words))
    return replace(without, last=at_end(replace(last.case, parameters=parameters), fit, last.split, last), fit=fit)
