"""Thermal parameters that a missing heat does not drive off: fitted beside a broad source that could be any of it (design section 8).

What a model lacks drives its parameters off before anything is judged: a source that nobody lists ends in a conductivity of half its value
and in jaws that conduct nothing, and a step from there names impostors. So the parameters that temperatures feel are fitted, on the motion
of the optimum, together with

    q(y, t) = sum q_ij N_i(y) N_j(t)    and    h(Lambda) d Lambda/dt,  h = sum h_k w_k(Lambda),

a power per volume over the whole specimen and a heat per plastic strain, both held by a roughness whose weight is the likeliest one
(`unlisted_field.likeliest`). The first is any source over place and time, at the ends of the specimen any history of the jaws. The second
is what goes with the flow, in which a few knots in time are too coarse. What neither can imitate determines the parameters. From there one
step of an effect says what it explains: candidates are ranked by it, and refitted from its end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.linalg import block_diag

from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Case, HeatFit, scans
from thermofit.diagnose.held_out import Rows, Split
from thermofit.diagnose.unlisted_field import SETTLED, Basis, MissingField, field_of, likeliest, roughness
from thermofit.effects.catalogue import effect
from thermofit.experiment.known_motion import acting_on_temperatures, acts_in_heat
from thermofit.experiment.missing import Missing
from thermofit.fit.linear_model import LinearModel, Room
from thermofit.identify.variables import fit_variables

COUNTS = (16, 7)
"""Hats of the broad source in time, and in y where it is observed."""
WEAK = 0.5
"""Standard error, as a part of it, of the study's first value of a parameter: where the data say nothing beside the source, that stands."""
WINDOWS = 12
"""Windows of the plastic strain, over the largest of the test, in each of which a heat per strain is free."""
SWEEPS = 6
"""Steps of the parameters beside the broad source at most."""
FARTHEST = 0.5
"""Part of its value by which a parameter may change in one of these steps."""
NOTHING = 1e-3
"""Part of the usual size of a parameter below which its value says nothing of how far it may go."""
_RANK = 1e-12
NO_FURTHER = 3e-3
"""Fall of the square sum beside the source below which no further step is made: what moves then is not determined."""


@dataclass(frozen=True)
class Protected:
    """Parameters beside the broad source, the problem of the temperatures linearised there without it, and the source itself."""

    parameters: Parameters
    linear: LinearModel
    source: MissingField

    @property
    def with_source(self) -> float:
        """Square sum that the broad source leaves, what its coefficients take of the noise apart."""
        return float(self.source.residual @ self.source.residual) + self.source.effective


@dataclass(frozen=True, eq=False)
class Begin:
    """Where a refit with one effect or two begins: their names, the parameters after one step from the protected ones, the square sum that
    the step leaves, the values of their times and exponents, and their columns (n, k) there."""

    effects: tuple[str, ...]
    parameters: Parameters
    f: float
    values: Mapping[str, float]
    columns: np.ndarray


def protected(case: Case, fit: HeatFit, rows: Rows, split: Split) -> Protected | None:
    """The protected parameters of a case, of the rows (n,) that its temperatures have; None where the model knows of no broad source.
    NumericsError where a run fails."""
    missing, directed = fit.model.missing, fit.model.directed
    grid = None if missing is None else missing.everywhere(COUNTS)
    if missing is None or directed is None or grid is None:
        return None
    thermal = acting_on_temperatures(case.parameters.free)
    readings = {prior.name: prior.value for prior in fit.model.priors if prior.firm and prior.name in thermal}
    there = case.parameters.replace(**{n: v for n, v in {**fit.first, **readings}.items() if n in thermal})
    scale = np.array([param(n).scale for n in thermal])
    found, f = None, np.inf
    for _ in range(SWEEPS):
        known = _linearised(fit, there, thermal)
        broad = _broad(case, fit, missing, there)
        found = field_of(known, broad, *_with_usual(fit, thermal, rows, split), likeliest(known, broad))
        values, room = np.array([there[n] for n in thermal]), _room(case, there, thermal)
        step = no_farther(np.clip(found.step, *room), values, either_sign(thermal), usual=scale)
        there = there.replace(**{n: there[n] + float(d) for n, d in zip(thermal, step, strict=True)})
        f, before = float(found.residual @ found.residual), f
        if np.max(np.abs(step) / scale) < SETTLED or f > (1.0 - NO_FURTHER) * before:
            break
    assert found is not None
    return Protected(there, replace(_linearised(fit, there, thermal), bounds=_room(case, there, thermal)), found)


def either_sign(names: Sequence[str]) -> np.ndarray:
    """Mask (p,) of the parameters that may have either sign, as the pose of a camera: a value of one says nothing of how far it may go."""
    return np.array([param(n).lower < 0.0 < param(n).upper for n in names], dtype=bool)


def no_farther(
    step: np.ndarray,
    value: np.ndarray,
    anywhere: np.ndarray | bool = False,
    usual: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Steps (p,) of parameters with these values (p,), none farther than FARTHEST of its value, but where `anywhere` (p,) or it is nothing:
    zero, or less than NOTHING of its `usual` size (p,). A fit that ends at a film of 2e-15 would stay there."""
    most = farthest(value, something(value, usual) & ~np.asarray(anywhere))
    return np.clip(step, -most, most)


def something(value: np.ndarray, usual: np.ndarray | float) -> np.ndarray:
    """Mask (p,) of the parameters whose values (p,) say how far they may go: more than NOTHING of their `usual` size (p,)."""
    return np.abs(value) > NOTHING * usual


def farthest(value: np.ndarray, known: np.ndarray) -> np.ndarray:
    """How far (p,) variables with these values (p,) may go in a step where their size is `known` (p,), else anywhere."""
    return np.where(known, FARTHEST * np.abs(value), np.inf)


def step_taken(
    parameters: Parameters, linear: tuple[np.ndarray, np.ndarray], bounds: Room, damping: float = 0.0, part: float = 1.0
) -> np.ndarray:
    """How far (p,) the free parameters move by a part of a linear step, straight in the variables in which they are fitted
    (`FitVariables`): a film by its resistance, exponents of the rate and the amplitude beside them by their logarithms. With a damping mu
    it is that of Levenberg and Marquardt,

        d = (H + mu diag H)^-1 H d*,   H = C^-1,

    `linear`: the step d* (p,) and the covariance C (p, p). None moves beyond its `bounds`, farther than `no_farther` lets it, or its
    logarithm than FARTHEST. A resistance grows no farther than that, and falls as far as it likes: a film that conducts as if there were
    none changes nothing until it is a hundredth of what it is. Where one is held up, the others go where they fit best beside it: what a
    step of the yield stress and of an overstress keep together, one of them alone would not."""
    names, value = parameters.free, parameters.vector()
    own, known = fit_variables(names, parameters), something(value, np.array([param(n).scale for n in names]))
    own = replace(own, is_reciprocal=own.is_reciprocal & known)
    y, slope = own.variables(value), own.slope(value)
    low, high = (end - y for end in own.bounds(*bounds))
    most = np.where(own.is_log, FARTHEST, farthest(y, known & ~either_sign(names)))
    room = np.maximum(low, -most), np.minimum(high, np.where(own.is_reciprocal, np.inf, most))
    along = held_up(*damped(linear[0] * slope, linear[1] * np.outer(slope, slope), damping), room)
    return own.parameters(y + part * along) - value


def damped(step: np.ndarray, covariance: np.ndarray, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """The step (p,) of Levenberg and Marquardt for a linear one, and (H + mu diag H)^-1 (p, p) in the stead of its covariance H^-1."""
    if not damping:
        return step, covariance
    sigma = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    inverse = np.linalg.pinv(covariance / np.outer(sigma, sigma), rcond=_RANK, hermitian=True)
    then = np.linalg.inv(inverse + damping * np.diag(np.diag(inverse)))
    return sigma * (then @ inverse @ (step / sigma)), then * np.outer(sigma, sigma)


def held_up(step: np.ndarray, covariance: np.ndarray, room: Room) -> np.ndarray:
    """A linear step d* (p,) of covariance C (p, p) within a room about nothing: d_B = d*_B + C_BA C_AA^-1 (d_A - d*_A) is what fits best
    beside those, A, that it, or what follows for the others, takes beyond the room. They stay at its end, also where another would be."""
    out, held = step, np.zeros(len(step), dtype=bool)
    while np.any(beyond := ~held & ((out < room[0]) | (out > room[1]))):
        held |= beyond
        out = np.where(held, np.clip(out, *room), step)
        away = np.linalg.lstsq(covariance[np.ix_(held, held)], (out - step)[held], rcond=None)[0]
        out = np.where(held, out, step + covariance[:, held] @ away)
    return out


def _usual(fit: HeatFit, thermal: Sequence[str]) -> dict[str, float]:
    """The study's first values of parameters that are no readings, each known to WEAK of itself."""
    read = {prior.name for prior in fit.model.priors}
    return {n: fit.first[n] for n in thermal if n not in read and fit.first.get(n, 0.0) != 0.0}


def _linearised(fit: HeatFit, there: Parameters, thermal: Sequence[str]) -> LinearModel:
    """The temperatures linearised at parameters, a row for each usual value behind their own."""
    residual, columns = fit.model.linearised(there, tuple(thermal))
    usual = _usual(fit, thermal)
    away = np.array([(there[n] - v) / (WEAK * abs(v)) for n, v in usual.items()])
    rows = np.array([[float(m == n) / (WEAK * abs(v)) for m in thermal] for n, v in usual.items()]).reshape(len(usual), len(thermal))
    return LinearModel(np.append(residual, away), np.vstack([columns, rows]), n_priors=len(fit.model.priors) + len(usual))


def _with_usual(fit: HeatFit, thermal: Sequence[str], rows: Rows, split: Split) -> tuple[Rows, Split]:
    """Rows and folds with those of the usual values, which are never held out."""
    more = len(_usual(fit, thermal))
    where = np.full(more, -1)
    longer = Rows(
        np.append(rows.channel, where),
        np.append(rows.time, np.full(more, rows.time.min())),
        np.vstack([rows.xy, np.zeros((more, 2))]),
        np.append(rows.phase, where),
    )
    held, near = (tuple(np.append(mask, np.zeros(more, dtype=bool)) for mask in masks) for masks in (split.held_out, split.buffer))
    return longer, Split(held, near, split.by)


def _broad(case: Case, fit: HeatFit, missing: Missing, there: Parameters) -> Basis:
    """The broad source at parameters: hats over place and time, windows of the plastic strain."""
    grid = missing.everywhere(COUNTS)
    assert grid is not None and fit.model.directed is not None
    chosen, width = np.arange(grid.size), case.largest_strain / WINDOWS
    (answers,) = missing.answers("heat", there, grid, chosen).values()
    shown = fit.model.comparisons
    hats = np.column_stack([np.concatenate([c.residual(answers[..., k]) for c in shown]) for k in range(grid.size)])
    name = "latent_heat.heat"
    others = [{"latent_heat.centre": (k + 0.5) * width, "latent_heat.width": width} for k in range(WINDOWS)]
    windows = fit.model.directed(there, [(name, values) for values in others])[: len(hats)]
    along = np.diff(np.eye(WINDOWS), axis=0)
    rough = along.T @ along
    # Both are held alike: a unit of roughness costs each the same share of what it shows.
    share = float(np.mean(np.sum(windows**2, axis=0)) / np.mean(np.sum(hats**2, axis=0)))
    columns = np.asfortranarray(np.hstack([hats, windows]))
    return Basis("heat", "mW/mm^3", grid, chosen, np.arange(len(hats)), columns, block_diag(roughness(grid, chosen), share * rough))


def _room(case: Case, there: Parameters, names: Sequence[str]) -> Room:
    """How far parameters may go to their bounds."""
    ends = np.array([case.bounds(n) for n in names]).reshape(len(names), 2)
    x = np.array([there[n] for n in names])
    return np.minimum(ends[:, 0] - x, 0.0), np.maximum(ends[:, 1] - x, 0.0)


def begins(case: Case, fit: HeatFit, found: Protected, names: Sequence[str]) -> tuple[Begin, ...]:
    """Where refits with the named dormant effects begin, what the step leaves least first: of every effect at the best of the values that
    are tried for its times and exponents. NumericsError where the run of the columns fails."""
    tried = [(e, values) for e in (effect(name) for name in names) for values in (scans(e, case) if acts_in_heat(e) else ({},))]
    directions = [(p.name, values) for e, values in tried for p in e.amplitudes if acts_in_heat(e)]
    shown = tuple(p.name for e, _ in tried for p in e.amplitudes if not acts_in_heat(e))
    assert fit.model.directed is not None
    along, seen = (np.zeros((len(found.linear.residual), len(n))) for n in (directions, shown))
    if directions:
        columns = fit.model.directed(found.parameters, directions)
        along[: len(columns)] = columns
    if shown:
        columns = fit.model.linearised(found.parameters, shown)[1]
        seen[: len(columns)] = columns
    best: dict[str, Begin] = {}
    k, m = 0, 0
    for e, values in tried:
        width = len(e.amplitudes)
        if acts_in_heat(e):
            block, k = along[:, k : k + width], k + width
        else:
            block, m = seen[:, m : m + width], m + width
        begin = _begin(case, found, (e.name,), values, block)
        if e.name not in best or begin.f < best[e.name].f:
            best[e.name] = begin
    return tuple(sorted(best.values(), key=lambda b: b.f))


def pairs(case: Case, found: Protected, singles: Sequence[Begin]) -> tuple[Begin, ...]:
    """Where refits with two of these effects begin, what the step leaves least first."""
    both = (
        _begin(case, found, (*a.effects, *b.effects), {**a.values, **b.values}, np.hstack([a.columns, b.columns]))
        for a, b in combinations(singles, 2)
    )
    return tuple(sorted(both, key=lambda b: b.f))


def _begin(case: Case, found: Protected, added: tuple[str, ...], values: Mapping[str, float], block: np.ndarray) -> Begin:
    """One step of all thermal parameters and effects, from the protected parameters, within the bounds."""
    linear, own = found.linear, tuple(p.name for name in added for p in effect(name).amplitudes)
    names = (*acting_on_temperatures(found.parameters.free), *own)
    whole = linear.with_columns(block, _room(case, found.parameters, own))
    step = whole.step
    moved = {n: found.parameters[n] + float(d) for n, d in zip(names, step.d, strict=True)}
    return Begin(added, found.parameters.replace(**values, **moved), linear.f - step.drop, values, block)
