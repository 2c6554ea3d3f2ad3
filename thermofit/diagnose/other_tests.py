"""Proof on experiments that no fit has seen, inside the loop: what the fitted parameters predict there, without and with an effect.

A held-out test is a case of its own. Its rows are predicted by the parameters of the fit: the linearised models of both together say how
the step of the fitted rows, alone or with an effect, changes the rows that are not seen. An effect of the material acts in every test
and is proved there. One of the boundary or of the instruments belongs to the test that shows it, and another test says nothing of it.
Where a held-out test hardly feels an effect, or its error falls by less than its uncertainty, the held-out rows of the fitted tests
decide; where its error does not fall, the effect is refused.

A held-out test whose force the model cannot carry is driven by the motion of its sections, as a fitted one would be. Where that fails as
well, or at other parameters, it judges nothing: it is said, and the answer is not trusted. It never ends an identification.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case, Linearised, OtherTest, columns_of, linearised, rows_of_tests, scans, stacked
from thermofit.diagnose.held_out import PRACTICAL, SURE, Proof, Rows, compared
from thermofit.effects.catalogue import Effect, effect
from thermofit.experiment.instruments import station_names
from thermofit.experiment.protocol import UnseenTest
from thermofit.fit.linear_model import LinearModel, Room, projection
from thermofit.observe.comparison import NoiseOperator
from thermofit.study.stages import StageSettings


@dataclass(frozen=True)
class UnseenColumns:
    """A held-out test at an optimum: residual (m,), columns (m, p) of the fitted parameters and (m, k) of effects, rows, channels with
    their noise, and what applies the correlation of it."""

    name: str
    residual: np.ndarray
    fitted: np.ndarray
    dormant: Mapping[str, np.ndarray]
    rows: Rows
    floors: Mapping[str, float]
    noise: NoiseOperator | None
    failed: Mapping[str, str] = field(default_factory=dict)
    """Effects with which this test could not be run, and why."""


Settings = Mapping[str, dict[str, float]]
"""Values of the exponents of effects."""


def other_test_of(test: UnseenTest, settings: StageSettings, base: Parameters, known: Sequence[Effect]) -> OtherTest:
    """A held-out test for the loop, which begins at `base` with the settings of the joint fit and the `known` effects of fitted tests."""
    try:
        return _driven(test, settings, base, known)
    except NumericsError as error:
        failed, other = str(error), test.by_sections
    if other is not None:
        try:
            return _driven(other, settings, base, known)
        except NumericsError as error:
            failed = f"{failed}; driven by its sections: {error}"

    def unpredicted(_: Parameters) -> Case:
        raise NumericsError(failed)

    return OtherTest(test.label, unpredicted, lambda free: test.carried(free, settings.free), frozenset(), test.fit_own)


def _driven(test: UnseenTest, settings: StageSettings, base: Parameters, known: Sequence[Effect]) -> OtherTest:
    """The same in the drive that the test has. NumericsError where its model fails."""
    identified = settings.free
    there = test.predicted(base, identified)
    problem = test.corrected(test.problem(settings, there, known), there)
    rows = rows_of_tests(problem.each, problem.spans)

    def case(parameters: Parameters) -> Case:
        return Case(
            problem.model,
            test.predicted(parameters, identified),
            problem.known,
            problem.spans,
            station_names(),
            cheap=problem.model.cheap,
            scored=None if problem.parts is None else problem.parts.scored,
            placed=rows,
        )

    judges = test.judges(problem.known)
    return OtherTest(test.label, case, lambda free: test.carried(free, identified), judges, test.fit_own)


def unseen_columns_of(case: Case, wanted: Sequence[str], settings: Settings) -> tuple[tuple[UnseenColumns, ...], dict[str, str]]:
    """The held-out tests of a case, with the columns of the wanted effects that each can judge; then those that the model cannot be run
    through at these parameters, and why."""
    out, failed = [], {}
    for test in case.other_tests:
        try:
            out.append(_unseen_columns(test, case, [n for n in wanted if n in test.judges], settings))
        except NumericsError as error:
            failed[test.name] = str(error)
    return tuple(out), failed


def both_predicted(
    before: Sequence[UnseenColumns], after: Sequence[UnseenColumns]
) -> tuple[tuple[UnseenColumns, ...], tuple[UnseenColumns, ...]]:
    """The held-out tests that both of two optima predict."""
    names = {b.name for b in before} & {b.name for b in after}
    return tuple(b for b in before if b.name in names), tuple(b for b in after if b.name in names)


def _unseen_columns(test: OtherTest, case: Case, wanted: Sequence[str], settings: Settings) -> UnseenColumns:
    names, weights = test.carried(case.parameters.free)
    there = test.case(case.parameters)
    own_names = (*names, *test.own)
    there = replace(
        there,
        parameters=there.parameters.with_free(own_names),
        known=tuple(effect(n) for n in wanted),
        largest_strain=case.largest_strain,
    )
    found = linearised(there)
    used = there.rows.channel >= 0
    blocks, failed = {}, {name: f"held-out {test.name}: {why}" for name, why in found.failed.items()}
    for name in (name for name in wanted if name in found.dormant):
        try:
            blocks[name] = _block(there, found, name, settings.get(name))[used]
        except NumericsError as error:
            failed[name] = f"held-out {test.name}: {error}"
    residual, fitted = found.residual[used], found.fitted[used]
    judged = projection(fitted[:, len(names) :]).projected  # without what the test's own parameters, fitted on its own data, take up
    rows = there.rows
    own = Rows(rows.channel[used], rows.time[used], rows.xy[used], rows.phase[used])
    floors = {c.channel: float(np.sqrt(np.mean(c.sigma**2))) for c in there.model.comparisons}
    noisy = any(c.noise is not None for c in there.model.comparisons)
    return UnseenColumns(
        test.name,
        judged(residual),
        judged(fitted[:, : len(names)] @ weights),
        {name: judged(block) for name, block in blocks.items()},
        own,
        floors,
        _noise_of(there, used) if noisy else None,
        failed,
    )


def _noise_of(there: Case, used: np.ndarray) -> NoiseOperator:
    def noise(v: np.ndarray) -> np.ndarray:
        whole = np.zeros((len(used), v.shape[1]))
        whole[used] = v
        return there.model.noise(whole)[used]

    return noise


def _block(there: Case, found: Linearised, name: str, chosen: dict[str, float] | None) -> np.ndarray:
    """Columns of an effect at the values of its exponents that the fitted tests chose."""
    tried = scans(effect(name), there)
    if chosen is None or chosen == tried[0]:
        return found.dormant[name][1]
    if name in found.scanned and chosen in tried:
        return found.scanned[name][tried.index(chosen)]
    return columns_of(there, effect(name), chosen)


def unseen_residual(seen: LinearModel, beyond: Sequence[UnseenColumns], there: Sequence[np.ndarray]) -> np.ndarray:
    """Residual (m,) of the held-out tests as the rows of the fitted ones predict it; `there` are their columns (m_k, p)."""
    residual = np.concatenate([seen.residual, *(b.residual for b in beyond)])
    held = np.arange(len(residual)) >= len(seen.residual)
    whole = LinearModel(residual, np.concatenate([seen.columns, *there]), bounds=seen.bounds)
    return whole.predicted([(held, held)])[held]


def proof_unseen(seen: LinearModel, name: str, block: np.ndarray, beyond: Sequence[UnseenColumns], room: Room) -> Proof | None:
    """Proof of a dormant effect of that name, its columns (n, k) in the fitted tests, on held-out ones; None where they cannot judge."""
    if not any(name in b.dormant for b in beyond):
        return None
    both = [np.concatenate([b.fitted, b.dormant.get(name, np.zeros((len(b.residual), block.shape[1])))], axis=1) for b in beyond]
    before = unseen_residual(seen, beyond, [b.fitted for b in beyond])
    return proof_of_change(before, unseen_residual(seen.with_columns(block, room), beyond, both), beyond)


def proof_of_change(before: np.ndarray, after: np.ndarray, beyond: Sequence[UnseenColumns]) -> Proof | None:
    """What held-out tests say of a change; None where they do not decide.

    A change may be so small there that noise alone would hide a true one: then r + d, what is left, is noise, and the fall of the square
    sum is d.d, with the standard error 2 sqrt(d.C d). Or the error falls, but by less than its uncertainty, because something else that
    the model lacks is still in it. An error that does not fall refuses the change.
    """
    at = np.cumsum([0, *(len(b.residual) for b in beyond)])

    def noise(v: np.ndarray) -> np.ndarray:
        parts = [v[a:e] if b.noise is None else b.noise(v[a:e]) for b, a, e in zip(beyond, at[:-1], at[1:], strict=True)]
        return np.concatenate(parts)

    change = after - before
    doubt = 2.0 * float(change @ noise(change[:, None])[:, 0]) ** 0.5
    if float(change @ change) <= max(SURE * doubt, PRACTICAL * float(before @ before)):
        return None
    found = compared(before, after, stacked([b.rows for b in beyond]), len(beyond), noise)
    return None if found.gain > 0.0 and not found.convinces else replace(found, on=", ".join(b.name for b in beyond))
