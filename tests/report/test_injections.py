"""What `inject` says of local effects and of shares: cells of the map, medians over draws, remarks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from thermofit.diagnose.expected import Expected
from thermofit.diagnose.injected import ITSELF, NOTHING
from thermofit.diagnose.planting import Planting
from thermofit.effects.catalogue import effect
from thermofit.report.injections import Injected, injection_datasets, injection_map, injection_summary, local_params

SEEN = Expected(8.0, 4.0, 0.25, 7.5, ("local_source",), True, "dtheta")
MISSED = Expected(2.0, 4.0, 1.0, 1.5, (), False, "dtheta")
PLAIN: dict[str, Any] = {"accepted": ["lamp"], "like": {"lamp": []}, "unlisted": None}


def planted(number: int, place: float, start: float) -> Planting:
    values = {"power": 0.5, "place": place, "width": 3.0, "start": start}
    return Planting(number, {f"local_source.{n}": v for n, v in values.items()})


def row(*names: str) -> dict[str, Any]:
    estimate = {f"local_source.{n}": [v, 0.1] for n, v in {"power": 0.6, "place": 1.0, "width": 3.0, "start": 9.0}.items()}
    return {**PLAIN, "accepted": ["lamp", *names], "like": {n: [] for n in names}, "estimate": estimate if names else {}, "wall_s": 1.0}


@pytest.fixture
def local() -> Injected:
    """Three sources at the lower end early, one of which was not run, and one at the upper end late."""
    how = (planted(0, -19.0, 1.0), planted(1, 19.0, 99.0), planted(2, -18.0, 2.0))
    rows = (row("local_source"), row())
    return Injected(effect("local_source"), how, (SEEN, MISSED, SEEN), PLAIN, rows, ((-20.0, 20.0), (0.0, 100.0)))


def test_cells_of_the_map(local: Injected) -> None:
    first, last = injection_summary(local)["map"]
    assert first == {
        **{"y_from_mm": -20.0, "y_to_mm": -10.0, "t_from_s": 0.0, "t_to_s": 25.0},
        **{"planted": 2, "expected": 2, "smallest": pytest.approx(0.25), "run": 1, "found": 1},
    }
    assert (last["y_to_mm"], last["t_to_s"], last["expected"], last["found"]) == (20.0, 100.0, 0, 0)
    assert last["smallest"] == pytest.approx(1.0)


def test_shares_and_estimates(local: Injected) -> None:
    said = injection_summary(local)
    assert (
        said["found"]["found"] == 1 and said["found"]["completeness"] == 0.5 and said["predicted"]["completeness"] == pytest.approx(2 / 3)
    )
    assert said["found"]["amplitude_over_planted"] == pytest.approx(1.2) and said["found"]["intervals_that_hold"] == {"held": 1, "of": 1}
    assert {r["answer"]: r["runs"] for r in said["answers"] if r["runs"]} == {ITSELF: 1, NOTHING: 1}
    assert said["injections"][0]["place"] == -19.0 and "answer" not in said["injections"][2]
    assert "the data as they are hold lamp; these are not counted" in said["remarks"]
    assert np.array_equal(injection_datasets(local)["planted/local_source.place"].value, [-19.0, 19.0, -18.0])
    assert len(injection_map(local, ()).axes) == 1


def test_what_lies_beyond_the_bounds_is_said(local: Injected) -> None:
    gain = Injected(
        effect("ir_gain"), (Planting(0, {"ir_gain.gain": 0.1}),), (Expected(0.5, 4.0, 0.8, 0.0, (), False, "dtheta"),), None, (), None
    )
    assert "no amplitude within its bounds would be found" in injection_summary(gain)["verdict"]
    assert local_params(gain.effect) is None and local_params(local.effect) == ("local_source.place", "local_source.start")


def test_what_the_data_hold_already_is_said() -> None:
    plain = {"accepted": ["ir_drift"], "like": {"ir_drift": ["ir_gain"]}, "unlisted": None}
    of = Injected(effect("ir_gain"), (Planting(0, {"ir_gain.gain": 0.1}),), (SEEN,), plain, ({**plain, "estimate": {}},), None)
    assert any("hold ir_gain or its like already" in text for text in injection_summary(of)["remarks"])
