"""Residuals of the objective (2.24): weights, relative displacements that no rigid motion reaches, noise that is what it claims."""

import numpy as np
import pytest

from thermofit.core.errors import DataError
from thermofit.observe.comparison import (
    RelativeScheme,
    neighbour_differences,
    plain,
    relative_displacements,
    rigid_free,
    temperature_change,
)
from thermofit.observe.observation import FieldObservation

X, Y = np.meshgrid(np.linspace(-10.0, 10.0, 6), np.linspace(-20.0, 20.0, 9))
XY = np.stack([X.ravel(), Y.ravel()], axis=1)
TIME = np.array([0.0, 1.0, 2.5, 4.0])
RNG = np.random.default_rng(3)


def displacement(sigma: float = 0.002, lost: bool = True) -> FieldObservation:
    value = np.stack([0.001 * t * np.stack([-0.4 * XY[:, 0], XY[:, 1]], axis=1) for t in TIME])
    mask = np.ones(value.shape[:2], dtype=bool)
    if lost:
        mask[2, [3, 17, 30]] = False
    return FieldObservation("u", TIME, XY, np.where(mask[:, :, None], value, np.nan), np.full(value.shape, sigma), mask, "mm")


def temperature() -> FieldObservation:
    value = np.stack([297.0 + 0.1 * t + 0.001 * XY[:, 1] for t in TIME])[:, :, None]
    return FieldObservation("theta", TIME, XY, value, np.full(value.shape, 0.02), np.ones(value.shape[:2], dtype=bool), "K")


def rigid(observation: FieldObservation) -> np.ndarray:
    """A small rigid motion of the deformed body, another one at every time."""
    current = observation.xy + np.nan_to_num(observation.value)
    shift, spin = RNG.normal(size=(len(TIME), 1, 2)), 1e-3 * RNG.normal(size=(len(TIME), 1))
    return shift + np.stack([-spin * current[..., 1], spin * current[..., 0]], axis=-1)


def test_rigid_body_motion_does_not_reach_du_but_reaches_u() -> None:
    observation = displacement()
    motion = rigid(observation)
    assert np.max(np.abs(rigid_free(observation).residual(motion))) < 1e-9
    assert np.max(np.abs(plain(observation).residual(motion))) > 100.0


def test_neighbour_differences_remove_translation_and_see_strain() -> None:
    observation = displacement(lost=False)
    comparison = neighbour_differences(observation, RelativeScheme("neighbour", ("xx", "yy", "xy", "yx")))
    shift = np.broadcast_to(RNG.normal(size=(len(TIME), 1, 2)), observation.value.shape)
    assert np.max(np.abs(comparison.residual(shift))) < 1e-9
    gradient = neighbour_differences(observation, RelativeScheme("gradient", ("yy",)), 1.0)
    error = np.zeros_like(observation.value)
    error[..., 1] = 0.01 * XY[:, 1]
    assert np.allclose(np.abs(gradient.residual(error)), 0.01, rtol=1e-12)
    assert gradient.unit == "1"


def test_neighbour_needs_both_points_and_counts() -> None:
    full = neighbour_differences(displacement(lost=False), RelativeScheme("neighbour", ("yy",)))
    lost = neighbour_differences(displacement(), RelativeScheme("neighbour", ("yy",)))
    assert 0 < full.n - lost.n <= 6
    assert full.n == len(TIME) * 6 * 8
    alone = FieldObservation("u", TIME, XY[:1], np.zeros((4, 1, 2)), np.ones((4, 1, 2)), np.ones((4, 1), bool), "mm")
    with pytest.raises(DataError, match="neighbours"):
        relative_displacements(alone, RelativeScheme("neighbour"))


@pytest.mark.parametrize("scheme", ["rigid-body", "neighbour", "gradient"])
def test_noise_of_the_residual_is_unit_variance_and_correlated_as_claimed(scheme: str) -> None:
    observation = displacement()
    comparison = relative_displacements(observation, RelativeScheme(scheme))
    draws = np.stack([comparison.residual(RNG.normal(scale=0.002, size=observation.value.shape)) for _ in range(3000)])
    claimed = np.eye(comparison.n) if comparison.noise is None else comparison.noise(np.eye(comparison.n))
    measured = draws.T @ draws / len(draws)
    # taking out three motions at a time lowers the variance of a point a little; nothing else may differ
    allowed = 0.15 if scheme == "rigid-body" else 0.11
    assert np.max(np.abs(measured - claimed)) < allowed + 4.0 / np.sqrt(len(draws))
    assert abs(np.trace(measured) / comparison.n - 1.0) < 0.06


@pytest.mark.parametrize("kind", ["white", "correlated"])
def test_errors_of_what_is_prescribed_are_whitened(kind: str) -> None:
    """cov = C + A A^T of the residual, C the correlation of the cameras' noise: after it 1, or what `noise` says."""
    seen = displacement(lost=False)
    plain = rigid_free(seen) if kind == "white" else neighbour_differences(seen, RelativeScheme("neighbour"))
    random = np.random.default_rng(4)
    fields = 0.01 * random.normal(size=(3, *seen.value.shape))
    columns = np.stack([plain.residual(f) for f in fields], axis=1)
    blurred = plain.blurred(columns)
    made = np.array(
        [
            blurred.residual(seen.sigma * random.normal(size=seen.value.shape) + np.tensordot(random.normal(size=3), fields, 1))
            for _ in range(4000)
        ]
    )
    before = np.array([plain.residual(seen.sigma * random.normal(size=seen.value.shape)) for _ in range(4000)])
    identity = np.eye(plain.n)
    expected = np.cov(before.T) if blurred.noise is None else blurred.noise(identity)
    assert np.linalg.norm(columns) > 10.0
    assert np.abs(np.cov(made.T) - expected).max() < 0.15
    direction = random.normal(size=seen.value.shape)
    assert blurred.slope(fields[0], direction) == pytest.approx(blurred.residual(direction))


def test_temperature_change_refers_to_the_mean_before_loading() -> None:
    observation = temperature()
    reference = np.array([True, True, False, False])
    comparison = temperature_change(observation, reference)
    offset = np.broadcast_to(RNG.normal(size=(1, len(XY), 1)), observation.value.shape)
    assert np.max(np.abs(comparison.residual(offset))) < 1e-9
    assert comparison.n == 2 * len(XY)
    assert comparison.sigma[0] == pytest.approx(0.02 * np.sqrt(1.5))
    draws = np.stack([comparison.residual(RNG.normal(scale=0.02, size=observation.value.shape)) for _ in range(4000)])
    assert comparison.noise is not None
    assert np.max(np.abs(draws.T @ draws / 4000 - comparison.noise(np.eye(comparison.n)))) < 0.1
    with pytest.raises(DataError, match="before loading"):
        temperature_change(observation, np.zeros(4, dtype=bool))


def test_weights_manual_value_and_max() -> None:
    observation = displacement(lost=False)
    error = np.full(observation.value.shape, 1e-3)
    manual = plain(observation, (5.0, 1.0)).residual(error)
    assert np.allclose(manual[::2], np.sqrt(5.0) * 1e-3) and np.allclose(manual[1::2], 1e-3)
    largest = plain(observation, "max")
    assert np.allclose(largest.residual(error)[1::2], 1e-3 / np.abs(observation.value[..., 1]).max())
    assert np.isfinite(plain(observation, "value").residual(error)).all()
    assert np.allclose(plain(observation, 4.0).residual(error), 2e-3)


def test_too_few_points_at_a_stage_are_refused() -> None:
    observation = displacement()
    observation.mask[1, 2:] = False
    with pytest.raises(DataError, match="fewer than 3 points"):
        rigid_free(observation)
