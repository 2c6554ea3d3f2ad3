"""The loop on small bodies: two tests fitted jointly, a third that no fit sees; what all share is proved on it, what one has is named."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest
from virtual_pulls import FORCE, TRUTH, pulled, study

from thermofit.core.errors import StudyError
from thermofit.core.jit import set_threads
from thermofit.diagnose.decide import decided
from thermofit.diagnose.loop import Closed, close_loop
from thermofit.diagnose.prepared import Prepared, prepared
from thermofit.diagnose.study_with_effects import study_text
from thermofit.diagnose.unlisted_loop import ended
from thermofit.experiment import body
from thermofit.experiment.body import BodyExperiment
from thermofit.experiment.fields import Measured
from thermofit.experiment.forms import experiment_of
from thermofit.experiment.many import SeveralExperiments
from thermofit.records.staging import Job
from thermofit.report.findings import diagnosis_parameters, loop_summary
from thermofit.report.unlisted import described, with_unlisted
from thermofit.study.study import Study

OTHER = {"alpha_air": 40.0, "alpha_clamp": 900.0, "theta_air": 300.0, "theta_clamp": 295.5, "theta_ref": 295.5}
THIRD = {"theta_air": 298.0, "theta_clamp": 296.0, "theta_ref": 296.0}
LAMP = {"lamp.absorbed": 0.01, "lamp.start": 12.0}
STARTS = {name: value for name, value in TRUTH.items() if not name.startswith("theta")} | {"alpha_exp": 0.0}
FREE = "stages: {elastic: {free: [E]}, plastic: {free: [M_y0]}, thermal: {free: [c0, alpha_air]}}\ndiagnosis: {max_effects: 2}\n"
ONE_OF_THREE = "experiments:\n  third: {experiment: c, held_out: true}\n"
TWO_OF_THREE = (
    "experiments:\n  first: {experiment: a}\n  second: {experiment: b, parameters: {alpha_air: 40.0, alpha_clamp: 900.0}}\n"
    "  third: {experiment: c, held_out: true, parameters: {alpha_air: 15.0}}\n"
)


@lru_cache(maxsize=1)
def pulls() -> dict[str, Any]:
    """First and third under one boundary; the second under another, with a lamp on it. None of the models expands."""
    set_threads(1)
    return {"first": pulled(), "second": pulled(OTHER | LAMP, 0.9 * FORCE, seed=8), "third": pulled(THIRD, 0.95 * FORCE, seed=11)}


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """What `interpolate` would have left."""

    def left(one: Study) -> Measured:
        return pulls()[one.run_dir.name if one.run_dir.name in pulls() else "first"]

    monkeypatch.setattr(body, "measured", left)


def looped(whole: Study, folder: Path) -> tuple[Prepared, Closed]:
    found = prepared(whole, Job("close-loop", folder / "close-loop.h5", {}, {}), ())
    return found, close_loop(found.case, found.fit, found.refit, whole.diagnosis.max_effects, found.numerical)


def test_two_tests_are_traced_together_and_a_third_judges(measured: None, tmp_path: Path) -> None:
    whole = study(TWO_OF_THREE + FREE, STARTS, raw="")
    found, closed = looped(whole, tmp_path)
    assert set(closed.accepted) == {"thermal_expansion", "lamp@second"}, [s.effect for s in closed.first.ranking.scores[:4]]
    proofs = {t.score.effect: t.proof for r in closed.rounds for t in r.trials if t.refused == ""}
    shared, own = proofs["thermal_expansion"], proofs["lamp@second"]
    assert shared is not None and shared.on == "experiment third" and own is not None and own.on == ""
    last = closed.last.case.parameters
    assert last["alpha_exp"] == pytest.approx(2e-5, rel=0.1)
    assert last["lamp.absorbed@second"] == pytest.approx(0.01, rel=0.2) and last["lamp.absorbed@first"] == 0.0
    said = loop_summary(found, closed, tmp_path / "with-effects.yaml")
    for channel in ("dtheta@first", "dtheta@second", "dtheta@experiment third"):
        assert said["after"]["held_out"][channel] < 1.2 * said["after"]["floor"][channel], channel
    assert said["before"]["held_out"]["dtheta@experiment third"] > 1.5 * said["after"]["held_out"]["dtheta@experiment third"]
    ending, missing = ended(closed, found.refit, found.numerical, whole.diagnosis.held_out)
    assert ending.accepted == closed.accepted and missing is None
    told = decided(said, closed.rounds[1].traced)["programmes"]
    assert any("lamp@second" in row["no_coupon_feels"] for row in told)
    assert with_unlisted(said, described(whole, closed.last, missing))["unlisted"] is None
    assert "added" in said["verdict"] and "held-out dtheta@experiment third" in said["verdict"]
    assert {row["phase"].split()[0] for row in said["lack_of_fit"]} == {"first", "second"}
    assert said["channels"]["du@second"]["unit"] == "mm"
    assert diagnosis_parameters(whole, closed.last.case, closed.fit)["lamp.absorbed@second"].unit == "mW/mm^2"


def test_one_test_is_traced_and_another_judges(measured: None, tmp_path: Path) -> None:
    """The material carries over; the film coefficient of the fitted test does where the other has none of its own."""
    whole = study(ONE_OF_THREE + FREE, STARTS)
    found, closed = looped(whole, tmp_path)
    assert closed.accepted == ("thermal_expansion",)
    proof = closed.rounds[0].trials[0].proof
    assert proof is not None and proof.on == "experiment third" and proof.gain > 0.3
    said = loop_summary(found, closed, tmp_path / "with-effects.yaml")
    assert said["after"]["held_out"]["dtheta@experiment third"] < 1.2 * said["after"]["floor"]["dtheta@experiment third"]
    assert said["held_out"].startswith("experiment third, which no fit has seen")
    for others, grade in ((("lamp",), "named-as-family"), ((), "named")):
        told = loop_summary(found, replace(closed, stand_ins={"thermal_expansion": others}), tmp_path / "with-effects.yaml")
        assert told["grade"] == grade
        assert ("the data do not tell thermal_expansion from lamp" in told["doubts"]) is bool(others)
        assert not (others and told["trustworthy"])


def test_the_study_with_effects_of_one_test_reads(measured: None, tmp_path: Path) -> None:
    """Params of one experiment stand under their full name and act in it alone."""
    from types import SimpleNamespace
    from typing import cast

    import yaml

    from thermofit.core.parameters import Parameters
    from thermofit.experiment.several import seen_by
    from thermofit.study.study import load_study

    text = {"name": "three", "experiments": {"first": {"experiment": "a"}, "second": {"experiment": "b"}}, "parameters": dict(STARTS)}
    file = tmp_path / "three.yaml"
    file.write_text(yaml.safe_dump(text), encoding="utf-8")
    whole = load_study(file, [f"run_dir={tmp_path}"])
    parameters = Parameters.of(
        {**STARTS, "lamp.absorbed@second": 0.05, "lamp.start@second": 12.0}, ("lamp.absorbed@second", "lamp.start@second")
    )
    closed = SimpleNamespace(accepted=("lamp@second",), last=SimpleNamespace(case=SimpleNamespace(parameters=parameters)))
    made = tmp_path / "with-effects.yaml"
    made.write_text(study_text(whole, cast(Closed, closed)), encoding="utf-8")
    again = load_study(made)
    tests = tuple(BodyExperiment(again.one_of(n), n, pulls()[n]) for n in ("first", "second"))
    start = SeveralExperiments(again, tests).start()
    assert seen_by(start, "second")["lamp.absorbed"] == 0.05 and seen_by(start, "second")["lamp.start"] == 12.0
    assert seen_by(start, "first")["lamp.absorbed"] == 0.0


def test_a_held_out_test_that_is_not_interpolated_is_named(tmp_path: Path) -> None:
    whole = study(ONE_OF_THREE + FREE, STARTS)
    with pytest.raises(StudyError, match="thermofit interpolate"):
        experiment_of(whole).unseen[0].experiment.start()
