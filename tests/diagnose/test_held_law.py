"""A hardening law that is held beside a curve: what the data leave of it, and what follows for all others."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.held_law import with_held_law
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.widened import known_to
from thermofit.fit.evaluate import Counts
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult

GIVEN = {"M_y0": 100.0, "M_yinf": 250.0, "H_exp": 10.0, "hardening_curve.level": 2.0, "hardening_curve.range": 0.1}
BY_BETA = {"M_y0": 0.01, "M_yinf": 0.02, "H_exp": 0.03}
"""Columns of the law in units of that of beta."""
ROWS = 400


def beside_curve(told: float, fails: bool = False, accepted: tuple[str, ...] = ("hardening_curve",), off: float = 0.0) -> Any:
    """A loop that has added a curve of 2 MPa, beta and c0 fitted; the law is `off` by as many MPa in M_yinf. Beyond beta, columns of the
    law are `told` long in directions of their own."""
    random = np.random.default_rng(6)
    directions = np.linalg.qr(random.normal(size=(ROWS, 5)))[0]
    jacobian = 100.0 * directions[:, :2]
    own = {n: told * directions[:, 2 + k] + BY_BETA[n] * jacobian[:, 0] for k, n in enumerate(BY_BETA)}
    residual = -off * told * directions[:, 3]  # r + S a is least where M_yinf has gone by `off`
    linear = LinearModel(residual, jacobian)
    spread = linear.covariance(("beta", "c0"), np.zeros(2, dtype=bool))
    nowhere = np.zeros(2, dtype=bool)
    fit = FitResult(
        ("beta", "c0"), "least-squares", "", np.array([0.8, 2.2]), linear.f, residual, jacobian, spread, spread.sigma, None, nowhere, True,
        "", Counts(0, 0, 0, 0, 0, 0.0), (),
    )  # fmt: skip

    def linearised(_: Any, names: tuple[str, ...]) -> Any:
        if fails:
            raise NumericsError("no equilibrium")
        return residual, np.stack([own[n] for n in names], axis=1)

    case = SimpleNamespace(
        parameters=Parameters.of(GIVEN, ("beta", "c0")), model=SimpleNamespace(linearised=linearised), largest_strain=0.1
    )
    here: Any = SimpleNamespace(case=case, problem=SimpleNamespace(model=linear))
    return Closed((), here, here, fit, accepted, (), None, None)  # type: ignore[arg-type]


def added(found: Any, before: Any) -> np.ndarray:
    """Standard errors (2,) of beta and c0 by the held law alone."""
    return np.asarray(np.sqrt(found.fit.sigma**2 - before.fit.sigma**2))


def test_a_law_that_no_datum_tells_may_be_anywhere() -> None:
    """2 MPa, as the curve adds, for the yield stress at no plastic strain; for M_yinf and H_exp as much as they are, uniform."""
    before = beside_curve(told=0.0)
    found = with_held_law(before)
    sizes = np.array([2.0, 250.0, 10.0]) * np.array([0.01, 0.02, 0.03]) / np.sqrt(3.0)
    assert added(found, before) == pytest.approx([np.linalg.norm(sizes), 0.0], rel=1e-6, abs=1e-9)
    (said,) = found.remarks
    assert said.startswith("M_y0, M_yinf = 250 +- 1.4e+02 MPa, H_exp = 10 +- 5.8 1: held beside the curve") and "beta +- " in said


def test_a_law_that_the_data_tell_is_known_as_well_as_they_tell_it() -> None:
    """A column 4 long tells a number to a quarter; the yield stress at no plastic strain hangs on no datum."""
    before = beside_curve(told=4.0)
    sizes = np.array([2.0 / np.sqrt(3.0), 0.25, 0.25]) * np.array([0.01, 0.02, 0.03])
    found = with_held_law(before)
    assert added(found, before)[0] == pytest.approx(np.linalg.norm(sizes), rel=1e-3)
    nothing = beside_curve(told=4.0, accepted=("lamp",))
    assert with_held_law(nothing) is nothing
    failed = with_held_law(beside_curve(told=4.0, fails=True))
    assert "count as exact" in failed.remarks[0] and "no equilibrium" in failed.remarks[0]


def test_where_the_data_would_move_the_law_it_is_known_no_better() -> None:
    """M_yinf is 30 MPa from where they have it."""
    before = beside_curve(told=4.0, off=30.0)
    assert added(with_held_law(before), before)[0] == pytest.approx(0.02 * 30.0, rel=0.05)


def test_what_is_unlisted_may_have_drawn_the_law() -> None:
    """A term that does the same as M_yinf to half of its length: the data tell M_yinf from it less well, and not where it is."""
    before = beside_curve(told=4.0, off=30.0)
    (by_yinf,) = before.last.case.model.linearised(None, ("M_yinf",))[1].T
    own = by_yinf - before.fit.jacobian @ np.linalg.lstsq(before.fit.jacobian, by_yinf, rcond=None)[0]
    rows = np.arange(0, ROWS, 2)
    missing: Any = SimpleNamespace(field=SimpleNamespace(basis=SimpleNamespace(rows=rows, columns=own[rows, None])))
    share = float(np.sum(own[rows] ** 2) / np.sum(own**2))
    assert 0.3 < share < 0.7
    found = with_held_law(before, missing)
    left = np.hypot(30.0, 0.25 / np.sqrt(1.0 - share))
    assert added(found, before)[0] == pytest.approx(0.02 * left, rel=0.02)
    whole: Any = SimpleNamespace(field=SimpleNamespace(basis=SimpleNamespace(rows=np.arange(ROWS), columns=own[:, None])))
    assert added(with_held_law(before, whole), before)[0] == pytest.approx(0.02 * 250.0 / np.sqrt(3.0), rel=0.02), "nothing tells it then"
    silent: Any = SimpleNamespace(field=None)
    assert added(with_held_law(before, silent), before)[0] == pytest.approx(0.02 * 30.0, rel=0.05)


def test_it_is_as_if_the_numbers_were_fitted_beside_a_prior() -> None:
    random = np.random.default_rng(1)
    model = LinearModel(np.zeros(60), random.normal(size=(60, 3)))
    own, before = random.normal(size=(60, 2)), np.array([0.05, 2.0])
    every = np.column_stack([model.columns, own])
    exact = np.linalg.inv(every.T @ every + np.diag([0.0, 0.0, 0.0, *before**-2]))[3:, 3:]
    assert known_to(model, own, before) == pytest.approx(exact, rel=1e-9)
