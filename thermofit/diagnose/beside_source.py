"""Parameters of the base model where an unlisted heat has not driven them off, with their standard errors.

A joint fit spreads a heat that nobody lists over all parameters: they end many of their standard errors away, with small ones. Beside an
unlisted heat two things are told instead. Parameters that temperatures do not feel are those of the displacements alone. The others are
those beside a broad source (`protected`); how little is known of that source is part of their standard errors. Beside a term that is the
same everywhere, or one spot that leaves nothing else, they are those fitted with it. Standard errors hold what the test prescribes, what
may be left of the errors of mesh and steps, and what the loop holds of the law that it has added (`FORM`). Beside one history, or one
spot, they hold other kinds of histories that may be there as well (`unlisted_second`), and those of channels of which nothing is told
(`quiet`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.diagnose.beside_form import moves_of_form
from thermofit.diagnose.case import Case
from thermofit.diagnose.combined import errors_of
from thermofit.diagnose.quiet import quiet_histories
from thermofit.diagnose.rescored import on_its_motion, protected_at, shown_rows
from thermofit.diagnose.trace import Traced
from thermofit.diagnose.trial import held_exponents
from thermofit.diagnose.unlisted import UNSETTLED, Unlisted, as_spot, has_parameters, weighed
from thermofit.diagnose.unlisted_field import MissingField, moves_beside
from thermofit.diagnose.unlisted_second import with_term
from thermofit.diagnose.unlisted_slopes import beside_term
from thermofit.diagnose.unlisted_spot import middle_of_power
from thermofit.diagnose.unlisted_structure import Structure, structures
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.fit.budget import EXCHANGED, EXPONENTS, FORM_OF_HEAT, HELD_LAW, OTHER_FORM, PULLED, SLOWER_RATES, Budget, moves
from thermofit.fit.linear_model import LinearModel

FORM = (EXCHANGED, EXPONENTS, HELD_LAW, FORM_OF_HEAT, OTHER_FORM, PULLED, SLOWER_RATES)
"""Causes of doubt that lie in the form of what was added, and not in the data."""
TOLD_ANEW = (EXPONENTS, SLOWER_RATES)
"""Those that are told where the parameters beside one history or spot are."""


@dataclass(frozen=True)
class Spot:
    """Where a heat is that was taken for one spot: the height y of its middle and its spread in mm, None where that is less than the mesh
    shows; of one that travels its velocity in mm/s, with its standard error, and the time in s at which its middle is there."""

    y: float
    spread: float | None
    velocity: tuple[float, float] | None = None
    time: float | None = None


@dataclass(frozen=True)
class BesideSource:
    """Values of the fitted parameters beside an unlisted heat or what cameras add, and their combined standard errors, each in its unit; in
    words why there are none, where a run failed."""

    value: Mapping[str, float]
    sigma: Mapping[str, float]
    failed: str = ""
    spot: Spot | None = None
    """The one spot beside which they were fitted; None where they were beside something else."""
    no_spot: str = ""
    """Why they are not told beside one spot, where the unlisted heat has a place."""
    second: Mapping[str, float] = field(default_factory=dict)
    """How likely each other kind of history is beside the one that is told, or beside the spot: standard errors hold them."""
    held: Mapping[str, float] = field(default_factory=dict)
    """Exponents of added laws that are held beside it, in the unit of each."""
    form: tuple[str, ...] = ()
    """Causes of doubt in the form of what was added that the standard errors hold already."""
    untold: tuple[str, ...] = ()
    """What of them they do not hold, in words."""


def beside_source(here: Traced, missing: Unlisted | None, budget: Budget | None = None) -> BesideSource | None:
    """The parameters beside an unlisted heat of a body, or what its cameras add to all of an image; None where none is unlisted, or the
    model knows of no broad source. `budget`: that of the joint fit."""
    found = _beside(here, missing)
    if found is None or budget is None:
        return found
    causes = [c for c in FORM if c in budget.parts and c not in found.form]
    form = {n: np.linalg.norm([budget.of(c)[k] for c in causes]) for k, n in enumerate(budget.names)}
    return replace(found, sigma={n: float(np.hypot(s, form.get(n, 0.0))) for n, s in found.sigma.items()})


def _beside(here: Traced, missing: Unlisted | None) -> BesideSource | None:
    """The same without what is known of the form of added laws."""
    case = here.case
    if missing is None or missing.field is None or not has_parameters(missing):
        return None
    silent = other_channels(here, missing)
    if missing.field.basis.grid.places == 1:
        if not missing.settled:
            return BesideSource({}, {}, UNSETTLED)
        return beside_one_place(missing.case or case, missing, silent)
    if case.heated is None or case.model.segments is not None:
        return None
    try:
        moved = on_its_motion(here)
        spot, no_spot = (missing.spot, "") if missing.spot is not None else as_spot(moved, missing)
        if spot is not None and spot.field is not None:
            return replace(beside_one_place(spot.case or case, spot, silent), spot=spot_of(spot.field))
        fit = case.heated(moved.case.parameters)
        found = None if fit is None else protected_at(moved, fit)
        if fit is None or found is None:
            return None
        free = moved.case.parameters.free
        _, columns = case.model.linearised(moved.case.parameters, free)
        errors = errors_of(replace(case, parameters=moved.case.parameters), columns)
        thermal = acting_on_temperatures(found.parameters.free)
    except NumericsError as error:
        return BesideSource({}, {}, f"parameters beside the unlisted heat are not known ({error})")
    mine = shown_rows(here)
    of_heat = np.pad(errors[mine], ((0, len(found.linear.residual) - mine.sum()), (0, 0)))  # usual values are no data
    value = {n: found.parameters[n] for n in thermal}
    sigma = dict(zip(thermal, _together(found.source.uncertainty, moves_beside(found.linear, found.source, of_heat)), strict=True))
    others = [n for n in free if n not in acting_on_temperatures(free)]
    if others and not mine.all():
        block = LinearModel(np.zeros((~mine).sum()), columns[~mine][:, [free.index(n) for n in others]])
        white = np.sqrt(np.sum(block.root() ** 2, axis=1))
        value |= {n: moved.case.parameters[n] for n in others}
        sigma |= dict(zip(others, _together(white, moves(block, errors[~mine], np.zeros(len(others), dtype=bool))), strict=True))
    return BesideSource({n: value[n] for n in free if n in value}, {n: sigma[n] for n in free if n in sigma}, no_spot=no_spot)


def spot_of(term: MissingField) -> Spot:
    """Where the spot of a term is. Behind its hats stand its middle, its velocity if it travels and, where it is more than the least, its
    spread."""
    grid, m = term.basis.grid, len(term.basis.chosen)
    travels = grid.along is not None
    spread = grid.spread if len(term.q) - m > 1 + travels else None
    if grid.along is None:
        return Spot(float(grid.y[0]), spread)
    since = middle_of_power(grid, term.q)
    velocity, y = np.polyfit(grid.time - since, grid.heights, 1)
    return Spot(float(y), spread, (float(velocity), float(np.sqrt(term.posterior[m + 1, m + 1]))), since)


def other_channels(here: Traced, missing: Unlisted) -> list[Structure]:
    """The channels of a body but that of which something is told."""
    every = structures(here.case, here.rows, here.problem.model.left, None)
    return [one for one in every if one.blocks.channel != missing.channel]


def beside_one_place(case: Case, missing: Unlisted, others: Sequence[Structure] = ()) -> BesideSource:
    """The parameters that were fitted with a term over time that is the same everywhere, or one spot; `others`: channels of which nothing
    is told, whose quiet histories are weighed beside it."""
    parameters, term = missing.parameters, missing.field
    assert term is not None, "they were fitted with it"
    there = replace(case, parameters=parameters)
    try:
        residual, columns = case.model.linearised(parameters, parameters.free)
        errors = errors_of(there, columns)
        known = beside_term(LinearModel(residual, columns), case, parameters, term)
        second = weighed(known, case, missing.structure, term, parameters)
        silent = quiet_histories(with_term(known, term), errors, there, others)
        form, untold = moves_of_form(known, term, there, missing.beside)
    except NumericsError as error:
        return BesideSource({}, {}, f"parameters beside the unlisted {term.basis.kind} are not known ({error})")
    noise = np.sqrt(term.uncertainty**2 + sum(np.diag(one.covariance) for one in (second, *silent)))
    likely = {kind: part for one in (second, *silent) for kind, part in one.likelihood.items()}
    sigma = _together(noise, np.concatenate([moves_beside(known, term, errors), form], axis=1))
    values = {n: parameters[n] for n in parameters.free}
    held = {n: parameters[n] for n in held_exponents(parameters)} if missing.beside else {}
    return BesideSource(
        values,
        dict(zip(parameters.free, sigma, strict=True)),
        second=likely,
        held=held,
        form=TOLD_ANEW if missing.beside else (),
        untold=untold,
    )


def _together(noise: np.ndarray, moved: np.ndarray) -> list[float]:
    """Standard errors (p,) by the noise and by moves (p, m) of unit variance together."""
    return [float(s) for s in np.sqrt(noise**2 + np.sum(moved**2, axis=1))]
