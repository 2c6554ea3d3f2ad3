"""What was declared before a test, and how well: priors of thermocouples and of effects of them in the joint objective."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from virtual_pulls import SIZE, TRUTH, data, study

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.experiment import body, many
from thermofit.experiment.interpolated import registration_sigma
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.experiment.many import SeveralExperiments
from thermofit.experiment.model import Prior
from thermofit.experiment.priors import effect_priors, improbable, off_declared, pose_bounds, prior_sigma

JAWS = "clamp_difference.difference"
OWN = "diagnosis: {priors: {theta_clamp: 0.3, clamp_difference.difference: 2.0, ir_drift.rate: 1.0e-4}}\n"


def test_jaws_that_differ_pay_in_objective_and_columns() -> None:
    """The row of the prior, its column as a fitted parameter, and as a direction of the heat equation; a drift of the jaws pays nothing."""
    case, free = study(), ("c0", JAWS)
    joint = Joint(case, data(), joint_settings(case, ("c0",), data()), SIZE, beside=effect_priors(case))
    assert [p for p in joint.model.priors if p.name == JAWS] == [Prior(JAWS, 0.0, 0.5)]
    row = [p.name for p in joint.model.priors].index(JAWS) - len(joint.model.priors)
    base = Parameters.of({**TRUTH, JAWS: 1.5}, free)
    assert joint.model.residual(base)[row] == pytest.approx(3.0)
    _, columns = joint.model.linearised(base, free)
    assert columns[row].tolist() == [0.0, 2.0]
    at_rest = Parameters.of(TRUTH, ("c0",))
    directions = [("clamp_drift.rate", {"clamp_drift.time": 1e5}), (JAWS, {})]
    residual, fitted, along = joint.scored(at_rest, ("c0",), directions)
    assert residual[row] == 0.0 and fitted[row].tolist() == [0.0] and along[row].tolist() == [0.0, 2.0]
    assert len(residual) == len(along) == len(joint.model.residual(base))
    assert np.abs(along[:row, 0]).max() > 0.0


def test_what_is_no_reading_has_no_prior() -> None:
    """Drifts, lamps, films and cameras happen: nobody declared them."""
    assert [p.name for p in effect_priors(study())] == [JAWS]
    for name in ("clamp_drift.rate", "air_drift.rate", "lamp.absorbed", "initial_gradient.amplitude", "ir_drift.rate", "c0"):
        assert prior_sigma(study(), name) is None, name


def test_a_study_says_how_well_it_was_read() -> None:
    own = study(OWN)
    found = {p.name: p.sigma for p in effect_priors(own)}
    assert found == {JAWS: 2.0, "ir_drift.rate": 1e-4}
    assert prior_sigma(own, "theta_clamp@second") == 0.3 and prior_sigma(own, "theta_air") == 0.1
    joint = Joint(own, data(), joint_settings(own, ("theta_air", "theta_clamp"), data()), SIZE)
    assert {p.name: p.sigma for p in joint.model.priors} == {"theta_air": 0.1, "theta_clamp": 0.3}
    none = study("diagnosis: {priors: {clamp_difference.difference: null, theta_air: null}}\n")
    assert effect_priors(none) == ()
    joint = Joint(none, data(), joint_settings(none, ("theta_air", "theta_clamp"), data()), SIZE)
    assert [p.name for p in joint.model.priors] == ["theta_clamp"]


@pytest.mark.parametrize("name", ["c0", "alpha_clamp", "lamp.start", "clamp_difference.difference@second", "theta_ref"])
def test_what_nobody_declared_has_no_key(name: str) -> None:
    with pytest.raises(StudyError, match=r"diagnosis\.priors.* has no declared value; expected theta_air, theta_clamp or the amplitude"):
        study(f"diagnosis: {{priors: {{{name}: 1.0}}}}\n")


def test_what_no_error_of_a_reading_explains_is_said_in_words() -> None:
    priors = (Prior("theta_clamp", 296.7, 0.1), Prior(JAWS, 0.0, 0.5))
    here = Parameters.of({**TRUTH, JAWS: 2.4})
    assert improbable(priors, here) == ""
    said = improbable(priors, here.replace(**{JAWS: 24.0}))
    assert said.startswith("clamp_difference.difference would be 24 K, 48 times the standard error of 0.5 K off the declared 0 K")
    far = here.replace(theta_clamp=297.5)
    assert "theta_clamp would be 297.5 K, 8 times" in improbable(priors, far)
    assert improbable(priors, far, far) == "", "what was so before is not held against it"
    assert improbable(priors, far.replace(theta_clamp=297.7), far) != ""


def test_a_prior_of_one_experiment_is_that_of_its_parameter() -> None:
    priors = (replace(Prior(JAWS, 0.0, 0.5), name=f"{JAWS}@second"),)
    assert improbable(priors, Parameters.of({**TRUTH, f"{JAWS}@first": 24.0})) == ""
    assert improbable(priors, Parameters.of({**TRUTH, f"{JAWS}@second": 24.0})).startswith(f"{JAWS}@second would be 24 K")


POSE = {"ir_registration.shift_y": 0.05, "ir_registration.shift_x": 0.04, "ir_registration.rotation": 1e-3, "ir_registration.scale": 2e-3}


def test_the_calibration_of_the_camera_is_data_with_an_error() -> None:
    """A small shift of the infrared image pays for itself; one that is far off is no error of the calibration, but a camera that moved."""
    case, shift = study(), "ir_registration.shift_x"
    assert {p.name: p.sigma for p in effect_priors(case, POSE) if p.name != JAWS} == POSE
    joint = Joint(case, data(), joint_settings(case, ("c0",), data()), SIZE, beside=effect_priors(case, POSE))
    row = [p.name for p in joint.model.priors].index(shift) - len(joint.model.priors)
    small = Parameters.of({**TRUTH, shift: 0.1}, ("c0", shift))
    assert joint.model.residual(small)[row] == pytest.approx(2.5)
    assert joint.model.linearised(small, ("c0", shift))[1][row].tolist() == [0.0, 25.0]
    far = small.replace(**{shift: 1.0})
    assert improbable(joint.model.priors, far) == "" and off_declared(joint.model.priors, far, 3.0) == []


def test_the_study_says_how_well_the_camera_was_calibrated() -> None:
    own = study("diagnosis: {priors: {ir_registration.shift_x: 0.3, ir_registration.scale: null}}\n")
    found = {p.name: p for p in effect_priors(own, POSE)}
    assert found["ir_registration.shift_x"] == Prior("ir_registration.shift_x", 0.0, 0.3)
    assert "ir_registration.scale" not in found and not found["ir_registration.shift_y"].firm


def test_a_diagnosis_of_fields_knows_the_error_of_the_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Joint] = []

    def told(joint: Joint, base: Parameters) -> None:
        seen.append(joint)
        raise InterruptedError

    monkeypatch.setattr(body, "told", told)
    case = study()
    with pytest.raises(InterruptedError):
        body.BodyExperiment(case, given=replace(data(), registration=POSE)).diagnosed(Parameters.of(TRUTH, ("c0",)))
    assert {p.name for p in seen[0].beside} == {JAWS, *POSE}
    assert seen[0].settings.free[-4:] == tuple(pose_bounds(case, POSE)), "and fits it with everything else"
    with pytest.raises(InterruptedError):
        body.BodyExperiment(case, given=replace(data(), registration=POSE)).diagnosed(Parameters.of(TRUTH, ("c0",)), ("c0",))
    assert seen[1].settings.free == ("c0", *pose_bounds(case, POSE)), "where names are given too"


def test_the_pose_is_fitted_within_what_an_error_of_its_landmarks_can_reach() -> None:
    """Five standard errors, the study's own where it gives one; not at all where a number of it has none, or is given."""
    shift = "ir_registration.shift_x"
    assert pose_bounds(study(), POSE) == {n: (-5.0 * s, 5.0 * s) for n, s in POSE.items()}
    own = pose_bounds(study("diagnosis: {priors: {ir_registration.shift_x: 0.3}}\n"), POSE)
    assert own[shift] == (-1.5, 1.5) and own["ir_registration.scale"] == (-0.01, 0.01)
    assert pose_bounds(study("diagnosis: {priors: {ir_registration.scale: null}}\n"), POSE) == {}
    assert pose_bounds(study(), {n: s for n, s in POSE.items() if n != shift}) == {} == pose_bounds(study(), {})
    given = study()
    assert pose_bounds(given.model_copy(update={"parameters": {**given.parameters, shift: 0.4}}), POSE) == {}


def test_every_test_has_a_camera_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of several experiments; one without landmarks has no pose that could be fitted."""
    starts = {name: value for name, value in TRUTH.items() if not name.startswith("theta")}
    whole = study("experiments:\n  first: {experiment: a}\n  second: {experiment: b}\n", starts, raw="")
    seen = {"first": replace(data(), registration=POSE), "second": data()}
    monkeypatch.setattr(body, "measured", lambda one: seen[one.run_dir.name])
    both = SeveralExperiments(whole)
    assert set(both.poses()) == {f"{n}@first" for n in POSE}
    free: list[tuple[str, ...]] = []

    def told(joint: Any, base: Parameters) -> None:
        free.extend((base.free, joint.each["first"].settings.free, joint.each["second"].settings.free))
        raise InterruptedError

    monkeypatch.setattr(many, "told", told)
    with pytest.raises(InterruptedError):
        both.diagnosed(both.start())
    assert [set(POSE) & {n.partition("@")[0] for n in names} for names in free] == [set(POSE), set(POSE), set()]


def test_errors_of_the_pose_are_those_of_its_axes() -> None:
    """Of a camera that lies on its side the row is across the load; origin in px, roll in degrees, scale in mm per px."""
    pose = {"scale_mm_per_px": 0.4, "axis_x": [1.0, 0.0], "axis_y": [0.0, -1.0]}
    doubt = {"origin_px": [0.1, 0.2], "roll_deg": 0.5, "scale_mm_per_px": 0.002}
    record: Any = SimpleNamespace(summary={"pose": pose, "uncertainty": doubt})
    found = registration_sigma(record)
    assert found["ir_registration.shift_x"] == pytest.approx(0.04) and found["ir_registration.shift_y"] == pytest.approx(0.08)
    assert found["ir_registration.rotation"] == pytest.approx(np.pi / 360.0) and found["ir_registration.scale"] == pytest.approx(0.005)
    assert registration_sigma(SimpleNamespace(summary={"pose": pose})) == {}  # type: ignore[arg-type]
