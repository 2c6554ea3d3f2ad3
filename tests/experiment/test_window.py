"""The elastic window is found from the data: it ends before the knee and holds every stage that it may."""

import dataclasses

import numpy as np
import pytest
from made_up import uniaxial_test

from thermofit.core.errors import DataError
from thermofit.experiment.window import axial_strain, elastic_window, window_times


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_window_ends_below_the_knee(noise: float) -> None:
    found = elastic_window(uniaxial_test(noise=noise))
    assert 5.5 <= found.t1 <= 7.0
    assert found.loaded_stages >= 6
    assert "loaded stages" in found.remark


def test_axial_strain_and_its_error() -> None:
    data = uniaxial_test()
    strain, error = axial_strain(data.displacement)
    assert strain[:2] == pytest.approx(0.0, abs=1e-15)
    draws = [
        axial_strain(dataclasses.replace(uniaxial_test(noise=0.0).displacement, value=_noisy(data.displacement.value, k)))[0]
        for k in range(300)
    ]
    assert np.std(draws, axis=0).mean() == pytest.approx(error.mean(), rel=0.1)


def _noisy(value: np.ndarray, seed: int) -> np.ndarray:
    return value + 0.002 * np.random.default_rng(seed).normal(size=value.shape)


def test_no_elastic_stage_is_said() -> None:
    data = uniaxial_test()
    late = dataclasses.replace(data, displacement=data.displacement.between(0.0, 2.0))
    with pytest.raises(DataError, match=r"stages\.elastic\.window"):
        elastic_window(late)


def test_named_windows() -> None:
    data = uniaxial_test()
    steps = data.steps["displacement"]
    assert window_times("all", data, steps)[:2] == (0.0, 107.0)
    assert window_times((1.0, 5.0), data, steps)[:2] == (1.0, 5.0)
    assert window_times("auto", data, steps)[2].startswith("elastic window found")
