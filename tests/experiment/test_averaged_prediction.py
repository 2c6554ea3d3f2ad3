"""Observations that are means over patches: the prediction goes through the same means, in the residual and in its derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.virtual_pulls import SIZE, TRUTH, pulled, study

from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import Measured, temperature_of
from thermofit.experiment.force_error import with_force_error
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.experiment.model import StageModel, stage_model
from thermofit.observe.observation import FieldObservation

BODY = ("E", "M_y0", "F", "c0", "beta")
SEEN = ("ir_gain.gain", "ir_registration.shift_y", "dic_scale.error")


def means(field: FieldObservation, seed: int) -> FieldObservation:
    """The observation as means over patches of a few millimetres that are others at every time."""
    rng, shape = np.random.default_rng(seed), field.mask.shape
    moments = np.concatenate([rng.uniform(-1.0, 1.0, (*shape, 2)), rng.uniform(0.0, 0.6, (*shape, 3))], axis=2)
    one = replace(field, moments=moments)
    return replace(one, value=one.averaged(field.value))


@pytest.fixture(scope="module")
def data() -> Measured:
    """A test without noise, seen as means over patches."""
    plain = pulled(noise=0.0)
    return replace(plain, displacement=means(plain.displacement, 1), temperature=means(temperature_of(plain), 2))


@pytest.fixture(scope="module")
def staged(data: Measured) -> tuple[StageModel, Parameters]:
    """A stage of both fields without effects of the instruments."""
    case = study("stages:\n  plastic: {free: [E, M_y0, F, c0, beta], channels: {du: {}, dtheta: {}}}\n")
    settings = case.stage("plastic")
    base = Parameters.of(TRUTH).with_free(settings.free)
    return stage_model(case, data, settings, base, SIZE, (0.0, 40.0, "")), base


@pytest.fixture(scope="module")
def joint(data: Measured) -> tuple[Joint, Parameters]:
    """The joint problem with instruments that show more than the fields."""
    case = study()
    free = (*BODY, *SEEN)
    base = Parameters.of(TRUTH).with_free(free)
    return Joint(case, data, joint_settings(case, free, data), SIZE), base


def test_the_residual_vanishes_at_the_truth(staged: tuple[StageModel, Parameters], joint: tuple[Joint, Parameters]) -> None:
    model, base = staged
    assert np.abs(model.residual(base)).max() < 2e-2
    assert np.abs(joint[0].model.residual(joint[1])).max() < 2e-2


def test_taylor_through_the_whole_residual(staged: tuple[StageModel, Parameters], joint: tuple[Joint, Parameters]) -> None:
    """What the derivatives leave of the residual is of the second order in the step, for body and instruments."""
    steps = {"E": 300.0, "M_y0": 1.0, "F": 0.01, "c0": 0.02, "beta": 0.02, "ir_gain.gain": 0.01, "ir_registration.shift_y": 0.3}
    for model, base in (staged, (joint[0].model, joint[1])):
        names = base.free
        way = np.array([steps.get(name, 1e-3) for name in names])
        residual, jacobian = model.linearised(base, names)
        left = []
        for size in (1.0, 0.5, 0.25):
            moved = base.replace(**{name: base[name] + size * step for name, step in zip(names, way, strict=True)})
            left.append(np.linalg.norm(model.residual(moved) - residual - size * (jacobian @ way)))
        assert left[0] < 0.1 * np.linalg.norm(jacobian @ way)
        rate = np.log2(np.array(left[:-1]) / left[1:])
        assert (rate > 1.8).all(), rate


def test_the_means_matter(staged: tuple[StageModel, Parameters], data: Measured) -> None:
    """Without them the prediction would be off by many times the noise."""
    model, base = staged
    bare = replace(data, displacement=replace(data.displacement, moments=None))
    case = study("stages:\n  plastic: {free: [E, M_y0, F], channels: {du: {}}}\n")
    plain = stage_model(case, bare, case.stage("plastic"), base, SIZE, (0.0, 40.0, ""))
    assert np.abs(plain.residual(base)).max() > 3.0 > np.abs(model.residual(base)).max()


def test_what_an_error_of_the_force_makes_goes_through_the_means(joint: tuple[Joint, Parameters], data: Measured) -> None:
    problem, base = joint
    steps = {name: replace(one, error=np.ones((len(one.time), 1))) for name, one in data.steps.items()}
    whole = replace(data, steps=steps)
    bare = replace(whole, displacement=replace(data.displacement, moments=None))
    fields = []
    for one in (whole, bare):
        found = with_force_error(replace(problem, data=one), base).force_error
        assert found is not None
        fields.append(found["u"].fields[..., 0] * found["u"].turned[0, 0])
    seen, plain = fields
    np.testing.assert_allclose(seen, data.displacement.averaged(plain), atol=1e-9)
    assert np.abs(seen - plain).max() > 0.01 * np.abs(plain).max() > 0.0
