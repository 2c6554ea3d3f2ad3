"""Local balances as a result: rows of the JSON, datasets with units and names of axes, lines for a terminal."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.core.jsonable import jsonable
from thermofit.diagnose import balances
from thermofit.diagnose.balances import Witness, Witnesses, where_of
from thermofit.diagnose.score import Columns
from thermofit.diagnose.significance import significance
from thermofit.experiment.local_balance import LocalBalance
from thermofit.fit.linear_model import LinearModel
from thermofit.report.balances import balance_datasets, balance_entry, maps_of, significance_figure
from thermofit.report.local_words import balance_lines

N_T, N_Y = 8, 4
ROW, COLUMN = (v.ravel() for v in np.meshgrid(np.arange(N_T), np.arange(N_Y), indexing="ij"))
KEPT = np.arange(N_T * N_Y) != 5
"""One cell was not measured."""


def witness(planted: float, whole: bool, test: str = "") -> Witness:
    n = int(KEPT.sum())
    amount = 0.01 * np.random.default_rng(3).normal(size=n) + planted * (ROW[KEPT] == 6) * (COLUMN[KEPT] >= 2)
    balance = LocalBalance(
        kind="heat",
        channel="dtheta",
        unit="mW/mm^3",
        amount=amount,
        covariance=1e-4 * np.eye(n),
        columns=np.zeros((n, 1)),
        names=("kappa",),
        value=np.array([100.0]),
        bounds=(np.array([1.0]), np.array([1000.0])),
        told=np.zeros((0, 1)),
        beside=np.zeros((n, 0)),
        y=10.0 * COLUMN[KEPT],
        time=5.0 * ROW[KEPT] + 2.0,
        row=ROW[KEPT],
        column=COLUMN[KEPT],
        extent=20.0,
        duration=np.full(n, 10.0),
        dropped=1,
        volume=np.full(n, 30.0 * 20.0 * 8.0 / 15.0),
    )
    found = significance(balance)
    return Witness(test, found, whole, where_of(whole, found.stands_out), ())


@pytest.mark.parametrize(
    ("planted", "whole", "word"), [(0.2, True, "inside"), (0.2, False, "inside"), (0.0, True, "outside"), (0.0, False, "none")]
)
def test_the_word_says_where_a_residual_comes_from(planted: float, whole: bool, word: str) -> None:
    seen = Witnesses((witness(planted, whole),), ())
    assert seen.where == word == seen.maps[0].where


def test_a_balance_is_told_the_error_of_the_mesh_that_no_parameter_has_taken_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two rows of either channel; the parameter has taken up what all four have in common."""
    error, left = np.array([3.0, 1.0, 2.0, 2.0]), np.array([1.0, -1.0, 0.0, 0.0])
    problem = Columns(LinearModel(np.zeros(4), np.ones((4, 1))), {}, numerical=error)
    told: list[Any] = []

    def shown(joint: Any, parameters: Any, numerical: Any) -> Any:
        told.extend(numerical)
        raise NumericsError("no run")

    for name, made in (("shown", shown), ("standing", lambda *_: []), ("has_sections", lambda _: True), ("named_phases", lambda _: ())):
        monkeypatch.setattr(balances, name, made)
    comparisons = [SimpleNamespace(channel=c, n=2) for c in ("du", "dtheta")]
    case = SimpleNamespace(model=SimpleNamespace(comparisons=comparisons), parameters=None)
    joint = SimpleNamespace(data=SimpleNamespace(phases=None))
    parts: Any = SimpleNamespace(each={"": joint}, seen_by=lambda parameters, _: parameters)
    found = balances.witnesses(cast(Any, SimpleNamespace(case=case, problem=problem)), parts)
    assert found is not None and found.without == ("local balances: the run failed (no run)",)
    assert [c for c, _ in told] == ["du", "dtheta"] and np.concatenate([rows for _, rows in told]) == pytest.approx(left)


def test_a_result_holds_all_of_a_map(tmp_path: object) -> None:
    seen = Witnesses((witness(0.2, True, "second"),), ("heat of pieces: a reason",))
    said = json.loads(json.dumps(jsonable(balance_entry(seen, None)), allow_nan=False))
    (row,) = said["maps"]
    assert row["where"] == said["where"] == "inside" and row["experiment"] == "second" and row["dropped"] == 1 and row["cells"] == 31
    block = row["block"]
    assert block["y_mm"] == [15.0, 35.0] and block["when_s"] == [29.5, 34.5] and block["value"] == pytest.approx(0.2, abs=0.03)
    # The section has 30 mm^2: the block 600 mm^3.
    assert block["power_mW"] == pytest.approx(600.0 * block["value"]) and row["peak"]["t_s"] == 32.0
    lines = balance_lines(said)
    assert lines[0].startswith("second: heat of pieces: chi2") and "at y = 15 to 35 mm from 29.5 to 34.5 s" in lines[0]
    assert lines[1] == "heat of pieces: a reason"


def test_datasets_are_maps_over_window_and_place() -> None:
    made = balance_datasets(Witnesses((witness(0.2, True, "second"),), ()))
    z = made["balance/heat@second/z"]
    assert z.unit == "1" and z.dims == ("window", "place") and z.value.shape == (8, 4) and np.isnan(z.value).sum() == 1
    assert made["balance/heat@second/amount"].unit == "mW/mm^3" and made["balance/heat@second/time"].unit == "s"
    (drawn,) = maps_of(made)
    assert (drawn.kind, drawn.test) == ("heat", "second") and drawn.y.tolist() == [0.0, 10.0, 20.0, 30.0]
    title = significance_figure([drawn]).axes[0].get_title()
    share = 100.0 * np.sum(np.abs(np.nan_to_num(z.value)) > 3.0) / 31
    assert title.startswith(f"second: heat of pieces: {share:.1f} % of 31 cells beyond 3") and share > 6.0
