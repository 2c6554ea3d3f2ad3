"""What the form of a law leaves unknown, told where parameters beside an unlisted heat are."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.parameters import Parameters
from thermofit.diagnose import beside_source as module
from thermofit.diagnose.beside_form import moves_of_form
from thermofit.diagnose.beside_source import TOLD_ANEW, BesideSource, beside_one_place, beside_source
from thermofit.diagnose.case import Case
from thermofit.diagnose.held_exponents import spread_of
from thermofit.diagnose.held_out import Rows, Split
from thermofit.diagnose.unlisted_field import Basis, MissingField, field_of, moves_beside, roughness
from thermofit.diagnose.unlisted_second import Second, with_term
from thermofit.diagnose.widened import known_to
from thermofit.experiment.missing import Grid
from thermofit.fit.budget import EXPONENTS, OTHER_FORM, SLOWER_RATES, Budget
from thermofit.fit.linear_model import LinearModel

RATE = np.geomspace(1e-3, 4e-3, 200)
"""Rates of a test, 1/s."""
NOISE = 0.02
VALUES = {"M_y0": 120.0, "rate_power.K": 6.0, "rate_power.m": 0.5, "rate_power.reference": 3e-4}
NAMES = ("M_y0", "rate_power.K", "rate_power.m", "rate_power.reference")


def stress(x: np.ndarray) -> np.ndarray:
    """M_y0 + K ((1 + rate / reference)^m - 1), MPa, over its noise."""
    return np.asarray((x[0] + x[1] * ((1.0 + RATE / x[3]) ** x[2] - 1.0)) / NOISE)


def columns_at(parameters: Parameters, names: tuple[str, ...]) -> np.ndarray:
    x = np.array([parameters[n] for n in NAMES], dtype=complex)
    units = [1e-30j * (np.array(NAMES) == n) for n in names]
    return np.stack([stress(x + unit).imag / 1e-30 for unit in units], axis=1)


def made(free: tuple[str, ...]) -> tuple[LinearModel, MissingField, Any]:
    """Parameters beside a term over time that is alike the overstress, and their case; data are of an arsinh law and such a term."""
    parameters = Parameters.of(VALUES, free)
    strain = np.linspace(0.0, 0.1, RATE.size + 1)
    model: Any = SimpleNamespace(linearised=lambda p, names: (None, columns_at(p, names)), missing=None)
    case = replace(Case(model, parameters, (), (), frozenset()), flowing=lambda _: (strain[1:], RATE, np.diff(strain)))
    grid = Grid(np.linspace(0.0, 1.0, 6), np.zeros(6, dtype=int), np.zeros(1), np.zeros(1))
    draw = np.random.default_rng(5)
    hats = np.cumsum(draw.normal(size=(RATE.size, 6)), axis=0)
    basis = Basis("offset", "K", grid, np.arange(6), np.arange(RATE.size), hats, roughness(grid, np.arange(6)))
    seen = (118.0 + 5.0 * np.arcsinh(RATE / 3e-4)) / NOISE + hats @ np.arange(6.0) + draw.normal(size=RATE.size)
    known = LinearModel(stress(np.array([VALUES[n] for n in NAMES])) - seen, columns_at(parameters, free))
    rows = Rows(np.zeros(RATE.size, dtype=int), np.arange(float(RATE.size)), np.zeros((RATE.size, 2)), np.zeros(RATE.size, dtype=int))
    fifths = tuple(np.arange(RATE.size) // 8 % 5 == k for k in range(5))
    return known, field_of(known, basis, rows, Split(fifths, fifths, "fifths"), 1e-2), case


def test_held_exponents_and_slower_rates_move_what_is_told_beside_a_term() -> None:
    """Against the steps that the same errors of the data make beside the term: exponents as far as data and term leave them unknown, from
    where they are held, and half of the overstress at the slowest rate."""
    known, term, case = made(("M_y0", "rate_power.K"))
    found, untold = moves_of_form(known, term, case, ("rate_power",))
    whole = with_term(known, term)
    more = len(whole.residual) - RATE.size
    exponents = ("rate_power.m", "rate_power.reference")
    columns = columns_at(case.parameters, exponents) * np.array([spread_of(n, case) for n in exponents])
    root = np.linalg.cholesky(known_to(whole, np.pad(columns, ((0, more), (0, 0))), np.ones(2)))
    np.testing.assert_allclose(found[:, :2], moves_beside(known, term, columns @ root), rtol=1e-4)
    assert np.abs(found[0, :2]).max() > 10.0 * term.uncertainty[0], "far more than the noise"
    overstress = 6.0 * ((1.0 + RATE[int(0.05 * RATE.size)] / 3e-4) ** 0.5 - 1.0)
    assert abs(found[0, 2]) == pytest.approx(0.5 * overstress / np.sqrt(3.0), rel=0.25)
    sigma = np.sqrt(term.uncertainty[0] ** 2 + np.sum(found[0] ** 2))
    off = abs(VALUES["M_y0"] + term.step[0] - 118.0)
    assert 3.0 * term.uncertainty[0] < off < 3.0 * sigma
    assert untold == () and moves_of_form(known, term, case, ())[0].shape == (2, 0), "nothing was added"


def test_what_is_not_told_of_a_law_is_said() -> None:
    """Of a straight line no exponent shifts the overstress at all rates: what it says below the slowest one counts as exact."""
    known, term, case = made(("M_y0", "rate_power.K"))
    straight = case.parameters.replace(**{"rate_power.m": 1.0, "rate_power.reference": 1.0})
    found, (said,) = moves_of_form(known, term, replace(case, parameters=straight), ("rate_power",))
    assert found.shape == (2, 2) and said.startswith("what rate_power says below ") and "counts as exact" in said


def test_exponents_that_are_fitted_do_not_take_up_the_shift() -> None:
    """What a law says below the slowest rate would else be what its reference rate does, and move nothing besides."""
    known, term, case = made(NAMES)
    found, _ = moves_of_form(known, term, case, ("rate_power",))
    assert found.shape == (4, 1) and np.all(found[2:] == 0.0) and abs(found[0, 0]) > 0.5


@pytest.mark.parametrize("added", [(), ("rate_power",)])
def test_the_form_is_told_where_the_parameters_are(monkeypatch: pytest.MonkeyPatch, added: tuple[str, ...]) -> None:
    """Beside one place, and not as the joint fit has it as well; what that tells of other forms is theirs too."""
    known, term, case = made(("M_y0", "rate_power.K"))
    by_form = np.array([[0.3, 0.4], [0.0, 0.1]]) if added else np.zeros((2, 0))
    monkeypatch.setattr(module, "beside_term", lambda *_: known)
    monkeypatch.setattr(module, "weighed", lambda *_: Second({}, np.zeros((2, 2))))
    monkeypatch.setattr(module, "other_channels", lambda *_: [])
    monkeypatch.setattr(
        module, "moves_of_form", lambda *given: (by_form, ("not told",)) if given[3] == added and given[2].parameters == told else None
    )
    told = case.parameters.replace(M_y0=118.5)
    missing: Any = SimpleNamespace(parameters=told, field=term, structure=None, beside=added, settled=True, case=None)
    found = beside_one_place(case, missing)
    assert found.value == {"M_y0": 118.5, "rate_power.K": 6.0} and found.untold == ("not told",)
    assert found.sigma["M_y0"] == pytest.approx(np.hypot(term.uncertainty[0], 0.5 if added else 0.0))
    assert found.form == (TOLD_ANEW if added else ()) and set(found.held) == ({"rate_power.m", "rate_power.reference"} if added else set())
    parts = {cause: np.array([[size], [0.0]]) for cause, size in ((EXPONENTS, 7.0), (SLOWER_RATES, 9.0), (OTHER_FORM, 2.0))}
    here: Any = SimpleNamespace(case=case)
    whole = beside_source(here, missing, Budget(("M_y0", "rate_power.K"), parts, np.zeros(2, dtype=bool)))
    assert isinstance(whole, BesideSource)
    more = 2.0 if added else np.linalg.norm([7.0, 9.0, 2.0])
    assert (
        whole.sigma["M_y0"] == pytest.approx(np.hypot(found.sigma["M_y0"], more))
        and whole.sigma["rate_power.K"] == found.sigma["rate_power.K"]
    )


def test_channels_of_which_nothing_is_told_are_asked_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their quiet histories widen what is told; the channel of the term has its own kinds, weighed already."""
    known, term, case = made(("M_y0", "rate_power.K"))
    told = case.parameters.replace(M_y0=118.5)
    channels = {name: SimpleNamespace(blocks=SimpleNamespace(channel=name)) for name in ("du", "dtheta")}
    asked, places = [], []

    def quiet(whole: LinearModel, errors: np.ndarray, there: Any, others: Any) -> list[Second]:
        asked.append((whole.columns.shape[1], there.parameters, [one.blocks.channel for one in others]))
        return [Second({"scale": 0.7}, np.diag([0.09, 0.0]))]

    monkeypatch.setattr(module, "beside_term", lambda *_: known)
    monkeypatch.setattr(module, "weighed", lambda *_: Second({"offset": 0.2}, np.zeros((2, 2))))
    monkeypatch.setattr(module, "structures", lambda *_: tuple(channels.values()))
    of_case = module.errors_of
    monkeypatch.setattr(module, "errors_of", lambda there, columns: places.append(there.parameters) or of_case(there, columns))
    monkeypatch.setattr(module, "quiet_histories", quiet)
    fields = {"parameters": told, "field": term, "structure": channels["dtheta"], "channel": "dtheta", "beside": ()}
    missing: Any = SimpleNamespace(**fields, settled=True, case=None)
    here: Any = SimpleNamespace(case=case, rows=None, problem=SimpleNamespace(model=SimpleNamespace(left=None)))
    found = beside_source(here, missing)
    assert isinstance(found, BesideSource) and found.second == {"offset": 0.2, "scale": 0.7}
    assert asked == [(2 + len(term.q), told, ["du"])] and places == [told]
    assert [found.sigma[n] for n in told.free] == pytest.approx([np.hypot(term.uncertainty[0], 0.3), term.uncertainty[1]])
