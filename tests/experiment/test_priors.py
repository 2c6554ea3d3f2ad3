"""What was declared before a test, and how well: priors of thermocouples and of effects of them in the joint objective."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from virtual_pulls import SIZE, TRUTH, data, study

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.experiment.model import Prior
from thermofit.experiment.priors import effect_priors, improbable, prior_sigma

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
