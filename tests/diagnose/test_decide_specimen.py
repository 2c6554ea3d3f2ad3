"""Changes of a test that would part what it cannot tell apart: a lamp and a heat of transformation, two errors of a camera."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from virtual_pulls import SIZE, TIME, TRUTH, pulled, study

from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case
from thermofit.diagnose.decide import Decision, decided, decisions, in_words
from thermofit.diagnose.decide_specimen import (
    COOLING,
    OWN,
    POINTS,
    PROGRAMMES,
    REST,
    STEPS,
    STOP,
    Discrimination,
    Family,
    ForceCourse,
    columns,
    course_of,
    drivable,
    planned,
    spread,
)
from thermofit.diagnose.score import ALIKE
from thermofit.diagnose.trace import Traced
from thermofit.experiment.fields import LoadSteps, Measured
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.experiment.known_effects import effects_of_fields
from thermofit.experiment.model import StageModel

FREE = ("E", "M_y0", "M_yinf", "H_exp", "kappa", "c0", "beta", "alpha_air", "alpha_clamp", "theta_air", "theta_clamp")
LAMP = ("lamp", "latent_heat")
SETTINGS = {"lamp": {"lamp.start": 4.0}, "latent_heat": {"latent_heat.centre": 0.02, "latent_heat.width": 0.06}}
PULL = np.interp(TIME, [0.0, 2.0, 4.0, 30.0], [0.0, 0.0, 3900.0, 5200.0])
"""N; a pull at one rate of force that ends with the test: a lamp that goes on with yielding heats as the flow does."""


@lru_cache(maxsize=1)
def pull() -> Measured:
    set_threads(1)
    steps = LoadSteps(TIME, PULL).until(30.0)
    data = pulled()
    return replace(data, steps=dict.fromkeys(data.steps, steps))


def joint(extra: str = "") -> Joint:
    made, data = study(extra), pull()
    return Joint(made, data, joint_settings(made, FREE, data), SIZE)


def left(*families: tuple[str, ...], **on: float) -> Traced:
    """A trace of which only the families count that it leaves undecided, at the truth with what is `on`."""
    scores = tuple(SimpleNamespace(effect=f[0], family=f, detectability=1.0, z=9.0) for f in families)
    model = cast(StageModel, SimpleNamespace(missing=None, comparisons=()))
    case = Case(model, Parameters.of({**TRUTH, **on}, FREE), effects_of_fields(infrared=True), (), frozenset())
    ranking = SimpleNamespace(scores=scores, threshold=3.0)
    return cast(Traced, SimpleNamespace(case=case, promising=lambda: scores, ranking=ranking, settings=SETTINGS))


def test_a_rest_or_a_cooling_parts_a_lamp_from_a_heat_of_transformation() -> None:
    """A lamp heats what does not flow; the rate, at which both go along, does not part them."""
    (found,) = decisions(left(LAMP), (), joint())
    assert found.as_it_was is not None and found.as_it_was.cosine > ALIKE and found.failed_on_specimen == ()
    cosine = {t.programme.name: t.cosine for t in found.on_specimen}
    assert max(cosine["long-rest"], cosine["long-cooling"]) < 0.3 and min(cosine["half-rate"], cosine["twice-rate"]) > ALIKE
    assert found.best_on_specimen is not None and found.best_on_specimen.programme.name == "long-rest"
    said = in_words(found)
    assert said.startswith(
        "lamp and latent_heat: a coupon test cannot show lamp and latent_heat, which act on the field of temperature; on the specimen"
    )
    assert "long-rest (rest 120 s longer before loading" in said and "it shows lamp from" in said


def test_two_errors_of_a_camera_that_are_one_are_parted_by_nothing() -> None:
    """A reflection without tilt grows with time as a drift does."""
    summary = decided({}, left(("ir_drift", "ir_reflection")), (), joint())
    (row,) = summary["programmes"]
    assert row["best"] is None and row["on_specimen"]["best"] is None
    assert min(t["max_cos"] for t in row["on_specimen"]["told"]) > 0.999
    assert "would distinguish them" in summary["undecided"][0]


def test_the_family_of_an_added_lamp_is_asked_with_the_lamp_on() -> None:
    on = {"lamp.absorbed": 0.02, "lamp.start": 4.0}
    here = left(**on)
    case = replace(here.case, parameters=here.case.parameters.with_free((*FREE, "lamp.absorbed")))
    here = cast(Traced, SimpleNamespace(case=case, promising=tuple, ranking=here.ranking, settings={}))
    (found,) = decisions(here, (Family(LAMP, "lamp", SETTINGS["latent_heat"]),), joint())
    assert found.as_it_was is not None and found.as_it_was.cosine > ALIKE, "what the lamp has is not taken out of its own column"
    assert in_words(found).startswith("lamp (added) or latent_heat: a coupon test cannot") and "on the specimen long-rest" in in_words(
        found
    )


def test_a_test_that_parts_too_weakly_asks_for_one_that_shows_more() -> None:
    """Half the amplitude of one member counts, if none is told later; |cos| counts with it."""

    def told(name: str, *shown: float, cosine: float = 0.5) -> Discrimination:
        programme = next(p for p in (OWN, *PROGRAMMES) if p.name == name)
        return Discrimination(programme, cosine, dict(zip(LAMP, shown, strict=True)))

    was = told("own", 1.0, 1.0)
    weak = Decision(LAMP, (), LAMP, (), "", was, (told("long-rest", 0.1, 1.1), told("stop", 0.4, 0.9)))
    assert weak.best_on_specimen is not None and weak.best_on_specimen.programme.name == "stop"
    none = replace(weak, on_specimen=weak.on_specimen[:1])
    assert none.best_on_specimen is None and "would distinguish them" in in_words(none)
    assert replace(weak, as_it_was=replace(was, cosine=0.95)).best_on_specimen is weak.on_specimen[0]
    same = (told("unloadings", 1.0, 1.0, cosine=0.0),)
    assert replace(weak, on_specimen=same).best_on_specimen is None, "0.87 of the amplitude"
    assert replace(weak, on_specimen=same, as_it_was=replace(was, cosine=0.88)).best_on_specimen is same[0], "0.47 of it"


def test_programmes_are_changes_of_the_test() -> None:
    course = course_of(pull())
    end, peak = course.time[-1], course.force.max()
    made = {p.name: p.course(course) for p in PROGRAMMES}
    assert all(np.all(np.diff(c.time) > 0.0) and c.force.max() == peak and c.time[0] == 0.0 for c in made.values())
    assert made["long-rest"].time[-1] == pytest.approx(end + REST) and made["stop"].time[-1] == pytest.approx(end + STOP)
    assert made["long-cooling"].force[-1] == 0.0 and np.interp(end + COOLING, *_of(made["long-cooling"])) == 0.0
    assert made["half-rate"].time[-1] - 2.0 == pytest.approx(2.0 * (end - 2.0)) and made["half-rate"].begin == course.begin
    falls = np.diff(made["unloadings"].force) < 0.0
    assert np.sum(np.diff(falls.astype(int)) == 1) == 2, "unloaded twice"
    half = float(course.force[course.middle])
    assert 0.0 < half < peak and np.sum(made["stop"].force == half) > 5


def _of(course: ForceCourse) -> tuple[np.ndarray, np.ndarray]:
    return course.time, course.force


def test_few_steps_and_points_stand_for_all() -> None:
    """Noise of a few values is that of the mean of all that they stand for: what a test shows does not depend on how many are kept."""
    data, time = pull(), np.linspace(0.0, 30.0, 3001)
    many = replace(data, steps={"all": LoadSteps(time, np.interp(time, TIME, PULL))})
    course = course_of(many)
    assert len(course.time) <= STEPS + 4 and course.time[course.begin] == pytest.approx(2.0, abs=0.02)
    xy = np.stack(np.meshgrid(np.linspace(-9.0, 9.0, 19), np.linspace(-20.0, 20.0, 41)), axis=-1).reshape(-1, 2)
    kept = spread(xy, POINTS)
    assert len(kept) == POINTS and np.ptp(xy[kept], axis=0).tolist() == [18.0, 40.0]
    shape = (500, len(xy))
    seen = replace(data.displacement, time=np.linspace(0.0, 30.0, 500), xy=xy, value=np.zeros((*shape, 2)))
    seen = replace(seen, sigma=np.full((*shape, 2), 0.002), mask=np.ones(shape, dtype=bool))
    sigma = planned(replace(many, displacement=seen), OWN).displacement.sigma
    assert sigma == pytest.approx(0.002 * (sigma[..., 0].size / (500 * len(xy))) ** 0.5)


def test_what_cannot_be_driven_is_told_as_before() -> None:
    assert drivable(joint()) is not None and drivable(None) is None
    assert drivable(joint("force: {drives: dic}\n")) is None
    (found,) = decisions(left(LAMP))
    assert found.as_it_was is None and in_words(found).endswith("which act on the field of temperature")
    weak = Parameters.of({**TRUTH, "M_y0": 20.0, "M_yinf": 25.0, "H_exp": 0.1}, FREE)
    assert columns(joint(), OWN, weak, Family(LAMP)) is None
    rests = replace(pull(), steps={"all": LoadSteps(TIME, 0.0 * TIME)})
    assert columns(replace(joint(), data=rests), OWN, Parameters.of(TRUTH, FREE), Family(LAMP)) is None, "never pulled"
    failed = Decision(LAMP, (), LAMP, (), "", None, (), ("own", "long-rest"))
    assert "cannot be driven as it was" in in_words(failed)
