"""What can be planted and with which values; what is expected of it; what an answer of the loop counts as."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from record_case import KNOWN, case_of

from thermofit.core.errors import StudyError
from thermofit.diagnose.case import Case
from thermofit.diagnose.expected import Expected, amplitude_for, changes, expected, expected_of
from thermofit.diagnose.injected import FAILED, ITSELF, LIKE, NOTHING, OTHER, UNLISTED, answer_of, impostors, off_planted
from thermofit.diagnose.planting import Planting, asked, plantable, plantings
from thermofit.diagnose.trace import Traced, traced, with_residual
from thermofit.effects.catalogue import effect

FIRST, GAIN = effect("backstress_first"), effect("ir_gain")


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """A record of stress and temperature that lacks nothing."""
    return replace(case_of(tmp_path_factory.mktemp("case"), 1), known=(*KNOWN, FIRST), cheap=True)


@pytest.fixture(scope="module")
def here(case: Case) -> Traced:
    return traced(case)


@pytest.mark.parametrize(
    ("name", "amplitude", "given", "said"),
    [
        ("nonsense", 1.0, {}, "effect 'nonsense' is not known; known are air_convection"),
        ("ir_gain", 0.0, {}, "at ir_gain.gain = 0 ir_gain is off; expected another value, such as 0.05"),
        ("ir_gain", 2.0, {}, "ir_gain.gain = 2 1 lies beyond its physical bounds -0.5 to 0.5"),
        ("ir_gain", 0.1, {"place": 1.0}, "ir_gain has no such parameter beside its amplitude ir_gain.gain; it has none"),
        ("backstress_first", 1e3, {"C": 5.0}, "beside its amplitude backstress_first.C; it has gamma"),
        ("backstress_first", 1e3, {"gamma": -5.0}, "beyond its physical bounds"),
    ],
)
def test_what_cannot_be_asked_is_one_sentence(name: str, amplitude: float, given: dict[str, float], said: str) -> None:
    with pytest.raises(StudyError, match=said.replace("(", r"\(")):
        asked(name, amplitude, given)


def test_values_are_given_by_short_or_full_names() -> None:
    wanted = {"backstress_first.C": 1e3, "backstress_first.gamma": 50.0}
    assert asked("backstress_first", 1e3, {"gamma": 50.0})[1] == wanted
    assert asked("backstress_first", 1e3, {"backstress_first.gamma": 50.0})[1] == wanted
    one, values = asked("local_source@second", 0.5, {"place": 4.0})
    assert one.name == "local_source@second" and values == {"local_source.power@second": 0.5, "local_source.place@second": 4.0}


def test_what_the_test_does_not_know_cannot_be_planted(case: Case) -> None:
    plantable(case, GAIN)
    with pytest.raises(StudyError, match=r"lamp is none that these data could show; can be planted: backstress_first, ir_drift"):
        plantable(case, effect("lamp"))
    on = replace(case, parameters=case.parameters.replace(**{"ir_gain.gain": 0.1}))
    with pytest.raises(StudyError, match="ir_gain is fitted in it already, or the study gives it a value"):
        plantable(on, GAIN)


def test_exponents_are_drawn_off_the_grid_and_more_draws_change_none(case: Case) -> None:
    few, many = (plantings(case, FIRST, {"backstress_first.C": 900.0}, n, 3) for n in (4, 30))
    assert many[:4] == few and len(many) == 30
    scanned = np.log(FIRST.params[1].scan) if FIRST.params[1].logarithmic else np.array(FIRST.params[1].scan)
    for how in many:
        value = how.values["backstress_first.gamma"]
        x = np.log(value) if FIRST.params[1].logarithmic else value
        assert np.abs(scanned - x).min() > 0.0 and how.values["backstress_first.C"] == 900.0, "no room below neutral: no sign is drawn"
    assert plantings(case, FIRST, {"backstress_first.C": 900.0}, 2, 4)[0] != few[0]
    assert len(plantings(case, FIRST, {"backstress_first.C": 900.0, "backstress_first.gamma": 50.0}, 9, 1)) == 1


def test_the_sign_is_drawn_where_there_is_room(case: Case) -> None:
    found = plantings(case, GAIN, {"ir_gain.gain": 0.1}, 40, 1)
    assert [how.values["ir_gain.gain"] for how in found] == [0.1, -0.1], "nothing else can be drawn: two injections differ"


def test_what_planting_changes_of_the_residual(case: Case, here: Traced) -> None:
    """By runs: exactly what data with the difference of two predictions leave; by columns near neutral: the same."""
    model, p = case.model, case.parameters
    for one, size in ((GAIN, 1e-4), (FIRST, 5.0)):
        (how,) = plantings(case, one, {one.amplitude.name: size}, 1, 1)
        (change,) = changes(here, one, [how])
        before, after = model.errors(p), model.errors(p.replace(**how.values))
        left = model.assemble({n: before[n] - (after[n] - before[n]) for n in before})
        assert change == pytest.approx(left - model.assemble(before), abs=1e-9)
        off = p.replace(**{n: v for n, v in how.values.items() if n != one.amplitude.name})
        block = model.linearised(off, ("E", one.amplitude.name))[1]
        assert change == pytest.approx(-block[:, 1] * size, abs=0.02 * np.abs(change).max())


@pytest.mark.parametrize(("times", "found"), [(0.3, False), (3.0, True)])
def test_what_is_expected_is_what_a_trace_of_planted_data_says(here: Traced, times: float, found: bool) -> None:
    unit = expected(here, GAIN, [Planting(0, {"ir_gain.gain": 0.05})])[0]
    how = Planting(0, {"ir_gain.gain": times * unit.smallest})
    (there,) = expected(here, GAIN, [how])
    assert there.smallest == pytest.approx(unit.smallest, rel=0.05) and there.size == pytest.approx(times * there.needed, rel=0.05)
    assert there.found is found and (there.chance > 0.99 if found else there.chance < 0.01) and there.channel == "dtheta"
    (change,) = changes(here, GAIN, [how])
    case = here.case
    before, after = case.model.errors(case.parameters), case.model.errors(case.parameters.replace(**how.values))
    planted = replace(
        case.model,
        linearise=lambda p, names: _shifted(case, p, names, {n: after[n] - before[n] for n in before}),
    )
    by_runs = traced(replace(case, model=planted), split=here.split)
    assert by_runs.columns.residual == pytest.approx(here.columns.residual + change, abs=1e-9)
    z = next((s.z for s in by_runs.ranking.scores if s.effect == "ir_gain"), 0.0)
    # How noise of neighbours is shared is told by the data as they are, which changes a score by little.
    assert there.z == pytest.approx(z, rel=0.01) and there.named == tuple(s.effect for s in by_runs.promising())


def _shifted(case: Case, parameters: Any, names: tuple[str, ...], added: dict[str, np.ndarray]) -> Any:
    """Error fields and derivatives with something added to the data."""
    assert case.model.linearise is not None
    errors, slopes = case.model.linearise(parameters, names)
    return {n: e - added[n] for n, e in errors.items()}, slopes


def test_what_the_data_point_to_already_is_not_expected(here: Traced) -> None:
    """Else anything would be found in data that hold something, whatever is planted."""
    how = Planting(0, {"ir_gain.gain": 0.4})
    (change,) = changes(here, GAIN, [how])
    assert expected_of(here, GAIN, how, change).found
    full = with_residual(here, here.columns.residual + change)
    assert full.promising()[0].effect == "ir_gain"
    again = expected_of(full, GAIN, Planting(0, {"ir_gain.gain": 1e-3}), change / 400.0)
    assert not again.found and "ir_gain" not in again.named and again.z > again.needed


def test_an_effect_that_is_not_seen_is_not_expected(here: Traced) -> None:
    lag = effect("ir_lag")
    nothing = replace(here, problem=replace(here.problem, model=here.problem.model.with_columns(_column(here, "ir_lag"))))
    there = expected_of(nothing, lag, Planting(0, {"ir_lag.time": 2.0}), -2.0 * _column(here, "ir_lag")[:, 0])
    assert not there.found and there.chance == 0.0 and there.smallest == np.inf and there.channel == "dtheta"


def _column(here: Traced, name: str) -> np.ndarray:
    return here.problem.dormant[name][1]


def test_amplitude_for_a_share_of_plantings() -> None:
    one = Expected(2.0, 4.0, 10.0, 0.0, (), False, "dtheta")
    assert amplitude_for(0.5, [one]) == pytest.approx(10.0)
    assert amplitude_for(0.9, [one]) == pytest.approx(10.0 + 1.2816 * 2.5, rel=1e-4), "standard error 10 / 4"
    other = replace(one, needed=4.0, smallest=30.0)
    assert 10.0 < amplitude_for(0.5, [one, other]) < 30.0 and amplitude_for(0.9, [one, other]) > 30.0
    assert amplitude_for(0.9, [one, replace(one, smallest=np.inf)]) == np.inf


PLAIN = {"accepted": ["lamp"], "like": {"lamp": []}, "unlisted": None}


def row(accepted: tuple[str, ...] = (), unlisted: str | None = None, **like: list[str]) -> dict[str, Any]:
    said = None if unlisted is None else {"channel": unlisted}
    return {"accepted": ["lamp", *accepted], "like": {"lamp": [], **{n: like.get(n, []) for n in accepted}}, "unlisted": said}


@pytest.mark.parametrize(
    ("said", "answer", "others"),
    [
        (row(("ir_gain",)), ITSELF, []),
        (row(("ir_lag", "ir_gain")), ITSELF, ["ir_lag"]),
        (row(("ir_lag",), ir_lag=["ir_gain"]), LIKE, []),
        (row(("ir_lag",)), OTHER, ["ir_lag"]),
        (row(unlisted="dtheta"), UNLISTED, []),
        (row(unlisted="stress"), NOTHING, []),
        (row(("ir_lag",), unlisted="dtheta"), UNLISTED, ["ir_lag"]),
        (row(), NOTHING, []),
        ({"failed": "no equilibrium"}, FAILED, []),
    ],
)
def test_answers(said: dict[str, Any], answer: str, others: list[str]) -> None:
    """What the data hold as they are is no answer to what was planted."""
    assert answer_of(said, "ir_gain", PLAIN, "dtheta") == answer
    assert impostors(said, "ir_gain", PLAIN) == others


def test_what_the_data_hold_already_does_not_count() -> None:
    both = {**PLAIN, "accepted": ["ir_gain"], "like": {"ir_gain": []}, "unlisted": {"channel": "dtheta"}}
    assert answer_of(both, "ir_gain", both, "dtheta") == NOTHING


def test_estimate_beside_what_was_planted() -> None:
    said = {**row(("ir_gain",)), "estimate": {"ir_gain.gain": [0.11, 0.02]}}
    ratio, z = off_planted(said, "ir_gain", {"ir_gain.gain": 0.1}) or (0.0, 0.0)
    assert ratio == pytest.approx(1.1) and z == pytest.approx(0.5)
    assert off_planted(row(), "ir_gain", {"ir_gain.gain": 0.1}) is None
    values = {"backstress_first.C": 1e3, "backstress_first.gamma": 50.0}
    held = {**row(("backstress_first",)), "estimate": {"backstress_first.C": [2e3, 10.0], "backstress_first.gamma": [90.0, None]}}
    assert off_planted(held, "backstress_first", values) is None, "an amplitude at another exponent is another amplitude"
