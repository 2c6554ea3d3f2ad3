"""`thermofit inject` from files to the count: on coupon records, and on a body; it resumes, and says in a sentence what it cannot do."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny
from pulled import HEAT, pulled_study
from record_studies import call, told

from thermofit.diagnose import injected
from thermofit.experiment.body import BodyExperiment
from thermofit.experiment.fields import with_identified
from thermofit.experiment.forms import experiment_of
from thermofit.experiment.verification import identified_stages
from thermofit.records.artefact import open_record
from thermofit.stages import inject
from thermofit.study.study import Study, load_study

CLOCK = ("--effect", "ir_clock", "--amplitude", "0.3")


@pytest.fixture(scope="module")
def pulled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study on one virtual record with a temperature, identified."""
    path = pulled_study(tmp_path_factory.mktemp("inject"), (*HEAT, "theta_air"), alpha_exp=11.5e-6)
    told("run", path, "--until", "identify-thermal")
    return path


@pytest.fixture(scope="module")
def first(pulled: Path) -> dict[str, Any]:
    """What the command says of a clock that is off, either way."""
    return told("inject", pulled, *CLOCK, "--count", "2")


def test_a_planted_effect_is_found_and_predicted(first: dict[str, Any], pulled: Path) -> None:
    found, predicted = first["found"], first["predicted"]
    assert (found["found"], found["runs"]) == (2, 2) and found["completeness"] == predicted["completeness"] == 1.0
    assert found["low"] == pytest.approx(0.025**0.5, rel=1e-6) and found["high"] == 1.0, "Clopper and Pearson"
    assert 0.9 < found["amplitude_over_planted"] < 1.1 and found["impostors"] == {}
    assert 0.0 < predicted["smallest"] < 0.3 < 2.0 * predicted["nine_of_ten"] + 0.3
    assert [row["offset"] for row in first["injections"]] == [0.3, -0.3]
    assert {row["answer"]: row["runs"] for row in first["answers"]}[injected.ITSELF] == 2
    assert first["verdict"].startswith("ir_clock of 0.3 s: 2 of 2 found (16 to 100 %); predicted 100 % (score ")
    assert first["parameters"]["beta"]["free"] and first["map"] == []
    record = open_record(pulled.parent / "run" / "inject-ir_clock.h5")
    assert record.stage == "inject" and record.attributes["seed"] == 1 and set(record.inputs) >= {"interpolate", "identify-thermal"}
    assert record["planted/ir_clock.offset"].unit == "s" and np.array_equal(record["loop/found"].value, [True, True])


def test_finished_runs_are_not_made_again(first: dict[str, Any], pulled: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither by the same command, which is fresh, nor by one that asks for more, nor behind a line that a kill has cut off."""
    assert told("inject", pulled, *CLOCK, "--count", "2")["fresh"]
    kept = pulled.parent / "run" / inject.KEPT
    whole = kept.read_text(encoding="utf-8")
    assert len(whole.splitlines()) == 3, "the data as they are, and two injections"
    made: list[dict[str, float]] = []
    real = inject.answered

    def counted(one: injected.Injection) -> dict[str, Any]:
        made.append({n: v for n, v in one.after.values.items() if v != one.before[n]})
        return real(one)

    monkeypatch.setattr(inject, "answered", counted)
    again = told("inject", pulled, *CLOCK, "--count", "2", "--force")
    assert made == [] and again["found"] == first["found"]
    kept.write_text(whole[: whole.rindex('"accepted"')], encoding="utf-8")
    again = told("inject", pulled, *CLOCK, "--count", "9")
    assert made == [{"ir_clock.offset": -0.3}] and again["found"]["found"] == 2
    assert any("2 of 9 injections are different" in text for text in again["remarks"])
    lines = kept.read_text(encoding="utf-8").splitlines()
    assert json.loads(lines[-1])["planted"] == {"ir_clock.offset": -0.3} and len(lines) == 4
    assert not list((pulled.parent / "run").glob(".inject*")), "evaluations go when a run is done"


def test_it_can_be_interrupted(pulled: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(one: injected.Injection) -> dict[str, Any]:
        raise KeyboardInterrupt

    monkeypatch.setattr(inject, "answered", stopped)
    result = call("inject", pulled, "--effect", "ir_clock", "--amplitude", "0.4")
    assert result.exit_code == 130 and "the same command resumes" in " ".join(result.output.split())
    assert not json.loads(json.dumps(open_record(pulled.parent / "run" / "inject-ir_clock.h5").summary["amplitude"])) == 0.4


def test_only_predicted(pulled: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inject, "answered", None)
    found = told("inject", pulled, "--effect", "ir_clock", "--amplitude", "0.001", "--predict-only")
    assert found["found"] is None and found["predicted"]["completeness"] == 0.0 and found["answers"] == []
    assert found["predicted"]["z"] < 1.0 < found["predicted"]["z_needed"]
    assert found["injections"][0]["expected"] == "missed" and "answer" not in found["injections"][0]


def test_a_loop_that_fails_is_counted_and_not_trusted(pulled: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inject, "answered", lambda one: {"failed": "no equilibrium", "wall_s": 0.1})
    found = told("inject", pulled, "--effect", "ir_clock", "--amplitude", "0.5", code=5)
    assert found["found"]["found"] == 0 and {row["answer"]: row["runs"] for row in found["answers"]}[injected.FAILED] == 1
    assert any("1 of 1 runs of the loop failed, the first with: no equilibrium" in text for text in found["remarks"])


def test_an_error_of_the_numerics_is_an_answer(pulled: Path) -> None:
    """It says so of one injection, and the others go on; a mistake of the study ends the command."""
    study = load_study(pulled)
    job = inject.diagnosis_job(study, inject.NAME)[0]
    base, _ = with_identified(study, experiment_of(study).start(), identified_stages(study))
    wrong = base.replace(M_y0=1e-3, H_exp=1e4, E=1.0)
    said = injected.answered(injected.Injection(study, identified_stages(study), False, base, wrong, "ir_clock", job))
    assert set(said) >= {"failed", "wall_s"} or said["accepted"] is not None


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--effect", "nonsense", "--amplitude", "1"), "effect 'nonsense' is not known; known are air_convection"),
        (("--effect", "ir_clock", "--amplitude", "0"), "--amplitude 0: at ir_clock.offset = 0 ir_clock is off"),
        (("--effect", "ir_clock", "--amplitude", "1", "--secondary", "place=3"), "ir_clock has no such parameter"),
        (("--effect", "ir_clock", "--amplitude", "1", "--secondary", "place"), "--secondary place: expected NAME=VALUE with a number"),
        (("--effect", "lamp", "--amplitude", "1"), "--effect lamp is none that these data could show; can be planted: air_drift"),
    ],
)
def test_what_cannot_be_planted_is_one_sentence(pulled: Path, options: tuple[str, ...], said: str) -> None:
    result = call("inject", pulled, *options)
    text = " ".join(result.output.split())
    assert result.exit_code == 2 and said in text and "Traceback" not in text, text


def test_without_an_identified_result_it_says_what_to_run(tmp_path: Path) -> None:
    path = pulled_study(tmp_path, HEAT)
    result = call("inject", path, *CLOCK)
    assert result.exit_code == 2 and "thermofit run pulled.yaml --until identify-elastic" in " ".join(result.output.split()), result.output


def test_what_is_planted_into_a_body(study_of: Callable[..., Study]) -> None:
    """The model with the effect misses the planted fields by what it misses the others without it; what drives it stays."""
    study = study_of()
    here = experiment_of(study)
    assert isinstance(here, BodyExperiment)
    base, _ = with_identified(study, here.start(), identified_stages(study))
    joint = here.joint(here.joint_settings(), base)
    base = base.with_free(joint.settings.free)
    after = base.replace(**{"rate_logarithmic.C": 0.01, "lamp.absorbed": 0.02, "lamp.start": 20.0, "ir_gain.gain": 0.05})
    there = here.planted(base, after)
    planted = there.joint(there.joint_settings(), base).model
    with_it, without = planted.errors(after), joint.model.errors(base)
    assert set(with_it) == {"u", "theta"}
    for name, error in without.items():
        assert np.allclose(with_it[name], error, rtol=0.0, atol=1e-9, equal_nan=True), name
    # What is compared of a displacement is referred to the measured position, so that rows differ by a little of their noise.
    assert planted.residual(after) == pytest.approx(joint.model.residual(base), abs=0.05)
    changed = planted.residual(base) - joint.model.residual(base)
    for k, c in enumerate(joint.model.comparisons):
        at = sum(one.n for one in joint.model.comparisons[:k])
        assert np.abs(changed[at : at + c.n]).max() > 0.5, c.channel
    assert np.array_equal(there.data.force.value, here.data.force.value) and np.array_equal(
        there.data.steps["all"].force, here.data.steps["all"].force
    )
    if here.data.stretched is not None and there.data.stretched is not None:
        assert not np.array_equal(there.data.stretched.elongation, here.data.stretched.elongation)
    same = here.planted(base, base.replace(**{"lamp.start": 20.0})).data
    assert np.array_equal(same.displacement.value, here.data.displacement.value, equal_nan=True)


@pytest.mark.slow
def test_a_body_from_raw_files_to_the_map(tmp_path: Path) -> None:
    """A source of heat at a place and from a time on, planted into a virtual test: found, predicted, and drawn on a map."""
    content = tiny.tree(tmp_path / "run")
    content["parameters"]["kappa"] = 133.0
    content["simulate"] |= {"ir": {"frames": 44, "image_shape": [150, 90]}}
    for key in ("gridsearch", "sensitivity"):
        content.pop(key)
    study = load_study(tiny.write(tmp_path, content))
    for name in ("simulate", "calibrate-ir", "interpolate", "identify-elastic", "identify-plastic", "identify-thermal"):
        tiny.stage_run(name)(study)
    options = inject.InjectOptions("local_source", 0.5, 3, {"width": 4.0})
    only = inject.run(study, replace(options, predict_only=True)).record.summary
    assert only["predicted"]["completeness"] == 1.0 and only["predicted"]["smallest"] < 0.25
    assert len(only["map"]) >= 1 and all(0.0 < cell["smallest"] for cell in only["map"]) and Path(only["figures"][inject.FIGURE]).exists()
    found = inject.run(study, options).record.summary
    assert found["found"]["found"] >= 2 and found["predicted"] == only["predicted"]
    assert sum(cell["run"] for cell in found["map"]) == 3 and sum(cell["found"] for cell in found["map"]) == found["found"]["found"]
