"""Other kinds of histories that may be there beside one that is told."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import null_space

from thermofit.diagnose.held_out import Rows, Split
from thermofit.diagnose.unlisted_field import Basis, MissingField, System, field_of, roughness
from thermofit.diagnose.unlisted_second import mixed, second_histories, with_term
from thermofit.experiment.missing import Grid
from thermofit.fit.linear_model import LinearModel

N, M = 90, 7


def hats(kind: str, draw: np.random.Generator, own: np.ndarray) -> Basis:
    """Hats of a kind over time whose columns are smooth and drawn, on some rows."""
    grid = Grid(np.linspace(0.0, 60.0, M), np.zeros(M, dtype=int), np.zeros(1), np.zeros(1))
    columns = np.cumsum(draw.normal(size=(len(own), M)), axis=0) / 5.0
    return Basis(kind, "K", grid, np.arange(M), own, columns, roughness(grid, np.arange(M)))


def beside(known: LinearModel, basis: Basis, weight: float) -> MissingField:
    """A term that is held by a lambda."""
    n = len(known.residual)
    rows = Rows(np.zeros(n, dtype=int), np.arange(float(n)), np.zeros((n, 2)), np.zeros(n, dtype=int))
    split = Split((np.arange(n) < n // 2, np.arange(n) >= n // 2), (np.zeros(n, dtype=bool),) * 2, "")
    return field_of(known, basis, rows, split, weight)


def made() -> tuple[LinearModel, MissingField, dict[str, Basis]]:
    """Three parameters beside a history, and two other kinds, the first of which is there."""
    draw = np.random.default_rng(7)
    own = np.arange(20, N)
    first, other, third = (hats(kind, draw, own) for kind in ("offset", "flux", "jaws"))
    columns = draw.normal(size=(N, 3))
    columns[own] += 2.0 * other.columns[:, :3]
    residual = draw.normal(size=N)
    residual[own] += first.columns @ draw.normal(size=M) + other.columns @ draw.normal(size=M)
    known = LinearModel(residual, columns)
    return known, beside(known, first, 0.3), {"flux": other, "jaws": third}


def spread(n: int, *terms: tuple[Basis, float]) -> np.ndarray:
    """Covariance (n, n) of noise of unit variance and of terms that are held by their lambdas, 1 + sum B (lambda R)^-1 B^T."""
    out = np.eye(n)
    for basis, weight in terms:
        block = np.zeros((n, basis.columns.shape[1]))
        block[basis.rows] = basis.columns
        out += block @ np.linalg.solve(weight * basis.rough, block.T)
    return out


def test_likelihoods_are_those_of_what_the_parameters_leave() -> None:
    """Against the density of contrasts that no parameter changes, the covariance of both terms in it (Patterson and Thompson 1971)."""
    known, term, others = made()
    contrasts = null_space(known.columns.T)

    def density(*terms: tuple[Basis, float]) -> float:
        v, r = contrasts.T @ spread(N, *terms) @ contrasts, contrasts.T @ known.residual
        return -0.5 * (len(r) * float(np.log(r @ np.linalg.solve(v, r))) + float(np.linalg.slogdet(v)[1]))

    system = System(with_term(known, term), others["flux"])
    own = (term.basis, term.weight)
    expected = [density(own, (others["flux"], w)) - density(own) for w in system.weights]
    np.testing.assert_allclose(system.gains, expected, atol=1e-4 * np.ptp(expected))


def test_intervals_are_those_of_a_mixture_about_what_is_told() -> None:
    """Against generalised least squares with each second history and without one, each as likely as its largest likelihood has it."""
    known, term, others = made()
    j, r = known.columns, known.residual

    def fitted(*terms: tuple[Basis, float]) -> tuple[np.ndarray, np.ndarray]:
        inverse = np.linalg.inv(spread(N, (term.basis, term.weight), *terms))
        covariance = np.linalg.inv(j.T @ inverse @ j)
        return -covariance @ j.T @ inverse @ r, covariance

    alone, least = fitted()
    share, parts = [1.0], [np.zeros((3, 3))]
    for basis in others.values():
        system = System(with_term(known, term), basis)
        step, covariance = fitted((basis, system.weights[int(np.argmax(system.gains))]))
        share.append(float(np.exp(system.gains.max())))
        parts.append(covariance - least + np.outer(step - alone, step - alone))
    found = second_histories(known, term, others)
    of_all = np.array(share) / np.sum(share)
    assert found.likelihood == pytest.approx(dict(zip(others, of_all[1:], strict=True)), rel=1e-3)
    assert found.likelihood["flux"] > 0.9
    expected = sum(w * part for w, part in zip(of_all, parts, strict=True))
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())


def test_kinds_share_what_is_believed_of_any_of_them() -> None:
    """Before the data speak: one of twenty tests has one, each kind as likely as any other. Else each is as likely as none."""
    known, term, others = made()
    own = {"offset": term.basis, **others}
    whole = LinearModel(np.random.default_rng(2).normal(size=N), known.columns)
    equal, rare = mixed(whole, own), mixed(whole, own, 0.05)
    odds = {kind: part / (1.0 - sum(equal.likelihood.values())) for kind, part in equal.likelihood.items()}
    less = {kind: one * (0.05 / 3) / 0.95 for kind, one in odds.items()}
    assert rare.likelihood == pytest.approx({kind: one / (1.0 + sum(less.values())) for kind, one in less.items()})
    assert 0.0 < sum(rare.likelihood.values()) < sum(equal.likelihood.values())


def test_steps_stand_as_the_steps_that_they_are() -> None:
    """Where a term was fitted as a few steps, these are held beside the parameters, not its hats."""
    known, term, others = made()
    steps = Basis("offset", "K", term.basis.grid, np.arange(1), term.basis.rows, term.basis.columns[:, :1], np.eye(1))
    own = beside(known, steps, 1e-3)
    told = MissingField(**{**vars(term), "solved": steps, "weight": 1e-3})
    assert second_histories(known, told, others).covariance == pytest.approx(second_histories(known, own, others).covariance)


def test_a_channel_with_no_other_kind_holds_nothing_more() -> None:
    """The records of a coupon with a clock: nothing else acts on them as a history."""
    known, term, _ = made()
    found = second_histories(known, term, {})
    p = known.columns.shape[1]
    assert found.likelihood == {} and np.array_equal(found.covariance, np.zeros((p, p)))


@pytest.mark.parametrize("there", [False, True])
def test_parameters_are_within_their_intervals(there: bool) -> None:
    """Drawn again and again, with a second history that looks like what a parameter changes, or with none: standard errors that know of
    one hold how far parameters are off (rms). Where none is there, intervals stay nearly what they are."""
    draw = np.random.default_rng(11)
    own = np.arange(N)
    first, other = hats("offset", draw, own), hats("flux", draw, own)
    columns = draw.normal(size=(N, 3))
    columns[:, 0] = other.columns @ np.array([1.0, 0.8, 0.5, 0.2, 0.0, 0.0, 0.0]) + 0.3 * draw.normal(size=N)
    off, wide, wider = [], [], []
    for _ in range(60):
        history = np.cumsum(draw.normal(size=M)) * (0.7 if there else 0.0)
        residual = draw.normal(size=N) + first.columns @ np.cumsum(draw.normal(size=M)) + other.columns @ history
        known = LinearModel(residual, columns)
        term = beside(known, first, 1.0)
        more = second_histories(known, term, {"flux": other}).covariance
        off.append(term.step[0])
        wide.append(term.uncertainty[0])
        wider.append(np.sqrt(term.uncertainty[0] ** 2 + more[0, 0]))
    before, after = (float(np.sqrt(np.mean((np.array(off) / np.array(s)) ** 2))) for s in (wide, wider))
    if there:
        assert before > 2.0 and 0.6 < after < 1.2, (before, after)
    else:
        assert 0.6 < after < 1.3 and np.median(np.array(wider) / np.array(wide)) < 1.3, (before, after)
