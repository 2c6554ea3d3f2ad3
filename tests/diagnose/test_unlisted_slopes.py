"""What the fitted parameters change of a missing heat: their sensitivities beside it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from refits import fitted
from strip import numerical, strip_case

from thermofit.diagnose.beside_source import beside_source
from thermofit.diagnose.trace import Traced, traced
from thermofit.diagnose.unlisted import alike_basis, alike_beside, histories, over_time, settled
from thermofit.diagnose.unlisted_field import MissingField, field_of
from thermofit.diagnose.unlisted_second import second_histories
from thermofit.diagnose.unlisted_slopes import beside_term
from thermofit.diagnose.unlisted_steps import in_steps, of_steps
from thermofit.diagnose.unlisted_structure import Structure, structures
from thermofit.fit.linear_model import LinearModel


def wave(x: np.ndarray, y: np.ndarray, t: float) -> np.ndarray:
    """Heat through all of the surface that comes and goes, mW/mm^3."""
    return 0.5 * np.sin(2.0 * np.pi * t / 60.0) + 0.0 * x


@pytest.fixture(scope="module")
def found() -> tuple[Traced, Structure, MissingField]:
    """A strip with a heat that nobody lists, and that heat as it is told at the optimum without it."""
    here = traced(fitted(strip_case(3, wave))[0], numerical())
    structure = structures(here.case, here.rows, here.problem.model.left, None)[0]
    return here, structure, over_time(here.problem.model, alike_basis(here, structure, "flux"), here)


def known_at(here: Traced) -> LinearModel:
    return LinearModel(*here.case.model.linearised(here.case.parameters, here.case.parameters.free))


def test_columns_hold_what_parameters_change_of_the_term(found: tuple[Traced, Structure, MissingField]) -> None:
    """By differences of the residual with the term in it; they are most of the column of the conductivity."""
    here, structure, term = found
    case, p = here.case, here.case.parameters
    told = beside_term(known_at(here), case, p, term)

    def residual(values: np.ndarray) -> np.ndarray:
        there = replace(case, parameters=p.with_vector(values))
        hat = alike_beside(there, structure, term)
        out = case.model.residual(there.parameters)
        out[hat.rows] += hat.columns @ term.q
        return out

    x = p.vector()
    for k, name in enumerate(p.free):
        step = np.eye(len(x))[k] * 1e-4 * x[k]
        slope = (residual(x + step) - residual(x - step)) / (2e-4 * x[k])
        assert np.abs(told.columns[:, k] - slope).max() < 1e-5 * np.abs(slope).max(), name
    alone = known_at(here).columns[:, p.free.index("kappa")]
    assert np.linalg.norm(told.columns[:, p.free.index("kappa")] - alone) > 0.2 * np.linalg.norm(alone)


def test_columns_of_every_field_hold_it(found: tuple[Traced, Structure, MissingField]) -> None:
    """What is warmer expands: displacements behind the temperatures have columns of their own. Of parameters that temperatures do not feel
    they stay."""
    here, _, term = found
    n = len(here.columns.residual)
    known = LinearModel(np.zeros(n + 3), np.zeros((n + 3, 2)))
    slopes = {"theta": np.ones((n, 1, 1, 1)), "u": np.full((3, 1, 1, 1), 5.0)}
    missing = SimpleNamespace(slopes=lambda *_: slopes)
    columns = {0: slopes["theta"][:, 0, 0], 1: slopes["u"][:, 0, 0]}
    both = SimpleNamespace(n=n), SimpleNamespace(n=3)
    model = SimpleNamespace(missing=missing, comparisons=both, columns=lambda moved: {k: columns[k] for k, _ in enumerate(moved)})
    case: Any = SimpleNamespace(model=model)
    told = beside_term(known, case, here.case.parameters.with_free(("E", "kappa")), term).columns
    assert not told[:, 0].any() and np.all(told[:n, 1] == 1.0) and np.all(told[n:, 1] == 5.0)


def test_coefficients_are_those_that_go_best_with_the_parameters(found: tuple[Traced, Structure, MissingField]) -> None:
    """A term that was told together with a step of the parameters says nothing where these have not taken it. As hats or as steps."""
    here, structure, term = found
    case, p, known = here.case, here.case.parameters, known_at(here)
    hats, steps = (of(known, term.basis, here.rows, here.split) for of in (field_of, in_steps))
    assert hats is not None and steps is not None and steps.solved is not None
    shape = of_steps(steps)
    assert of_steps(hats) is None and shape is not None and shape.shape == (len(steps.q), len(steps.solved.chosen))
    for one in (hats, steps):
        hat = alike_beside(case, structure, one)
        told = [beside_term(known, case, p, replace(one, q=factor * one.q), hat).columns for factor in (1.0, 5.0)]
        assert np.array_equal(*told)
        whole = [beside_term(known, case, p, replace(one, q=factor * one.q)).columns - known.columns for factor in (1.0, 5.0)]
        assert np.allclose(5.0 * whole[0], whole[1]) and np.abs(whole[0]).max() > 0.0


def test_a_camera_changes_no_sensitivity(found: tuple[Traced, Structure, MissingField]) -> None:
    """What it adds does not run through the heat equation."""
    here, structure, _ = found
    known = known_at(here)
    term = over_time(known, alike_basis(here, structure, "offset"), here)
    assert beside_term(known, here.case, here.case.parameters, term) is known


def test_parameters_settle_where_they_and_the_term_fit_best(found: tuple[Traced, Structure, MissingField]) -> None:
    """No small change of a parameter makes the sum of squares fall, with the coefficients that go best with it."""
    here, structure, begin = found
    term, parameters, remark = settled(here, structure, begin)
    assert remark == ""
    shape = of_steps(term)

    def left(values: np.ndarray) -> float:
        there = replace(here.case, parameters=parameters.with_vector(values))
        hat, r = alike_beside(there, structure, term), there.model.residual(there.parameters)
        columns = hat.columns if shape is None else hat.columns @ shape
        rough = term.weight * (hat.rough if shape is None or term.solved is None else term.solved.rough)
        q = np.linalg.solve(columns.T @ columns + rough, -columns.T @ r[hat.rows])
        r[hat.rows] += columns @ q
        return float(r @ r + q @ rough @ q)

    x, at = parameters.vector(), left(parameters.vector())
    for k, sigma in enumerate(term.uncertainty):
        ways = [left(x + way * np.eye(len(x))[k] * sigma) - at for way in (-1.0, 1.0)]
        lowest = 0.5 * (ways[0] - ways[1]) / sum(ways)
        assert sum(ways) > 0.0 and abs(lowest) < 0.4, "in standard errors, of the parabola through three points"


def test_intervals_hold_what_an_error_moves_beside_the_term(found: tuple[Traced, Structure, MissingField]) -> None:
    """An error between two limits moves the parameters as a fit beside the term would be moved by it."""
    here, structure, begin = found
    term, parameters, _ = settled(here, structure, begin)
    doubt = 0.3 * np.random.default_rng(5).normal(size=len(here.rows.time)).cumsum() / 20.0
    case = replace(here.case, parameters=parameters, doubts={"mesh": doubt})
    own = {"field": term, "structure": structure, "channel": structure.blocks.channel}
    missing: Any = SimpleNamespace(**own, settled=True, case=case, parameters=parameters, beside=())
    told = beside_source(here, missing)
    assert told is not None
    known = beside_term(LinearModel(*case.model.linearised(parameters, parameters.free)), case, parameters, term)
    hat = term.basis if term.solved is None else term.solved
    ends = [field_of(replace(known, residual=known.residual + e), hat, here.rows, here.split, term.weight).step for e in (0.0, doubt)]
    moved = (ends[1] - ends[0]) / np.sqrt(3.0)
    assert np.all(np.abs(moved) > term.uncertainty)
    second = second_histories(known, term, histories(case, structure, term))
    assert set(second.likelihood) == {"offset"} and told.second == second.likelihood
    wider = np.sqrt(term.uncertainty**2 + np.diag(second.covariance))
    assert np.any(wider > 1.01 * term.uncertainty)
    for n, sigma, move in zip(parameters.free, wider, moved, strict=True):
        assert told.sigma[n] == pytest.approx(np.hypot(sigma, move), rel=1e-3), n
