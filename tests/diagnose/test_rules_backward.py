"""The rules of the backward check, one at a time."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from thermofit.core.parameters import Parameters
from thermofit.diagnose import backward as module
from thermofit.diagnose.backward import compensated, moved_by, still_needed, without_effects
from thermofit.diagnose.case import Case
from thermofit.diagnose.held_out import Proof, Split
from thermofit.fit.linear_model import LinearModel

GOOD = Proof(2.0, 1.0, {}, 0.5, 0.01, 5)
END = Parameters.of({"kappa": 120.0, "ir_drift.rate": 0.02, "lamp.absorbed": 0.1, "lamp.start": 45.0}).with_free(
    ("kappa", "ir_drift.rate", "lamp.absorbed", "lamp.start")
)


def here_of(parameters: Parameters = END, cheap: bool = False, left: float = 1.0) -> Any:
    """Every parameter has a row of its own; exponents that are held leave this part of the square of what the drift does."""
    fitted = np.diag(np.arange(1.0, 7.0))[:, : len(parameters.free)]
    exponent = np.sqrt(1.0 - left) * fitted[:, 1] / 2.0 + np.sqrt(left) * np.eye(6)[5]
    model = SimpleNamespace(linearised=lambda *_: (None, exponent[:, None]))
    return SimpleNamespace(
        case=SimpleNamespace(parameters=parameters, cheap=cheap, model=model),
        columns=SimpleNamespace(residual=np.ones(6)),
        rows=None,
        split=Split((np.zeros(6, dtype=bool),) * 5, (np.zeros(6, dtype=bool),) * 5, ""),
        problem=SimpleNamespace(model=LinearModel(np.ones(6), fitted)),
    )


def test_an_effect_goes_back_to_neutral_by_its_amplitude_with_all_its_columns() -> None:
    """Exponents have no neutral value: their columns go, and nothing moves along them."""
    fitted = here_of().problem.model.columns
    lamp, drift, both = (without_effects(here_of(), names) for names in (["lamp"], ["ir_drift"], ["lamp", "ir_drift"]))
    assert lamp.residual == pytest.approx(1.0 - 0.1 * fitted[:, 2]) and lamp.columns.shape == (6, 2)
    assert drift.residual == pytest.approx(1.0 - 0.02 * fitted[:, 1]) and drift.columns.shape == (6, 3)
    assert both.residual == pytest.approx(lamp.residual + drift.residual - 1.0) and np.array_equal(both.columns, fitted[:, :1])


@pytest.mark.parametrize(
    ("inside", "beyond", "needed"), [(True, None, True), (False, None, False), (True, False, False), (False, True, True)]
)
def test_an_effect_is_needed_where_held_out_data_say_so(
    monkeypatch: pytest.MonkeyPatch, inside: bool, beyond: bool | None, needed: bool
) -> None:
    """The held-out tests, where one judges; else the folds."""
    proofs = {True: GOOD, False: replace(GOOD, sigma=0.3)}
    monkeypatch.setattr(module, "compared", lambda *_: proofs[inside])
    monkeypatch.setattr(module, "proof_of_need", lambda *_: None if beyond is None else proofs[beyond])
    monkeypatch.setattr(module, "moved_by", lambda *_: False)
    assert still_needed(here_of(), "ir_drift") is needed


@pytest.mark.parametrize(("moves", "needed"), [(True, True), (False, False)])
def test_an_effect_that_moves_the_material_is_needed_however_little_it_takes(
    monkeypatch: pytest.MonkeyPatch, moves: bool, needed: bool
) -> None:
    monkeypatch.setattr(module, "compared", lambda *_: replace(GOOD, gain=0.0021, sigma=0.0005))
    monkeypatch.setattr(module, "proof_of_need", lambda *_: None)
    monkeypatch.setattr(module, "moved_by", lambda *_: moves)
    assert still_needed(here_of(), "ir_drift") is needed


@pytest.mark.parametrize(("amount", "beside", "far"), [(0.1, (), True), (0.004, (), False), (0.1, ("ir_drift.rate",), False)])
def test_what_an_accepted_effect_has_moved(amount: float, beside: tuple[str, ...], far: bool) -> None:
    """Lamp and conductivity alike but for a hundredth: without the lamp, conductivity would be 100 times its amount higher; two per cent of
    120 are 2.4. Beside a further effect nothing is asked, unless all of them leave no more than the floor."""
    free = ("kappa", "lamp.absorbed", *beside)
    parameters = Parameters.of({"kappa": 120.0, "ir_drift.rate": 0.02, "lamp.absorbed": amount}).with_free(free)
    columns = np.zeros((6, len(free)))
    columns[:, : len(free)] = 1e3 * np.eye(6)[:, : len(free)]
    columns[:2, :2] = [[1e3, -1e5], [0.0, 1e3]]
    case = Case(cast(Any, SimpleNamespace(priors=())), parameters, (), (), frozenset())
    here: Any = SimpleNamespace(case=case, answered=False, problem=SimpleNamespace(model=LinearModel(np.zeros(6), columns)))
    assert moved_by(here, "lamp", without_effects(here, ["lamp"])) is far
    here.answered = True
    assert moved_by(here, "lamp", without_effects(here, ["lamp"])) is (amount == 0.1)


HELD = Parameters.of({"kappa": 120.0, "ir_drift.rate": 0.02, "lamp.absorbed": 0.1, "lamp.start": 45.0}).with_free(
    ("kappa", "ir_drift.rate", "lamp.absorbed")
)


def asked(monkeypatch: pytest.MonkeyPatch, left: float, convinces: bool = False, cheap: bool = False) -> tuple[list[Parameters], bool]:
    """The refits that are asked where the exponents leave this part of what the effect does, and whether it is dropped after them; it is
    still needed where the proof of it `convinces`."""
    begun: list[Parameters] = []

    def refit(start: Parameters, label: str, **_: Any) -> Any:
        begun.append(start)
        return start, "fit"

    monkeypatch.setattr(module, "held_out_of", lambda *_: None)
    monkeypatch.setattr(module, "proof_of_refit", lambda *_: None)
    monkeypatch.setattr(module, "compared", lambda *_: GOOD if convinces else replace(GOOD, sigma=0.3))
    means: Any = SimpleNamespace(refit=refit, at_end=lambda *_: "there")
    return begun, compensated(here_of(HELD, cheap, left), "ir_drift", ["lamp"], means) is not None


@pytest.mark.parametrize(("left", "refits"), [(0.79, 1), (0.81, 0)])
def test_a_refit_asks_where_held_exponents_explain_a_fifth(monkeypatch: pytest.MonkeyPatch, left: float, refits: int) -> None:
    begun, dropped = asked(monkeypatch, left)
    assert len(begun) == refits and dropped is bool(refits)
    if begun:
        assert begun[0]["ir_drift.rate"] == 0.0 and begun[0].free == ("kappa", "lamp.absorbed", "lamp.start", "lamp.onset")


def test_what_that_refit_shows_to_be_needed_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, dropped = asked(monkeypatch, 0.1, convinces=True)
    assert len(begun) == 1 and not dropped


def test_of_coupons_exponents_have_been_tried_free(monkeypatch: pytest.MonkeyPatch) -> None:
    assert asked(monkeypatch, 0.1, cheap=True) == ([], False)
