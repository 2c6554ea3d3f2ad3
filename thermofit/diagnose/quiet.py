"""Histories and effects that nothing tells, and what they may make of the fitted parameters all the same.

A jaw, a film or a camera may change by so little that held-out data gain less by it than an answer has to, and still move a conductivity by
many of its standard errors: all of it that parameters could take, they have. So at the end every kind k of history that a channel may have,
and the term of any place, is weighed beside all that is fitted, and none of them too (`unlisted_second.mixed`). Values stay what they are;
standard errors hold

    E = sum_k p_k (C_k - C + d_k d_k^T)

more. What may be left of the errors of mesh and steps is free beside them: it is no history. A kind of which the data show nothing has its
lambda at the largest, moves nothing, and adds nothing. Each channel is asked by itself. Where parameters are told beside something
unlisted, the other channels are asked beside it (`beside_source`).

So is every effect of the catalogue that is not in the model. One that changes a modulus takes hardly any of the error of a whole test, for
an unloading is a small part of it, and all of the modulus. Its columns stand for the hats, with a ridge for the roughness. An effect whose
refit does not lower held-out error, or that cannot be, is none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.diagnose.case import Case
from thermofit.diagnose.combined import errors_of, with_wider
from thermofit.diagnose.held_out import SURE
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.unlisted import IN_TIME, LIKELIER, Unlisted, broad_basis, has_parameters, histories
from thermofit.diagnose.unlisted_field import Basis
from thermofit.diagnose.unlisted_second import Second, held_beside, mixed
from thermofit.diagnose.unlisted_structure import Structure, structures
from thermofit.diagnose.widened import most_widened, widened
from thermofit.experiment.missing import KINDS, Grid
from thermofit.fit.budget import QUIET, QUIET_EFFECT
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult
from thermofit.records.progress import progress

RARE = 0.05
"""How likely a channel has a history which nothing tells, or the model lacks an effect, before the data speak. So often may chance name an
effect."""


def with_quiet(closed: Closed, missing: Unlisted | None) -> Closed:
    """The loop's result with standard errors that know what histories and effects which nothing tells may make of the parameters of a body,
    and a remark where one is likelier than not; the same where parameters are told beside something unlisted, or none is widened. Where a
    run for it fails, a remark says so."""
    here, fit, case = closed.last, closed.fit, closed.last.case
    if case.cheap or fit.covariance is None or fit.jacobian is None or case.model.missing is None or has_parameters(missing):
        return closed
    there, known = replace(case, parameters=case.parameters.with_free(fit.names)), LinearModel(fit.residual, fit.jacobian)
    try:
        errors = errors_of(there, fit.jacobian)
        channels = structures(case, here.rows, here.problem.model.left, None)
        found = quiet_histories(known, errors, there, channels)
    except NumericsError as error:
        words = f"what histories that nothing tells may make of the parameters is not known: a run failed ({error})"
        return replace(closed, remarks=(*closed.remarks, words))
    wider, likely = fit, list[str]()
    for one in found:
        wider = widened(wider, one.covariance)
        likely += likely_ones(one)
    closed = _with_remark(with_wider(closed, QUIET, wider), fit, likely) if most_widened(fit, wider) else closed
    effects = quiet_effects(known, errors, not_refuted(closed))
    if effects is None or not most_widened(fit := closed.fit, wider := widened(fit, effects.covariance)):
        return closed
    return _with_remark(with_wider(closed, QUIET_EFFECT, wider), fit, likely_ones(effects))


def likely_ones(found: Second) -> list[str]:
    """What is likelier than not, in words."""
    return [f"a quiet {KINDS[kind].words}" if kind in KINDS else kind for kind, part in found.likelihood.items() if part > LIKELIER]


def _with_remark(closed: Closed, before: FitResult, likely: Sequence[str]) -> Closed:
    """The loop's result with a remark on what is likelier than not and has widened the fit `before`; the same where nothing is."""
    if not likely:
        return closed
    most = most_widened(before, closed.fit)
    words = f"intervals hold what {' and '.join(likely)} would make of the parameters, most of all of {most}"
    return replace(closed, remarks=(*closed.remarks, f"{words}: too small to be told, and not excluded"))


@dataclass(frozen=True)
class QuietEffect:
    """An effect that may be there although nothing tells it: its columns (n, k) at every value of its exponents that was tried, and the
    share of what they take of the square sum that counts, for the noise is correlated."""

    blocks: tuple[np.ndarray, ...]
    counts: float


def not_refuted(closed: Closed) -> dict[str, QuietEffect]:
    """The effects that may be there at the end of the loop although nothing tells them. An effect whose refit in the last round, or by
    which it was taken back, does not lower held-out error is none."""
    here = closed.last
    alone = [t for r in closed.rounds[-1:] for t in r.trials if len(t.effects) == 1]
    refuted = {n for t in alone if t.proof is not None and t.gain <= SURE * t.proof.sigma for n in t.effects}
    possible = {s.effect: s for s in here.ranking.scores if not s.vetoed and s.effect not in {*closed.dropped, *refuted}}
    found = {}
    for name, score in possible.items():
        tried = tuple(block for _, block in here.scanned.get(name, ())) or (here.problem.dormant[name][1],)
        found[name] = QuietEffect(tried, min(1.0, score.z**2 / max(score.predicted_drop, 1e-300)))
    return found


def quiet_effects(known: LinearModel, errors: np.ndarray, effects: Mapping[str, QuietEffect]) -> Second | None:
    """How likely every effect is, and E (p, p) of the fitted parameters; None where nothing of any effect shows beyond them. Every effect
    is as likely as any other before the data speak, and so is each value of its exponents. `known` and `errors` as for `quiet`: what the
    errors could make is no effect."""
    p, whole = known.columns.shape[1], _beside_errors(known, errors)
    felt: dict[str, list[Basis]] = {}
    for name, one in effects.items():
        for block in one.blocks:
            longer = np.pad(block, ((0, len(whole.residual) - len(block)), (0, 0)))
            if whole.sensitive(longer).shape[1] == longer.shape[1]:
                felt.setdefault(name, []).append(_with_ridge(name, longer, one.counts))
    if not felt:
        return None
    every = {f"{name} {k}": basis for name, bases in felt.items() for k, basis in enumerate(bases)}
    found = mixed(whole, every, RARE, [1.0 / len(felt) / len(bases) for bases in felt.values() for _ in bases])
    of = {name: sum(found.likelihood[f"{name} {k}"] for k in range(len(bases))) for name, bases in felt.items()}
    return Second(of, found.covariance[:p, :p])


def _with_ridge(name: str, block: np.ndarray, counts: float) -> Basis:
    """The columns (n, k) of an effect, scaled to length one, in the place of hats; a ridge is their roughness."""
    k = block.shape[1]
    nowhere = Grid(np.zeros(1), np.zeros(1, dtype=int), np.zeros(1), np.zeros(1))
    return Basis(name, "", nowhere, np.arange(k), np.arange(len(block)), block / np.linalg.norm(block, axis=0), np.eye(k), counts=counts)


def quiet_histories(known: LinearModel, errors: np.ndarray, case: Case, channels: Sequence[Structure]) -> list[Second]:
    """The quiet histories of channels that have any (`quiet`). NumericsError where a run fails."""
    found = list[Second]()
    with progress("quiet histories", len(channels)) as advance:
        for one in channels:
            second = quiet(known, errors, case, one)
            found += [] if second is None else [second]
            advance(1, one.blocks.channel)
    return found


def quiet(known: LinearModel, errors: np.ndarray, case: Case, structure: Structure) -> Second | None:
    """How likely every kind of history is that a channel may have, and the term of any place, and E (p, p) of the fitted parameters of a
    case; None where there is no kind of which anything would show. NumericsError where a run fails.

    `known`: the linear model of the parameters, with what else is fitted behind them. `errors` (n, m): what may be left of the errors of
    mesh and steps, and what else counts as exact, as one standard error each. They are free beside: what they could make is no history."""
    kinds, broad = histories(case, structure, most=IN_TIME), broad_basis(case, structure)
    if broad is not None:
        kinds[broad.kind] = broad
    if not kinds:
        return None
    p = len(case.parameters.free)
    found = mixed(_beside_errors(known, errors), kinds, RARE)
    return replace(found, covariance=found.covariance[:p, :p])


def _beside_errors(known: LinearModel, errors: np.ndarray) -> LinearModel:
    """The linear model with errors (n, m) free beside it, each held by its standard error; rows that hold a term know nothing of them."""
    longer = np.pad(errors, ((0, len(known.residual) - len(errors)), (0, 0)))
    return held_beside(known, longer, np.eye(errors.shape[1]))
