"""Unlisted effects: structure that no family of the catalogue explains, as a reconstructed term (design section 8.5).

After the last fit the excess of every channel (`unlisted_structure`) is put to the effects that are still worth a refit: the best linear
step of each takes away a part of it. What was refused explains nothing. Where none takes away half, the missing term is sought as a field
of hats, and on coupons as a law over the state as well. It is reconstructed only if it also predicts held-out data. On a body nothing is
told without that: a few blocks of many stand out by what the mesh makes. A coupon's channel that holds structure misses something, whether
or not a term of ours takes its form. An effect that the loop has accepted and that held-out data no longer ask for once the field is there
only resembled what is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Case
from thermofit.diagnose.held_out import Proof, compared, far
from thermofit.diagnose.protected import step_taken
from thermofit.diagnose.rescored import protected_at
from thermofit.diagnose.score import Score
from thermofit.diagnose.trace import Traced, material_of, room_of
from thermofit.diagnose.unlisted_field import ALONE, SETTLED, SURE, Basis, MissingField, believed, field_of, likeliest, proved, roughness
from thermofit.diagnose.unlisted_hints import Hint, hints
from thermofit.diagnose.unlisted_law import StateLaw, state_law
from thermofit.diagnose.unlisted_middle import about, found_middle, with_middle
from thermofit.diagnose.unlisted_place import Place, compact, place_of
from thermofit.diagnose.unlisted_second import Second, second_histories
from thermofit.diagnose.unlisted_slopes import beside_term
from thermofit.diagnose.unlisted_spot import nearest, travels
from thermofit.diagnose.unlisted_steps import best_of_its_form, better, in_steps
from thermofit.diagnose.unlisted_structure import SURE as STANDS_OUT
from thermofit.diagnose.unlisted_structure import Structure, alternating, as_weight, structures
from thermofit.experiment.channels import field_of as observed_field
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.experiment.missing import KINDS, Grid, MissingTerm
from thermofit.fit.linear_model import LinearModel, Room
from thermofit.records.progress import Advance, progress

HALF = 0.5
"""Part of the excess that a family has to explain to be the answer."""
MOST_HATS = 320
"""Most hats of a term whose place is known, and of the offset of a camera, one for every frame as far as they go. A camera jumps from one
frame to the next; smeared over a few of them, the jump is taken up by conductivity and films."""
COUNTS: Mapping[str, tuple[int, int, int]] = {
    **{"heat": (12, 9, 2), "displacement": (7, 6, 3), "stress": (48, 1, 1)},
    **{name: (MOST_HATS, 1, 1) for name, kind in KINDS.items() if kind.alike},
    "clock": (12, 1, 1),
}
"""Hats in time, y and x with which a term is sought."""
IN_TIME = 48
"""Hats in time once its place is known, and of a coupon's heat."""
CLIPPED = 5.0
"""Standard deviations of the noise beyond which a value counts as that much, where structure is told without a term."""
OF_ITS_ERROR = 0.3
"""Part of their standard errors to which a step has come down where parameters beside a term that is the same everywhere have settled; that
step is taken as well."""
MOST_STEPS = 12
"""Most such steps, and most searches for the history of a film at each of them."""
DAMPING = (0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0)
"""Damping of Levenberg and Marquardt that is tried, the least first."""
TURNED = 0.5
"""Part of its steps that is taken from where one turns back on the step before: that of twice the way goes to and fro without end."""
SETTLING = 3
"""Steps of the fitted parameters beside a term at most."""
LIKELIER = 0.5
"""Likelihood of another kind of history beside a term above which it is likelier than not: at most one is."""
RIVALS = 0.8
"""Part of the gain of a term from which one of another kind may be the better once parameters have followed it."""
WORTH = 0.03
"""Least relative fall of the held-out mean square of a channel by a term of which no block shows anything, and by one that is not away from
nothing."""
LEAST_ROWS = 5
"""Values within its window with which a term begins: fewer are wild samples."""


UNSETTLED = "parameters beside the term have not settled"
"""What is said where they are still on their way after the most steps, or no part of one leaves less."""
LEAVES = "one spot leaves structure"
"""What is said where it is not all of what is missing."""
GONE = "the term is that at the optimum without it: once parameters have followed, held-out data ask for none"
"""Why parameters stay where they are beside a term."""


@dataclass(frozen=True)
class Unlisted:
    """What is missing: channel, excess, the listed effect that explains most of it with its part, the reconstructed field and its place
    (None where the channel has no kind of term, or held-out data ask for none), hints, other channels that hold structure, the parameters
    beside the field, and accepted effects that only resembled it and were taken back."""

    channel: str
    structure: Structure
    listed: tuple[str, float]
    field: MissingField | None
    place: Place | None
    hints: tuple[Hint, ...]
    others: tuple[str, ...]
    parameters: Parameters
    resembles: tuple[str, ...] = ()
    remark: str = ""
    """What kept the fitted parameters from taking their step beside the field."""
    law: StateLaw | None = None
    """The missing stress of a coupon as a law, with its own proof."""
    beside: tuple[str, ...] = ()
    """Accepted effects that stay, although this is left beside them: they are a part of the answer, or only resemble it."""
    case: Case | None = None
    """The case that knows its errors as they are beside the field; None: they are those at the optimum without it."""
    settled: bool = True
    """Whether the parameters beside a field that is the same everywhere have settled: else they are not known."""
    spot: Unlisted | None = None
    """The same as one spot (`as_spot`), where that is known to be all that is missing."""


def has_parameters(missing: Unlisted | None) -> bool:
    """Whether parameters are told beside what is missing: a displacement and a stress are maps of what is left, and no cause."""
    return missing is not None and missing.field is not None and missing.field.basis.kind not in ("displacement", "stress")


def unlisted(
    here: Traced,
    hold: Sequence[Structure],
    explains: Sequence[str],
    base: np.ndarray | None = None,
    remark: Callable[[str], object] = lambda words: None,
) -> Unlisted | None:
    """The unlisted effect that a traced case holds; None where nothing stands out, or an effect that `explains` takes half of it.

    `hold`: its channels that hold structure (`structured`). `explains`: effects that are still worth a refit. One that was tried and
    refused, or is not worth it, explains nothing, however much of the excess its linear step would take: it would take it with an
    amplitude, a reading or a held-out error that cannot be. `base`: the residual (n,) before any effect was accepted, where one was;
    without a term, less than ALONE of its excess is none. `remark` hears, in words, of terms that are no more than nothing (`away`).
    """
    every = [s.effect for s in here.ranking.scores]
    found = []
    with progress("unlisted terms", None) as advance:
        for structure in hold:
            seen = structure.blocks.channel
            if best_listed(here, structure, explains)[1] >= HALF:
                continue
            apart, failed = undriven(here, structure)
            advance(1, f"{seen}: parameters that it has not driven off")
            term, there = sought(here, apart, structure)
            advance(1, f"{seen}: a term with a place")
            terms = [] if term is None else [Sought(term, there, there is not here)]
            protected = [] if apart is here else [(through_surface, apart)]
            for other, where in ((through_surface, here), *protected, (of_instrument, here)):
                instead = other(here, where, structure, terms[0].term if terms else None)
                terms = terms if instead is None else [instead, *terms]
                advance(1, f"{seen}: a term that is the same everywhere")
            law = state_law(here, structure) if kind_of(here.case, structure) == "stress" else None
            proofs = [p.gain for p in (terms[0].term.proof if terms else None, believed_law(law)) if p is not None]
            if proofs or not kind_of(here.case, structure) or _told_alone(here, structure, base):
                found.append((max(proofs, default=-np.inf), structure, best_listed(here, structure, every), terms, apart, failed, law))
    for _, structure, listed, terms, apart, failed, law in sorted(found, key=lambda f: -f[0]):
        others = tuple(s.blocks.channel for _, s, *_ in found if s is not structure)
        alone = Unlisted(structure.blocks.channel, structure, listed, None, None, (), others, here.case.parameters, law=law)
        if not terms:
            return alone
        for begin in terms:
            whole = told(here, structure, begin, replace(alone, remark=failed))
            if whole is None:
                continue
            whole = or_rival(here, apart, structure, whole, replace(alone, remark=failed))
            if away(here, whole):
                return whole
            remark(not_told(here, whole, "it is not away from nothing"))
            break
        # The term has taken wild samples; there may be structure besides.
        if believed_law(law) is not None or _told_alone(here, structure, base):
            return alone
    return None


@dataclass(frozen=True)
class Sought:
    """A term, the problem in which it was found, and whether it stays with the parameters of that."""

    term: MissingField
    there: Traced
    fitted: bool = False


def told(here: Traced, structure: Structure, begin: Sought, alone: Unlisted) -> Unlisted | None:
    """What is missing by a term, with the parameters that follow it; None where it has no more than a few wild samples in its window, or,
    of one that is the same everywhere, where held-out data ask for none once parameters have followed. `alone`: the same without a term."""
    first, there, case, said, remark = begin.term, begin.there, here.case, "", ""
    term, parameters = first, there.case.parameters
    if not begin.fitted:
        term, parameters, remark = settled(there, structure, first)
    alike = first.basis.grid.places == 1 and case.model.segments is None
    last = remark
    if alike and term is not first:
        case, then, parameters, said = told_beside(there, structure, term, parameters)
        last, term = remark if then is term else said, then
    if alike and GONE in (remark, said):
        return None
    place = place_of(term, volumes(here.case, term.basis))
    if term is not first:
        # Neither the parameters at the optimum nor those that have followed a term of few hats are those without what is missing.
        moved = place.size - place_of(first, volumes(here.case, first.basis)).size
        place = replace(place, doubt=float(np.hypot(place.doubt, moved)))
    inside = (here.rows.time[term.basis.rows] >= place.when[0]) & (here.rows.time[term.basis.rows] <= place.when[1])
    if inside.sum() < LEAST_ROWS:
        return None
    remark = "; ".join(dict.fromkeys(words for words in (alone.remark, remark, said) if words))
    found = replace(alone, field=term, place=place, hints=hints_of(here, term), parameters=parameters, remark=remark, case=case)
    return replace(found, settled=last != UNSETTLED)


def away(here: Traced, found: Unlisted) -> bool:
    """Whether a term of a body is away from nothing by SURE of its standard errors, as an accepted effect has to be by two; one that is
    worth it (WORTH) need not be, for which of several kinds it is may be all that is not known."""
    term, place = found.field, found.place
    if here.case.model.segments is not None or term is None or place is None:
        return True
    return term.proof.gain > WORTH or abs(place.size) > SURE * place.doubt


def not_told(here: Traced, found: Unlisted, why: str) -> str:
    """What is said of a term that is not told."""
    term, place = found.field, found.place
    assert term is not None and place is not None, "it has an amount"
    kind = KINDS[term.basis.kind]
    unit = "mW" if volumes(here.case, term.basis) is not None else kind.unit
    size = f"{place.size:.2g} +- {place.doubt:.1g} {unit}"
    what = f"{kind.words} ({size}, {place.when[0]:.4g} to {place.when[1]:.4g} s)"
    return f"{found.channel}: {what} is not told, for {why}; {term.proof.words} with it"


def or_rival(here: Traced, apart: Traced, structure: Structure, whole: Unlisted, alone: Unlisted) -> Unlisted:
    """What is missing by a term that is the same everywhere, or by one of another kind, once parameters have followed either. At the
    optimum without them each has a part of what the other does: parameters that were driven off make up for the rest, of a lamp that burns
    for a while as of jaws that warm up and cool down.

    The rival is the kind that is likelier than not beside the term (`weighed`). It is what is missing where it predicts held-out data
    better, or no worse while the term is not likely beside it: the rival alone is then enough. Where no kind is likely,
    what a camera adds and a term beside which the parameters do not settle have the rival that is best at the optimum: a heat has to
    predict no worse than what a camera adds, as there (`of_instrument`), and so has any rival of the other. A run that fails and would tell
    what is likely is said, and then nothing is."""
    term = whole.field
    if term is None or term.basis.grid.places != 1 or here.case.model.segments is not None:
        return whole
    missing = here.case.model.missing
    assert missing is not None, "the term has a kind"
    seen = observed_field(structure.blocks.channel)
    likely, failed = likelier(here, structure, whole)
    whole = _saying(whole, failed)
    of_camera = term.basis.kind in missing.of_instruments.get(seen, ())
    if not likely and whole.settled and not of_camera:
        return whole
    kinds = (likely,) if likely else tuple(kind for kind in other_kinds(here.case, structure, term) if kind != "gradient")
    rivals = [
        own
        for kind in kinds
        for there in ((here,) if apart is here else (here, apart))
        if (own := everywhere_alike(here, there, structure, {seen: (kind,)})) is not None
    ]
    best = max(rivals, key=lambda own: own.term.proof.gain, default=None)
    if best is None or (not likely and best.term.proof.gain < RIVALS * term.proof.gain):
        return whole
    other = told(here, structure, best, alone)
    if other is None or other.field is None or not other.settled:
        return whole
    if predicts_better(here, other.field, term):
        return other
    if predicts_better(here, term, other.field):
        return whole
    if not whole.settled or (of_camera and best.term.basis.kind in missing.of_surface.get(seen, ())):
        return other
    if not likely:
        return whole
    back, failed = likelier(here, structure, other)
    return _saying(whole, failed) if failed or back == term.basis.kind else other


def likelier(here: Traced, structure: Structure, found: Unlisted) -> tuple[str, str]:
    """The kind of another history that is likelier than not beside a term, where the parameters that have followed it are; empty where none
    is, and where they have not settled. Then why it is not known, where a run there fails."""
    case, term, parameters = found.case or here.case, found.field, found.parameters
    if term is None or not found.settled:
        return "", ""
    try:
        known = beside_term(LinearModel(*case.model.linearised(parameters, parameters.free)), case, parameters, term)
        share = weighed(known, case, structure, term, parameters).likelihood
    except NumericsError as error:
        return "", f"other kinds of histories were not weighed beside the {term.basis.kind}: a run failed ({error})"
    return next((kind for kind, part in share.items() if part > LIKELIER), ""), ""


def weighed(known: LinearModel, case: Case, structure: Structure, term: MissingField, parameters: Parameters) -> Second:
    """Other kinds of histories that a channel may have beside a term, where the parameters that have followed it are; `known`: the linear
    model there (`beside_term`). NumericsError where a run fails."""
    return second_histories(known, term, histories(replace(case, parameters=parameters), structure, term))


def _saying(found: Unlisted, words: str) -> Unlisted:
    """The same with words behind its remark."""
    return replace(found, remark="; ".join(filter(None, (found.remark, words)))) if words else found


def _told_alone(here: Traced, structure: Structure, base: np.ndarray | None) -> bool:
    """Whether structure is told without a term that takes it."""
    if here.case.model.segments is None:
        return False
    blocks = structure.blocks
    most = CLIPPED * float(np.sqrt(blocks.noise.mean()))
    # A few wild samples make a block stand out, and are no structure.
    if blocks.excess(np.clip(here.problem.model.left, -most, most)) <= STANDS_OUT * blocks.spread:
        return False
    return base is None or structure.excess > ALONE * blocks.excess(base)


def believed_law(law: StateLaw | None) -> Proof | None:
    """The proof of a law over the state where held-out data ask for it."""
    return law.field.proof if law is not None and believed(law.field) else None


def sought(here: Traced, there: Traced, structure: Structure) -> tuple[MissingField | None, Traced]:
    """The term of a channel, None where held-out data do not ask for one, and where it was found; `there`: at protected parameters.

    A heat of a body is sought at protected parameters, and stays with these: a term of few hats is not all that is missing, and a fit
    beside it would drive them off again. It has to predict held-out data better than the optimum without it does, and no worse than a term
    at the optimum; else it is sought there. Where the data hardly tell the parameters beside a broad source, they smear the term.
    """
    term = term_of(there, structure)
    if there is here:
        return term, here
    if term is not None:
        term = beside_optimum(here, term)
        if believed(term):
            near = term_of(here, structure)
            if near is None or not predicts_better(here, near, term):
                return term, there
            return near, here
    return term_of(here, structure), here


def beside_optimum(here: Traced, term: MissingField) -> MissingField:
    """A term that was found elsewhere, proved against the optimum without it."""
    before = replace(here.problem.model, bounds=None).predicted(here.split.folds)
    return replace(term, before=before, proof=proved(term.basis, here.rows, (before, term.after), len(here.split.held_out)))


def through_surface(here: Traced, there: Traced, structure: Structure, term: MissingField | None) -> Sought | None:
    """A heat through all of the free surface alike or from the jaws, over time of any form, in the stead of another term, or of none; None
    where held-out data do not ask for it, or `term` predicts them better. What warms a sheet evenly has no place, and what comes from a jaw
    has none that is seen. Found `there`, at protected parameters, it has to predict better: beside a broad source any smooth term does
    well."""
    missing = here.case.model.missing
    own = None if missing is None else everywhere_alike(here, there, structure, missing.of_surface)
    if own is None or term is None:
        return own
    taken = predicts_better(here, own.term, term) if there is not here else not predicts_better(here, term, own.term)
    return own if taken else None


def of_instrument(here: Traced, there: Traced, structure: Structure, term: MissingField | None) -> Sought | None:
    """An offset of the camera over time or one that grows along the load, of cameras that see displacements an apparent strain or a drift
    of their scale, in the stead of a term of the body, or of none; None where held-out data do not ask for it, or the term of the body
    predicts them no worse.

    What a source does spreads by conduction and dies away. A camera's offset is the same all over the image, and jumps. Cameras that warm
    up or come nearer see all lengths grow alike; a displacement that has places is no more than what is left, so it has to predict better.
    Temperatures that are not even at first look like an offset along the load, which is told in the stead of another term alone.
    """
    missing = here.case.model.missing
    own = None if missing is None else everywhere_alike(here, there, structure, missing.of_instruments)
    if own is None:
        return None
    if term is None:
        return None if own.term.basis.kind == "gradient" else own
    if term.basis.kind == "displacement":
        return own if not predicts_better(here, term, own.term) else None
    return own if predicts_better(here, own.term, term) else None


def predicts_better(here: Traced, one: MissingField, other: MissingField) -> bool:
    """Whether a term predicts held-out data better than another one, surely."""
    return compared(other.after, one.after, here.rows, len(here.split.held_out), here.problem.model.noise, one.residual).convinces


def everywhere_alike(
    here: Traced, there: Traced, structure: Structure, kinds: Mapping[str, tuple[str, ...]], most: int = MOST_HATS
) -> Sought | None:
    """The term of the kinds that a channel has among `kinds` which predicts held-out data best, the same everywhere, with no more hats than
    `most`; None where they ask for none. It is found `there`, and proved against the optimum `here`."""
    found = []
    for kind in kinds.get(observed_field(structure.blocks.channel), ()):
        hat = alike_basis(there, structure, kind, most)
        if not hat.columns.any():  # of jaws through a contact that conducts nothing
            continue
        own = over_time(there.problem.model, hat, there)
        found.append(own if there is here else beside_optimum(here, own))
    best = max(filter(believed, found), key=lambda term: term.proof.gain, default=None)
    return None if best is None else Sought(best, there)


def undriven(here: Traced, structure: Structure) -> tuple[Traced, str]:
    """The problem at parameters that a missing heat of a body has not driven off (`protected`); as it is where another kind of term is
    missing, or where a run there fails, and then why."""
    heated = here.case.heated if kind_of(here.case, structure) == "heat" and here.case.model.segments is None else None
    fit = None if heated is None else heated(here.case.parameters)
    if fit is None:
        return here, ""
    free = here.case.parameters.free
    try:
        found = protected_at(here, fit)
        if found is None:
            return here, ""
        parameters = here.case.parameters.replace(**{n: found.parameters[n] for n in acting_on_temperatures(free)})
        residual, columns = here.case.model.linearised(parameters, free)
    except NumericsError as error:
        return here, f"the term was sought at the optimum without it: parameters beside a broad source are not known ({error})"
    model = replace(here.problem.model, residual=residual, columns=columns, bounds=room_of(parameters, free, here.case.reach))
    return replace(here, case=replace(here.case, parameters=parameters), problem=replace(here.problem, model=model)), ""


def standing(here: Traced, numerical: np.ndarray | None) -> list[Structure]:
    """Channels that hold more than noise and discretisation make, the surest first."""
    model = here.problem.model
    error = None if numerical is None else model.projected(numerical)
    found = [s for s in structures(here.case, here.rows, model.left, error, alternating(here.case, model)) if s.stands_out]
    return sorted(found, key=lambda s: -s.excess / s.blocks.spread)


def structured(here: Traced, numerical: np.ndarray | None) -> list[Structure]:
    """Channels that hold structure, the surest first; of a body those of which held-out data ask for a term, too.

    What is small and everywhere, or looks like noise that remembers, makes no block stand out. The rows of such a channel are weighted by
    what the term adds.
    """
    model, case = here.problem.model, here.case
    found = standing(here, numerical)
    if case.model.segments is not None or case.model.missing is None:
        return found
    error = None if numerical is None else model.projected(numerical)
    weights: dict[int, tuple[np.ndarray, ...]] = {}
    for k, structure in enumerate(structures(case, here.rows, model.left, error)):
        term = None if structure.stands_out else asked_for(here, structure)
        if term is not None:
            added = np.zeros(len(model.residual))
            added[term.basis.rows] = term.basis.columns @ term.q[: len(term.basis.chosen)]
            weight = as_weight(model, added, term.basis.own)
            weights |= {} if weight is None else {k: (weight,)}
    if not weights:
        return found
    weighted = structures(case, here.rows, model.left, error, weights)
    more = [s for k, s in enumerate(weighted) if k in weights and s.stands_out]
    return sorted([*found, *more], key=lambda s: -s.excess / s.blocks.spread)


def asked_for(here: Traced, structure: Structure) -> MissingField | None:
    """The term at the optimum that predicts held-out data of a channel best; None where they ask for none.

    They have to ask by as many standard errors as blocks have to stand out by, for of all kinds some term predicts a little better by
    chance; and it has to be worth it (`worth_asking`). A history of few hats is enough to ask. An offset that grows along the load is told
    in the stead of another term alone.
    """
    missing = here.case.model.missing
    assert missing is not None, "it has kinds"
    instruments = {seen: tuple(kind for kind in kinds if kind != "gradient") for seen, kinds in missing.of_instruments.items()}
    alike = [everywhere_alike(here, here, structure, kinds, IN_TIME) for kinds in (missing.of_surface, instruments)]
    broad = broad_basis(here.case, structure)
    terms = [own.term for own in alike if own is not None] + ([] if broad is None else [solved(here, broad)])
    return max((t for t in terms if worth_asking(here.case, t)), key=lambda term: term.proof.gain, default=None)


def worth_asking(case: Case, term: MissingField) -> bool:
    """Whether held-out data that ask for a term surely gain enough by it, or it moves a parameter of the material far: that is worth it,
    however little it takes of the error, as of an effect (`moves_material`)."""
    if not believed(term, STANDS_OUT):
        return False
    asked = material_of(case, answered=True)
    places, value = np.array(list(asked), dtype=int), np.array(list(asked.values()))
    return term.proof.gain > WORTH or far(term.step[places], value, term.uncertainty[places])


def best_listed(here: Traced, structure: Structure, names: Sequence[str]) -> tuple[str, float]:
    """The one of the named dormant effects whose linear step takes most of the excess away, and that part."""
    best = ("", 0.0)
    for score in (s for s in here.ranking.scores if s.effect in names):
        part = 1.0 - structure.blocks.excess(_stepped(here, score)) / structure.excess
        if not score.vetoed and part > best[1]:
            best = (score.effect, float(part))
    return best


def _stepped(here: Traced, score: Score) -> np.ndarray:
    """Residual (n,) after a joint step of an effect and all fitted parameters."""
    model = here.problem.model
    return LinearModel(model.left, model.sensitive(here.problem.dormant[score.effect][1])).left


def kind_of(case: Case, structure: Structure) -> str:
    """Kind of term that a channel can show; empty where there is none."""
    if case.model.missing is None:
        return ""
    return case.model.missing.kinds.get(observed_field(structure.blocks.channel), "")


def broad_basis(case: Case, structure: Structure) -> Basis | None:
    """The hats over all places and times with which the term of a channel is first sought; None where it has no kind of term."""
    missing, kind = case.model.missing, kind_of(case, structure)
    if missing is None or not kind:
        return None
    grid = missing.grid(kind, (IN_TIME, 1, 1) if case.model.segments is not None else COUNTS[kind])
    return basis(case, structure, kind, grid, np.arange(grid.size))


def camera_bases(here: Traced, structure: Structure) -> list[Basis]:
    """The hats over all times of what the infrared camera may add to a channel; none for other channels."""
    missing, seen = here.case.model.missing, observed_field(structure.blocks.channel)
    if missing is None or kind_of(here.case, structure) != "heat":
        return []
    return [alike_basis(here, structure, kind) for kind in missing.of_instruments.get(seen, ())]


def histories(case: Case, structure: Structure, term: MissingField | None = None, most: int = MOST_HATS) -> dict[str, Basis]:
    """The hats over all times, no more than `most`, of every kind of history that a channel may have, beside a term every other one, and
    that shows in it, where the parameters of a case are. NumericsError where a run fails."""
    missing = case.model.missing
    assert missing is not None, "the channel has kinds"
    kinds = other_kinds(case, structure, term)
    found = {kind: every_hat(case, structure, kind, missing.grid(kind, (min(COUNTS[kind][0], most), 1, 1))) for kind in kinds}
    return {kind: hat for kind, hat in found.items() if hat.columns.any()}


def other_kinds(case: Case, structure: Structure, term: MissingField | None = None) -> list[str]:
    """Kinds of terms that are the same everywhere which a channel may have, but that of a term."""
    missing, seen = case.model.missing, observed_field(structure.blocks.channel)
    assert missing is not None, "the channel has kinds"
    if missing.records:
        return []
    told = None if term is None else term.basis.kind
    return [k for of in (missing.of_surface, missing.of_instruments) for k in of.get(seen, ()) if k != told]


def alike_basis(here: Traced, structure: Structure, kind: str, most: int = MOST_HATS) -> Basis:
    """The hats over all times of a term that is the same everywhere, no more than `most`, about the middle that it has beside the fitted
    parameters."""
    missing = here.case.model.missing
    assert missing is not None, "it has kinds"
    grid = missing.grid(kind, (min(COUNTS[kind][0], most), 1, 1))
    hats = partial(every_hat, here.case, structure, kind)
    return hats(found_middle(here.problem.model, hats, grid, here.rows, here.split) if KINDS[kind].about else grid)


def alike_beside(case: Case, structure: Structure, term: MissingField) -> Basis:
    """The hats of a term that is the same everywhere where the parameters of a case are, and what its middle does."""
    hats = partial(every_hat, case, structure, term.basis.kind)
    return with_middle(hats, term) if KINDS[term.basis.kind].about else hats(term.basis.grid)


def every_hat(case: Case, structure: Structure, kind: str, grid: Grid) -> Basis:
    """All whitened hats of a grid."""
    return basis(case, structure, kind, grid, np.arange(grid.size))


def _shown(case: Case, structure: Structure, kind: str, grid: Grid, amount: np.ndarray) -> np.ndarray:
    """What an amount (m,) of all hats of a grid makes of the residual (n,)."""
    out, ends = np.zeros(len(case.rows.time)), np.cumsum([c.n for c in case.model.comparisons])
    for k, part in _whitened(case, structure, kind, grid, np.arange(grid.size), amount).items():
        out[ends[k] - len(part) : ends[k]] = part[:, 0]
    return out


def term_of(here: Traced, structure: Structure) -> MissingField | None:
    """The reconstructed term of a channel, None where held-out data do not ask for one."""
    broad, missing = broad_basis(here.case, structure), here.case.model.missing
    if broad is None or missing is None:
        return None
    whole, kind, grid = solved(here, broad), broad.kind, broad.grid
    counts = COUNTS[kind]
    if not believed(whole):
        return None
    if kind != "heat":
        return whole
    if here.case.model.segments is not None:
        return closer_grid(whole, solved(here, basis(here.case, structure, kind, grid, _lasting(whole))))
    near = compact(whole.values, whole.sigma)
    in_time = min(IN_TIME, MOST_HATS // int(near.sum()))
    if in_time <= counts[0]:
        return whole
    finer = replace(missing.grid(kind, (in_time, *counts[1:])), x=grid.x, y=grid.y)
    chosen = np.flatnonzero(np.broadcast_to(near[None, :, :, None], finer.shape).ravel())
    close = solved(here, basis(here.case, structure, kind, finer, chosen))
    return closer_grid(whole, close)


def closer_grid(whole: MissingField, close: MissingField) -> MissingField:
    """The field of fewer hats, unless held-out data ask for all of them."""
    own = whole.basis.rows
    worse = np.nanmean(close.after[own] ** 2) - np.nanmean(whole.after[own] ** 2)
    doubt = whole.proof.sigma * np.nanmean(whole.before[own] ** 2)
    return close if worse <= doubt else whole


def _lasting(whole: MissingField) -> np.ndarray:
    """Hats of a coupon within the window of the term and one more on each side: power that goes on and on is a loss, which parameters
    know how to give."""
    grid, place = whole.basis.grid, place_of(whole, None)
    part = grid.part[int(np.argmax(np.abs(place.strength)))]
    inside = np.flatnonzero((grid.part == part) & (grid.time >= place.when[0]) & (grid.time <= place.when[1]))
    own = np.flatnonzero(grid.part == part)
    return np.arange(max(inside.min() - 1, own.min()), min(inside.max() + 1, own.max()) + 1)


def settled(here: Traced, structure: Structure, term: MissingField) -> tuple[MissingField, Parameters, str]:
    """The term where the fitted parameters have taken their step, and these: what was missing had driven them off, and the answers to the
    hats with them; then why they have not, where they have not. Held-out data without the term stay those of the optimum.

    Beside a term that is the same everywhere the parameters are told as those that were fitted with it. So they step until what is left of
    a step is a small part of their standard errors, and take that too. Where a step turns back on the one before, half of it is taken, and
    of those after it, until one goes on: then twice as much again, up to all. No step is taken with which the sum of squares, the term's
    own part with it, rises by more than that small part of a standard error makes. Along a bent valley, as that of a law of the rate,
    linear steps run off to where nothing carries the load. Of a spot it is that of the hats where it is: what its middle and its spread
    would leave if they went on is of first order."""
    case, first = here.case, term
    low, high = room_of(case.parameters, case.parameters.free, case.reach)
    bounds = case.parameters.vector() + low, case.parameters.vector() + high
    parameters, usual = case.parameters, np.array([param(n).scale for n in case.parameters.free])
    alike = term.basis.grid.places == 1 and case.model.segments is None
    share, before, near, tried = 1.0, np.zeros(len(usual)), False, 0
    with progress(f"parameters beside the missing {KINDS[term.basis.kind].words}", None) as advance:
        for _ in range(MOST_STEPS if alike else SETTLING):
            step = step_taken(parameters, (term.step, term.together), bounds)
            if alike:  # it goes to and fro, as between films that conduct as if there were none
                turns = np.sum(step * before / np.maximum(term.uncertainty, 1e-300) ** 2) < 0.0
                share = share * TURNED if turns else min(1.0, share / TURNED)
            before = step
            then, there, tried, failed = falling(here, structure, term, parameters, bounds, tried, share, advance)
            if then is None:
                if failed:
                    return first, case.parameters, f"the term is that at the optimum without it: beside it the run failed ({failed})"
                break
            change = np.abs(there.vector() - parameters.vector()) / usual
            term, parameters = then, there
            rest = step_taken(parameters, (term.step, term.together), bounds)
            near = _rests(term, rest) if alike else change.max(initial=0.0) < SETTLED
            if near:
                break
    words = ""
    if alike:
        parameters = parameters.with_vector(parameters.vector() + rest) if near else parameters
        words = "" if near else UNSETTLED
    folds = len(here.split.held_out)
    term = replace(term, before=first.before, proof=proved(term.basis, here.rows, (first.before, term.after), folds))
    if believed(term):
        return term, parameters, words
    return first, case.parameters, GONE


def falling(
    here: Traced,
    structure: Structure,
    term: MissingField,
    parameters: Parameters,
    bounds: Room,
    tried: int,
    share: float,
    advance: Advance,
) -> tuple[MissingField | None, Parameters, int, str]:
    """The term where parameters have taken that share of its step with the least of DAMPING, from the one before that which was `tried`
    last, with which the sum of squares rises by no more than OF_ITS_ERROR of a standard error makes, these parameters, and the number of
    the damping; None and where they were where it rises with each, and why the last could not be run where it could not."""
    failed = ""
    square = best_of_its_form(term, term.bare, where_it_is(term.basis))[1]
    for number in range(max(tried - 1, 0), len(DAMPING)):
        step = step_taken(parameters, (term.step, term.together), bounds, DAMPING[number], share)
        there = parameters.with_vector(parameters.vector() + step)
        try:
            then, failed = at_parameters(here, replace(here.case, parameters=there), structure, term), ""
        except NumericsError as error:
            failed = str(error)
            advance(1, "failed")
            continue
        fallen = best_of_its_form(term, then.bare, where_it_is(then.basis))[1] - square
        advance(1, f"sum of squares {fallen:+.3g}, damping {DAMPING[number]:g}", {"fallen": fallen})
        if fallen <= OF_ITS_ERROR**2:
            return then, there, number, ""
    return None, parameters, len(DAMPING), failed


def where_it_is(basis: Basis) -> Basis:
    """The hats of a spot where it is, without what its middle and its spread would do if they went on, which is of first order alone. What
    the middle of an offset along the load does is exact, and stays with its hats."""
    return basis.alone if basis.grid.spread else basis


def at_parameters(here: Traced, there: Case, structure: Structure, term: MissingField) -> MissingField:
    """A term of a traced case where the parameters of another one are, with their next step beside it. NumericsError where a run fails."""
    parameters, own = there.parameters, term.basis
    known = LinearModel(*there.model.linearised(parameters, parameters.free))
    if own.grid.spread:
        return at_spot(known, here, there, structure, term)
    alike = own.grid.places == 1 and there.model.segments is None
    if own.kind == "film":
        hat = film_beside(known.residual, there, structure, term)
    else:
        hat = alike_beside(there, structure, term) if alike else basis(there, structure, own.kind, own.grid, own.chosen)
    known = beside_term(known, there, parameters, term, hat)
    return over_time(known, hat, here) if alike else field_of(known, hat, here.rows, here.split)


def film_beside(residual: np.ndarray, case: Case, structure: Structure, term: MissingField) -> Basis:
    """The hats of a film that changes by as much as they then say, beside parameters that stay where they left the residual r (n,): what it
    lets out goes with temperatures, and these with what it has let out. NumericsError where that comes to no end."""
    hats = partial(every_hat, case, structure, term.basis.kind)
    hat = hats(about(term))
    for _ in range(MOST_STEPS):
        q = best_of_its_form(term, residual, hat)[0]
        before = hat.grid.level
        assert before is not None, "those of the term"
        if np.abs(q - before).max() <= SETTLED * np.abs(q).max():
            return hat
        hat = hats(replace(hat.grid, level=q))
    raise NumericsError("the change of the film and the temperatures that it leaves do not settle: the film may be none that cools")


def at_spot(known: LinearModel, here: Traced, there: Case, structure: Structure, term: MissingField) -> MissingField:
    """The same of a term that is one spot, which moves to where it fits best; `known`: the linear model where the parameters are."""
    least = None if there.model.missing is None else there.model.missing.spot(len(term.basis.grid.time))
    assert least is not None, "a spot has a place"
    hats, shown = partial(every_hat, there, structure, term.basis.kind), partial(_shown, there, structure, term.basis.kind)
    found = nearest(known.residual, hats, shown, hats(term.basis.grid), weight=term.weight, least=least.spread)
    weight = likeliest(known, found.alone)
    beside = beside_term(known, there, there.parameters, replace(term, basis=found, weight=weight), found)
    return field_of(beside, found, here.rows, here.split, weight)


def _rests(term: MissingField, rest: np.ndarray) -> bool:
    """Whether what is left of a step (p,), and of one of the term's middle, is a small part of their standard errors."""
    m = len(term.basis.chosen)
    middle = np.abs(term.q[m:]) <= OF_ITS_ERROR * np.sqrt(np.diag(term.posterior)[m:])
    return bool(np.all(np.abs(rest) <= OF_ITS_ERROR * term.uncertainty) and middle.all())


def basis(case: Case, structure: Structure, kind: str, grid: Grid, chosen: np.ndarray) -> Basis:
    """Whitened hats of a channel, and behind their rows those of other channels that feel them too."""
    ends, columns = np.cumsum([c.n for c in case.model.comparisons]), _whitened(case, structure, kind, grid, chosen)
    rows = [np.arange(ends[k] - len(part), ends[k]) for k, part in columns.items()]
    first, *others = columns.values()
    rough = roughness(grid, chosen, from_nothing=KINDS[kind].from_rest)
    out = Basis(kind, KINDS[kind].unit, grid, chosen, rows[0], first, rough)
    if not others:
        return out
    return replace(out, rows=np.concatenate(rows), columns=np.concatenate([first, *others]), n_own=len(rows[0]))


def _whitened(
    case: Case, structure: Structure, kind: str, grid: Grid, chosen: np.ndarray, amount: np.ndarray | None = None
) -> dict[int, np.ndarray]:
    """Whitened columns (n_i, m) of the hats, by the number of the channel that feels them, that of the structure first; (n_i, 1) of an
    `amount` (m,) of each."""
    model, own = case.model, case.channels.index(structure.blocks.channel)
    assert model.missing is not None
    columns = model.columns(model.missing.answers(kind, case.parameters, grid, chosen, amount))
    return {own: columns[own], **columns}


def told_beside(
    here: Traced, structure: Structure, term: MissingField, parameters: Parameters
) -> tuple[Case, MissingField, Parameters, str]:
    """The case with its errors of mesh, steps and force told at the parameters beside a term of one place, the term and the parameters that
    follow it there, and why they are those of before, where a run fails. Errors that were told where what is missing had driven the
    parameters are those of another contact and other gradients, and would be taken for the parameters' own. How much of these errors the
    data hold is what they show beyond parameters and term, whatever its coefficients are: a term that is wrong would have them agree."""
    case, chosen = here.case, term.basis.chosen
    adds = MissingTerm(term.basis.kind, about(term), chosen, term.q[: len(chosen)])
    try:
        sharp = None if case.refined_at is None else case.refined_at(parameters, adds)
        if sharp is None:
            return case, term, parameters, ""
        told = replace(case, model=sharp.model, doubts=sharp.doubts, parameters=parameters)
        begin = replace(at_parameters(here, told, structure, term), before=term.before)
        found, moved, remark = settled(replace(here, case=told), structure, begin)
    except NumericsError as error:
        words = f"errors of mesh and steps are those at the optimum without the term: a run that tells them failed ({error})"
        return case, term, parameters, words
    return (case, term, parameters, remark) if found is begin else (told, found, moved, remark)


def over_time(known: LinearModel, hat: Basis, here: Traced) -> MissingField:
    """Field of a basis of one place of a body: steps, unless held-out data ask for hats; hats of what drifts.

    Held-out data judge hats by the history that predicts hidden frames best. That is smoother than what is missing, and the parameters
    would take the rest. What is told is the likeliest history, with the parameters beside it."""
    judged = field_of(known, hat, here.rows, here.split)
    told = field_of(known, hat, here.rows, here.split, likeliest(known, hat))
    smooth = replace(told, after=judged.after, proof=judged.proof)
    steps = None if KINDS[hat.kind].drifts else in_steps(known, hat, here.rows, here.split)
    return smooth if steps is None or better(steps, smooth, here.rows, here.split) else steps


def solved(here: Traced, hat: Basis) -> MissingField:
    """Field of a basis at the optimum."""
    return field_of(here.problem.model, hat, here.rows, here.split)


def as_spot(here: Traced, found: Unlisted) -> tuple[Unlisted | None, str]:
    """An unlisted heat of a body that has a place as one spot, with the parameters fitted beside it; None where it is no such heat, and
    where parameters beside one are not told, and why.

    They are not where they do not settle, or where the spot leaves structure: it is then not all of what is missing. Nor are they where the
    errors of the mesh cannot be told beside it, for it may be smaller than an element. Where they do not settle with exponents of added
    laws free, these are held: amplitude, exponents and what they share a sum with make a valley in which every step crawls. Where the hats
    show that it travels it is one that does, and one at rest where parameters beside that are not told.
    NumericsError where its first run fails."""
    missing, place = here.case.model.missing, found.place
    if missing is None or found.field is None or place is None or found.field.basis.kind != "heat":
        return None, ""
    grid = missing.spot(IN_TIME)
    if grid is None or found.field.basis.grid.places == 1:
        return None, ""
    grid = replace(grid, y=np.array([place.centroid[1]]), spread=max(place.extent[1], grid.spread))
    line = travels(found.field, place)
    moving = [] if line is None else [replace(grid, y=line[:1], along=line[1] * (grid.time - line[2]))]
    exponents = tuple(n for n in here.case.parameters.free if param(n).scan)
    held = [n for n in exponents if n not in acting_on_temperatures(exponents)]
    why = ""
    for one in (*moving, grid):
        spot, why = fitted_spot(here, found, one)
        if held and why == UNSETTLED:
            spot, why = fitted_spot(holding(here, held), found, one)
        if spot is not None:
            return spot, why
    return None, why


def beside_spot(here: Traced, hold: Sequence[Structure], found: Unlisted, spot: Unlisted) -> Unlisted | None:
    """What is missing of a traced case by the hats of a heat that was found elsewhere (`found`), with the parameters where they are beside
    the one spot that is all of it; None where its channel holds no structure here, or held-out data do not ask for it.

    `hold`: channels of the case that hold structure. NumericsError where a run fails."""
    structure = next((s for s in hold if s.blocks.channel == found.channel), None)
    if structure is None or found.field is None:
        return None
    there = replace(here.case, parameters=spot.parameters)
    term = beside_optimum(here, at_parameters(here, there, structure, found.field))
    if not believed(term):
        return None
    every = [s.effect for s in here.ranking.scores]
    others = tuple(s.blocks.channel for s in hold if s is not structure)
    alone = Unlisted(found.channel, structure, best_listed(here, structure, every), None, None, (), others, spot.parameters)
    return replace(alone, field=term, place=place_of(term, volumes(here.case, term.basis)), hints=hints_of(here, term), spot=spot)


def holding(here: Traced, names: Sequence[str]) -> Traced:
    """A trace that holds fitted parameters where they are."""
    free = here.case.parameters.free
    kept = [k for k, n in enumerate(free) if n not in names]
    case = replace(here.case, parameters=here.case.parameters.with_free(tuple(free[k] for k in kept)))
    return replace(here, case=case, problem=replace(here.problem, model=here.problem.model.only(kept)))


def fitted_spot(here: Traced, found: Unlisted, grid: Grid) -> tuple[Unlisted | None, str]:
    """An unlisted heat as one spot, from that of a grid, with the parameters fitted beside it; None where they are not told, and why."""
    structure = found.structure
    apart, _ = undriven(here, structure)
    hat = every_hat(apart.case, structure, "heat", grid)
    first = beside_optimum(here, field_of(apart.problem.model, hat, here.rows, here.split, likeliest(apart.problem.model, hat)))
    term, parameters, remark = settled(apart, structure, first)
    if remark:
        return None, remark
    case, then, parameters, said = told_beside(apart, structure, term, parameters)
    if case is apart.case:
        return None, said or "the errors of the mesh cannot be told beside one spot"
    if said == UNSETTLED:
        return None, said
    if replace(structure, excess=structure.blocks.excess(then.residual)).stands_out:
        return None, LEAVES
    return replace(found, field=then, parameters=parameters, case=case, remark=said), ""


def volumes(case: Case, hat: Basis) -> np.ndarray | None:
    """Volumes (n_places,) mm^3 where the term is a heat source of a body."""
    return None if hat.kind != "heat" or case.model.missing is None else case.model.missing.volumes(hat.grid)


def hints_of(here: Traced, term: MissingField) -> tuple[Hint, ...]:
    """What the term goes with where it is: over the hats that were chosen."""
    grid, missing = term.basis.grid, here.case.model.missing
    assert missing is not None
    near = np.zeros(grid.places, dtype=bool)
    near[np.unravel_index(term.basis.chosen, (len(grid.time), grid.places, grid.components))[1]] = True
    states = {name: value[:, near] for name, value in missing.states(here.case.parameters, grid).items()}
    flat = term.values.reshape(len(grid.time), grid.places, grid.components)[:, near]
    return hints(flat[:, :, 0] if grid.components == 1 else np.linalg.norm(flat, axis=2), states, grid.time, here.case.spans)
